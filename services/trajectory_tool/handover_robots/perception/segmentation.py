"""Parts in a bin: the faces that a depth image shows, and the poses of the parts behind them.

Parts are boxes of a known size. The points above the bottom of the bin are cut where the depth jumps or the
surface turns; each piece is a face. A plane is fitted to it, and the rectangle of a face of the part is moved
over it for the best cover, which separates two parts that lie side by side. The thickness of the part behind
the face gives its middle.

Example: a face of 24 x 60 mm at a height of 36 mm, in a bin with a bottom of 12 mm, is a part of
24 x 60 x 24 mm that lies flat; its middle is 12 mm below the face.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np
from numpy.typing import NDArray

from handover_robots.model.poses import Frame
from handover_robots.perception.depth_image import Array, DepthImage, Mask, frame_of

BOTTOM_M = 0.005
WALL_M = 0.003
"""Points this near to the bottom or to a wall of the bin belong to the bin."""

JUMP_M = 0.005
MAX_BEND_COS = math.cos(math.radians(25))
MIN_PIXELS = 30
MAX_PLANE_ERROR_M = 0.0025
GRID_M = 0.001
MIN_COVER = 0.8
FULL_COVER = 0.85
MAX_SPREAD_CELLS = 6
MAX_FACE_TILT_COS = math.cos(math.radians(50))
SMOOTHING = 5


@dataclass(frozen=True, slots=True)
class Inside:
    """The inside of a bin: the frame of the middle of its bottom, its width, depth and height in m."""

    bottom: Frame
    width: float
    depth: float
    height: float


@dataclass(frozen=True)
class SeenPart:
    """A part of which a face is visible.

    `pose` is the frame of its middle; axis 2 (z) points out of the visible face, `size` are its lengths along
    the axes. `cover` says which share of the face is visible. `pixels` is its mask in the image.
    """

    pose: Frame
    size: tuple[float, float, float]
    cover: float
    pixels: Mask
    is_known: bool = True
    """Whether it is a part of the known size, and not the box around a thing of any shape."""

    @property
    def top_m(self) -> float:
        """Return the height of the middle of the visible face."""
        return self.pose.position[2] + self.pose.rotation[2][2] * self.size[2] / 2


def find_parts(image: DepthImage, inside: Inside, part_size_m: tuple[float, float, float]) -> list[SeenPart]:
    """Return the parts in a bin, the highest first."""
    content = contents_of(image.points, inside)
    normals = _normals(_smoothed(image))
    flat = content & ~_edges(image.depth_m, normals, content)
    count, labels = cv2.connectedComponents(flat.astype(np.uint8), connectivity=4)
    parts: list[SeenPart] = []
    for label in range(1, count):
        pixels = labels == label
        if int(pixels.sum()) >= MIN_PIXELS:
            parts += _parts_of_face(image.points, pixels, content, inside, part_size_m)
    return sorted(parts, key=lambda part: -part.top_m)


def contents_of(points: Array, inside: Inside) -> Mask:
    """Return which points lie in a bin, not on its bottom or its walls."""
    back = inside.bottom.inverse()
    local = points @ np.array(back.rotation).T + np.array(back.position)
    with np.errstate(invalid="ignore"):
        return np.asarray(
            (np.abs(local[..., 0]) < inside.width / 2 - WALL_M)
            & (np.abs(local[..., 1]) < inside.depth / 2 - WALL_M)
            & (local[..., 2] > BOTTOM_M)
            & (local[..., 2] < inside.height + 0.1)
        )


def _smoothed(image: DepthImage) -> Array:
    """Return the points with the noise of the depth reduced; edges stay."""
    depth = np.nan_to_num(image.depth_m, nan=10.0).astype(np.float32)
    even = cv2.bilateralFilter(cv2.medianBlur(depth, SMOOTHING), SMOOTHING, 0.004, 2.0)
    return DepthImage(even.astype(np.float64), image.intrinsics, image.camera).points


def _normals(points: Array) -> Array:
    """Return the normals of the surface, upwards: height x width x 3."""
    step = 2
    along = np.zeros_like(points)
    across = np.zeros_like(points)
    along[:, step:-step] = points[:, 2 * step :] - points[:, : -2 * step]
    across[step:-step] = points[2 * step :] - points[: -2 * step]
    normals = np.cross(along, across)
    with np.errstate(invalid="ignore", divide="ignore"):
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[normals[..., 2] < 0] *= -1
    return np.asarray(np.nan_to_num(normals))


def _edges(depth_m: Array, normals: Array, content: Mask) -> Mask:
    """Return where the depth jumps or the surface turns, and where the content of the bin ends."""
    edges = np.zeros(depth_m.shape, dtype=bool)
    for axis in (0, 1):
        jump = np.abs(np.diff(depth_m, axis=axis)) > JUMP_M
        first, second = (normals[:-1], normals[1:]) if axis == 0 else (normals[:, :-1], normals[:, 1:])
        bend = (first * second).sum(axis=-1) < MAX_BEND_COS
        cut = jump | bend
        if axis == 0:
            edges[:-1] |= cut
            edges[1:] |= jump
        else:
            edges[:, :-1] |= cut
            edges[:, 1:] |= jump
    return np.asarray(edges & content)


def _parts_of_face(
    points: Array, pixels: Mask, content: Mask, inside: Inside, part_size_m: tuple[float, float, float]
) -> Iterator[SeenPart]:
    """Yield the parts that a piece of surface belongs to: one, or several side by side."""
    face = points[pixels]
    middle, normal = _plane(face)
    if normal[2] < MAX_FACE_TILT_COS:
        return
    # Pixels at the rim of the face were cut off as edges: those on the plane belong to it.
    off = np.abs((points - middle) @ normal)
    near = cv2.dilate(pixels.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    with np.errstate(invalid="ignore"):
        pixels = near & content & (off < MAX_PLANE_ERROR_M)
    face = points[pixels]
    along = np.cross(normal, [0.0, 1.0, 0.0])
    along /= np.linalg.norm(along)
    across = np.cross(normal, along)
    flat = np.stack([(face - middle) @ along, (face - middle) @ across], axis=1)
    left = np.ones(len(flat), dtype=bool)
    bottom_m = inside.bottom.position[2]
    for _ in range(6):
        if int(left.sum()) < MIN_PIXELS:
            return
        fitted = _best_face(flat[left], part_size_m, float(middle[2]) - bottom_m)
        if fitted is None:
            return
        centre, angle, size, cover = fitted
        x_axis = math.cos(angle) * along + math.sin(angle) * across
        y_axis = np.cross(normal, x_axis)
        at = middle + centre[0] * along + centre[1] * across - normal * size[2] / 2
        inside_face = left & _is_in_rectangle(flat, centre, angle, size)
        mask = np.zeros_like(pixels)
        rows, columns = np.nonzero(pixels)
        mask[rows[inside_face], columns[inside_face]] = True
        yield SeenPart(frame_of(x_axis, y_axis, normal, at), size, cover, mask)
        left &= ~_is_in_rectangle(flat, centre, angle, (size[0] + 0.003, size[1] + 0.003, 0.0))


def _plane(face: Array) -> tuple[Array, Array]:
    """Return the middle and the upward normal of the plane through points, without outliers."""
    for _ in range(3):
        middle = face.mean(axis=0)
        normal = np.linalg.svd(face - middle, full_matrices=False)[2][2]
        off = np.abs((face - middle) @ normal)
        keep = off < max(2.5 * float(off.std()), 0.0005)
        if keep.all():
            break
        face = face[keep]
    return middle, normal if normal[2] > 0 else -normal


def _best_face(
    flat: Array, part_size_m: tuple[float, float, float], top_m: float
) -> tuple[Array, float, tuple[float, float, float], float] | None:
    """Return middle, angle, size and cover of the face of the part that covers most of the points."""
    _, (width, height), turned = cv2.minAreaRect(flat.astype(np.float32))
    area = _area(flat)
    best, best_score = None, 0.0
    faces = {(length, width, thickness) for length, width, thickness in permutations(part_size_m)}
    for size in sorted(faces):
        if size[0] > size[1] + 1e-9 or size[2] > top_m + 0.02:
            continue
        for angle_deg in (turned, turned + 90.0):
            for extra_deg in (-4.0, -2.0, 0.0, 2.0, 4.0) if max(width, height) > size[1] + 0.01 else (0.0,):
                angle = math.radians(angle_deg + extra_deg)
                centre, covered = _place(flat, angle, size)
                cover = covered / (size[0] * size[1])
                explained = covered / area
                score = min(cover, 1.0) * 0.6 + explained * 0.4
                if cover > MIN_COVER / 2 and score > best_score:
                    best_score = score
                    best = (centre, angle, size, min(cover, 1.0))
    return best


def _area(flat: Array) -> float:
    return float(len(flat)) * _pixel_area(flat)


def _pixel_area(flat: Array) -> float:
    """Return the area of one point of a dense face, from the smallest rectangle or the hull of its points."""
    hull = cv2.contourArea(cv2.convexHull(flat.astype(np.float32)))
    # The hull of the pixels' middles misses half a pixel at each side.
    side = math.sqrt(max(hull, 1e-8) / max(len(flat), 1))
    perimeter = cv2.arcLength(cv2.convexHull(flat.astype(np.float32)), True)
    return (hull + perimeter * side / 2) / len(flat)


def _place(flat: Array, angle: float, size: tuple[float, float, float]) -> tuple[Array, float]:
    """Return the middle of the rectangle of a face that covers the largest area of the points.

    Where several cover the same, it is the mean of them at a partly visible face, else one at the end.
    """
    c, s = math.cos(angle), math.sin(angle)
    turned = flat @ np.array([[c, -s], [s, c]])
    low = turned.min(axis=0)
    spread = np.ptp(turned, axis=0)
    margin = [math.ceil(side / GRID_M) + 2 for side in size[:2]]
    shape = [math.ceil(spread[axis] / GRID_M) + 1 + 2 * margin[axis] for axis in (0, 1)]
    grid = np.zeros(shape, dtype=np.float32)
    cells = np.round((turned - low) / GRID_M).astype(np.int64) + margin
    np.add.at(grid, (cells[:, 0], cells[:, 1]), 1.0)
    kernel = [max(round(side / GRID_M), 1) for side in size[:2]]
    sums = cv2.boxFilter(grid, -1, (kernel[1], kernel[0]), normalize=False, borderType=cv2.BORDER_CONSTANT)
    most = float(sums.max())
    if most * _pixel_area(flat) > FULL_COVER * size[0] * size[1]:
        cell = _corner(*np.nonzero(sums >= 0.97 * most)) - margin
    else:
        rows, columns = np.nonzero(sums >= most - 0.5)
        cell = np.array([rows.mean(), columns.mean()]) - margin
    even = [0.5 * (1 - kernel[axis] % 2) for axis in (0, 1)]
    centre = low + (cell - even) * GRID_M
    back = np.array([[c, -s], [s, c]])
    return np.asarray(back @ centre), most * _pixel_area(flat)


def _corner(rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Array:
    """Return the middle of some cells or, along an axis on which they spread, their end.

    A face fits at many places into the surface of several parts that lie side by side; at its end it is one.
    """
    if np.ptp(rows) > MAX_SPREAD_CELLS:
        ends = rows <= rows.min() + 1
        rows, columns = rows[ends], columns[ends]
    if np.ptp(columns) > MAX_SPREAD_CELLS:
        ends = columns <= columns.min() + 1
        rows, columns = rows[ends], columns[ends]
    return np.array([rows.mean(), columns.mean()])


def _is_in_rectangle(flat: Array, centre: Array, angle: float, size: tuple[float, float, float]) -> Mask:
    c, s = math.cos(angle), math.sin(angle)
    turned = (flat - centre) @ np.array([[c, -s], [s, c]])
    return np.asarray((np.abs(turned[:, 0]) <= size[0] / 2) & (np.abs(turned[:, 1]) <= size[1] / 2))
