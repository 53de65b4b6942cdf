"""The Sensomative seat mat: a characteristic of 12 bytes, one a cell, 0 (no load) to 255."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover_body.drivers.base import PacketError

SERVICE: Final = "000055c0-0000-1000-8000-00805f9b34fb"
CELLS_UUID: Final = "000055c2-0000-1000-8000-00805f9b34fb"
POSITIONS: Final = (
    (1, 1), (3, 3), (5, 1), (7, 3), (10, 1), (10, 3), (10, 6), (10, 8), (7, 6), (5, 8), (3, 6), (1, 8)
)  # fmt: skip
"""Row (1 to 10) and column (1 to 8) of each cell as the mat sends them; they are no regular grid."""
CHANNELS: Final = tuple(f"r{row}c{column}" for row, column in POSITIONS)


def parse(data: bytes) -> NDArray[np.float64]:
    """Return the cells, shape (1, 12); raise `PacketError`."""
    if len(data) != len(POSITIONS):
        raise PacketError(f"{len(data)} bytes of a mat with {len(POSITIONS)} cells")
    return np.frombuffer(data, dtype=np.uint8).astype(np.float64)[None, :]


def build(cells: NDArray[np.float64]) -> bytes:
    """Return the bytes of 12 cells: what a simulated mat answers."""
    return bytes(np.clip(np.round(cells.ravel()), 0, 255).astype(np.uint8))
