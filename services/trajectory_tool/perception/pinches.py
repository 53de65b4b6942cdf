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

from services.trajectory_tool.perception.depth_image import Array
from services.trajectory_tool.perception.grasps import CLEARANCE_M, Fingers

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
    found = [
        one
        for number in range(DIRECTIONS)
        if (one := _best_along(flat - middle, number * math.pi / DIRECTIONS, fingers)) is not None
    ]
    if not found:
        return None
    _, angle, along, across, width_m = max(found)
    c, s = math.cos(angle), math.sin(angle)
    x, y = middle + np.array([c * across - s * along, s * across + c * along])
    return Pinch((float(x), float(y)), angle, width_m)


def _best_along(
    flat: Array, angle: float, fingers: Fingers
) -> tuple[float, float, float, float, float] | None:
    """Return score, angle, place along and across the direction of closing, and width; None without one."""
    c, s = math.cos(angle), math.sin(angle)
    turned = flat @ np.array([[c, -s], [s, c]])  # first: in the direction of closing
    half, room = fingers.opening / 2, fingers.thickness + CLEARANCE_M
    margin = half + room + 2 * CELL_M
    low = turned.min(axis=0) - margin
    shape = np.ceil((turned.max(axis=0) + margin - low) / CELL_M).astype(int) + 1
    grid = np.zeros(shape, dtype=np.float32)
    cells = np.floor((turned - low) / CELL_M).astype(int)
    grid[cells[:, 0], cells[:, 1]] = 1.0
    grid = cv2.morphologyEx(grid, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    wide = max(round((fingers.width + 2 * CLEARANCE_M) / CELL_M), 1)
    free = max(round((room + PLAY_M + CLEARANCE_M) / CELL_M), 1)
    inner = max(round((fingers.opening - 2 * (PLAY_M + CLEARANCE_M)) / CELL_M), 1)
    beside = cv2.boxFilter(grid, -1, (wide, free), normalize=False, borderType=cv2.BORDER_CONSTANT)
    between = cv2.boxFilter(grid, -1, (wide, inner), normalize=False, borderType=cv2.BORDER_CONSTANT)
    shift = inner // 2 + free // 2 + 1
    left, right = np.full_like(grid, np.inf), np.full_like(grid, np.inf)
    left[shift:], right[:-shift] = beside[:-shift], beside[shift:]
    full = wide * inner
    needed = MIN_FILLED * wide * MIN_ACROSS_M / CELL_M
    possible = (left < 0.5) & (right < 0.5) & (between >= needed)
    if not possible.any():
        return None
    rows, columns = np.nonzero(possible)
    across = low[0] + (rows + 0.5) * CELL_M
    along = low[1] + (columns + 0.5) * CELL_M
    scores = FILLED_WEIGHT_M * between[rows, columns] / full - np.hypot(across, along)
    best = int(scores.argmax())
    # Between the fingers the middle of what is there counts: both then have the same room.
    row, column = int(rows[best]), int(columns[best])
    first, last = max(row - inner // 2, 0), row + inner // 2 + 1
    strip = grid[first:last, max(column - wide // 2, 0) : column + wide // 2 + 1].any(axis=1)
    filled = np.flatnonzero(strip)
    centre = low[0] + (first + (filled[0] + filled[-1]) / 2 + 0.5) * CELL_M
    width_m = float((filled[-1] - filled[0] + 1) * CELL_M)
    return float(scores[best]), angle, float(along[best]), float(centre), width_m
