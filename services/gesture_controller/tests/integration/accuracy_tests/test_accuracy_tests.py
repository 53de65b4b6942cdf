"""Accuracy tests with a real controller: the glove is a TCP client that makes what it is asked for."""

import csv
import io
from collections.abc import Callable
from typing import Any

import pytest

from handover_gloves.recognition.gestures import M2O2P_GESTURES
from tests.kit.waiting import Bound

TWO = ["Thumbs up", "Horns"]


class Participant:
    """Does what the screen asks: opens the hand, makes the gesture, puts the glove on again."""

    def __init__(self, bench: Any, glove: Any, begun: dict[str, Any]) -> None:
        self.bench, self.glove, self.id = bench, glove, begun["id"]

    def seen(self) -> dict[str, Any]:
        return dict(self.bench.screen.get(f"/tests/{self.id}").raise_for_status().json())

    def answer(
        self, makes: Callable[[str], str] = lambda code: code, most: int | None = None
    ) -> dict[str, Any]:
        """Answer trials until the test waits or is over, or `most` of them are done."""
        bound = Bound(30)
        while True:
            bound.check(lambda: f"the test does not move: {self.seen()}")
            test = self.seen()
            live = test["live"]
            if live is None:
                if test["phase"] in {"finished", "interrupted"}:
                    return test
                continue  # it has just been continued or ended, and its record follows
            if live["phase"] in {"break", "interrupted"}:
                return test
            if most is not None and live["done"] >= most:
                return test
            if live["phase"] == "rest":
                self.glove.show("00000", 0.2)
            elif live["phase"] == "asked":
                self.glove.show(makes(live["asked"]["code"]), 0.2)


@pytest.fixture
def begin(bench: Any, put_on: Callable[..., Any]) -> Callable[..., Participant]:
    def make(**plan: Any) -> Participant:
        glove = put_on()
        answer = bench.screen.post("/tests", json={"glove": "glove-1", "gestures": TWO, **plan})
        assert answer.status_code == 201, answer.text
        return Participant(bench, glove, answer.json())

    return make


async def test_a_whole_test_ends_with_table_3_and_leaves_the_glove_as_it_was(
    bench: Any, begin: Callable[..., Participant]
) -> None:
    participant = begin(rounds=2, seed=4)
    assert bench.view()["testing"] is True
    assert participant.answer()["phase"] == "break"
    bench.screen.post(f"/tests/{participant.id}/continue").raise_for_status()
    test = participant.answer()
    assert (test["phase"], test["live"]) == ("finished", None)
    report = bench.screen.get(f"/tests/{participant.id}/report").json()
    assert report["table"] == {
        "problematic": [],
        "successfulInteractions": 4,
        "problematicInteractions": 0,
        "accuracy": 1.0,
    }
    assert report["overall"]["medianMs"] >= 500
    view = bench.view()
    assert (view["testing"], view["accuracyTest"]) == (False, None)


async def test_what_was_taken_for_another_is_in_matrix_and_table_files(
    bench: Any, begin: Callable[..., Participant]
) -> None:
    participant = begin(rounds=1, limitMs=1500)
    horns = M2O2P_GESTURES["Horns"]
    participant.answer(makes=lambda code: "20022" if code == horns else code)
    report = bench.screen.get(f"/tests/{participant.id}/report").json()
    matrix = report["confusion"]
    row = dict(zip(matrix["recognized"], matrix["counts"][matrix["asked"].index("Horns")], strict=True))
    assert row["Index and middle straight"] == 1
    answer = bench.screen.get(f"/tests/{participant.id}/trials.csv")
    assert answer.headers["content-type"].startswith("text/csv")
    lines = list(csv.DictReader(io.StringIO(answer.text)))
    assert {line["asked"]: line["outcome"] for line in lines} == {"Horns": "missed", "Thumbs up": "right"}
    trials = bench.screen.get(f"/tests/{participant.id}/trials.json").json()
    assert [trial["asked"] for trial in trials] == [line["asked"] for line in lines]


async def test_no_task_is_touched_while_a_test_is_on_its_way(
    bench: Any, begin: Callable[..., Participant], eventually: Callable[..., None]
) -> None:
    participant = begin(rounds=1)
    task = await bench.put("while-testing", gesture="Thumbs up")
    eventually(lambda: bench.view()["task"] is not None)
    participant.answer()
    assert await bench.status(task) == "inProgress"


@pytest.mark.nightly
async def test_a_test_survives_the_death_of_the_service(
    bench: Any, begin: Callable[..., Participant], put_on
) -> None:
    participant = begin(rounds=2, breaks=False)
    participant.answer(most=3)
    bench.cell.restart("gesture_controller")
    test = participant.seen()
    assert (test["phase"], test["live"]) == ("interrupted", None)
    assert bench.view()["testing"] is False, "nobody may stand before a glove that tests by itself"
    assert len(bench.screen.get(f"/tests/{participant.id}/trials.json").json()) == 3
    participant.glove = put_on()
    bench.screen.post(f"/tests/{participant.id}/continue").raise_for_status()
    assert participant.answer()["phase"] == "finished"
    trials = bench.screen.get(f"/tests/{participant.id}/trials.json").json()
    assert [trial["trial"] for trial in trials] == [1, 2, 3, 4]


async def test_switching_testing_off_interrupts_the_test(
    bench: Any, begin: Callable[..., Participant], eventually: Callable[..., None]
) -> None:
    participant = begin(rounds=1)
    bench.screen.put("/gloves/glove-1/modes", json={"testing": False}).raise_for_status()
    eventually(lambda: participant.seen()["phase"] == "interrupted")
    assert participant.seen()["reason"] == "testing mode was switched off"
    assert bench.view()["testing"] is False


async def test_a_test_is_stopped_listed_and_deleted(bench: Any, begin: Callable[..., Participant]) -> None:
    participant = begin(rounds=1)
    second = bench.screen.post("/tests", json={"glove": "glove-1"})
    assert second.status_code == 409
    assert bench.screen.post(f"/tests/{participant.id}/stop").json()["phase"] == "stopped"
    assert [test["id"] for test in bench.screen.get("/tests").json()] == [participant.id]
    assert bench.screen.post(f"/tests/{participant.id}/continue").status_code == 409
    assert bench.screen.delete(f"/tests/{participant.id}").status_code == 204
    assert bench.screen.get(f"/tests/{participant.id}").status_code == 404


async def test_a_wrong_plan_is_refused_with_the_reason(bench: Any) -> None:
    for wrong, says in (
        ({"gestures": ["Thumb up"]}, 'did you mean "Thumbs up"'),
        ({"glove": "glove-9"}, 'no glove "glove-9"'),
        ({"holdMs": 2000, "limitMs": 1500}, "time limit must be longer"),
        ({"rounds": 0}, "rounds"),
    ):
        answer = bench.screen.post("/tests", json={"glove": "glove-1", **wrong})
        assert answer.status_code in {404, 422}
        assert says in answer.json()["detail"]
