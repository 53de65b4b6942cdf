"""Objects of any shape in simulated physics: they fall, lie in their bin, and the camera finds them."""

import math

import pytest

from handover.errors import UsageError
from handover_robots.perception.heaps import find_things
from handover_robots.physics.cameras import HAND_CAMERA, Cameras
from handover_robots.physics.loose_objects import OBJECTS
from handover_robots.physics.parts import Parts
from handover_robots.physics.simulation import Simulation
from handover_robots.physics.vision import inside_of
from handover_robots.physics.world_model import build, fingers_of, objects_of
from handover_robots.robots import ROBOTS
from handover_robots.scene.scene import Scene

PANDA = ROBOTS.load("panda")
TRAY = {
    "view": {"position": [0.42, -0.24, 0.42]},
    "walls": {"position": [0.45, -0.24, 0.0], "size": [0.46, 0.42, 0.02], "wall_m": 0.008},
}


def scene_with(*objects: str) -> Scene:
    bins = {"tray": {**TRAY, "objects": list(objects)}}
    return Scene.model_validate({"name": "tray", "bins": bins})


@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_lies_where_the_camera_finds_it(name: str) -> None:
    scene = scene_with(name)
    view = PANDA.reach(scene.bins["tray"].view.pose, PANDA.home)
    simulation = Simulation(build({"panda-1": PANDA}, scene, 0), {"panda-1": view})
    assert simulation.is_parked(0)
    parts = Parts(simulation, scene, seed=5)
    simulation.run(parts.fill("tray"))
    assert parts.in_bin("tray") == [0]
    masses = simulation.part_masses(0)
    assert sum(mass for _, mass in masses) == pytest.approx(OBJECTS[name].mass_kg)
    fingers = fingers_of(PANDA)
    camera = Cameras(simulation, simulation.arms["panda-1"], scene, seed=1, fingers=fingers.frame)[
        HAND_CAMERA
    ]
    walls = scene.bins["tray"].walls
    assert walls is not None
    things = find_things(camera.image(), inside_of(walls), fingers)
    assert things
    x, y, _ = things[0].pose.position
    assert min(math.dist((x, y), at[:2]) for at, _ in masses) < 0.04
    if not OBJECTS[name].is_cloth:
        assert len(things) == 1
        assert min(things[0].size[:2]) < fingers.opening
    state = simulation.saved()
    simulation.step_for(0.1)
    assert simulation.restore(state)


def test_an_object_that_is_unknown_or_named_twice_is_refused() -> None:
    with pytest.raises(UsageError, match='no object "melon"; there is cube, apple'):
        objects_of(scene_with("melon"))
    with pytest.raises(UsageError, match='"cube" is named twice'):
        objects_of(scene_with("cube", "cube"))


def test_cloth_that_hangs_down_falls_from_above_its_bin() -> None:
    scene = scene_with("jacket")
    view = PANDA.reach(scene.bins["tray"].view.pose, PANDA.home)
    simulation = Simulation(build({"panda-1": PANDA}, scene, 0), {"panda-1": view})
    next(Parts(simulation, scene, seed=5).fill("tray"))
    assert simulation.lowest_m(0) > TRAY["walls"]["size"][2]  # type: ignore[index]
