"""Simulated cells for the tests of physics. They need the extra `physics`."""

from pathlib import Path

import pytest

from handover_robots.physics import is_available
from handover_robots.planning import is_available as is_planning_available

if not is_available() or not is_planning_available():  # no wheels for this platform
    collect_ignore_glob = ["test_*.py"]
else:
    from handover_robots.physics.simulation import Simulation
    from handover_robots.physics.world_model import build

from handover_robots.robots.ur10 import FOLDER, ROBOT
from handover_robots.scene.reading import load
from handover_robots.scene.scene import Scene


@pytest.fixture(scope="session")
def scene() -> Scene:
    return load(Path(FOLDER) / "bin_picking_physics.yaml", ROBOT)


@pytest.fixture
def simulation(scene: Scene) -> "Simulation":
    """A cell with two parts beside it, and the arm over its fixture."""
    joints = ROBOT.reach(scene.fixtures["fixture-1"].nests[0].pose.raised(-0.006), ROBOT.home)
    world = build({"ur10-1": ROBOT}, scene, 2)
    return Simulation(world, {"ur10-1": joints})
