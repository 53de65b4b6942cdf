"""The REST routes of people apply requests or refuse them with a reason, and respect sensor faults."""

from collections.abc import AsyncIterator
from typing import Any

import httpx
import pytest
from sqlalchemy import Engine

from handover.security.guard import Guard
from handover.serving.service import create_app
from handover_gloves.calibration.glove_store import GloveStore
from handover_gloves.configuration.gestures_file import built_in
from handover_gloves.connection.admission import TokenStore
from handover_gloves.connection.glove_registry import GloveRegistry
from handover_gloves.people import profile_file
from handover_gloves.people.people import People
from handover_gloves.people.store import PeopleStore
from handover_gloves.people.study_condition_store import StudyConditionStore
from handover_gloves.routes.own_gestures import add_own_gestures
from handover_gloves.routes.people import add_people
from handover_gloves.routes.people_views import PeopleParts
from handover_gloves.routes.profiles import add_profiles
from handover_gloves.settings import ControllerSettings

FIST, OPEN = [300.0] * 5, [700.0] * 5


@pytest.fixture
def gloves(database: Engine, listener_log: Any) -> GloveRegistry:
    people = People(built_in(), PeopleStore(database))
    return GloveRegistry(
        ControllerSettings(),
        store=GloveStore(database),
        tokens=TokenStore(database),
        people=people,
        conditions=StudyConditionStore(database),
        listener=listener_log,
        adopted=lambda _: None,
    )


@pytest.fixture
async def screen(gloves: GloveRegistry) -> AsyncIterator[httpx.AsyncClient]:
    """A screen at the routes of people."""
    app = create_app("People", description="", guard=Guard(ControllerSettings(), "people"))
    parts = PeopleParts(gloves.wearers, gloves.known, gloves.records)
    for add in (add_people, add_own_gestures, add_profiles):
        add(app, parts)
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        yield client


async def test_a_finger_with_a_small_span_does_not_separate_two_gestures(
    screen: httpx.AsyncClient, gloves: GloveRegistry
) -> None:
    weak_index = [700.0, 360.0, 700.0, 700.0, 700.0]
    await gloves.fits.calibrate(gloves.known.named("glove-1"), [FIST] * 20, [weak_index] * 20)
    mine = "/people/operator-1/gestures/Mine"
    refused = await screen.put(mine, json={"code": "20000"})  # the index alone parts it from 22000
    assert refused.status_code == 409
    assert "the sensor of the index hardly separates bent from straight" in refused.json()["detail"]
    assert refused.json()["nearest"] == {
        "gesture": "Middle, ring and little straight",
        "code": "22000",
        "distance": 1,
        "fingers": ["index"],
        "timesNoise": None,
    }
    await gloves.fits.calibrate(gloves.known.named("glove-1"), [FIST] * 20, [OPEN] * 20)
    assert (await screen.put(mine, json={"code": "20000"})).status_code == 201
    assert (await screen.put(mine, json={"code": "20000"})).status_code == 200


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("body", "words"),
    [
        ({}, "give one of code, left and right, sequence"),
        ({"code": "20000", "sequence": ["Horns", "Horns"]}, "and no other"),
        ({"frames": [[1, 2, 3, 4, 5]]}, "name the glove"),
        ({"glove": "glove-1", "frames": [[1, 2, 3, 4]]}, "5 items"),
        ({"glove": "glove-1", "recordMs": 10}, "200"),
        ({"left": "Horns"}, "names one hand"),
        ({"glove": "glove-1", "frames": [[1, 2, 3, 4, 5]]}, "1 frames are too few"),
        ({"sequence": ["Horns", "Wave"]}, 'unknown part "Wave"'),
        ({"code": "123456"}, "5 characters"),
        ({"colour": "red"}, "Extra inputs"),
    ],
)
async def test_a_gesture_that_cannot_be_kept_is_refused_in_a_sentence(
    screen: httpx.AsyncClient, body: dict[str, Any], words: str
) -> None:
    answer = await screen.put("/people/operator-1/gestures/Mine", json=body)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert words in answer.json()["detail"]


