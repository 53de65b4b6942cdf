"""A command belongs to the Task, the gesture to the person; what is theirs survives."""

import asyncio
from collections.abc import Callable

import pytest
from sqlalchemy import Engine

from handover.database import connect
from handover.errors import Problem
from handover_gloves.calibration.glove_store import Fit, GloveStore, StoredGlove
from handover_gloves.configuration.gestures_file import built_in, parse
from handover_gloves.people.people import People
from handover_gloves.people.person import OwnGesture
from handover_gloves.people.store import PeopleStore
from handover_gloves.recognition.gestures import Shape
from handover_gloves.recognition.thresholds import M2O2P_THRESHOLDS

Open = Callable[..., People]
MINE = OwnGesture(Shape("20000"))


@pytest.fixture
def open_people(database: Engine) -> Open:
    """Open the people of a site, as a start of the controller does."""
    return lambda site=None: People(site or built_in(), PeopleStore(database))


async def refused(work: object) -> Problem:
    with pytest.raises(Problem) as problem:
        await work  # type: ignore[misc] - a coroutine
    return problem.value


async def test_what_is_a_persons_own_survives(open_people: Open) -> None:
    people = open_people()
    assert await people.add("anna", "Anna Virtanen")
    assert not await people.add("anna", None)
    await people.define("anna", "Mine", MINE)
    await people.define("anna", "Both", OwnGesture(Shape(left="22222", right="Mine")))
    await people.set_commands("anna", {3: "mine", 8: None}, whole=True)
    again = open_people()
    assert again.named("anna") == people.named("anna")
    assert again.named("anna").title == "Anna Virtanen"
    assert again.commands_of("anna").gestures[3] == "Mine"
    assert 8 not in again.commands_of("anna").gestures
    assert again.gestures_of("anna").parts_of("Both")[1].code == "20000"
    assert again.commands_of("ben").gestures[3] == "Thumbs up"
    assert again.gestures_of(None).find("Mine") is None


async def test_two_gestures_are_exchanged_at_once_but_none_stands_for_two(open_people: Open) -> None:
    people = open_people()
    await people.add("anna", None)
    problem = await refused(people.set_commands("anna", {3: "Horns"}, whole=False))
    assert problem.status == 422
    assert '"Horns" stands for the commands 3 and 8 for anna; give one of them another' in problem.detail
    await people.set_commands("anna", {3: "Horns", 8: "Thumbs up"}, whole=False)
    assert people.commands_of("anna").ids["Horns"] == 3
    await people.set_commands("anna", {1: None}, whole=False)
    assert people.named("anna").commands == {1: None, 3: "Horns", 8: "Thumbs up"}
    problem = await refused(people.reset_command("anna", 3))
    assert "stands for the commands 3 and 8" in problem.detail
    await people.reset_command("anna", 1)
    assert people.commands_of("anna").gestures[1] == "Point with index"
    problem = await refused(people.set_commands("anna", {4: "Wave"}, whole=False))
    assert 'command 4 has the unknown gesture "Wave"' in problem.detail


async def test_a_gesture_too_near_another_is_refused_with_its_name_and_distance(open_people: Open) -> None:
    people = open_people()
    await people.add("anna", None)
    problem = await refused(people.define("anna", "My horns", OwnGesture(Shape("20220"))))
    assert (problem.status, problem.title) == (409, "Too near")
    assert '"My horns" cannot be kept: it is "Horns" (code 20220, no finger differs)' in problem.detail
    assert problem.extra is not None
    assert (problem.extra["nearest"]["gesture"], problem.extra["nearest"]["distance"]) == ("Horns", 0)
    is_new, nearest = await people.define("anna", "Mine", MINE)
    assert is_new
    assert nearest is not None
    assert nearest.distance == 1
    assert (await people.define("anna", "Mine", OwnGesture(Shape("02200"))))[0] is False
    problem = await refused(people.define("anna", "Other", MINE, unreliable=["index", "thumb", "ring"]))
    assert "hardly separates bent from straight" in problem.detail


@pytest.mark.parametrize(
    ("name", "shape", "status", "words"),
    [
        ("Horns", Shape("20000"), 422, 'there is a gesture "Horns" already'),
        ("Mine", Shape("20001"), 422, "a code is five states"),
        ("Mine", Shape("22222"), 409, "the fist is how a hand rests"),
        ("a/b", Shape("20000"), 422, "without a slash"),
        ("20000", Shape("20000"), 422, "no bare code"),
        ("Mine", Shape(sequence=("Horns", "Wave")), 422, 'the unknown part "Wave"'),
    ],
)
async def test_a_gesture_that_cannot_be_is_refused(
    open_people: Open, name: str, shape: Shape, status: int, words: str
) -> None:
    people = open_people()
    await people.add("anna", None)
    problem = await refused(people.define("anna", name, OwnGesture(shape)))
    assert problem.status == status
    assert words in problem.detail
    assert people.named("anna").gestures == {}


