"""A wall clock that a test moves for whole processes, as suspend and resume or NTP do."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from handover.runtime.python_processes import module_command
from tests.kit import processes
from tests.kit.cell import MODULES, Cell, new_cell
from tests.kit.other_broker import running
from tests.kit.skipping import NO_FAKETIME

LIBRARIES = (
    Path("/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1"),
    Path("/usr/lib/aarch64-linux-gnu/faketime/libfaketime.so.1"),
    Path("/usr/lib/faketime/libfaketime.so.1"),
    Path("/usr/lib64/faketime/libfaketime.so.1"),
)


class MovedClock:
    """The wall clock of the processes that have its `environment`; their monotonic clock is not moved."""

    def __init__(self, folder: Path) -> None:
        library = next((file for file in LIBRARIES if file.exists()), None)
        if library is None:
            pytest.skip(NO_FAKETIME)
        self._file = folder / "moved-clock"
        self.environment = {
            "LD_PRELOAD": str(library),
            "FAKETIME_TIMESTAMP_FILE": str(self._file),
            "FAKETIME_NO_CACHE": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            "FAKETIME_DISABLE_SHM": "1",
        }
        self.move(0)

    def move(self, seconds: int) -> None:
        """Let the clock differ by `seconds` from that of the machine, from now on."""
        new = self._file.with_suffix(".new")
        new.write_text(f"{seconds:+d}\n")
        new.replace(self._file)


class ClockedCell(Cell):
    """A cell whose processes are started by themselves, so that their clock can be moved."""

    def spawn(self, service: str) -> None:
        if service == "context_broker" and running.IS_OTHER:
            super().spawn(service)
            return
        module = MODULES[service]
        self.processes[service] = processes.spawn(
            module_command(module), self.environment, self._log_file(service), self.data_dir
        )


@contextmanager
def clocked_cell(folder: Path) -> Iterator[tuple[ClockedCell, MovedClock]]:
    """Make a cell of which nothing runs yet, and the clock of all that it will run."""
    clock = MovedClock(folder)
    with new_cell(folder) as plain:
        cell = ClockedCell(plain.data_dir, plain.ports, {**plain.extra, **clock.environment})
        try:
            yield cell, clock
        finally:
            cell.stop()