async def test_a_missing_person_and_a_missing_glove_are_distinguished(screen: httpx.AsyncClient) -> None:
    for method, path, body in (
        ("GET", "/people/anna", None),
        ("GET", "/people/anna/profile.yaml", None),
        ("DELETE", "/people/anna", None),
        ("PUT", "/people/anna/commands", {"3": "Horns"}),
        ("DELETE", "/people/anna/commands/3", None),
        ("PUT", "/people/anna/gestures/Mine", {"code": "20000"}),
        ("DELETE", "/people/anna/gestures/Mine", None),
        ("PUT", "/gloves/glove-1/person", {"person": "anna"}),
        ("PUT", "/gloves/glove-9/person", {"person": "operator-1"}),
        ("PUT", "/people/operator-1/gestures/Mine", {"glove": "glove-9", "recordMs": 500}),
        ("DELETE", "/people/operator-1/commands/3", None),
        ("DELETE", "/people/operator-1/gestures/Mine", None),
    ):
        answer = await screen.request(method, path, json=body)
        assert answer.status_code == 404, (method, path, answer.text)


async def test_commands_are_set_taken_back_and_refused(screen: httpx.AsyncClient) -> None:
    commands = "/people/operator-1/commands"
    assert (await screen.put(commands, json={"three": "Horns"})).status_code == 422
    assert (await screen.put(commands, json={"-1": "Horns"})).status_code == 422
    twice = await screen.patch(commands, json={"3": "Horns"})
    assert twice.status_code == 422
    assert '"Horns" stands for the commands 3 and 8' in twice.json()["detail"]
    swapped = await screen.patch(commands, json={"3": "horns", "8": "Thumbs up", "9": None})
    assert swapped.json()["ownCommands"] == {"3": "Horns", "8": "Thumbs up", "9": None}
    assert "9" not in swapped.json()["commands"]
    back = await screen.delete(f"{commands}/9")
    assert back.json()["commands"]["9"] == "Thumb, index and middle straight"
    whole = await screen.put(commands, json={})
    assert whole.json()["ownCommands"] == {}


async def test_a_title_is_given_changed_and_taken_away(screen: httpx.AsyncClient) -> None:
    assert (await screen.put("/people/anna", json={"title": "Anna"})).status_code == 201
    assert (await screen.put("/people/anna")).json()["title"] == "Anna"
    assert (await screen.put("/people/anna", json={"title": ""})).json()["title"] is None
    wrong = await screen.put("/people/an%20na")
    assert wrong.status_code == 422
    assert "what people call them is the title" in wrong.json()["detail"]
    assert [one["name"] for one in (await screen.get("/people")).json()] == ["anna", "operator-1"]


async def test_a_profile_that_is_too_long_is_not_read_to_its_end(screen: httpx.AsyncClient) -> None:
    answer = await screen.put(
        "/people/anna/profile.yaml", content=b"#" * 1_100_000, headers={"Content-Type": "application/yaml"}
    )
    assert answer.status_code == 413


@pytest.mark.nightly
async def test_a_large_profile_is_read_and_written_by_another_process(
    screen: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("it runs on the event loop")

    monkeypatch.setattr(profile_file._ProfileReader, "compose", never)
    monkeypatch.setattr(profile_file.yaml, "safe_dump", never)
    rows = "".join(f"        - [{nth}, {nth}, {nth}]\n" for nth in range(2_000))
    large = f"person: anna\ngloves:\n  glove-1:\n    learnt:\n      rows:\n{rows}"
    yaml_type = {"Content-Type": "application/yaml"}
    taken = await screen.put("/people/anna/profile.yaml", content=large, headers=yaml_type)
    assert taken.is_success, taken.text
    kept = await screen.get("/people/anna/profile.yaml")
    assert "- [1999, 1999, 1999]" in kept.text
    too_large = large + "".join(f"        - [{nth}, 1, 1]\n" for nth in range(20_000))
    refused = await screen.put("/people/anna/profile.yaml", content=too_large, headers=yaml_type)
    assert refused.status_code == 422
    assert "too many values; 20000 are allowed" in refused.json()["detail"]
