"""The first tutorial: a process of the reader's own, answered by hand."""

import subprocess
import sys

import httpx
import pytest

from tests.kit.cell import Cell
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

PROCESS = REPOSITORY / "docs" / "tutorials" / "check-part.bpmn"
GLOVE = "/gloves/glove-1"


def handover(cell: Cell, *words: str) -> str:
    """Run the command line in the environment of a cell and return its output."""
    return subprocess.run(
        [sys.executable, "-m", "handover_cell", *words],
        env=cell.environment,
        cwd=cell.data_dir,
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
    ).stdout


@pytest.mark.parametrize("outcome", ["ok", "notGood"])
def test_process_of_the_tutorial_is_performed(cell: Cell, outcome: str) -> None:
    cell.start("context_broker", "task_orchestrator", "gesture_controller", "trajectory_tool")
    orchestrator, controller = cell.url("task_orchestrator"), cell.url("gesture_controller")
    httpx.put(f"{controller}{GLOVE}", json={}, timeout=120).raise_for_status()
    assert "check-part version 1 deployed" in handover(cell, "process", "deploy", str(PROCESS))
    process = handover(cell, "process", "start", "check-part").split()[0]

    def is_asked() -> bool:
        return bool(httpx.get(f"{controller}{GLOVE}", timeout=120).json()["task"])

    wait_for(is_asked, 60, why=lambda: httpx.get(f"{orchestrator}/processes/{process}", timeout=120).text)
    answer = {"by": "Anna", "outcome": outcome}
    httpx.post(f"{controller}{GLOVE}/complete", json=answer, timeout=120).raise_for_status()

    def status() -> str:
        return str(httpx.get(f"{orchestrator}/processes/{process}", timeout=120).json()["status"])

    wait_for(lambda: status() == "completed", 60, why=status)
    variables = httpx.get(f"{orchestrator}/processes/{process}", timeout=120).json()["variables"]
    assert variables["check_part"]["outcome"] == outcome
