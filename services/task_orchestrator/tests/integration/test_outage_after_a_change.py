"""A PostgreSQL server that stops after a change was made: no answer says that nothing was changed."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from services.task_orchestrator.tests.integration.cell import Cell, cell, eventually
from services.task_orchestrator.tests.integration.test_retry import deploy, play
from services.task_orchestrator.tests.unit.drawing import ONE_STEP
from tests.kit.ports import next_free_port
from tests.kit.postgres import PostgresServer, postgres_server

pytestmark = pytest.mark.slow


@pytest.fixture
def server() -> Iterator[PostgresServer]:
    """Return a server that no other test uses."""
    with postgres_server() as server:
        yield server


def refusal(answer: httpx.Response) -> str:
    return f"{answer.status_code} {answer.json()['detail']}"


@pytest.mark.nightly
@pytest.mark.parametrize("act", ["pause", "cancel"])
def test_what_lowers_acts_without_a_database_and_says_so(
    act: str, server: PostgresServer, tmp_path: Path
) -> None:
    with cell(tmp_path, next_free_port, server.new_database()) as running:
        play(running, work_1={"after_s": 3600})
        deploy(running, ONE_STEP)
        process = running.start("p")
        eventually(lambda: begun(running, process), "the Task being begun")
        server.stop()
        acted = running.api.post(f"/processes/{process}/{act}", json={"by": "Olga"})
        server.start()
        assert "nothing was changed" not in acted.text
        assert acted.status_code in {200, 504}, acted.text
        assert acted.is_success or "the change was made" in refusal(acted)
        eventually(lambda: is_stored(running, process, act), f"{act} being stored")


def begun(running: Cell, process: str) -> bool:
    return bool(running.look(process)["tasks"][0]["status"] == "inProgress")


def is_stored(running: Cell, process: str, act: str) -> bool:
    answer = running.api.get(f"/processes/{process}")
    if not answer.is_success:
        return False
    seen = answer.json()
    return bool(seen["status"] == "paused" if act == "pause" else seen["reason"] == "cancelled by Olga")
