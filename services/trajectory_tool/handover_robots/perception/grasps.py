"""Grasps of parts in a bin, checked against the bin and the other parts, the best first.

A gripper with two flat fingers comes from above, at most `MAX_TILT` from the vertical, and closes across two
opposite sides of a part. A grasp is possible where the opened fingers and the palm touch neither the bin nor
points of other parts, and no other part is between the fingers. Better grasps are deep, central, upright, and
at parts that lie on top.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from handover.messages import Message, message
from handover_robots.model.poses import NO_TURN, Frame
from handover_robots.perception.depth_image import Array, DepthImage, Mask, frame_of
from handover_robots.perception.segmentation import Inside, SeenPart, contents_of

Bounds = tuple[float, float]
AT_TIP = Frame(NO_TURN, (0.0, 0.0, 0.0))

CLEARANCE_M = 0.003
"""Between an opened finger and anything else, the bin included."""

MIN_TIP_HEIGHT_M = 0.003
MAX_TILT = math.radians(20)
DEPTHS_M = (0.018, 0.015, 0.011)
"""How far the fingers reach below the face of a part."""

MIN_BELOW_M = 0.005
"""The fingers end this far above the opposite face, at least: something may lie there."""

REACHES = (0.9, 0.65, 0.5)
"""How far the fingers reach below the top of a thing of any shape, as shares of its height."""

MARGIN_BELOW_M = 0.0005
"""The fingers end this far above where they would touch the bottom, there."""

OFFSETS = (0.0, -0.2, 0.2, -0.35, 0.35)
"""Along the part, as shares of its length."""

BETWEEN_VIEWS_M = 0.005
"""A point that one view shows this near to a part of another view may be of that part."""

SHIFTS = (0.0, 0.5, -0.5, 0.9, -0.9)
"""Across the part, as shares of the play between the opened fingers: away from what is in the way."""


@dataclass(frozen=True, slots=True)
class Fingers:
    """Two fingers that close along x of their frame; z points to their tips, which are at 0.

    Each finger is `thickness` x `width` x `length`, with `opening` between them; behind them is the palm.
    `frame` is theirs in that of the tip: fingers that close along y of the tip are turned about z, and their
    ends may be beyond the tip.
    """

    opening: float
    thickness: float
    width: float
    length: float
    palm: tuple[float, float, float]
    frame: Frame = AT_TIP


@dataclass(frozen=True, slots=True)
class Grasp:
    """A pose of the fingers that grips a part: `part` is its middle in the cell, `size` its lengths."""

    tool: Frame
    part: Frame
    size: tuple[float, float, float]
    score: float


class GraspFinder:
    """Finds grasps in one image of a bin; `further` images show what is in the way from other sides."""

    def __init__(
        self, image: DepthImage, inside: Inside, fingers: Fingers, further: Sequence[DepthImage] = ()
    ) -> None:
        self._fingers = fingers
        self._inside = inside
        self._content = contents_of(image.points, inside)
        self._points = image.points
        self._further = [view.points[contents_of(view.points, inside)] for view in further]

    def grasps(self, part: SeenPart) -> tuple[Grasp, ...] | Message:
        """Return the grasps of a part, the best first, or why there is none."""
        others = self._points[self._content & ~_grown(part.pixels)]
        others = np.vstack([others, *(_outside(points, part) for points in self._further)])
        near = np.linalg.norm(others - np.array(part.pose.position), axis=1) < 0.15
        possible, reasons = [], set()
        for grasp in _candidates(part, self._fingers):
            reason = self._obstacle(grasp, others[near])
            if reason is None:
                possible.append(grasp)
            else:
                reasons.add(reason)
        if possible:
            return tuple(sorted(possible, key=lambda grasp: -grasp.score))
        return _why_not(reasons)

    def _obstacle(self, grasp: Grasp, others: Array) -> str | None:
        """Return what the opened gripper touches at a grasp: "wall", "bottom" or "part"; None if nothing."""
        to_bin = self._inside.bottom.inverse() @ grasp.tool
        corners = _corners(self._fingers) @ np.array(to_bin.rotation).T + np.array(to_bin.position)
        if float(corners[:, 2].min()) < MIN_TIP_HEIGHT_M:
            return "bottom"
        low = corners[corners[:, 2] < self._inside.height + CLEARANCE_M]
        if len(low) and (
            float(np.abs(low[:, 0]).max()) > self._inside.width / 2 - CLEARANCE_M
            or float(np.abs(low[:, 1]).max()) > self._inside.depth / 2 - CLEARANCE_M
        ):
            return "wall"
        back = grasp.tool.inverse()
        local = others @ np.array(back.rotation).T + np.array(back.position)
        return "part" if _meets(local, self._fingers) else None


def _candidates(part: SeenPart, fingers: Fingers) -> Iterator[Grasp]:
    rotation = np.array(part.pose.rotation)
    normal, middle = rotation[:, 2], np.array(part.pose.position)
    tilt = math.acos(min(float(normal[2]), 1.0))
    face = middle + normal * part.size[2] / 2
    for axis in (0, 1):
        width, length = part.size[axis], part.size[1 - axis]
        play = fingers.opening - width
        if play < 4 * CLEARANCE_M / 3:
            continue
        closing, along = rotation[:, axis], rotation[:, 1 - axis]
        for approach in _approaches(normal, tilt):
            x_axis = closing - approach * float(closing @ approach)
            x_axis /= np.linalg.norm(x_axis)
            if x_axis[0] < 0:
                x_axis = -x_axis
            y_axis = np.cross(approach, x_axis)
            depths = _depths(part, fingers)
            for depth, offset, shift in product(depths, OFFSETS, SHIFTS):
                tip = (
                    face
                    + along * offset * length
                    + x_axis * shift * (play / 2 - CLEARANCE_M)
                    + approach * depth
                )
                score = (
                    float(face[2]) * 4.0
                    + 0.3 * part.cover
                    - abs(offset) * 0.2
                    - abs(shift) * 0.1
                    + depth * 8.0
                    - math.acos(min(-float(approach[2]), 1.0)) * 0.3
                    - (0.15 if play < 0.012 else 0.0)
                )
                yield Grasp(frame_of(x_axis, y_axis, approach, tip), part.pose, part.size, score)


def _depths(part: SeenPart, fingers: Fingers) -> list[float]:
    """Return how far the fingers reach below the top: to a fixed depth, or around a thing of any shape."""
    height = part.size[2]
    if part.is_known:
        return [depth for depth in DEPTHS_M if depth <= height - MIN_BELOW_M]
    most = min(fingers.length - CLEARANCE_M, height - MIN_TIP_HEIGHT_M - MARGIN_BELOW_M)
    return [min(share * height, most) for share in REACHES]


def _approaches(normal: Array, tilt: float) -> Iterator[Array]:
    """Yield directions of approach: along the normal of the face, or straight down on a tilted face."""
    down = np.array([0.0, 0.0, -1.0])
    if tilt < MAX_TILT:
        yield -normal
    if tilt > math.radians(2):
        if tilt >= MAX_TILT:
            between = -normal * math.sin(MAX_TILT) / max(math.sin(tilt), 0.1) + down
            yield between / np.linalg.norm(between)
        yield down


def _boxes(
    fingers: Fingers,
) -> Iterator[tuple[tuple[float, float], tuple[float, float], tuple[float, float]]]:
    half, width = fingers.opening / 2, fingers.width / 2
    for side in (-1, 1):
        edges = sorted((side * half, side * (half + fingers.thickness)))
        yield ((edges[0], edges[1]), (-width, width), (-fingers.length, 0.0))
    x, y, z = fingers.palm
    yield ((-x / 2, x / 2), (-y / 2, y / 2), (-fingers.length - z, -fingers.length))


def _corners(fingers: Fingers) -> Array:
    return np.array(
        [[x, y, z] for xs, ys, zs in _boxes(fingers) for x in xs for y in ys for z in zs], dtype=np.float64
    )


def _meets(local: Array, fingers: Fingers) -> bool:
    half, width = fingers.opening / 2, fingers.width / 2
    between = ((-half, half), (-width, width), (-fingers.length, 0.0))
    for bounds in (between, *_boxes(fingers)):
        inside = np.ones(len(local), dtype=bool)
        for axis, (low, high) in enumerate(bounds):
            inside &= (local[:, axis] > low - CLEARANCE_M) & (local[:, axis] < high + CLEARANCE_M)
        if int(inside.sum()) > 2:
            return True
    return False


def _outside(points: Array, part: SeenPart) -> Array:
    """Return the points that do not belong to a part; cameras agree within `BETWEEN_VIEWS_M`."""
    back = part.pose.inverse()
    local = points @ np.array(back.rotation).T + np.array(back.position)
    return np.asarray(points[(np.abs(local) > np.array(part.size) / 2 + BETWEEN_VIEWS_M).any(axis=1)])


def _grown(pixels: Mask) -> Mask:
    """Return a mask with a rim of two pixels: those at the edge of a part belong to it."""
    grown = pixels.copy()
    for _ in range(2):
        wider = grown.copy()
        wider[1:] |= grown[:-1]
        wider[:-1] |= grown[1:]
        wider[:, 1:] |= grown[:, :-1]
        wider[:, :-1] |= grown[:, 1:]
        grown = wider
    return grown


def _why_not(reasons: set[str]) -> Message:
    if "part" in reasons:
        return message("robot.grasp_other_part", "another part is in the way of the fingers")
    if "wall" in reasons:
        return message("robot.grasp_wall", "it lies too near to a wall of the bin")
    if "bottom" in reasons:
        return message("robot.grasp_bottom", "the fingers would touch the bottom of the bin")
    return message("robot.grasp_too_wide", "the gripper does not open wide enough for it")
