"""Recordings of control: both inputs, what was commanded, and when, so that a study can be computed.

A recording is a CSV file in SI units, one row a cycle of the control loop, from the moment the person moves
the robot to its rest. Rows are handed over by the control thread and written in the background; a recording
that is cut off by a crash is complete up to its last full second. Axes are those of the base of the robot.
"""

import asyncio
import csv
import re
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from handover.telemetry import get_logger

log = get_logger(__name__)

FOLDER: Final = "control-recordings"
WRITE_EVERY_S: Final = 1.0
MAX_WAITING_ROWS: Final = 100_000
MAX_BYTES: Final = 500 * 1024 * 1024
"""Size after which a recording ends; some four hours of motion."""
MAX_LISTED: Final = 500
_NAME = re.compile(r"^[A-Za-z0-9_.-]{1,120}\.csv$")
_AXES: Final = ("x", "y", "z", "rx", "ry", "rz")
COLUMNS: Final = (
    "t",
    "inputT",
    "seq",
    "mix",
    "mixAsked",
    "arbitration",
    "gamma",
    "goal",
    "goalDistance",
    *(f"human_{axis}" for axis in _AXES),
    *(f"robot_{axis}" for axis in _AXES),
    *(f"blended_{axis}" for axis in _AXES),
    *(f"tool_{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")),
)
"""`t` and `inputT`, the arrival of the input, are s since 1970; velocities are m/s and rad/s.

`joint_…` columns follow: the velocities that were sent to the limiter, in the order of the joints.
"""

Row = tuple[float | int | str, ...]


@dataclass(frozen=True, slots=True)
class StoredRecording:
    """A recording in the folder of a robot."""

    name: str
    size: int
    begun_at: datetime


class Recording:
    """One recording; `add` may be called by any thread, `run` writes until `close`."""

    def __init__(self, file: Path, joints: Sequence[str]) -> None:
        self.is_full = False
        self._file = file
        self._columns = (*COLUMNS, *(f"joint_{name}" for name in joints))
        self._rows: deque[Row] = deque(maxlen=MAX_WAITING_ROWS)
        self._writing = threading.Lock()
        """A write in the background may still run when the recording ends."""

    @classmethod
    def begin(cls, data_dir: Path, robot: str, person: str, joints: Sequence[str]) -> "Recording":
        """Create the file; raise `OSError`."""
        folder = folder_of(data_dir, robot)
        folder.mkdir(parents=True, exist_ok=True)
        who = re.sub(r"[^A-Za-z0-9_-]+", "-", person)[:40] or "somebody"
        file = folder / f"{datetime.now(UTC):%Y%m%dT%H%M%S.%f}-{who}.csv"
        recording = cls(file, joints)
        with file.open("x", newline="", encoding="utf-8") as opened:
            csv.writer(opened).writerow(recording._columns)
        return recording

    def add(self, row: Row) -> None:
        """Add a row."""
        if not self.is_full:
            self._rows.append(row)

    def close(self) -> None:
        """Write the rows that wait, where `run` was not used; raise `OSError`."""
        self._write()

    async def run(self) -> None:
        """Write rows until this is cancelled; then write the rest."""
        try:
            while not self.is_full:
                await asyncio.sleep(WRITE_EVERY_S)
                await asyncio.to_thread(self._write)
        except OSError as error:
            self.is_full = True
            log.warning("recording ended", file=self._file.name, error=error.strerror)
        finally:
            with suppress(OSError):
                self._write()

    def _write(self) -> None:
        with self._writing:
            rows = [self._rows.popleft() for _ in range(len(self._rows))]
            if not rows:
                return
            with self._file.open("a", newline="", encoding="utf-8") as opened:
                csv.writer(opened).writerows(rows)
            self.is_full = self._file.stat().st_size >= MAX_BYTES


def folder_of(data_dir: Path, robot: str) -> Path:
    """Return the folder of the recordings of a robot."""
    return data_dir / FOLDER / robot


def stored(data_dir: Path, robot: str) -> list[StoredRecording]:
    """Return the recordings of a robot, the newest first."""
    folder = folder_of(data_dir, robot)
    files = sorted(folder.glob("*.csv"), reverse=True)[:MAX_LISTED] if folder.is_dir() else []
    return [
        StoredRecording(
            file.name,
            file.stat().st_size,
            datetime.strptime(file.name.split("-", 1)[0], "%Y%m%dT%H%M%S.%f").replace(tzinfo=UTC),
        )
        for file in files
    ]


def file_of(data_dir: Path, robot: str, name: str) -> Path | None:
    """Return the file of a recording; None if there is none."""
    file = folder_of(data_dir, robot) / name
    return file if _NAME.match(name) and file.is_file() else None


Record = Callable[[Row], None]
