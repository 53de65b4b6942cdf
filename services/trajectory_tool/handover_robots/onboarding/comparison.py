"""How the shapes of a robot decide about its self-collision, beside its meshes.

A configuration is *free by the meshes* if the meshes of no two links are within the planner's smallest
clearance. It is *falsely refused* if it is, and shapes are within that clearance; *falsely allowed* if meshes
touch, and no shapes of these links are within the clearance. Links that share a joint are not compared, and
neither are pairs that the model leaves unchecked because they always touch.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin

from handover_robots.model.obstacles import World
from handover_robots.model.srdf import LinkPair
from handover_robots.onboarding.meshes import Surfaces
from handover_robots.planning.arm import Arm, Array
from handover_robots.planning.collision import Collisions, link_of
from handover_robots.planning.planner import Options

MAX_FALSELY_REFUSED = 0.02
DEFAULT_CONFIGURATIONS = 1000
CLEARANCE_M = Options().margins_m[-1]


@dataclass(frozen=True, slots=True)
class PairShares:
    """A pair of links, and its shares of the compared configurations."""

    first: str
    second: str
    touching: float
    """By the meshes."""
    falsely_refused: float
    """Of the configurations that are free by the meshes of this pair."""
    falsely_allowed: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Shares of uniform random configurations within the limits of the joints."""

    configurations: int
    seed: int
    free: int
    """The configurations that are free by the meshes of all pairs."""
    falsely_refused: float
    """Of the free configurations."""
    falsely_allowed: float
    """Of all configurations."""
    pairs: tuple[PairShares, ...]
    """The pairs that are checked and touch, or are falsely refused or allowed, in some configuration."""
    unchecked: tuple[PairShares, ...]
    """The pairs that the model leaves unchecked on purpose, although their meshes touch."""


class MeshPairs:
    """The pairs of links that do not share a joint, by their meshes. Used by one thread at a time."""

    def __init__(self, arm: Arm, surfaces: Surfaces) -> None:
        self.arm = arm
        self.geometry = pin.GeometryModel()
        of_link: dict[str, list[int]] = {}
        for link, shapes in surfaces.items():
            frame = arm.pin_model.frames[arm.pin_model.getFrameId(link, pin.FrameType.BODY)]
            for number, surface in enumerate(shapes):
                item = pin.GeometryObject(
                    f"{link}_{number}",
                    frame.parentJoint,
                    frame.placement * surface.placement,
                    surface.geometry,
                )
                of_link.setdefault(link, []).append(self.geometry.addGeometryObject(item))
        self.names: list[LinkPair] = []
        """The pair of links of each pair of meshes."""
        for first, second in combinations(of_link, 2):
            if abs(arm.joint_of_link(first) - arm.joint_of_link(second)) < 2:
                continue
            for shape in of_link[first]:
                for other in of_link[second]:
                    self.geometry.addCollisionPair(pin.CollisionPair(shape, other))
                    self.names.append(frozenset((first, second)))

    def within(self, configurations: Array, margin_m: float) -> list[frozenset[LinkPair]]:
        """Return for each configuration the pairs whose meshes are within a margin of each other."""
        return _within(self.arm, self.geometry, self.names, configurations, margin_m)


@dataclass(frozen=True, slots=True)
class Decided:
    """What the meshes say about random configurations: the pairs that touch, and those that are near."""

    seed: int
    configurations: Array
    pairs: frozenset[LinkPair]
    touching: list[frozenset[LinkPair]]
    near: list[frozenset[LinkPair]]

    def share_touching(self, pair: LinkPair) -> float:
        """Return the share of the configurations in which the meshes of a pair touch."""
        return sum(pair in touching for touching in self.touching) / len(self.configurations)


def decide(arm: Arm, surfaces: Surfaces, count: int, seed: int) -> Decided:
    """Return what the meshes say about `count` uniform random configurations."""
    configurations = np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, arm.n))
    meshes = MeshPairs(arm, surfaces)
    near = meshes.within(configurations, CLEARANCE_M)
    # Only where something is near something can touch.
    candidates = [number for number, pairs in enumerate(near) if pairs]
    touching = [frozenset[LinkPair]()] * count
    for number, pairs in zip(candidates, meshes.within(configurations[candidates], 0.0), strict=True):
        touching[number] = pairs
    return Decided(seed, configurations, frozenset(meshes.names), touching, near)


