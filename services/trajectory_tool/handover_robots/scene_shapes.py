"""What a page draws of a scene, beside bins and fixtures: each thing as a shape at a pose."""

import importlib
from collections.abc import Iterator
from typing import Any

from handover_robots.obstacles import Box, Cylinder, Mesh, Shape, Sphere
from handover_robots.planning import is_available
from handover_robots.poses import Frame, Pose
from handover_robots.scene import IDENTITY, Scene

Drawn = dict[str, Any]


def drawn_shapes(scene: Scene) -> Iterator[Drawn]:
    """Yield the shapes of obstacles, fences, cameras and zones; a mesh is drawn as its bounding box."""
    for name, thing in scene.obstacles.items():
        yield _drawn("obstacle", name, thing.shape(scene.folder), thing.pose)
    for name, fence in scene.fences.items():
        for panel in fence.obstacles(name):
            yield _drawn("fence", name, panel.shape, panel.pose)
    for name, camera in scene.cameras.items():
        housing = camera.obstacle(name)
        yield _drawn("camera", name, housing.shape, housing.pose)
    for zone in scene.all_zones():
        yield _drawn(zone.kind, zone.name, zone.shape, zone.pose)


def _drawn(kind: str, name: str, shape: Shape, pose: Pose) -> Drawn:
    match shape:
        case Box(size):
            form, lengths = "box", size
        case Cylinder(radius, length):
            form, lengths = "cylinder", (2 * radius, 2 * radius, length)
        case Sphere(radius):
            form, lengths = "sphere", (2 * radius, 2 * radius, 2 * radius)
        case Mesh():
            form = "box"
            lengths, pose = _bounding_box(shape, pose)
        case _:
            raise ValueError(f"{name} cannot be drawn")
    return {"kind": kind, "name": name, "form": form, "size": list(lengths), **pose.written()}


def _bounding_box(mesh: Mesh, pose: Pose) -> tuple[tuple[float, float, float], Pose]:
    if not is_available():
        return (0.1, 0.1, 0.1), pose
    hull = importlib.import_module("handover_robots.planning.collision").geometry_of(mesh)
    hull.computeLocalAABB()
    low, high = hull.aabb_local.min_.tolist(), hull.aabb_local.max_.tolist()
    middle = Frame(IDENTITY, tuple((one + other) / 2 for one, other in zip(low, high, strict=True)))
    size = tuple(other - one for one, other in zip(low, high, strict=True))
    return (size[0], size[1], size[2]), Pose.of(pose.frame() @ middle)
