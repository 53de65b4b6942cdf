"""Collision shapes in place of meshes: polytopes that contain them, each within a capsule or a box.

The polytopes are what planning checks, as `<hull>` of a collision element. The plain shapes around them are
for readers of a URDF that need those: physics, and the volumes that other robots avoid. Both contain every
triangle, so the robot is never smaller than its mesh.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from handover.errors import UsageError
from handover.formats.robot_xml import SIZES, plain_shapes, settle_sizes, sizes_of
from handover_robots.onboarding.hulls import Piece, pieces_of
from handover_robots.onboarding.meshes import mesh_of, read_surface, vector_of
from handover_robots.onboarding.urdf import Examined, Finding
from handover_robots.planning.arm import Array

MIN_RADIUS_M, MIN_SIZE_M = 0.005, 0.01
ROD_OF_LENGTH = 0.15
"""The radius of a link without any shape, as a share of its length."""
MAX_SIZE_M = 20.0
PIECE = "_shape_"
PADDING_M = 1e-5
"""Plain shapes are larger by this much than what they contain, so that rounded numbers still do."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """A shape in the frame of its link: a capsule (radius, length) or a box by its lengths."""

    placement: Any
    size: tuple[float, ...]
    volume_m3: float


def replace_meshes(examined: Examined, urdf: Path) -> dict[str, list[Piece]]:
    """Give every link plain collision shapes; the meshes leave the URDF. Raises `UsageError`.

    Returns the pieces of the links that had meshes.
    """
    pieces: dict[str, list[Piece]] = {}
    faults: list[str] = []
    for link in examined.root.findall("link"):
        examined.findings += [Finding("info", link.get("name"), text) for text in settle_sizes(link)]
        faults += _replace_in(link, urdf, examined, pieces)
    if faults:
        raise UsageError("\n".join(dict.fromkeys(faults)))
    write_pieces(examined.root, pieces)
    for link in examined.root.findall("link"):
        for shape in link.findall("collision"):
            _require_plausible(link.get("name"), shape)
    if pieces:
        examined.findings.append(
            Finding("info", ", ".join(pieces), "convex hulls in capsules and boxes replace its meshes")
        )
    _add_rods(examined)
    return pieces


def _replace_in(link: Any, urdf: Path, examined: Examined, pieces: dict[str, list[Piece]]) -> Iterator[str]:
    """Take the meshes out of a link, and add what they become to `pieces`; yield why some cannot be used."""
    name = link.get("name")
    shapes = [collision for collision in link.findall("collision") if collision.find("geometry") is not None]
    by_visual = not shapes
    for shape in shapes or [
        visual for visual in link.findall("visual") if visual.find("geometry") is not None
    ]:
        _require_plausible(name, shape)
        try:
            surface = read_surface(shape, urdf, name, examined.findings)
        except UsageError as fault:
            yield str(fault)
            continue
        if surface is not None:
            examined.surfaces.setdefault(name, []).append(surface)
        if mesh_of(shape) is not None:
            if surface is not None:
                pieces.setdefault(name, []).extend(pieces_of(surface.triangles))
        elif by_visual:
            _copy_as_collision(link, shape)
    for element in (*link.findall("collision"), *link.findall("visual")):
        if element.find("geometry") is None or mesh_of(element) is not None:
            link.remove(element)
    if by_visual and (name in pieces or link.find("collision") is not None):
        examined.findings.append(
            Finding("warning", name, "no collision geometry; its visual shapes are used")
        )


def write_pieces(root: Any, pieces: Mapping[str, Sequence[Piece]]) -> None:
    """Write the shapes of pieces into their links, in place of the ones that have been written before."""
    for link in root.findall("link"):
        name = link.get("name")
        if name not in pieces:
            continue
        for written in [
            collision for collision in link.findall("collision") if collision.find("hull") is not None
        ]:
            link.remove(written)
        for listed in link.findall("collision_checking/capsule"):
            if str(listed.get("name")).startswith(f"{name}{PIECE}"):
                listed.getparent().remove(listed)
        for number, piece in enumerate(pieces[name]):
            _add_collision(link, fit(piece.corners), f"{name}{PIECE}{number}", piece.corners)


def fit(points: Array) -> Fitted:
    """Return the smallest of some capsules and boxes that contain all points.

    Their axes are the principal axes of the points or those of the frame.
    """
    centre = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - centre, full_matrices=False)
    if np.linalg.det(axes) < 0:
        axes[2] = -axes[2]
    fits: list[Fitted] = []
    for rows in (axes, np.eye(3)):
        fits.append(_box(points - centre, rows, centre))
        fits += [_capsule(points - centre, np.roll(rows, -turn, axis=0), centre) for turn in range(3)]
    return min(fits, key=lambda fitted: fitted.volume_m3)


def _box(points: Array, axes: Array, centre: Array) -> Fitted:
    local = points @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    size = np.maximum(high - low + 2 * PADDING_M, MIN_SIZE_M)
    placement = pin.SE3(axes.T, centre + axes.T @ ((low + high) / 2))
    return Fitted(placement, tuple(size.tolist()), float(np.prod(size)))


def _capsule(points: Array, axes: Array, centre: Array) -> Fitted:
    """Return the capsule along the first axis."""
    local = points @ axes.T
    middle = (local.min(axis=0) + local.max(axis=0)) / 2
    along = local - middle
    radius = max(float(np.hypot(along[:, 1], along[:, 2]).max()) + PADDING_M, MIN_RADIUS_M)
    # The half spheres cover what is beyond the ends of the cylinder: as far as each vertex leaves room.
    room = np.sqrt(np.maximum(radius**2 - along[:, 1] ** 2 - along[:, 2] ** 2, 0.0))
    half = max(float((np.abs(along[:, 0]) - room).max()), 0.0)
    to_z = np.column_stack([axes[1], axes[2], axes[0]])
    volume = math.pi * radius**2 * (2 * half + 4 / 3 * radius)
    return Fitted(pin.SE3(to_z, centre + axes.T @ middle), (radius, 2 * half), volume)


def _add_collision(link: Any, fitted: Fitted, name: str, corners: Array | None = None) -> None:
    collision = etree.SubElement(link, "collision", name=name)
    xyz = np.round(fitted.placement.translation, 6)
    rpy = np.round(pin.rpy.matrixToRpy(fitted.placement.rotation), 7)
    etree.SubElement(collision, "origin", xyz=_written(xyz), rpy=_written(rpy))
    geometry = etree.SubElement(collision, "geometry")
    if corners is not None:
        local = (corners - xyz) @ pin.rpy.rpyToMatrix(*rpy.tolist())
        etree.SubElement(collision, "hull").text = "  ".join(_written(corner) for corner in local.round(5))
    if len(fitted.size) == 3:
        etree.SubElement(geometry, "box", size=" ".join(f"{value:.6g}" for value in fitted.size))
        return
    radius, length = fitted.size
    etree.SubElement(geometry, "cylinder", radius=f"{radius:.6g}", length=f"{max(length, 1e-4):.6g}")
    checking = link.find("collision_checking")
    if checking is None:
        checking = etree.SubElement(link, "collision_checking")
    etree.SubElement(checking, "capsule", name=name)


def _written(values: Array) -> str:
    return " ".join(f"{value + 0.0:.7g}" for value in values.tolist())


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
        end = vector_of(None if origin is None else origin.get("xyz"), 0.0)
        length = float(np.linalg.norm(end))
        if link.find("collision") is not None or length < 2 * MIN_SIZE_M:
            continue
        along = end / length
        rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
        radius = max(ROD_OF_LENGTH * length, MIN_RADIUS_M)
        rod = Fitted(pin.SE3(rotation, end / 2), (radius, length), 0.0)
        _add_collision(link, rod, f"{link.get('name')}_rod")
        examined.findings.append(
            Finding(
                "warning",
                link.get("name"),
                f"no geometry; a capsule of radius {radius:.2f} m to the next joint is assumed: check it",
            )
        )


def _require_plausible(link: str, shape: Any) -> None:
    kind = "collision shape" if shape.tag == "collision" else "visual shape"
    for element in plain_shapes(shape):
        for attribute in SIZES:
            written = element.get(attribute)
            if written is not None and not all(0 < value <= MAX_SIZE_M for value in sizes_of(written)):
                raise UsageError(
                    f'a {kind} of "{link}" has {attribute}="{written}"; sizes are in m, above 0 and '
                    f"at most {MAX_SIZE_M:g}"
                )
