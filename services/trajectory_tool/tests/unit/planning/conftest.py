"""Robots among obstacles, for the tests of planning. They need the extra `motion`."""

import math

import pytest

from handover_robots.planning import is_available

if not is_available():  # Windows, for which the libraries have no wheels
    collect_ignore_glob = ["test_*.py"]

from handover_robots.model.obstacles import Box, Cylinder, Obstacle, World
from handover_robots.model.poses import Pose


def upright(x: float, y: float, z: float, yaw: float = 0.0) -> Pose:
    return Pose((x, y, z), (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))


def box(name: str, size: tuple[float, float, float], pose: Pose) -> Obstacle:
    return Obstacle(name, Box(size), pose)


@pytest.fixture(scope="session")
def cell() -> World:
    """A table with a bin, a post and a wall beside the robot; it fits arms of 0.8 m to 1.3 m."""
    walls = [box("bin-1", (0.32, 0.012, 0.12), upright(0.5, side, 0.06)) for side in (-0.16, 0.16)] + [
        box("bin-1", (0.012, 0.32, 0.12), upright(0.5 + side, 0.0, 0.06)) for side in (-0.16, 0.16)
    ]
    return World(
        (
            box("table", (2.0, 2.0, 0.05), upright(0.0, 0.0, -0.05)),
            *walls,
            Obstacle("post", Cylinder(0.04, 0.9), upright(0.35, 0.45, 0.45)),
            box("wall", (0.6, 0.05, 0.8), upright(-0.1, -0.62, 0.4)),
        )
    )
