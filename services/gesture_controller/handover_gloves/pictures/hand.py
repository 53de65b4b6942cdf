"""The shape of a hand: a palm, and three phalanges for each of the five finger states.

The view shows the palm of a right hand, fingers up, thumb at the right; a left hand is mirrored. A finger
bends towards the viewer: its phalanges shorten, and beyond a right angle they lie over the palm with the nail
visible. The proportions are in `hand.json`, which the web page uses as well.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import orjson

Point = tuple[float, float]
Polyline = tuple[Point, ...]

BENT = 2.0
FOLDED_DEG = 75.0
"""A phalanx turned further than this shows its back."""

NAIL_DEG = 90.0
THUMB_FOLDED = 1.4
LONG_FINGERS = ("index", "middle", "ring", "little")


@dataclass(frozen=True, slots=True)
class Phalanx:
    """One bone of a finger: two ends, half the width at each end, and whether its back is visible."""

    start: Point
    end: Point
    start_radius: float
    end_radius: float
    folded: bool


@dataclass(frozen=True, slots=True)
class FingerShape:
    """A finger: three phalanges, the nail if it is visible, and the creases of its joints."""

    finger: str
    phalanges: tuple[Phalanx, Phalanx, Phalanx]
    nail: Polyline | None
    creases: tuple[tuple[Point, Point], ...]


@cache
def proportions() -> dict[str, Any]:
    """Return the content of `hand.json`; lengths in units of the box (240 × 322), angles in degrees."""
    read: dict[str, Any] = orjson.loads(files(__package__).joinpath("hand.json").read_bytes())
    return read


def box() -> tuple[int, int]:
    """Return the width and height of the box around a hand."""
    return proportions()["box"]["width"], proportions()["box"]["height"]


@cache
def palm() -> Polyline:
    """Return the outline of the palm down to the wrist."""
    return _rounded(proportions()["palm"])


@cache
def palm_lines() -> tuple[Polyline, ...]:
    """Return the lines of the palm."""
    return tuple(_rounded(line) for line in proportions()["palmLines"])


def bends_of(states: str) -> tuple[float, ...]:
    """Return the bend of each finger of `states` (such as "02222"): 0 straight, 2 bent."""
    return tuple(float(state) for state in states)


def shape_of(bends: Sequence[float]) -> tuple[FingerShape, ...]:
    """Return the five fingers of a right hand, thumb first; `bends` go from 0 (straight) to 2 (bent)."""
    thumb, *others = (min(BENT, max(0.0, bend)) for bend in bends)
    long_fingers = (_long_finger(name, bend) for name, bend in zip(LONG_FINGERS, others, strict=True))
    return (_thumb(thumb), *long_fingers)


def _long_finger(name: str, bend: float) -> FingerShape:
    anatomy = proportions()["fingers"][name]
    splay = math.radians(anatomy["splay"])
    up = (math.sin(splay), -math.cos(splay))
    points: list[Point] = [tuple(anatomy["knuckle"])]
    folded: list[bool] = []
    angle = 0.0
    for length, joint in zip(anatomy["lengths"], proportions()["fingerJoints"], strict=True):
        angle += _along(joint, bend)
        seen = length * math.cos(math.radians(angle))
        x, y = points[-1]
        points.append((x + up[0] * seen, y + up[1] * seen))
        folded.append(angle > FOLDED_DEG)
    phalanges = _chain(points, anatomy["radii"], folded)
    nail = _nail(phalanges[2], angle) if angle > NAIL_DEG else None
    return FingerShape(name, phalanges, nail, _creases(phalanges))


def _thumb(bend: float) -> FingerShape:
    thumb = proportions()["thumb"]
    segment = 0 if bend <= 1 else 1
    before, after = thumb["way"][segment], thumb["way"][segment + 1]
    joints = [_between(a, b, bend - segment) for a, b in zip(before, after, strict=True)]
    folded = bend > THUMB_FOLDED
    phalanges = _chain([tuple(thumb["root"]), *joints], thumb["radii"], [False, folded, folded])
    return FingerShape("thumb", phalanges, _nail(phalanges[2], 130) if folded else None, _creases(phalanges))


def _chain(
    points: Sequence[Point], radii: Sequence[float], folded: Sequence[bool]
) -> tuple[Phalanx, Phalanx, Phalanx]:
    first, second, third = (
        Phalanx(points[n], points[n + 1], radii[n], radii[n + 1], folded[n]) for n in range(3)
    )
    return first, second, third


def _nail(tip: Phalanx, angle_deg: float) -> Polyline:
    """Return the nail on the back of the tip, which is turned by `angle_deg`."""
    radius = tip.end_radius
    way = math.atan2(tip.end[1] - tip.start[1], tip.end[0] - tip.start[0])
    long = radius * min(1.0, math.sin(math.radians(min(angle_deg, 180) - 90)) + 0.35) * 0.72
    wide = radius * 0.62
    points = []
    for step in range(14):
        turn = 2 * math.pi * step / 14
        u, v = long * math.cos(turn) + radius * 0.08, wide * math.sin(turn)
        points.append(
            (
                tip.end[0] + u * math.cos(way) - v * math.sin(way),
                tip.end[1] + u * math.sin(way) + v * math.cos(way),
            )
        )
    return tuple(points)


def _creases(phalanges: Sequence[Phalanx]) -> tuple[tuple[Point, Point], ...]:
    """Return a line across each of the two outer joints that is not seen end on."""
    creases: list[tuple[Point, Point]] = []
    for phalanx in phalanges[1:]:
        (x, y), (end_x, end_y) = phalanx.start, phalanx.end
        length = math.hypot(end_x - x, end_y - y)
        if length < 10:
            continue
        half = phalanx.start_radius * 0.55
        nx, ny = -(end_y - y) / length * half, (end_x - x) / length * half
        creases.append(((x + nx, y + ny), (x - nx, y - ny)))
    return tuple(creases)


def _rounded(points: Sequence[Sequence[float]], steps: int = 4) -> Polyline:
    """Return a smooth line through `points` (Catmull-Rom)."""
    last = len(points) - 1
    line: list[Point] = []
    for index in range(last):
        around = [points[min(last, max(0, index + beside))] for beside in (-1, 0, 1, 2)]
        for step in range(steps):
            part = step / steps
            x, y = (_catmull_rom([point[axis] for point in around], part) for axis in (0, 1))
            line.append((x, y))
    x, y = points[last]
    return (*line, (x, y))


def _catmull_rom(values: Sequence[float], part: float) -> float:
    a, b, c, d = values
    return b + 0.5 * part * (c - a + part * (2 * a - 5 * b + 4 * c - d + part * (3 * (b - c) + d - a)))


def _along(stops: Sequence[float], bend: float) -> float:
    if bend <= 1:
        return stops[0] + (stops[1] - stops[0]) * bend
    return stops[1] + (stops[2] - stops[1]) * (bend - 1)


def _between(start: Sequence[float], end: Sequence[float], part: float) -> Point:
    return start[0] + (end[0] - start[0]) * part, start[1] + (end[1] - start[1]) * part
