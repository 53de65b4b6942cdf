"""The surfaces of the links of a URDF, as its author gives them: meshes, boxes, cylinders and spheres."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from handover.errors import UsageError
from handover_robots.onboarding.sources import find_mesh
from handover_robots.onboarding.urdf import Finding
from handover_robots.planning.arm import Array, convex, hull_of
from handover_robots.planning.mesh_files import load_mesh

ROUND_POINTS = 48
"""The points around a cylinder; a sphere has its square."""


@dataclass(frozen=True, slots=True)
class Surface:
    """A shape of a link: for coal with its placement in the frame of the link, and its triangles there."""

    placement: Any
    geometry: Any
    triangles: Array

    def moved(self, by: Any) -> "Surface":
        """Return the surface in another frame; `by` is the pose of its frame there."""
        return Surface(
            by * self.placement, self.geometry, self.triangles @ by.rotation.T + np.asarray(by.translation)
        )


Surfaces = Mapping[str, Sequence[Surface]]
"""The surfaces of links by name."""


def read_surfaces(root: Any, urdf: Path, findings: list[Finding]) -> dict[str, list[Surface]]:
    """Return the surfaces of the links of a URDF that have some.

    They are the collision shapes. A link whose collision shapes are no meshes, but which is drawn by meshes,
    has the latter: they are nearer to the real one. Raises `UsageError` for a mesh that cannot be used.
    """
    surfaces: dict[str, list[Surface]] = {}
    for link in root.findall("link"):
        collision, visual = (_with_geometry(link, tag) for tag in ("collision", "visual"))
        drawn = [shape for shape in visual if mesh_of(shape) is not None]
        is_plain = all(mesh_of(shape) is None for shape in collision)
        for shape in drawn if is_plain and drawn else collision or visual:
            surface = read_surface(shape, urdf, link.get("name"), findings)
            if surface is not None:
                surfaces.setdefault(link.get("name"), []).append(surface)
    return surfaces


def read_surface(shape: Any, urdf: Path, link: str, findings: list[Finding]) -> Surface | None:
    """Return the surface of a collision or visual element; None, with a finding, for one without any.

    Raises `UsageError` for a mesh that is missing or cannot be used: without it a link touches nothing.
    """
    origin = shape.find("origin")
    xyz, rpy = (vector_of(None if origin is None else origin.get(name), 0.0) for name in ("xyz", "rpy"))
    placement = pin.SE3(pin.rpy.rpyToMatrix(*rpy.tolist()), xyz)
    mesh = mesh_of(shape)
    surface = _plain(shape) if mesh is None else _loaded(mesh, urdf, link, findings)
    if surface is None:
        return None
    geometry, triangles = surface
    return Surface(placement, geometry, triangles @ placement.rotation.T + xyz)


def mesh_of(shape: Any) -> Any:
    """Return the mesh element of a shape; None without one."""
    return shape.find("geometry").find("mesh")


def _with_geometry(link: Any, tag: str) -> list[Any]:
    return [shape for shape in link.findall(tag) if shape.find("geometry") is not None]


def _loaded(mesh: Any, urdf: Path, link: str, findings: list[Finding]) -> tuple[Any, Array] | None:
    name = mesh.get("filename", "")
    file = find_mesh(name, urdf)
    if file is None:
        raise UsageError(
            f'the mesh {name} of "{link}" was not found; put it where the URDF names it, or name the folder '
            "of its ROS package in ROS_PACKAGE_PATH"
        )
    try:
        model = load_mesh(file, vector_of(mesh.get("scale"), 1.0))
    except UsageError as fault:
        raise UsageError(f'"{link}": {fault}') from None
    points = np.asarray(model.vertices(), dtype=np.float64).reshape(-1, 3)
    corners = [model.tri_indices(number) for number in range(model.num_tris)]
    if len(points) < 4 or not corners:
        findings.append(Finding("warning", link, f"the mesh {file.name} has no volume"))
        return None
    return model, points[[[corner[0], corner[1], corner[2]] for corner in corners]]


def _plain(collision: Any) -> tuple[Any, Array] | None:
    """Return a hull, a box, a cylinder or a sphere, and triangles with their corners on it."""
    if (corners := _hull_of(collision)) is not None:
        return convex(corners), corners[ConvexHull(corners).simplices]
    geometry = collision.find("geometry")
    turns = np.linspace(0, 2 * np.pi, ROUND_POINTS, endpoint=False)
    box, cylinder, sphere = (geometry.find(kind) for kind in ("box", "cylinder", "sphere"))
    if box is not None:
        half = vector_of(box.get("size"), 0.0) / 2
        points = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
        shape = coal.Box(*(2 * half).tolist())
    elif cylinder is not None:
        radius, length = float(cylinder.get("radius")), float(cylinder.get("length"))
        ring = np.column_stack([radius * np.cos(turns), radius * np.sin(turns), np.full(len(turns), 0.5)])
        points = np.concatenate([ring * (1, 1, side * length) for side in (-1, 1)])
        shape = coal.Cylinder(radius, length)
    elif sphere is not None:
        radius = float(sphere.get("radius"))
        heights = np.cos(turns / 2)
        points = radius * np.concatenate(
            [
                np.column_stack([sine * np.cos(turns), sine * np.sin(turns), np.full(len(turns), height)])
                for height, sine in zip(heights, np.sqrt(1 - heights**2), strict=True)
            ]
        )
        shape = coal.Sphere(radius)
    else:
        return None
    return shape, points[ConvexHull(points).simplices]


def _hull_of(collision: Any) -> Array | None:
    try:
        return hull_of(collision)
    except ValueError as fault:
        raise UsageError(str(fault)) from None


def vector_of(written: str | None, default: float) -> Array:
    """Return three numbers of a URDF; `default` three times where there are none."""
    try:
        values = np.array([float(part) for part in (written or "").split()])
    except ValueError:
        values = np.full(3, np.nan)
    return values if values.shape == (3,) and np.isfinite(values).all() else np.full(3, default)
