"""The shapes of a scene as arrays: distances of many points, and ray casting for simulated sensors."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from handover_robots.model.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere
from handover_robots.model.poses import Vector

Array = NDArray[np.float64]
STEP_M = 0.002
"""A ray that is this near to a shape has hit it."""
MAX_STEPS = 200


class Surroundings:
    """Shapes at rest. Meshes are left out: what a sensor sees of one counts as a person."""

    def __init__(self, things: Iterable[Obstacle]) -> None:
        self._things = [
            (thing.shape, np.array(thing.pose.frame().rotation), np.array(thing.pose.position))
            for thing in things
            if not isinstance(thing.shape, Mesh)
        ]

    def distances_m(self, points: Array) -> Array:
        """Return the distance of each point from the nearest shape, 0 inside; infinite without any shape."""
        nearest = np.full(len(points), np.inf)
        for shape, rotation, position in self._things:
            nearest = np.minimum(nearest, _distances((points - position) @ rotation, shape))
        return nearest

    def ranges_m(self, origin: Array, directions: Array, max_m: float) -> Array:
        """Return how far each ray of unit `directions` goes until it hits a shape; nan beyond `max_m`.

        A ray advances by its distance from the nearest shape, which it cannot pass (sphere tracing).
        """
        gone = np.zeros(len(directions))
        moving = np.ones(len(directions), dtype=bool)
        for _ in range(MAX_STEPS):
            step = self.distances_m(origin + gone[moving, None] * directions[moving])
            gone[moving] += step
            moving[moving] = (step > STEP_M) & (gone[moving] < max_m)
            if not moving.any():
                break
        return np.where(gone < max_m, gone, np.nan)


def distances_from_chains(points: Array, chains: Iterable[Sequence[Vector]]) -> Array:
    """Return the distance of each point from the nearest line between consecutive points of a chain."""
    nearest = np.full(len(points), np.inf)
    for chain in chains:
        corners = np.array(chain)
        for start, end in pairwise(corners):
            way = end - start
            length2 = float(way @ way)
            share = np.clip((points - start) @ way / (length2 or 1.0), 0.0, 1.0)
            nearest = np.minimum(nearest, np.linalg.norm(points - start - share[:, None] * way, axis=1))
    return nearest


def _distances(local: Array, shape: Box | Cylinder | Capsule | Sphere) -> Array:
    match shape:
        case Box(size):
            return np.asarray(np.linalg.norm(np.maximum(np.abs(local) - np.array(size) / 2, 0.0), axis=1))
        case Sphere(radius):
            return np.asarray(np.maximum(np.linalg.norm(local, axis=1) - radius, 0.0))
    across = np.hypot(local[:, 0], local[:, 1])
    along = np.maximum(np.abs(local[:, 2]) - shape.length / 2, 0.0)
    if isinstance(shape, Capsule):
        return np.asarray(np.maximum(np.hypot(across, along) - shape.radius, 0.0))
    return np.asarray(np.hypot(np.maximum(across - shape.radius, 0.0), along))
