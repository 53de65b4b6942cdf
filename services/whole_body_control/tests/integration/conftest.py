"""A cell with a humanoid; the control process is ended with it, also when the service was killed."""

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.kit.cell import Cell, new_cell
from tests.kit.waiting import wait_for

SERVICE = "whole_body_control"
WITHIN_S = 120.0


class HumanoidCell:
    """The cell, and requests to the service of its humanoid."""

    def __init__(self, cell: Cell, folder: Path) -> None:
        self.cell, self.folder = cell, folder
        self.http = httpx.Client(base_url=cell.url(SERVICE), trust_env=False, timeout=WITHIN_S)

    def start(self) -> None:
        """Start what does not run, and wait until the robot stands."""
        self.cell.run("context_broker", SERVICE)
        wait_for(lambda: self.state()["fault"] is None, WITHIN_S, "the control cycle runs")

    def state(self) -> dict[str, Any]:
        """Return the newest live document."""
        answer = self.http.get("/state")
        assert answer.status_code == 200, answer.text
        document: dict[str, Any] = answer.json()
        return document

    def cycle(self) -> dict[str, Any]:
        """Return what is known of the control process."""
        view: dict[str, Any] = self.http.get("/cycle").json()
        return view

    def post(self, path: str, body: Any = None, status: int = 200) -> Any:
        """Post, and return the answer with this status."""
        answer = self.http.post(path, json=body)
        assert answer.status_code == status, answer.text
        return answer.json()

    def end(self) -> None:
        """End the control process, which outlives its service."""
        self.http.close()
        self.cell.stop()
        with suppress(OSError, ValueError):
            pid = int((self.folder / "control.pid").read_text())
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
            if str(self.folder).encode() in command:
                os.kill(pid, signal.SIGKILL)


@pytest.fixture(scope="module")
def humanoid(tmp_path_factory: pytest.TempPathFactory) -> Iterator[HumanoidCell]:
    """Return a cell whose humanoid stands."""
    data_dir = tmp_path_factory.mktemp("humanoid")
    with new_cell(data_dir) as cell:
        folder = data_dir / "ports"
        cell.extra = {"HANDOVER_HUMANOID_PORTS_DIR": str(folder), "HANDOVER_HUMANOID_FIFO": "false"}
        made = HumanoidCell(cell, folder)
        try:
            made.start()
            yield made
        finally:
            made.end()
