"""The recorder: a thread that reads the ports in shared memory and writes a file.

It shares nothing with the control cycle but the ports, which no reader can delay, so that a slow disk delays
the recording only. Ports of a control cycle that was restarted are opened again.
"""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import IO, Any, Final

from handover.errors import UsageError
from handover.telemetry import get_logger
from handover_humanoid.cycle.ports import PortReader
from handover_humanoid.recording.files import RecordingWriter

log = get_logger(__name__)

PORTS: Final = ("state", "wish")
FRAME_PERIOD_S: Final = 1 / 30
REOPEN_EVERY_S: Final = 0.5
JOIN_WITHIN_S: Final = 30.0

Document = Callable[[], Mapping[str, Any]]


class RecordingEnd(StrEnum):
    """Why a recording has ended."""

    STOPPED = "stopped"
    TOO_LONG = "tooLong"
    DISK = "disk"
    """The disk was full, or failed."""
    SERVICE = "service"
    """The service was stopped."""
    INTERRUPTED = "interrupted"
    """The service ended in the middle; the file has what was written until then."""


@dataclass(frozen=True, slots=True)
class RecordingLimits:
    """How long and how large a recording may be, and how often the ports are read."""

    max_s: float
    max_bytes: int
    hz: float


class _Port:
    """A port that may not exist yet, or be another file after a restart of the control cycle."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._reader: PortReader | None = None
        self._inode, self._written_ns, self._checked_s = 0, 0, float("-inf")

    def newest(self, now_s: float) -> PortReader | None:
        """Return a reader with values that were not returned before, None without such."""
        if now_s - self._checked_s >= REOPEN_EVERY_S:
            self._checked_s = now_s
            self._open()
        reader = self._reader
        if reader is None or not reader.read() or reader.time_ns in {0, self._written_ns}:
            return None
        self._written_ns = reader.time_ns
        return reader

    def _open(self) -> None:
        try:
            inode = self.path.stat().st_ino
            if inode != self._inode:
                self._reader = PortReader(self.path)
                self._inode = inode
        except (OSError, UsageError):  # it is just being made
            self._reader, self._inode = None, 0


class Recorder:
    """Records until `stop`, or until a bound is reached: then `reason` says so."""

    def __init__(
        self, path: Path, ports: Path, document: Document, bounds: RecordingLimits, name: str
    ) -> None:
        self.reason: RecordingEnd | None = None
        self.messages = 0
        self._stream: IO[bytes] = path.open("xb")
        self._bounds, self._document = bounds, document
        try:
            path.chmod(0o600)
            self._writer = RecordingWriter(self._stream, {"recording": name})
        except BaseException:
            self._stream.close()
            path.unlink()
            raise
        self._ports = {name: _Port(ports / name) for name in PORTS}
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="humanoid recorder", daemon=True)
        self._thread.start()

    @property
    def is_running(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Write what is left and close the file. Blocks for the disk."""
        self._end.set()
        self._thread.join(JOIN_WITHIN_S)

    def _run(self) -> None:
        try:
            self._record()
            self._writer.close()
        except (OSError, ValueError):
            log.exception("recording failed")
            self.reason = RecordingEnd.DISK
        finally:
            self.messages = self._writer.messages
            try:
                self._stream.close()
            except OSError:
                self.reason = RecordingEnd.DISK

    def _record(self) -> None:
        bounds, began_s = self._bounds, time.monotonic()
        offset_ns = time.time_ns() - time.monotonic_ns()
        period_s, due_s, frame_s = 1.0 / bounds.hz, began_s, began_s
        while not self._end.is_set():
            now_s = time.monotonic()
            for name, port in self._ports.items():
                reader = port.newest(now_s)
                if reader is not None:
                    values = reader.values.tolist()
                    self._writer.write_port(name, reader.names, values, reader.time_ns + offset_ns)
            if now_s >= frame_s:
                frame_s = max(frame_s + FRAME_PERIOD_S, now_s)
                self._writer.write_document(self._document(), time.monotonic_ns() + offset_ns)
            if now_s - began_s > bounds.max_s:
                self.reason = RecordingEnd.TOO_LONG
                return
            if self._stream.tell() > bounds.max_bytes:
                self.reason = RecordingEnd.DISK
                return
            due_s = max(due_s + period_s, now_s)
            self._end.wait(max(0.0, due_s - time.monotonic()))
