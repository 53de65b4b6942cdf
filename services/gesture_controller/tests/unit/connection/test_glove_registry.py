"""Gloves are known from the file, by declaration and by hello; their thresholds survive a restart."""

import asyncio
import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Engine, select

from handover.errors import Problem
from handover_gloves import tables
from handover_gloves.calibration.glove_store import Fit, GloveStore
from handover_gloves.configuration.gestures_file import Configuration, built_in, parse
from handover_gloves.connection.admission import TokenStore
from handover_gloves.connection.glove_registry import GloveRegistry, TooManyGloves
from handover_gloves.gloves.connection_state import ConnectionRefused
from handover_gloves.gloves.glove import Glove
from handover_gloves.people.people import People
from handover_gloves.people.person import OwnGesture, Person
from handover_gloves.people.store import PeopleStore
from handover_gloves.people.study_condition_store import StudyConditionStore
from handover_gloves.prompting.prompt import GesturePrompt, PromptSpec
from handover_gloves.recognition.frames import Frame, Hello
from handover_gloves.recognition.gestures import Shape
from handover_gloves.recognition.thresholds import M2O2P_THRESHOLDS, Threshold
from handover_gloves.settings import ControllerSettings

Open = Callable[..., GloveRegistry]


@pytest.fixture
def open_gloves(tmp_path: Path, database: Engine, listener_log: Any) -> Open:
    """Open the gloves of a data directory, as a start of the controller does."""

    def begin(
        site: Configuration | None = None, adopted: Callable[[Glove], None] = lambda _: None, **overrides: Any
    ) -> GloveRegistry:
        settings = ControllerSettings.load(data_dir=tmp_path, **overrides)
        known = site or built_in()
        people = People(known, PeopleStore(database))
        return GloveRegistry(
            settings,
            store=GloveStore(database),
            tokens=TokenStore(database),
            people=people,
            conditions=StudyConditionStore(database),
            listener=listener_log,
            adopted=adopted,
        )

    return begin


async def test_thresholds_survive_a_restart_and_can_be_taken_back(open_gloves: Open) -> None:
    gloves = open_gloves()
    glove = gloves.known.named("glove-1")
    await gloves.fits.set_thresholds(glove, {"ring": {"upper": 700, "lower": 600}})
    await gloves.fits.set_thresholds(glove, {"thumb": {"upper": 500, "lower": 400}})
    gloves = open_gloves()
    glove = gloves.known.named("glove-1")
    assert glove.reader.config.thresholds.fingers[0] == Threshold(500, 400)
    assert glove.reader.config.thresholds.fingers[3] == Threshold(700, 600)
    await gloves.fits.restore(glove)
    assert glove.reader.config.thresholds.fingers[0] == Threshold(1000, 800)
    assert glove.reader.config.thresholds.fingers[3] == Threshold(700, 600)
    gloves = open_gloves()
    await gloves.fits.restore(gloves.known.named("glove-1"))
    assert gloves.known.named("glove-1").reader.config.thresholds.fingers[0] == Threshold(500, 400)


async def test_thresholds_that_are_set_at_once_are_all_kept(open_gloves: Open) -> None:
    gloves = open_gloves()
    glove = gloves.known.named("glove-1")
    fingers = ("thumb", "index", "middle", "ring", "little")
    await asyncio.gather(
        *(
            gloves.fits.set_thresholds(glove, {finger: {"upper": 2000 + place}})
            for place, finger in enumerate(fingers)
        )
    )
    for known in (gloves, open_gloves()):
        uppers = [finger.upper for finger in known.known.named("glove-1").reader.config.thresholds.fingers]
        assert uppers == [2000, 2001, 2002, 2003, 2004]


async def test_two_gloves_of_one_hand_are_never_worn_by_one_person(open_gloves: Open) -> None:
    gloves = open_gloves()
    for name in ("a", "b", "c"):
        await gloves.declare(name, None, None)
    await asyncio.gather(*(gloves.wearers.wear(gloves.known.named(name), "anna") for name in ("a", "b", "c")))
    for known in (gloves, open_gloves()):
        assert len(known.known.worn_by("anna")) == 1


