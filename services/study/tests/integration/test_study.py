"""A study with a real controller: participants go through it, the power fails, and answers are taken home."""

from typing import Any

import pytest

from handover_study.model.questionnaires import TLX_PAIRS, TLX_SCALES
from tests.kit.waiting import until


class Participant:
    """Answers whatever step is asked."""

    def __init__(self, bench: Any, **session: Any) -> None:
        self.study = bench.study
        answer = self.study.post("/sessions", json=session)
        assert answer.status_code == 201, answer.text
        self.id = answer.json()["id"]
        self.version = answer.json()["consentVersion"]

    @property
    def path(self) -> str:
        return f"/sessions/{self.id}"

    def seen(self) -> dict[str, Any]:
        return dict(self.study.get(self.path).raise_for_status().json())

    def answer(self, step: str, **content: Any) -> Any:
        return self.study.post(f"{self.path}/steps/{step}", json=content)

    def go_to(self, step: str) -> None:
        while (here := self.seen())["step"] != step:
            self.answer(here["step"], **self.content(here)).raise_for_status()

    def content(self, here: dict[str, Any]) -> dict[str, Any]:
        step = here["step"]
        if step == "consent":
            return {"agreed": True, "text": self.version}
        if step == "sus":
            return {"answers": [5, 1] * 5}
        if step.startswith("tlx"):
            rating = 20 if here["condition"] == "personal" else 40
            choices = [{"of": pair, "chosen": pair[0]} for pair in here["pairs"]]
            return {"ratings": dict.fromkeys(TLX_SCALES, rating), "choices": choices}
        return {"preferred": "personal"} if step == "preference" else {}


PERSONAL = {"3": "Horns", "8": None}
"""The commands of a person who gives one of them with another gesture."""


def add_person(bench: Any, name: str, commands: dict[str, str | None] | None = None) -> None:
    bench.screen.put(f"/people/{name}", json={}).raise_for_status()
    if commands is not None:
        bench.screen.put(f"/people/{name}/commands", json=commands).raise_for_status()


async def complete_task(bench: Any, name: str, glove: str = "glove-1", **parameters: Any) -> str:
    """Put a Task for a glove and complete it; return the gesture of its prompt."""
    await bench.put(name, f"urn:ngsi-ld:Device:demo:{glove}", **parameters)
    task = await until(lambda: bench.view(glove)["task"])
    bench.press("complete", glove, by="test").raise_for_status()
    await until(lambda: bench.view(glove)["task"] is None)
    return str(task["gesture"])


@pytest.mark.nightly
async def test_participants_go_through_the_study_and_what_they_said_is_analysed(bench: Any) -> None:
    for nth in range(2):
        participant = Participant(bench, language="de")
        assert participant.seen()["pseudonym"] == f"P{nth + 1:02}"
        participant.go_to("finished")
    firsts = {one["first"] for one in bench.study.get("/sessions").json()}
    assert firsts == {"personal", "predefined"}
    analysis = bench.study.get("/analysis").raise_for_status().json()
    assert (analysis["participants"], analysis["finished"]) == (2, 2)
    assert (analysis["sus"]["mean"], analysis["sus"]["grade"]) == (100, "A+")
    assert analysis["tlx"]["weighted"]["personal"]["mean"] == 20
    assert analysis["tlx"]["weighted"]["test"]["effect"] == -1
    table = bench.study.get("/answers.csv")
    assert table.headers["content-type"].startswith("text/csv")
    assert len(table.text.splitlines()) == 3
    report = bench.study.get("/report.pdf", params={"language": "fi"})
    assert report.headers["content-type"] == "application/pdf"
    assert report.content.startswith(b"%PDF")


@pytest.mark.nightly
async def test_a_session_continues_after_the_service_was_killed(bench: Any) -> None:
    participant = Participant(bench, pseudonym="Lumi")
    participant.go_to("tlx1")
    before = participant.seen()
    bench.cell.restart("study")
    assert participant.seen() == before
    participant.go_to("finished")
    assert len(participant.seen()["answers"]) == 9


async def test_a_declined_consent_deletes_the_session(bench: Any) -> None:
    participant = Participant(bench)
    assert participant.answer("consent", agreed=False, text=participant.version).json()["step"] == "declined"
    assert bench.study.get(participant.path).status_code == 404
    assert bench.study.get("/sessions").json() == []


async def test_nothing_is_asked_out_of_turn_and_nothing_is_taken_back(bench: Any) -> None:
    participant = Participant(bench)
    early = participant.answer("sus", answers=[3] * 10)
    assert early.status_code == 409
    assert 'P01 is at step 1, "consent", not at "sus"' in early.json()["detail"]
    outdated = participant.answer("consent", agreed=True, text="en-0")
    assert outdated.status_code == 409
    participant.go_to("interaction1")
    same = participant.answer("sus", answers=[5, 1] * 5)
    assert same.status_code == 200, "a repeated answer changes nothing"
    assert participant.answer("sus", answers=[1] * 10).status_code == 409
    assert participant.seen()["answers"]["sus"] == {"answers": [5, 1] * 5}


@pytest.mark.nightly
async def test_a_deleted_session_is_gone_from_list_analysis_and_files(bench: Any) -> None:
    participant = Participant(bench)
    participant.go_to("preference")
    participant.answer("preference", preferred="none", comment="unmistakable words").raise_for_status()
    assert bench.study.delete(participant.path).status_code == 204
    assert bench.study.get(participant.path).status_code == 404
    assert bench.study.get("/analysis").json()["participants"] == 0
    holding = [
        file.name
        for file in bench.cell.data_dir.rglob("*")
        if file.is_file() and b"unmistakable words" in file.read_bytes()
    ]
    assert holding == []


