"""The simulated operator before a real controller: calibrates the glove, then completes Tasks."""

from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from tests.kit.cell import Cell

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]


class Workplace:
    """A broker into which Tasks for glove-1 are put, and the screen of a controller."""

    def __init__(self, cell: Cell) -> None:
        self._http = httpx.Client(timeout=120, trust_env=False)
        self._entities = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
        self._gloves = f"{cell.url('gesture_controller')}/gloves"

    def screen(self, glove: str) -> dict[str, Any]:
        """What is shown of a glove; empty while it is not known."""
        answer = self._http.get(f"{self._gloves}/{glove}")
        return dict(answer.json()) if answer.is_success else {}

    def put(self, name: str, gesture: str) -> str:
        task_id = f"urn:ngsi-ld:Task:demo:{name}"
        involved = {"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:glove-1"}
        answer = self._http.post(
            self._entities,
            json={
                "id": task_id,
                "type": "Task",
                "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:confirm"},
                "status": {"type": "Property", "value": "pending", "observedAt": "2026-01-01T12:00:00Z"},
                "involves": {"type": "Property", "value": [involved]},
                "workParameters": {"type": "Property", "value": {"gesture": gesture}},
            },
        )
        assert answer.status_code == 201, answer.text
        return task_id

    def task(self, task_id: str) -> dict[str, Any]:
        """A Task's values."""
        answer = self._http.get(f"{self._entities}/{task_id}", params={"options": "keyValues"})
        return dict(answer.json())

    def close(self) -> None:
        self._http.close()


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests: each wears a glove of its own."""
    return shared_cell


@pytest.fixture
def workplace(cell: Cell) -> Iterator[Workplace]:
    cell.run("context_broker", "gesture_controller")
    made = Workplace(cell)
    yield made
    made.close()


def words(cell: Cell, glove: str, *more: str) -> list[str]:
    port, url = cell.ports["glove"], cell.url("gesture_controller")
    return ["simulate", "--glove", glove, "--port", str(port), "--controller", url, "--seed", "3", *more]


GESTURES = ["Thumbs up", "Point with index", "Horns", "Middle, ring and little straight", "Thumbs up"]


@pytest.mark.nightly
def test_tasks_are_completed_with_the_gestures_they_ask_for_mistakes_and_a_restart_included(
    cell: Cell, workplace: Workplace, bridge: Callable[..., Any], eventually: Any
) -> None:
    operator = bridge(*words(cell, "glove-1", "--mistakes", "1", "--speed", "3"))
    for number, gesture in enumerate(GESTURES):
        task = workplace.put(f"t{number}", gesture)
        eventually(lambda task=task: workplace.task(task)["status"] == "completed", 60)
        outputs = workplace.task(task)["outputParameters"]
        assert outputs["gesture"] == gesture
        assert outputs["by"] == "gesture"
        assert outputs["heldMs"] >= 1500
        if number == 2:
            cell.restart("gesture_controller")
    operator.terminate()
    assert operator.wait(timeout=120) == 0
    complaints = operator.stderr.read().decode()
    assert "calibrated with a fist and an open hand" in complaints
    assert "Traceback" not in complaints


@pytest.mark.nightly
def test_the_calibration_fits_the_hand(
    cell: Cell, workplace: Workplace, bridge: Callable[..., Any], eventually: Any
) -> None:
    operator = bridge(*words(cell, "glove-2"))

    def thresholds() -> dict[str, dict[str, float]]:
        return dict(workplace.screen("glove-2").get("thresholds", {}))

    eventually(lambda: thresholds().get("thumb", {}).get("upper", 999) < 500)
    fitted = thresholds()
    for finger, (bent, straight) in {"thumb": (305, 405), "index": (485, 714), "little": (470, 677)}.items():
        assert bent < fitted[finger]["lower"] < fitted[finger]["upper"] < straight
    operator.terminate()
    assert operator.wait(timeout=120) == 0


def test_without_calibration_the_thresholds_stay_as_they_are(
    cell: Cell, workplace: Workplace, bridge: Callable[..., Any], eventually: Any
) -> None:
    operator = bridge(*words(cell, "glove-3", "--no-calibrate"))
    eventually(lambda: workplace.screen("glove-3").get("frames", 0) > 100)
    assert workplace.screen("glove-3")["thresholds"]["thumb"] == {"upper": 1000, "lower": 800}
    operator.terminate()
    assert operator.wait(timeout=120) == 0
    assert b"calibrated" not in operator.stderr.read()