async def test_wrong_thresholds_change_nothing(open_gloves: Open) -> None:
    gloves = open_gloves()
    glove = gloves.known.named("glove-1")
    before = glove.reader.config.thresholds
    with pytest.raises(Problem, match="ring: the lower threshold 900 is above") as refused:
        await gloves.fits.set_thresholds(
            glove, {"thumb": {"upper": 999}, "ring": {"upper": 800, "lower": 900}}
        )
    assert refused.value.status == 422
    assert (
        glove.reader.config.thresholds
        == before
        == open_gloves().known.named("glove-1").reader.config.thresholds
    )
    with pytest.raises(Problem, match="were never changed"):
        await gloves.fits.restore(glove)


async def test_the_profile_chooses_what_reads_the_hand_and_the_setting_where_it_does_not(
    open_gloves: Open,
) -> None:
    gloves = open_gloves(recognizer="personal")
    glove = gloves.known.named("glove-1")
    for person in ("anna", "ben"):
        await gloves.wearers.wear(glove, person)
        await gloves.fits.calibrate(glove, [[300.0] * 5] * 20, [[700.0] * 5] * 20)
    await gloves.records.save_fit(glove, replace(gloves.records.fit_of(glove), recognizer="thresholds"))
    gloves = open_gloves(recognizer="personal")
    glove = gloves.known.named("glove-1")
    assert (glove.person, glove.reader.config.recognizer_name) == ("ben", "thresholds")
    await gloves.wearers.wear(glove, "anna")
    assert (glove.reader.config.recognizer_name, glove.reader.config.missing) == ("personal", None)
    assert open_gloves().known.named("glove-1").reader.config.recognizer_name == "thresholds"


async def test_a_calibration_is_kept(open_gloves: Open) -> None:
    gloves = open_gloves()
    await gloves.fits.calibrate(gloves.known.named("glove-1"), [[300.0] * 5] * 20, [[700.0] * 5] * 20)
    assert open_gloves().known.named("glove-1").reader.config.thresholds.fingers[2] == Threshold(620, 520)


async def test_a_calibration_that_fails_names_the_finger_and_changes_nothing(open_gloves: Open) -> None:
    gloves = open_gloves()
    glove = gloves.known.named("glove-1")
    before = glove.reader.config.thresholds
    with pytest.raises(Problem, match="thumb: the sensor does not rise"):
        await gloves.fits.calibrate(glove, [[300.0] * 5] * 20, [[300.0, 700, 700, 700, 700]] * 20)
    assert glove.reader.config.thresholds == before


async def test_a_declared_glove_is_known_after_a_restart(open_gloves: Open) -> None:
    declared, is_new = await open_gloves().declare("glove-2", "left", "ben")
    assert is_new
    assert (declared.hand, declared.person) == ("left", "ben")
    gloves = open_gloves()
    again, is_new = await gloves.declare("glove-2", None, None)
    assert not is_new
    assert (again.hand, again.person) == ("left", "ben")


async def test_a_declaration_that_cannot_be_is_refused(open_gloves: Open) -> None:
    gloves = open_gloves(max_gloves=2)
    for name, hand, person, status, words in (
        ("a b", None, None, 422, "cannot be called"),
        ("glove-1", "left", None, 409, "is the right glove of operator-1"),
        ("glove-2", None, "operator-1", 409, "operator-1 wears glove-1"),
    ):
        with pytest.raises(Problem, match=words) as refused:
            await gloves.declare(name, hand, person)
        assert refused.value.status == status
    await gloves.declare("glove-2", None, None)
    with pytest.raises(Problem, match="2 gloves at most"):
        await gloves.declare("glove-3", None, None)


def test_an_unknown_glove_is_a_404_that_names_the_known(open_gloves: Open) -> None:
    with pytest.raises(Problem, match='there is no glove "glove-9"; known: glove-1') as missing:
        open_gloves().known.named("glove-9")
    assert missing.value.status == 404


def test_every_glove_is_adopted_once(open_gloves: Open) -> None:
    adopted: list[str] = []
    gloves = open_gloves(
        parse("gloves: {left-1: {hand: left}, right-1: {}}"), lambda glove: adopted.append(glove.name)
    )
    link: Any = object()
    for name in ("left-1", "new", "new"):
        gloves.connect(Hello(name), link, 1.0)
    assert adopted == ["left-1", "right-1", "new"]
    assert [glove.name for glove in gloves.known] == adopted


