"""Capsules, boxes and spheres that contain a mesh, for the check of collisions.

A mesh is cut across where that makes the shapes around its pieces smaller; each piece gets the smallest of
some capsules and boxes. They contain every triangle, so the robot is never smaller than its mesh.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from lxml import etree
from scipy.spatial import ConvexHull, QhullError

from handover.errors import UsageError
from services.trajectory_tool.onboarding.sources import find_mesh
from services.trajectory_tool.onboarding.urdf import Examined, Finding
from services.trajectory_tool.planning.arm import Array
from services.trajectory_tool.planning.collision import MAX_MESH_BYTES, mesh_fault

MIN_RADIUS_M, MIN_SIZE_M = 0.005, 0.01
ROD_OF_LENGTH = 0.15
"""The radius of a link without any shape, as a share of its length."""
MAX_SIZE_M = 20.0

MAX_PIECES = 4
CUTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
"""Where a mesh is cut, as shares of its extent."""
WORTH_A_CUT, LEAST_GAIN_M3 = 0.93, 2e-5
"""A cut must leave less than this share of the volume, and save so much: pieces make pairs to check."""
MANY_POINTS = 50


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
                for found in _fit_mesh(shape, urdf, link.get("name"), examined):
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
    """Return the smallest of some capsules and boxes that contain all points.

    Their axes are the principal axes of the points or those of the frame.
    """
    centre = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - centre, full_matrices=False)
    if np.linalg.det(axes) < 0:
        axes[2] = -axes[2]
    found: list[Fitted] = []
    for rows in (axes, np.eye(3)):
        found.append(_box(points - centre, rows, centre))
        found += [_capsule(points - centre, np.roll(rows, -turn, axis=0), centre) for turn in range(3)]
    return min(found, key=lambda one: one.volume_m3)


def _box(points: Array, axes: Array, centre: Array) -> Fitted:
    local = points @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    size = np.maximum(high - low, MIN_SIZE_M)
    placement = pin.SE3(axes.T, centre + axes.T @ ((low + high) / 2))
    return Fitted(placement, tuple(size.tolist()), float(np.prod(size)))


def _capsule(points: Array, axes: Array, centre: Array) -> Fitted:
    """Return the capsule along the first axis."""
    local = points @ axes.T
    middle = (local.min(axis=0) + local.max(axis=0)) / 2
    along = local - middle
    radius = max(float(np.hypot(along[:, 1], along[:, 2]).max()), MIN_RADIUS_M)
    # The half spheres cover what is beyond the ends of the cylinder: as far as each vertex leaves room.
    room = np.sqrt(np.maximum(radius**2 - along[:, 1] ** 2 - along[:, 2] ** 2, 0.0))
    half = max(float((np.abs(along[:, 0]) - room).max()), 0.0)
    to_z = np.column_stack([axes[1], axes[2], axes[0]])
    volume = math.pi * radius**2 * (2 * half + 4 / 3 * radius)
    return Fitted(pin.SE3(to_z, centre + axes.T @ middle), (radius, 2 * half), volume)


def fit_pieces(triangles: Array, most: int = MAX_PIECES) -> list[Fitted]:
    """Return shapes that together contain a mesh of n x 3 corners: cut where that makes them smaller."""
    pieces = [(triangles, fit(_hull(triangles)))]
    is_settled: list[tuple[Array, Fitted]] = []
    while pieces and len(pieces) + len(is_settled) < most:
        pieces.sort(key=lambda piece: piece[1].volume_m3)
        largest = pieces.pop()
        halves = _halves(*largest)
        if halves is None:
            is_settled.append(largest)
        else:
            pieces += halves
    return [shape for _, shape in (*pieces, *is_settled)]


def _halves(triangles: Array, whole: Fitted) -> list[tuple[Array, Fitted]] | None:
    """Return both sides of the cut across an axis of the shape that leaves the least volume."""
    best = None
    least_m3 = min(WORTH_A_CUT * whole.volume_m3, whole.volume_m3 - LEAST_GAIN_M3)
    for axis in whole.placement.rotation.T:
        heights = triangles @ axis
        low, high = float(heights.min()), float(heights.max())
        for share in CUTS:
            at = low + share * (high - low)
            sides = [
                side for side in (_beyond(triangles, axis, at), _beyond(triangles, -axis, -at)) if len(side)
            ]
            shapes = [fit(_hull(side)) for side in sides]
            volume_m3 = sum(shape.volume_m3 for shape in shapes)
            if len(sides) == 2 and volume_m3 < least_m3:
                best, least_m3 = list(zip(sides, shapes, strict=True)), volume_m3
    return best


def _beyond(triangles: Array, axis: Array, at: float) -> Array:
    """Return the triangles where `axis` is above `at`, those on both sides cut there."""
    above = triangles @ axis - at
    count = (above > 0).sum(axis=1)
    kept = [triangles[count == 3]]
    for corners in (1, 2):
        cut, heights = triangles[count == corners], above[count == corners]
        if not len(cut):
            continue
        # Turn each triangle so that the corner that is alone on its side is the first one.
        alone = np.argmax((heights > 0) == (corners == 1), axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        first, second, third = np.moveaxis(np.take_along_axis(cut, order[..., None], axis=1), 1, 0)
        a, b, c = np.take_along_axis(heights, order, axis=1).T
        to_second = first + (a / (a - b))[:, None] * (second - first)
        to_third = first + (a / (a - c))[:, None] * (third - first)
        if corners == 1:
            kept.append(np.stack([first, to_second, to_third], axis=1))
        else:
            kept.append(np.stack([second, third, to_second], axis=1))
            kept.append(np.stack([third, to_third, to_second], axis=1))
    return np.concatenate(kept)


def _hull(triangles: Array) -> Array:
    """Return the corners of the convex hull: a shape that contains them contains everything between them."""
    points = np.unique(triangles.reshape(-1, 3), axis=0)
    if len(points) <= MANY_POINTS:
        return points
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # flat
        return points


def _has_mesh(shape: Any) -> bool:
    return shape.find("geometry").find("mesh") is not None


def _fit_mesh(shape: Any, urdf: Path, link: str, examined: Examined) -> list[Fitted]:
    findings = examined.findings
    mesh = shape.find("geometry").find("mesh")
    name = mesh.get("filename", "")
    file = find_mesh(name, urdf)
    if file is None:
        findings.append(Finding("warning", link, f"the mesh {name} was not found"))
        return []
    if (size := file.stat().st_size) > MAX_MESH_BYTES:
        raise UsageError(
            f'the mesh {file} of "{link}" has {size >> 20} MB; reduce it to {MAX_MESH_BYTES >> 20} MB at most'
        )
    scale = _vector(mesh.get("scale"), 1.0)
    try:
        mesh_model = coal.MeshLoader().load(str(file), scale)
        points = np.asarray(mesh_model.vertices(), dtype=np.float64).reshape(-1, 3)
        corners = [mesh_model.tri_indices(number) for number in range(mesh_model.num_tris)]
    except (ValueError, RuntimeError) as error:
        findings.append(Finding("warning", link, f"the mesh {file.name} cannot be read: {mesh_fault(error)}"))
        return []
    if len(points) < 4 or not np.isfinite(points).all():
        findings.append(Finding("warning", link, f"the mesh {file.name} has no volume"))
        return []
    origin = shape.find("origin")
    xyz, rpy = (_vector(None if origin is None else origin.get(one), 0.0) for one in ("xyz", "rpy"))
    origin_of_mesh = pin.SE3(pin.rpy.rpyToMatrix(*rpy.tolist()), xyz)
    examined.meshes.setdefault(link, []).append((origin_of_mesh, mesh_model))
    return [
        Fitted(origin_of_mesh * found.placement, found.size, found.volume_m3)
        for found in fit_pieces(points[[[one[0], one[1], one[2]] for one in corners]])
    ]


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
