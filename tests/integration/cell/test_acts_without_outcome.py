"""A service that is killed between the intent and the outcome leaves an intent, which the audit shows."""

import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from typer.testing import CliRunner

from handover.command_line.main import app as command_line
from tests.kit import processes
from tests.kit.ports import next_free_port

LAMP = Path(__file__).parent / "dying_lamp.py"


class Lamp:
    """The lamp as a process."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder, next_free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.process: processes.Process | None = None

    def start(self) -> None:
        environment = {
            **processes.clean_environment(),
            "HANDOVER_DATA_DIR": str(self.folder),
            "LAMP_PORT": str(self.port),
        }
        log = self.folder / "lamp.log"
        self.process = processes.spawn([sys.executable, str(LAMP)], environment, log, self.folder)
        processes.wait_ready(self.process, f"{self.url}/readyz", log.read_text, 60)

    def move(self, *, is_killed: bool) -> httpx.Response:
        query = {"is_killed": str(is_killed).lower()}
        return httpx.post(f"{self.url}/robots/ur10-1/move", params=query, timeout=120, trust_env=False)

    def get(self, path: str) -> httpx.Response:
        return httpx.get(f"{self.url}{path}", timeout=120, trust_env=False).raise_for_status()


@pytest.fixture
def lamp(tmp_path: Path) -> Iterator[Lamp]:
    made = Lamp(tmp_path)
    made.start()
    yield made
    if made.process is not None and made.process.poll() is None:
        processes.kill(made.process)


@pytest.mark.nightly
def test_an_act_that_was_interrupted_by_a_kill_is_shown_without_an_outcome(
    lamp: Lamp, tmp_path: Path
) -> None:
    assert lamp.move(is_killed=False).status_code == 200
    for _ in range(2):
        with pytest.raises(httpx.TransportError):
            lamp.move(is_killed=True)
        assert lamp.process is not None
        lamp.process.wait(60)
        lamp.start()
    assert lamp.move(is_killed=False).status_code == 200

    listed = [(one["outcome"], one["endedBy"]) for one in lamp.get("/audit").json()]
    assert listed == [("done", None), ("intended", None), ("intended", None), ("done", None)]
    intents = lamp.get("/audit?outcome=intended").json()
    assert [(one["seq"], one["endedBy"]) for one in intents] == [(5, 6), (4, None), (3, None), (1, 2)]
    assert {one["subject"] for one in intents} == {"local"}
    verified = lamp.get("/audit/verification").json()
    assert (verified["fault"], verified["withoutOutcome"]) == (None, [3, 4])

    run = CliRunner()
    where = ["--data-dir", str(tmp_path)]
    checked = run.invoke(command_line, ["audit", "verify", *where])
    assert checked.exit_code == 0, checked.output
    assert "lamp: 6 records are intact" in checked.output
    assert "no outcome of 2 acts is recorded (records 3, 4)" in checked.output
    exported = run.invoke(command_line, ["audit", "export", "--format", "json", *where])
    assert exported.output.count('"endedBy": null') == 4, "two intents, and the two outcomes"