def test_the_gloves_of_the_file_are_known_even_if_they_are_many(open_gloves: Open) -> None:
    gloves = open_gloves(parse("gloves: {a: {}, b: {}, c: {}}"), max_gloves=2)
    assert len(list(gloves.known)) == 3
    with pytest.raises(TooManyGloves):
        gloves.connect(Hello("d"), object(), 1.0)  # type: ignore[arg-type]


def test_a_person_with_own_gestures_shows_them_with_their_glove(open_gloves: Open) -> None:
    site = parse("persons: {anna: {3: Horns, 8: Thumbs up}}\ngloves: {g: {person: anna}, h: }")
    gloves = open_gloves(site)
    assert gloves.known.named("g").responder.commands.gestures[3] == "Horns"
    assert gloves.known.named("h").responder.commands.gestures[3] == "Thumbs up"


async def test_another_wearer_brings_their_own_fit_gestures_and_commands_at_once(open_gloves: Open) -> None:
    site = parse("persons: {anna: {3: Horns, 8: Thumbs up}}\ngloves: {g: {person: ben}}")
    gloves = open_gloves(site)
    glove = gloves.known.named("g")
    await gloves.fits.set_thresholds(glove, {"thumb": {"upper": 1100}})
    await gloves.wearers.wear(glove, "anna")
    assert glove.responder.commands.gestures[3] == "Horns"
    assert (
        glove.reader.config.thresholds.fingers[0].upper == 1100
    )  # those that served last, until hers are known
    with pytest.raises(Problem, match="the thresholds of g for anna were never changed"):
        await gloves.fits.restore(glove)
    await gloves.fits.set_thresholds(glove, {"thumb": {"upper": 1200}})
    await gloves.wearers.wear(glove, "ben")
    assert glove.reader.config.thresholds.fingers[0].upper == 1100
    assert glove.responder.commands.gestures[3] == "Thumbs up"
    await gloves.wearers.wear(glove, "anna")
    again = open_gloves(site).known.named("g")
    assert (again.person, again.reader.config.thresholds.fingers[0].upper) == ("anna", 1200)
    await gloves.wearers.wear(glove, None)
    assert open_gloves(site).known.named("g").person is None


async def test_a_person_wears_one_glove_a_hand(open_gloves: Open) -> None:
    adopted: list[str] = []
    gloves = open_gloves(adopted=lambda glove: adopted.append(f"{glove.name} {glove.person}"))
    await gloves.declare("glove-2", None, None)
    left, _ = await gloves.declare("left-1", "left", "operator-1")
    right = gloves.known.named("glove-1")
    assert gloves.known.worn_by("operator-1") == [right, left]
    assert (gloves.known.partner_of(right), gloves.known.partner_of(left)) == (left, right)
    await gloves.wearers.wear(gloves.known.named("glove-2"), "operator-1")
    assert right.person is None
    assert gloves.known.partner_of(left) is gloves.known.named("glove-2")
    assert adopted[-2:] == ["glove-1 None", "glove-2 operator-1"]
    again = open_gloves()
    assert {glove.name: glove.person for glove in again.known} == {
        "glove-1": None,
        "glove-2": "operator-1",
        "left-1": "operator-1",
    }
    assert again.known.partner_of(again.known.named("glove-1")) is None


async def test_a_new_gesture_is_read_at_once_by_the_glove_of_its_person(
    open_gloves: Open, database: Engine
) -> None:
    gloves = open_gloves()
    glove = gloves.known.named("glove-1")
    people = gloves.wearers.people
    await people.define("operator-1", "Mine", OwnGesture(Shape("20000")))
    await people.set_commands("operator-1", {3: "Mine"}, whole=False)
    assert glove.reader.config.gestures.names["20000"] == "Mine"
    assert glove.responder.commands.ids["Mine"] == 3
    await gloves.wearers.wear(glove, "anna")
    assert "20000" not in glove.reader.config.gestures.names


