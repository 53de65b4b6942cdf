"""Things of unknown shape in a bin: what stands out of its bottom in a depth image.

The points above the bottom are cut into connected pieces. A piece that fits between the fingers is one
thing: the smallest rectangle around it from above, and its height. Of a wider one, such as cloth, a piece is
taken beside which the fingers find room (`pinches`); the rest of it is an obstacle. Without such a piece it
is the part above some height that fits, about its highest point: two fingers can grip a fold. What cannot be
seen, below the widest place, is assumed to be as wide as it.

Example: a ball of 74 mm is a square of 74 mm, 74 mm high; a jacket that lies spread out, one of its sleeves.
"""

import math
from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np

from handover_robots.perception.depth_image import Array, DepthImage, Mask, frame_of
from handover_robots.perception.grasps import CLEARANCE_M, Fingers
from handover_robots.perception.pinches import Pinch, best_pinch
from handover_robots.perception.segmentation import MIN_PIXELS, Inside, SeenPart, contents_of

LEVELS: Final = 8
"""Heights at which a wide piece is cut."""
MIN_HEIGHT_M: Final = 0.006
MIN_PLAY_M: Final = 0.005
"""Between the opened fingers and a thing, together."""
JOINED_PIXELS: Final = 5
"""Pieces of a thing this near to each other in the image are one."""
UP: Final = np.array([0.0, 0.0, 1.0])


def find_things(image: DepthImage, inside: Inside, fingers: Fingers) -> list[SeenPart]:
    """Return the things in a bin, the highest first."""
    content = contents_of(image.points, inside)
    things = []
    for pixels in _pieces(content, JOINED_PIXELS):
        thing = _graspable(image.points, pixels & content, inside.bottom.position[2], fingers)
        if thing is not None:
            things.append(thing)
    return sorted(things, key=lambda part: -part.top_m)


def _pieces(mask: Mask, joined: int) -> Iterator[Mask]:
    kernel = np.ones((joined, joined), np.uint8)
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    count, labels = cv2.connectedComponents(closed, connectivity=8)
    for label in range(1, count):
        piece = labels == label
        if int((piece & mask).sum()) >= MIN_PIXELS:
            yield piece


def _graspable(points: Array, pixels: Mask, bottom_m: float, fingers: Fingers) -> SeenPart | None:
    """Return what of a piece fits between the fingers: all of it, a pinch, or what is above some height."""
    heights = points[..., 2]
    top = float(np.percentile(heights[pixels], 98))
    if top - bottom_m < MIN_HEIGHT_M:
        return None
    max_width_m = fingers.opening - MIN_PLAY_M
    whole = _rectangle(points, pixels, pixels, top, bottom_m)
    if min(whole.size[:2]) <= max_width_m:
        return whole
    pinch = best_pinch(points[pixels], fingers)
    if pinch is not None:
        return _pinched(points, pixels, pinch, bottom_m, fingers)
    return _highest_fold(points, pixels, top, bottom_m, max_width_m)


def _pinched(points: Array, pixels: Mask, pinch: Pinch, bottom_m: float, fingers: Fingers) -> SeenPart:
    """Return the piece between the fingers at a pinch, along whose first axis they close."""
    c, s = math.cos(pinch.closing_rad), math.sin(pinch.closing_rad)
    local = (points[..., :2] - np.array(pinch.place)) @ np.array([[c, -s], [s, c]])
    between = (
        pixels
        & (np.abs(local[..., 0]) < fingers.opening / 2)
        & (np.abs(local[..., 1]) < fingers.width / 2 + CLEARANCE_M)
    )
    height = max(float(np.percentile(points[between][:, 2], 98)) - bottom_m, MIN_HEIGHT_M)
    x_axis = np.array([c, s, 0.0])
    middle = np.array([*pinch.place, bottom_m + height / 2])
    frame = frame_of(x_axis, np.cross(UP, x_axis), UP, middle)
    return SeenPart(frame, (pinch.width_m, fingers.width, height), 1.0, between, is_known=False)


def _highest_fold(
    points: Array, pixels: Mask, top: float, bottom_m: float, max_width_m: float
) -> SeenPart | None:
    heights = points[..., 2]
    for share in np.linspace(0.0, 0.8, LEVELS)[1:]:
        level = bottom_m + share * (top - bottom_m)
        above = pixels & (heights > level)
        pieces = [piece & above for piece in _pieces(above, 3)]
        if not pieces:
            return None
        highest = max(pieces, key=lambda piece: float(heights[piece].max()))
        part = _rectangle(points, highest, pixels, top, bottom_m)
        if min(part.size[:2]) <= max_width_m:
            return part
    peak = points[pixels][int(np.argmax(heights[pixels]))]
    near = pixels & (np.linalg.norm(points[..., :2] - peak[:2], axis=-1) < 0.4 * max_width_m)
    return _rectangle(points, near, pixels, top, bottom_m)


def _rectangle(points: Array, seen: Mask, pixels: Mask, top: float, bottom_m: float) -> SeenPart:
    """Return the smallest upright box around the points from above; `pixels` is the whole thing."""
    flat = points[seen][:, :2]
    (x, y), (width, depth), turned = cv2.minAreaRect(flat.astype(np.float32))
    angle = math.radians(turned)
    x_axis = np.array([math.cos(angle), math.sin(angle), 0.0])
    height = max(top - bottom_m, MIN_HEIGHT_M)
    middle = np.array([x, y, top - height / 2])
    frame = frame_of(x_axis, np.cross(UP, x_axis), UP, middle)
    return SeenPart(frame, (float(width), float(depth), height), 1.0, pixels, is_known=False)
