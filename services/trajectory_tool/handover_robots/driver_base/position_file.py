"""Position file: the joints of a simulated robot after a crash, as the encoders of a real one have them.

A memory-mapped file with two slots, which are written in turn in each control cycle, without a system call.
What was written survives `kill -9`, not a power cut. A slot has its number before and after
its content, so a slot whose write was interrupted is recognized. A position counts only together with the
stored state of the cell after which it was written, the `base`.
"""

import mmap
import struct
from pathlib import Path

from handover_robots.model.joints import Joints


class PositionFile:
    """The file at `path`; `base` are the joints that the stored state of the cell has."""

    def __init__(self, path: Path, base: Joints) -> None:
        self.base = base
        self._path = path
        self._slot = struct.Struct(f"<Q{len(base)}d{len(base)}dQ")
        self._map: mmap.mmap | None = None
        self._number = 0

    def open(self) -> Joints:
        """Open the file; return the last position after `base`, or `base`. Raises `OSError`."""
        size = 2 * self._slot.size
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._path.touch()
        with self._path.open("rb+") as file:
            if file.seek(0, 2) != size:
                file.truncate(0)
                file.truncate(size)
            self._map = mmap.mmap(file.fileno(), size)
        latest = self.base
        for offset in (0, self._slot.size):
            first, *content, last = self._slot.unpack_from(self._map, offset)
            base, joints = tuple(content[: len(self.base)]), tuple(content[len(self.base) :])
            if first == last and first > self._number:
                self._number = first
                latest = joints if base == self.base else self.base
        return latest

    def write(self, joints: Joints) -> None:
        """Write the present position; called in the control thread."""
        if self._map is not None:
            self._number += 1
            offset = self._number % 2 * self._slot.size
            self._slot.pack_into(self._map, offset, self._number, *self.base, *joints, self._number)
