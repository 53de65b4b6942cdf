"""Objects that are no boxes: rigid ones of several shapes, and cloth as articulated patches.

The eight are those of the case study of the IoHRT paper (Table I), which gives no sizes: sizes and masses
here are those of common goods of the kind, made to fit into the tray of the study. Cloth is a tree of flat
rigid patches with hinges that bend, not a continuum: it folds along its hinges, does not stretch, and its
patches are thicker than fabric.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from handover_robots.model.obstacles import Box, Capsule, Shape, Sphere
from handover_robots.model.poses import NO_TURN, Frame, Pose, Vector

ALONG_X: Final = (1.0, 0.0, 0.0)
ALONG_Y: Final = (0.0, 1.0, 0.0)
LYING: Final = (0.0, math.sin(math.pi / 4), 0.0, math.cos(math.pi / 4))
"""Turns a capsule, which is along z, along x."""

HINGE_STIFFNESS_NM_RAD: Final = 0.001
HINGE_DAMPING_NMS_RAD: Final = 0.0008
HINGE_RANGE_RAD: Final = 2.6
SEAM_M: Final = 0.003
"""Between the edges of two patches."""


@dataclass(frozen=True, slots=True)
class Link:
    """A rigid piece: `shapes` in its frame, which is at `position` in that of its parent.

    It bends about `axes` through its origin; the first link of an object has no parent and moves freely.
    """

    shapes: tuple[tuple[Shape, Pose], ...]
    mass_kg: float
    parent: int | None = None
    position: Vector = (0.0, 0.0, 0.0)
    axes: tuple[Vector, ...] = ()


@dataclass(frozen=True, slots=True)
class LooseObject:
    """An object that slides, tips, falls and bends; `friction` is that of its surface on everything."""

    name: str
    links: tuple[Link, ...]
    friction: float

    @property
    def is_cloth(self) -> bool:
        """Return whether it is made of patches."""
        return len(self.links) > 1

    @property
    def mass_kg(self) -> float:
        """Return the mass of all links."""
        return sum(link.mass_kg for link in self.links)


def _rigid(name: str, mass_kg: float, friction: float, *shapes: tuple[Shape, Pose]) -> LooseObject:
    return LooseObject(name, (Link(shapes, mass_kg),), friction)


def _at(x: float = 0.0, y: float = 0.0, turn: tuple[float, float, float, float] = (0, 0, 0, 1)) -> Pose:
    return Pose((x, y, 0.0), turn)


def _chilli() -> Iterator[tuple[Shape, Pose]]:
    """Yield four pieces along a bend, thinner towards the tip."""
    x, y, angle = -0.045, 0.0, 0.35
    for radius, length in ((0.010, 0.028), (0.009, 0.028), (0.0075, 0.026), (0.005, 0.024)):
        half = angle / 2
        flat = Frame(
            ((math.cos(angle), -math.sin(angle), 0.0), (math.sin(angle), math.cos(angle), 0.0), NO_TURN[2]),
            (x + math.cos(angle) * length / 2, y + math.sin(angle) * length / 2, 0.0),
        )
        yield Capsule(radius, length), Pose.of(flat @ Pose((0.0, 0.0, 0.0), LYING).frame())
        x, y, angle = x + math.cos(angle) * length, y + math.sin(angle) * length, angle - half - 0.12


class Cloth:
    """Patches that are added one by one; each hangs on an edge of another."""

    def __init__(self, thickness_m: float, kg_m2: float) -> None:
        self.links: list[Link] = []
        self._sizes: list[tuple[float, float]] = []
        self._middles: list[tuple[float, float]] = []
        self._thickness_m = thickness_m
        self._kg_m2 = kg_m2

    def add(
        self,
        size: tuple[float, float],
        parent: int | None = None,
        to: tuple[int, int] = (0, 0),
        shift: float = 0.0,
    ) -> int:
        """Add a patch at the edge `to` (-1 or 1 along x or y) of `parent`; return its number.

        `shift` moves it along that edge. It bends about the edge, and a little about the other axis.
        """
        width, depth = size
        middle, position = (0.0, 0.0), (0.0, 0.0, 0.0)
        axes: tuple[Vector, ...] = ()
        if parent is not None:
            on, at = self._sizes[parent], self._middles[parent]
            edge = [at[axis] + to[axis] * (on[axis] / 2 + SEAM_M / 2) for axis in (0, 1)]
            edge[0 if to[1] else 1] += shift
            middle = (to[0] * (width + SEAM_M) / 2, to[1] * (depth + SEAM_M) / 2)
            position = (edge[0], edge[1], 0.0)
            axes = (ALONG_X, ALONG_Y) if to[1] else (ALONG_Y, ALONG_X)
        box = Box((width, depth, self._thickness_m))
        mass_kg = self._kg_m2 * width * depth
        self.links.append(Link(((box, _at(*middle)),), mass_kg, parent, position, axes))
        self._sizes.append(size)
        self._middles.append(middle)
        return len(self.links) - 1

    def chain(
        self, count: int, size: tuple[float, float], parent: int, to: tuple[int, int], shift: float = 0.0
    ) -> int:
        """Add patches one after the other; return the last one."""
        for _ in range(count):
            parent, shift = self.add(size, parent, to, shift), 0.0
        return parent


def _pantyhose() -> LooseObject:
    cloth = Cloth(0.007, 3.0)
    waist = cloth.add((0.075, 0.03))
    for side in (-1, 1):
        cloth.chain(6, (0.028, 0.028), waist, (0, -1), side * 0.022)
    return LooseObject("pantyhose", tuple(cloth.links), 0.5)


def _glove(name: str, finger_patches: int, thickness_m: float, kg_m2: float, friction: float) -> LooseObject:
    cloth = Cloth(thickness_m, kg_m2)
    palm = cloth.add((0.08, 0.034))
    knuckles = cloth.add((0.08, 0.034), palm, (0, 1))
    cloth.add((0.07, 0.03), palm, (0, -1))  # the cuff
    for place in (-0.0315, -0.0105, 0.0105, 0.0315):
        cloth.chain(finger_patches, (0.018, 0.026), knuckles, (0, 1), place)
    cloth.chain(finger_patches, (0.026, 0.018), palm, (1, 0), 0.005)
    return LooseObject(name, tuple(cloth.links), friction)


def _jacket() -> LooseObject:
    cloth = Cloth(0.009, 7.0)
    spine = [cloth.add((0.05, 0.04))]
    for _ in range(4):
        spine.append(cloth.add((0.05, 0.04), spine[-1], (0, -1)))
    for row, middle in enumerate(spine):
        for side in (-1, 1):
            outer = cloth.chain(2, (0.04, 0.04), middle, (side, 0))
            if row == 0:
                cloth.chain(5, (0.034, 0.036), outer, (side, 0))
    return LooseObject("jacket", tuple(cloth.links), 0.55)


OBJECTS: Final = {
    loose.name: loose
    for loose in (
        _rigid("cube", 0.05, 0.6, (Box((0.045, 0.045, 0.045)), _at())),
        _rigid("apple", 0.15, 0.5, (Sphere(0.034), _at())),
        _rigid("chilli", 0.02, 0.5, *_chilli()),
        _rigid("orange", 0.18, 0.45, (Sphere(0.037), _at())),
        _pantyhose(),
        _glove("yellow-glove", 3, 0.008, 5.0, 0.7),
        _glove("pink-glove", 1, 0.008, 4.0, 0.55),
        _jacket(),
    )
}