async def test_the_wording_is_there_in_three_languages(bench: Any) -> None:
    for language in ("en", "de", "fi"):
        words = bench.study.get("/wording", params={"language": language}).raise_for_status().json()
        assert len(words["sus"]["items"]) == 10
        assert [tuple(pair) for pair in words["pairs"]] == list(TLX_PAIRS)
    assert bench.study.get("/wording", params={"language": "sv"}).status_code == 422


@pytest.mark.nightly
async def test_the_glove_is_asked_for_the_gestures_that_the_step_is_about(bench: Any, put_on: Any) -> None:
    put_on()
    screen = bench.screen
    add_person(bench, "P01", PERSONAL)
    screen.put("/gloves/glove-1/person", json={"person": "P01"}).raise_for_status()
    participant = Participant(bench, glove="glove-1", person="P01")
    prompted = {}
    for step in ("interaction1", "interaction2"):
        participant.go_to(step)
        if step == "interaction2":
            bench.cell.restart("gesture_controller")
        prompted[participant.seen()["condition"]] = await complete_task(bench, step, commandId=3)
    assert prompted == {"personal": "Horns", "predefined": "Thumbs up"}


@pytest.mark.nightly
async def test_a_shipped_task_that_names_its_gesture_is_asked_in_the_gestures_of_the_condition(
    bench: Any, put_on: Any
) -> None:
    put_on()
    add_person(bench, "P01", PERSONAL)
    participant = Participant(bench, glove="glove-1", person="P01")
    assert bench.view()["person"] == "P01", "who takes part wears the glove of the session"
    prompted: dict[str, list[str]] = {}
    for step in ("interaction1", "interaction2"):
        participant.go_to(step)
        condition = participant.seen()["condition"]
        named = {"both": {"commandId": 3, "gesture": "Thumbs up"}, "gesture": {"gesture": "Thumbs up"}}
        for nth, parameters in named.items():
            prompted.setdefault(condition, []).append(
                await complete_task(bench, f"{step}-{nth}", **parameters)
            )
    assert prompted == {"personal": ["Horns"] * 2, "predefined": ["Thumbs up"] * 2}


@pytest.mark.nightly
async def test_a_condition_holds_for_the_person_whatever_glove_they_wear(bench: Any, put_on: Any) -> None:
    put_on()
    screen = bench.screen
    add_person(bench, "P01", PERSONAL)
    left = {"hand": "left", "person": "P01"}
    screen.put("/gloves/left-1", json=left).raise_for_status()
    participant = Participant(bench, glove="glove-1", person="P01")
    for step in ("interaction1", "interaction2"):
        participant.go_to(step)
        expected = {"personal": "Horns", "predefined": "Thumbs up"}[participant.seen()["condition"]]
        assert await complete_task(bench, step, glove="left-1", commandId=3) == expected


async def test_conditions_cannot_be_changed_while_they_are_tried(bench: Any) -> None:
    screen = bench.screen
    add_person(bench, "P01")
    add_person(bench, "P02")
    participant = Participant(bench, glove="glove-1", person="P01")
    assert screen.put("/people/P01/commands", json=PERSONAL).status_code == 200
    participant.go_to("interaction1")
    changes = [
        screen.put("/people/P01/commands", json={}),
        screen.patch("/people/P01/commands", json={"3": "Horns"}),
        screen.put("/people/P01/commands/3", json={"gesture": "Horns"}),
        screen.delete("/people/P01/commands/3"),
        screen.put("/people/P01/gestures/Mine", json={"code": "20002"}),
        screen.put("/gloves/glove-1/person", json={"person": "P02"}),
        screen.delete("/people/P01"),
    ]
    assert [one.status_code for one in changes] == [409] * len(changes)
    assert "P01 tries gestures in a study" in changes[0].json()["detail"]
    assert screen.put("/people/P02/commands", json=PERSONAL).status_code == 200
    assert bench.study.delete(participant.path).status_code == 204
    assert screen.put("/people/P01/commands", json={}).status_code == 200


@pytest.mark.nightly
async def test_a_session_that_was_left_does_not_decide_for_the_next_participant(
    bench: Any, put_on: Any
) -> None:
    put_on()
    for name in ("P01", "P02"):
        add_person(bench, name, PERSONAL)
    left = Participant(bench, glove="glove-1", person="P01")
    while left.seen()["condition"] != "predefined":
        left.go_to("interaction1" if left.seen()["step"] == "consent" else "interaction2")
    Participant(bench, glove="glove-1", person="P02")
    for lifetime in range(2):
        assert await complete_task(bench, f"t{lifetime}", commandId=3) == "Horns"
        bench.cell.restart("gesture_controller")


@pytest.mark.nightly
async def test_a_session_that_was_left_does_not_put_the_glove_on_again_after_a_restart(bench: Any) -> None:
    screen = bench.screen
    for name in ("P01", "Anna"):
        add_person(bench, name)
    Participant(bench, glove="glove-1", person="P01").go_to("introduction")
    assert bench.view()["person"] == "P01"
    screen.put("/gloves/glove-1/person", json={"person": "Anna"}).raise_for_status()
    bench.cell.restart("gesture_controller")
    assert bench.view()["person"] == "Anna"
