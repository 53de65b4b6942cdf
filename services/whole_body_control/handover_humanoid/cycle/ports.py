"""Ports in shared memory: one process writes the newest values, any number read them, and none waits.

A port is a file (below `/dev/shm` it never reaches a disk) with the names of its values. The writer makes
the sequence odd, writes values, time stamp and checksum, and makes it even (a sequence lock); a reader that
sees an odd or changed sequence, or another checksum, reads again, a bounded number of times. A writer that is
killed in between leaves the sequence odd: readers then have nothing new, and the next writer mends it. The
lock of the file makes the writer the only one, and ends with its process.

The checksum is what orders memory: a processor may show the sequence before the values.
"""

import fcntl
import json
import mmap
import os
import time
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from handover.errors import UsageError
from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.model.kinematics import Array

MAGIC = 0x484F504F52543031
HEADER_WORDS = 8
NAMES_AT, VALUES_AT = 64, 16384
MAX_TRIES = 100
_MAGIC, _SEQUENCE, _TIME, _CHECKSUM, _COUNT, _NAMES_LENGTH = range(6)


class PortWriter:
    """The only writer of a port; makes the file. Raises `UsageError` if another process writes it."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        text = json.dumps(list(names)).encode()
        if len(text) > VALUES_AT - NAMES_AT:
            raise UsageError(
                f"the port {path.name} has too many names; {VALUES_AT - NAMES_AT} bytes are the most"
            )
        self.path, self.names = path, tuple(names)
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            raise UsageError(
                f"the port {path} already has a writer; stop that process, or use another folder of ports"
            ) from None
        size = VALUES_AT + 8 * len(names)
        if os.fstat(self._file).st_size != size:
            os.ftruncate(self._file, size)
        self._memory = mmap.mmap(self._file, size)
        self._memory[NAMES_AT : NAMES_AT + len(text)] = text
        self._header = np.frombuffer(self._memory, dtype=np.uint64, count=HEADER_WORDS)
        self._values = np.frombuffer(self._memory, dtype=np.float64, offset=VALUES_AT)
        self._header[_COUNT], self._header[_NAMES_LENGTH] = len(names), len(text)
        self._sequence = int(self._header[_SEQUENCE]) | 1
        self._header[_SEQUENCE] = self._sequence
        self.write(np.full(len(names), np.nan), 0)
        self._header[_MAGIC] = MAGIC

    @runs_in_cycle
    def write(self, values: Array, time_ns: int | None = None) -> None:
        """Publish values with a time stamp, by default that of the monotonic clock."""
        stamp = time.monotonic_ns() if time_ns is None else time_ns
        self._header[_SEQUENCE] = self._sequence | 1
        self._values[:] = values
        self._header[_TIME] = stamp
        self._header[_CHECKSUM] = _checksum(self._values, stamp)
        self._sequence = (self._sequence | 1) + 1
        self._header[_SEQUENCE] = self._sequence

    def close(self) -> None:
        """Let another process write."""
        fcntl.flock(self._file, fcntl.LOCK_UN)  # the mapping keeps a copy of the descriptor, and its lock
        os.close(self._file)


class PortReader:
    """A reader of a port. Raises `UsageError` for a file that is no port."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with path.open("rb") as file:
                self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise UsageError(f"the port {path} cannot be opened: {error}; start its writer first") from None
        self._header = np.frombuffer(self._memory, dtype=np.uint64, count=HEADER_WORDS)
        length, count = int(self._header[_NAMES_LENGTH]), int(self._header[_COUNT])
        if int(self._header[_MAGIC]) != MAGIC or len(self._memory) != VALUES_AT + 8 * count:
            raise UsageError(f"{path} is no port, or of another version")
        self.names = tuple(json.loads(self._memory[NAMES_AT : NAMES_AT + length]))
        self._values = np.frombuffer(self._memory, dtype=np.float64, offset=VALUES_AT)
        self.values = np.full(count, np.nan)
        self.time_ns = 0
        self._copy = np.empty(count)

    @runs_in_cycle
    def read(self) -> bool:
        """Copy the newest values to `values` and `time_ns`; return whether they could be read whole."""
        header = self._header
        for _ in range(MAX_TRIES):
            sequence = int(header[_SEQUENCE])
            if sequence % 2:
                continue
            self._copy[:] = self._values
            stamp, checksum = int(header[_TIME]), int(header[_CHECKSUM])
            if int(header[_SEQUENCE]) == sequence and checksum == _checksum(self._copy, stamp):
                self.values[:] = self._copy
                self.time_ns = stamp
                return True
        return False

    @runs_in_cycle
    def age_s(self, now_ns: int | None = None) -> float:
        """Return the age of the values; infinite before the first."""
        now = time.monotonic_ns() if now_ns is None else now_ns
        return (now - self.time_ns) / 1e9 if self.time_ns else float("inf")

    def value(self, name: str) -> float:
        """Return one of the values that were read last."""
        return float(self.values[self.names.index(name)])


def _checksum(values: Array, stamp: int) -> int:
    return zlib.crc32(values.data, stamp & 0xFFFFFFFF)
