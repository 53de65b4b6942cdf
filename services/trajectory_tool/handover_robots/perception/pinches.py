"""Pinches: where two fingers find room on both sides of a piece of something that lies spread out.

A thing wider than the gripper opens, such as cloth, cannot be gripped across its middle: the fingers would
land on it. Seen from above, a pinch is a place and a direction of closing where the areas of both opened
fingers are free, and something is between them. The points are entered into a grid that is turned step by
step; sums over rectangles give what is in these areas at every place. Pieces near the middle of the thing are
preferred, as what is gripped at its end hangs far down; then those with much between the fingers.

Example: of a glove that lies flat, the thumb is a pinch, the palm is none, and neither is one of four
fingers that lie side by side.
"""

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from handover_robots.perception.depth_image import Array
from handover_robots.perception.grasps import CLEARANCE_M, Fingers

CELL_M: Final = 0.0025
DIRECTIONS: Final = 12
"""Of closing, over half a turn."""
MIN_FILLED: Final = 0.25
"""The share of the width of the fingers, times `MIN_ACROSS_M`, that is filled between them at least."""
MIN_ACROSS_M: Final = 0.012
PLAY_M: Final = 0.004
"""Room for errors beside each finger, in the direction of closing, in addition to the clearance."""
FILLED_WEIGHT_M: Final = 0.02
"""A pinch that is full may be this much farther from the middle than one that is nearly empty."""


@dataclass(frozen=True, slots=True)
class Pinch:
    """A place (x, y) in m, the direction of closing in rad about z, and the width between the fingers."""

    place: tuple[float, float]
    closing_rad: float
    width_m: float


def best_pinch(points: Array, fingers: Fingers) -> Pinch | None:
    """Return the best pinch of a thing; `points` are those of its surface from above, N x 2 or more."""
    flat = np.asarray(points)[:, :2].astype(np.float64)
    if not len(flat):
        return None
    middle = flat.mean(axis=0)
    pinches = [
        pinch
        for number in range(DIRECTIONS)
        if (pinch := _best_along(flat - middle, number * math.pi / DIRECTIONS, fingers)) is not None
    ]
    if not pinches:
        return None
    _, angle, along, across, width_m = max(pinches)
    c, s = math.cos(angle), math.sin(angle)
    x, y = middle + np.array([c * across - s * along, s * across + c * along])
    return Pinch((float(x), float(y)), angle, width_m)


def _best_along(
    flat: Array, angle: float, fingers: Fingers
) -> tuple[float, float, float, float, float] | None:
    """Return score, angle, place along and across the direction of closing, and width; None without one."""
    c, s = math.cos(angle), math.sin(angle)
    turned = flat @ np.array([[c, -s], [s, c]])  # first: in the direction of closing
    areas = _Areas.of(fingers)
    margin = (areas.shift + areas.free) * CELL_M
    low = turned.min(axis=0) - margin
    shape = np.ceil((turned.max(axis=0) + margin - low) / CELL_M).astype(int) + 1
    grid = np.zeros(shape, dtype=np.float32)
    cells = np.floor((turned - low) / CELL_M).astype(int)
    grid[cells[:, 0], cells[:, 1]] = 1.0
    grid = np.asarray(cv2.morphologyEx(grid, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), np.float32)
    beside = _sums(grid, areas.free, areas.wide)
    between = _sums(grid, areas.inner, areas.held)
    left, right = np.full_like(grid, np.inf), np.full_like(grid, np.inf)
    left[areas.shift :], right[: -areas.shift] = beside[: -areas.shift], beside[areas.shift :]
    needed = MIN_FILLED * fingers.width * MIN_ACROSS_M / CELL_M**2
    possible = (left < 0.5) & (right < 0.5) & (between >= needed)
    if not possible.any():
        return None
    rows, columns = np.nonzero(possible)
    across = low[0] + (rows + 0.5) * CELL_M
    along = low[1] + (columns + 0.5) * CELL_M
    full = areas.inner * areas.held
    scores = FILLED_WEIGHT_M * between[rows, columns] / full - np.hypot(across, along)
    best = int(scores.argmax())
    row, column = int(rows[best]), int(columns[best])
    first = row - areas.inner // 2
    strip = grid[first : row + areas.inner // 2 + 1, column - areas.held // 2 : column + areas.held // 2 + 1]
    filled = np.flatnonzero(strip.any(axis=1))
    # Both fingers have the same room at the middle of what is between them; but something else that lies
    # beside it may be in the way of a finger there.
    middle = first + (int(filled[0]) + int(filled[-1])) // 2
    if possible[middle, column]:
        row = middle
    width_m = float((filled[-1] - filled[0] + 1) * CELL_M)
    return float(scores[best]), angle, float(along[best]), float(low[0] + (row + 0.5) * CELL_M), width_m


@dataclass(frozen=True, slots=True)
class _Areas:
    """Sizes in cells, all odd, so that the middle of an area is the middle of a cell.

    In the direction of closing: `inner` between the fingers, `free` that each finger needs, and `shift` from
    the middle to that of a finger's area. Across it: `wide` that the fingers need, and `held` between them,
    without a cell at each edge of the fingers, as nothing is held by an edge.
    """

    inner: int
    free: int
    shift: int
    wide: int
    held: int

    @classmethod
    def of(cls, fingers: Fingers) -> "_Areas":
        """Return the sizes: what must be free is rounded up, what must be filled is rounded down."""
        inner = _odd_down(fingers.opening - 2 * (PLAY_M + CLEARANCE_M))
        free = _odd_up(fingers.opening / 2 + fingers.thickness + CLEARANCE_M - inner * CELL_M / 2)
        wide = _odd_up(fingers.width + 2 * CLEARANCE_M)
        return cls(inner, free, (inner + free) // 2, wide, _odd_down(fingers.width - 2 * CELL_M))


def _odd_down(length_m: float) -> int:
    return max(math.floor((length_m / CELL_M - 1) / 2) * 2 + 1, 1)


def _odd_up(length_m: float) -> int:
    return max(math.ceil((length_m / CELL_M - 1) / 2) * 2 + 1, 1)


def _sums(grid: NDArray[np.float32], rows: int, columns: int) -> NDArray[np.float32]:
    """Return the sum over the area of so many rows and columns around each cell; both odd."""
    sums = cv2.boxFilter(grid, -1, (columns, rows), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(sums, dtype=np.float32)