async def test_a_deleted_gesture_gives_its_command_back_but_not_while_another_needs_it(
    open_people: Open,
) -> None:
    people = open_people()
    await people.add("anna", None)
    await people.define("anna", "Mine", MINE)
    await people.define("anna", "Twice", OwnGesture(Shape(sequence=("Mine", "Horns"))))
    await people.set_commands("anna", {3: "Mine"}, whole=False)
    problem = await refused(people.drop_gesture("anna", "Mine"))
    assert problem.status == 409
    assert 'gesture "Twice" has the unknown part "Mine"' in problem.detail
    assert await people.drop_gesture("anna", "Twice") == []
    assert await people.drop_gesture("anna", "Mine") == [3]
    assert people.commands_of("anna").gestures[3] == "Thumbs up"
    assert (await refused(people.drop_gesture("anna", "Mine"))).status == 404


async def test_conflicts_with_the_site_are_reported_and_the_rest_still_works(open_people: Open) -> None:
    people = open_people()
    await people.add("anna", None)
    await people.define("anna", "Mine", MINE)
    await people.define("anna", "Other", OwnGesture(Shape("02200")))
    await people.set_commands("anna", {3: "Mine", 4: "Other", 5: "Ring straight", 16: None}, whole=True)
    site = parse("gestures: {Thumbs up: 02222, Theirs: 20000}\ncommands: {3: Thumbs up, 6: Theirs}")
    changed = open_people(site)
    faults = changed.faults_of("anna")
    assert any('gesture "Mine" has the code 20000, which "Theirs" already has' in fault for fault in faults)
    assert any('command 5 has the unknown gesture "Ring straight"' in fault for fault in faults)
    assert changed.commands_of("anna").gestures == {3: "Thumbs up", 4: "Other", 6: "Theirs"}


async def test_changes_that_come_at_once_are_all_kept(open_people: Open) -> None:
    people = open_people()
    await people.add("anna", None)
    free = ["00002", "00200", "00202", "02000", "02002", "02022", "02200", "02202", "20000"]
    await asyncio.gather(
        *(people.define("anna", f"Mine {code}", OwnGesture(Shape(code))) for code in free),
        *(people.set_commands("anna", {command: None}, whole=False) for command in range(1, 9)),
        people.add("anna", "Anna"),
    )
    again = open_people().named("anna")
    assert len(again.gestures) == len(free)
    assert set(again.commands) == set(range(1, 9))
    assert again.title == "Anna"


async def test_people_and_gloves_are_kept_in_postgresql_too(new_database: Callable[[], str]) -> None:
    engine = connect(new_database())
    people, gloves = People(built_in(), PeopleStore(engine)), GloveStore(engine)
    assert gloves.load() == {}
    await people.add("anna", "Anna")
    await people.define("anna", "Mine", MINE)
    await people.set_commands("anna", {3: "Mine", 8: None}, whole=True)
    glove, fit = StoredGlove("glove-1", person="anna"), Fit(M2O2P_THRESHOLDS, learnt={"a": [1.5, None]})
    kept = gloves.save_fit(glove, "anna", fit)
    again = PeopleStore(engine).load()["anna"]
    assert again == people.named("anna")
    assert (GloveStore(engine).load(), GloveStore(engine).fits()) == (
        {"glove-1": glove},
        {("glove-1", "anna"): kept},
    )
    await people.remove("anna")
    assert (PeopleStore(engine).load(), GloveStore(engine).fits()) == ({}, {})
    engine.dispose()


async def test_nobody_is_known_who_was_never_named(open_people: Open) -> None:
    people = open_people(
        parse("persons: {ben: {3: Ring straight, 16: Thumbs up}}\ngloves: {g: {person: carl}}")
    )
    assert people.names() == ["ben", "carl"]
    problem = await refused(people.set_commands("anna", {}, whole=True))
    assert (problem.status, problem.title) == (404, "Unknown person")
    assert "known: ben, carl" in problem.detail
    assert (await refused(people.add("An na", None))).status == 422
    await people.set_commands("ben", {4: None}, whole=False)
    assert people.commands_of("ben").gestures[3] == "Ring straight"
    await people.remove("ben")
    assert 4 in people.commands_of("ben").gestures