async def test_a_profile_that_is_taken_in_applies_at_once(open_gloves: Open) -> None:
    gloves = open_gloves()
    glove = gloves.known.named("glove-1")
    fit = Fit(M2O2P_THRESHOLDS.with_changes({"ring": {"upper": 999}}), learnt={"levels": {}})
    person = Person("operator-1", gestures={"Mine": OwnGesture(Shape("20000"))})
    await gloves.wearers.import_profile(person, {"glove-1": fit, "glove-7": fit})
    assert glove.reader.config.gestures.names["20000"] == "Mine"
    for known in (gloves, open_gloves()):
        assert known.known.named("glove-1").reader.config.thresholds.fingers[3].upper == 999
        assert sorted(known.records.fits_of("operator-1")) == ["glove-1", "glove-7"]
        assert known.records.fits_of("operator-1")["glove-1"].learnt == {"levels": {}}


def test_a_connection_gives_way_only_when_it_has_been_silent(glove: Glove, link: Any) -> None:
    first, second = link(), link()
    glove.connect(first, Hello("glove-1"), 100.0)
    glove.receive(Frame(1.0, [700.0] * 5), b"", 101.0)
    with pytest.raises(ConnectionRefused, match=r"another connection of glove-1 is in use.* for 3 s"):
        glove.connect(second, Hello("glove-1"), 103.9)
    assert glove.connection.link is first
    assert first.ended == []
    glove.connect(second, Hello("glove-1"), 104.0)
    assert glove.connection.link is second
    assert len(first.ended) == 1


async def test_a_token_is_kept_as_a_hash_and_survives_a_restart(
    open_gloves: Open, database: Engine, link: Any
) -> None:
    gloves = open_gloves()
    first = await gloves.set_token("new")
    token = await gloves.set_token("new")
    with database.connect() as connection:
        (row,) = connection.execute(select(tables.tokens)).all()
    assert row == ("new", hashlib.sha256(token.encode()).hexdigest())
    gloves = open_gloves()
    assert gloves.known.named("new").hand == "right"
    for wrong in (first, ""):
        with pytest.raises(ConnectionRefused, match="new has a token of its own"):
            gloves.connect(Hello("new", token=wrong), link(), 1.0)
    gloves.connect(Hello("new", token=token), link(), 1.0)
    await gloves.remove_token(gloves.known.named("new"))
    with pytest.raises(Problem, match="new has no token of its own"):
        await gloves.remove_token(gloves.known.named("new"))
    open_gloves().connect(Hello("new"), link(), 1.0)


async def test_a_glove_that_is_just_being_declared_is_not_taken_for_absent(open_gloves: Open) -> None:
    gloves = open_gloves()
    declaring = asyncio.create_task(gloves.set_token("new"))
    while not declaring.done():
        assert gloves.absent(1e9) == []
        await asyncio.sleep(0)
    assert await declaring


async def test_gloves_that_nobody_declared_are_forgotten_when_they_have_been_away(
    open_gloves: Open, link: Any, make_job: Any
) -> None:
    gloves = open_gloves(max_undeclared_gloves=4, glove_forget_s=60)
    lines = {name: link() for name in ("glove-1", "there", "away", "busy", "paused")}
    for name, line in lines.items():
        gloves.connect(Hello(name), line, 100.0)
    await gloves.declare("declared", None, None)
    with pytest.raises(ConnectionRefused, match="nobody declared"):
        gloves.connect(Hello("one-more"), link(), 100.0)
    for name, line in lines.items():
        if name != "there":
            gloves.known.named(name).disconnect(line)
    job = make_job()
    asked = PromptSpec(job.task.id, "Confirm", "Horns", "20220", 3)
    gloves.known.named("busy").responder.begin(
        GesturePrompt(asked, job, asyncio.get_running_loop().create_future())
    )
    gloves.known.named("paused").pause()
    assert gloves.absent(159.0) == []
    (absent,) = gloves.absent(160.0)
    assert absent.name == "away"
    gloves.forget(absent)
    assert absent.observers.forgotten.is_set()
    with pytest.raises(Problem, match="there is no glove"):
        gloves.known.named("away")
    gloves.connect(Hello("one-more"), link(), 161.0)
