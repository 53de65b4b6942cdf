"""The process of the demonstration in simulated physics: every service is real, and a person answers."""

from collections.abc import Callable
from typing import Any

import httpx
import pytest

from handover_robots.physics import is_available
from handover_robots.planning import is_available as is_planning_available
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(300),
    pytest.mark.skipif(not (is_available() and is_planning_available()), reason="the extra physics"),
]

SERVICES = ("context_broker", "task_orchestrator", "gesture_controller", "trajectory_tool")


class Person:
    """Answers the Tasks of a process: those of the glove on its screen, the others on the page Tasks."""

    def __init__(self, cell: Cell, process: str) -> None:
        self._orchestrator = httpx.Client(base_url=cell.url("task_orchestrator"), timeout=120)
        self._controller = httpx.Client(base_url=cell.url("gesture_controller"), timeout=120)
        self._process = process
        self._cell = cell

    def tasks(self) -> list[dict[str, Any]]:
        seen: list[dict[str, Any]] = self._orchestrator.get(f"/processes/{self._process}").json()["tasks"]
        return seen

    def asked_of(self, task: str) -> dict[str, Any]:
        """Return the workParameters of a Task."""
        entities = f"{self._cell.url('context_broker')}/ngsi-ld/v1/entities"
        return dict(httpx.get(f"{entities}/{task}", timeout=120).json()["workParameters"]["value"])

    def result_of(self, element: str) -> dict[str, Any]:
        """Return the variable of the activity."""
        seen: dict[str, Any] = self._orchestrator.get(f"/processes/{self._process}").json()
        return dict(seen["variables"][element])

    def waits_for(self, element: str, visit: int = 1) -> str:
        """Wait for the Task of an activity, and return its id."""

        def shown() -> str | None:
            task = next(
                (candidate for candidate in self.tasks() if candidate["id"].endswith(f"-{element}-{visit}")),
                None,
            )
            return task["id"] if task and task["status"] not in {"completed", "failed"} else None

        return wait_for(shown, 60, f"{element} {visit} is not waited for")

    def answers(self, element: str, outcome: str = "ok", visit: int = 1) -> None:
        task = self.waits_for(element, visit)

        def accepted() -> bool:
            said = {"by": "Anna", "task": task, "outcome": outcome}
            return self._controller.post("/gloves/glove-1/complete", json=said).is_success

        wait_for(accepted, 60, f"{task} cannot be answered")

    def fills_in(self, element: str, **outputs: Any) -> httpx.Response:
        task = self.waits_for(element)
        claimed = self._orchestrator.post(f"/tasks/{task}/claim", json={"by": "Anna"})
        assert claimed.status_code in {200, 409}, claimed.text
        return self._orchestrator.post(f"/tasks/{task}/complete", json={"by": "Anna", "outputs": outputs})

    def sees_it_end(self) -> None:
        """Wait until the process is completed."""

        def is_completed() -> bool:
            seen = self._orchestrator.get(f"/processes/{self._process}").json()
            return bool(seen["status"] == "completed")

        wait_for(is_completed, 60, f"{self._process} has not ended")

    def close(self) -> None:
        self._orchestrator.close()
        self._controller.close()


@pytest.fixture
def start(cell: Cell) -> Any:
    """Start the process of the demonstration in physics; the person who answers it."""
    cell.extra |= {"HANDOVER_ROBOT": "physics", "HANDOVER_SIMULATION_PACE": "0"}
    cell.run(*SERVICES)
    made: list[Person] = []

    def begin() -> Person:
        answer = httpx.post(
            f"{cell.url('task_orchestrator')}/processes", json={"definition": "bin-picking"}, timeout=120
        )
        made.append(Person(cell, answer.raise_for_status().json()["id"]))
        return made[-1]

    yield begin
    for person in made:
        person.close()


@pytest.mark.nightly
def test_a_person_confirms_repeats_and_adjusts_the_views_before_a_part_is_picked(
    start: Callable[[], Person],
) -> None:
    person = start()
    person.answers("confirm_clear")
    person.answers("check_view", "notGood")
    person.answers("check_view", "problem", visit=2)
    assert person.result_of("scan")["view"] == 0
    refused = person.fills_in("adjust_view", x=5000, y=0, z=0)
    assert refused.status_code == 422, "the camera cannot be moved by 5 m"
    assert person.fills_in("adjust_view", x=20, y=-10, z=30).status_code == 200
    person.answers("check_view", visit=3)
    person.answers("check_view", visit=4)
    person.answers("confirm_pick")
    person.answers("confirm_grip")
    person.answers("confirm_placed")
    person.sees_it_end()
    asked = [person.asked_of(task["id"]) for task in person.tasks() if "-scan-" in task["id"]]
    assert [(parameters["view"], parameters["offset"]) for parameters in asked] == [
        (0, [0, 0, 0]),
        (0, [0, 0, 0]),
        (0, [0.02, -0.01, 0.03]),
        (1, [0, 0, 0]),
    ]
    assert person.result_of("scan")["found"]
    assert person.result_of("place")["location"] == "fixture-1"