def compare(arm: Arm, decided: Decided, left_unchecked: Iterable[LinkPair] = ()) -> Comparison:
    """Return how the shapes of a robot decide, beside its meshes.

    `left_unchecked` are pairs that are not checked on purpose: they count for nothing, and are listed.
    """
    excluded = frozenset(left_unchecked)
    by_shapes = shapes_within(arm, decided.configurations)
    count = len(decided.configurations)
    touching: Counter[LinkPair] = Counter()
    near: Counter[LinkPair] = Counter()
    refused: Counter[LinkPair] = Counter()
    allowed: Counter[LinkPair] = Counter()
    free = refused_free = any_allowed = 0
    for touch, close, shapes in zip(decided.touching, decided.near, by_shapes, strict=True):
        wrongly_refused = (shapes & decided.pairs) - close
        wrongly_allowed = touch - shapes - excluded
        touching.update(touch)
        near.update(close)
        refused.update(wrongly_refused)
        allowed.update(wrongly_allowed)
        any_allowed += bool(wrongly_allowed)
        if not close - excluded:
            free += 1
            refused_free += bool(wrongly_refused)

    def shares(pair: LinkPair) -> PairShares:
        first, second = sorted(pair)
        return PairShares(
            first,
            second,
            touching[pair] / count,
            refused[pair] / max(count - near[pair], 1),
            allowed[pair] / count,
        )

    pairs = sorted((set(touching) | set(refused)) - excluded, key=sorted)
    return Comparison(
        count,
        decided.seed,
        free,
        refused_free / max(free, 1),
        any_allowed / count,
        tuple(shares(pair) for pair in pairs),
        tuple(shares(pair) for pair in sorted(excluded, key=sorted) if touching[pair]),
    )


def shapes_within(
    arm: Arm, configurations: Array, margin_m: float = CLEARANCE_M
) -> list[frozenset[LinkPair]]:
    """Return for each configuration the checked pairs of links whose shapes are within a margin."""
    geometry = Collisions(arm, World()).geometry
    return _within(arm, geometry, link_pairs(geometry), configurations, margin_m)


def refusing_shapes(arm: Arm, decided: Decided, pair: LinkPair) -> Counter[tuple[str, str]]:
    """Return the pairs of shapes that refuse what the meshes of two links allow, with how often they do."""
    geometry = Collisions(arm, World()).geometry
    numbers = [number for number, links in enumerate(link_pairs(geometry)) if links == pair]
    names = [item.name for item in geometry.geometryObjects]
    data = pin.GeometryData(geometry)
    for request in data.collisionRequests:
        request.security_margin = CLEARANCE_M
    counts: Counter[tuple[str, str]] = Counter()
    for joints, near in zip(decided.configurations, decided.near, strict=True):
        if pair in near:
            continue
        pin.updateGeometryPlacements(arm.pin_model, arm.data, geometry, data, joints)
        for number in numbers:
            if pin.computeCollision(geometry, data, number):
                shapes = geometry.collisionPairs[number]
                counts[names[shapes.first], names[shapes.second]] += 1
    return counts


def link_pairs(geometry: Any) -> list[LinkPair]:
    """Return the links of each pair of a geometry model."""
    names = [link_of(item.name) for item in geometry.geometryObjects]
    return [frozenset((names[pair.first], names[pair.second])) for pair in geometry.collisionPairs]


def _within(
    arm: Arm, geometry: Any, names: list[LinkPair], configurations: Array, margin_m: float
) -> list[frozenset[LinkPair]]:
    data = pin.GeometryData(geometry)
    for request in data.collisionRequests:
        request.security_margin = margin_m
    within = []
    for joints in configurations:
        pin.updateGeometryPlacements(arm.pin_model, arm.data, geometry, data, joints)
        pin.computeCollisions(geometry, data, False)
        within.append(
            frozenset(
                pair
                for pair, result in zip(names, data.collisionResults, strict=True)
                if result.isCollision()
            )
        )
    return within
