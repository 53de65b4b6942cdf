"""Capsules, boxes and spheres that contain a mesh, for the check of collisions.

Of a capsule along the longest axis of the vertices and a box along their principal axes, the smaller one is
used. Both contain every vertex, so the robot is never smaller than its mesh.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from lxml import etree

from handover.errors import UsageError
from services.trajectory_tool.onboarding.sources import find_mesh
from services.trajectory_tool.onboarding.urdf import Examined, Finding
from services.trajectory_tool.planning.arm import Array
from services.trajectory_tool.planning.collision import MAX_MESH_BYTES, mesh_fault

MIN_RADIUS_M, MIN_SIZE_M = 0.005, 0.01
ROD_OF_LENGTH = 0.15
"""The radius of a link without any shape, as a share of its length."""
MAX_SIZE_M = 20.0


@dataclass(frozen=True, slots=True)
class Fitted:
    """A shape in the frame of its link: a capsule (radius, length) or a box by its lengths."""

    placement: Any
    size: tuple[float, ...]
    volume_m3: float


def replace_meshes(examined: Examined, urdf: Path) -> None:
    """Give every link plain collision shapes; the meshes leave the URDF. Raises `UsageError`."""
    fitted: list[str] = []
    for link in examined.root.findall("link"):
        shapes = [one for one in link.findall("collision") if one.find("geometry") is not None]
        by_visual = not shapes
        for shape in shapes or [one for one in link.findall("visual") if one.find("geometry") is not None]:
            if _has_mesh(shape):
                found = _fit_mesh(shape, urdf, link.get("name"), examined.findings)
                if found is not None:
                    _add_collision(link, found)
                    fitted.append(link.get("name"))
            elif by_visual:
                _copy_as_collision(link, shape)
        for one in (*link.findall("collision"), *link.findall("visual")):
            if one.find("geometry") is None or _has_mesh(one):
                link.remove(one)
        if by_visual and link.find("collision") is not None:
            examined.findings.append(
                Finding("warning", link.get("name"), "no collision geometry; its visual shapes are used")
            )
        for shape in link.findall("collision"):
            _require_plausible(link.get("name"), shape)
    if fitted:
        names = ", ".join(dict.fromkeys(fitted))
        examined.findings.append(Finding("info", names, "capsules and boxes replace its meshes"))
    _add_rods(examined)


def fit(points: Array) -> Fitted:
    """Return the smaller of a capsule and a box that contain all points."""
    centre = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - centre, full_matrices=False)
    if np.linalg.det(axes) < 0:
        axes[2] = -axes[2]
    local = (points - centre) @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    middle = (low + high) / 2
    size = np.maximum(high - low, MIN_SIZE_M)
    box = Fitted(pin.SE3(axes.T, centre + axes.T @ middle), tuple(size.tolist()), float(np.prod(size)))
    along = local - middle
    radius = max(float(np.hypot(along[:, 1], along[:, 2]).max()), MIN_RADIUS_M)
    # The half spheres cover what is beyond the ends of the cylinder: as far as each vertex leaves room.
    room = np.sqrt(np.maximum(radius**2 - along[:, 1] ** 2 - along[:, 2] ** 2, 0.0))
    half = max(float((np.abs(along[:, 0]) - room).max()), 0.0)
    to_z = np.column_stack([axes[1], axes[2], axes[0]])
    volume = math.pi * radius**2 * (2 * half + 4 / 3 * radius)
    capsule = Fitted(pin.SE3(to_z, centre + axes.T @ middle), (radius, 2 * half), volume)
    return min(capsule, box, key=lambda one: one.volume_m3)


def _has_mesh(shape: Any) -> bool:
    return shape.find("geometry").find("mesh") is not None


def _fit_mesh(shape: Any, urdf: Path, link: str, findings: list[Finding]) -> Fitted | None:
    mesh = shape.find("geometry").find("mesh")
    name = mesh.get("filename", "")
    file = find_mesh(name, urdf)
    if file is None:
        findings.append(Finding("warning", link, f"the mesh {name} was not found"))
        return None
    if (size := file.stat().st_size) > MAX_MESH_BYTES:
        raise UsageError(
            f'the mesh {file} of "{link}" has {size >> 20} MB; reduce it to {MAX_MESH_BYTES >> 20} MB at most'
        )
    scale = _vector(mesh.get("scale"), 1.0)
    try:
        points = np.asarray(coal.MeshLoader().load(str(file), scale).vertices(), dtype=np.float64)
    except (ValueError, RuntimeError) as error:
        findings.append(Finding("warning", link, f"the mesh {file.name} cannot be read: {mesh_fault(error)}"))
        return None
    points = points.reshape(-1, 3)
    if len(points) < 4 or not np.isfinite(points).all():
        findings.append(Finding("warning", link, f"the mesh {file.name} has no volume"))
        return None
    found = fit(points)
    origin = shape.find("origin")
    xyz, rpy = (_vector(None if origin is None else origin.get(one), 0.0) for one in ("xyz", "rpy"))
    placed = pin.SE3(pin.rpy.rpyToMatrix(*rpy.tolist()), xyz) * found.placement
    return Fitted(placed, found.size, found.volume_m3)


def _vector(written: str | None, default: float) -> Array:
    try:
        values = np.array([float(part) for part in (written or "").split()])
    except ValueError:
        values = np.array([math.nan])
    return values if values.shape == (3,) and np.isfinite(values).all() else np.full(3, default)


def _add_collision(link: Any, found: Fitted) -> None:
    number = len(link.findall("collision"))
    name = f"{link.get('name')}_shape_{number}"
    collision = etree.SubElement(link, "collision", name=name)
    xyz = " ".join(f"{value:.6g}" for value in found.placement.translation.tolist())
    rpy = " ".join(f"{value:.6g}" for value in pin.rpy.matrixToRpy(found.placement.rotation).tolist())
    etree.SubElement(collision, "origin", xyz=xyz, rpy=rpy)
    geometry = etree.SubElement(collision, "geometry")
    if len(found.size) == 3:
        etree.SubElement(geometry, "box", size=" ".join(f"{value:.6g}" for value in found.size))
        return
    radius, length = found.size
    etree.SubElement(geometry, "cylinder", radius=f"{radius:.6g}", length=f"{max(length, 1e-4):.6g}")
    checking = link.find("collision_checking")
    if checking is None:
        checking = etree.SubElement(link, "collision_checking")
    etree.SubElement(checking, "capsule", name=name)


def _copy_as_collision(link: Any, visual: Any) -> None:
    collision = etree.SubElement(link, "collision")
    for tag in ("origin", "geometry"):
        if visual.find(tag) is not None:
            collision.append(etree.fromstring(etree.tostring(visual.find(tag))))


def _add_rods(examined: Examined) -> None:
    """Give a link without a shape a capsule from its frame to the next joint of the chain."""
    named = {link.get("name"): link for link in examined.root.findall("link")}
    for joint in examined.chain:
        link = named[joint.find("parent").get("link")]
        origin = joint.find("origin")
        end = _vector(None if origin is None else origin.get("xyz"), 0.0)
        length = float(np.linalg.norm(end))
        if link.find("collision") is not None or length < 2 * MIN_SIZE_M:
            continue
        along = end / length
        rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
        radius = max(ROD_OF_LENGTH * length, MIN_RADIUS_M)
        _add_collision(link, Fitted(pin.SE3(rotation, end / 2), (radius, length), 0.0))
        examined.findings.append(
            Finding(
                "warning",
                link.get("name"),
                f"no geometry; a capsule of radius {radius:.2f} m to the next joint is assumed: check it",
            )
        )


def _require_plausible(link: str, shape: Any) -> None:
    geometry = shape.find("geometry")
    for element in geometry:
        for attribute in ("radius", "length", "size"):
            written = element.get(attribute)
            if written is None:
                continue
            try:
                values = [float(part) for part in written.split()]
            except ValueError:
                values = [math.nan]
            if not values or not all(0 < value <= MAX_SIZE_M for value in values):
                raise UsageError(
                    f'a collision shape of "{link}" has {attribute}="{written}"; sizes are in m, above 0 and '
                    f"at most {MAX_SIZE_M:g}"
                )
