"""How far the meshes of a manufacturer reach out of the shapes that planning uses for a robot."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from handover.errors import UsageError
from handover.formats.robot_xml import parse_robot_xml
from handover_robots.model.robot_model import RobotModel
from handover_robots.onboarding.comparison import Comparison, compare, decide
from handover_robots.onboarding.hulls import surface_points
from handover_robots.onboarding.mapping import Mapping, map_links
from handover_robots.onboarding.meshes import Surface, read_surfaces
from handover_robots.onboarding.semantics import ALWAYS_SHARE
from handover_robots.onboarding.sources import find_urdf
from handover_robots.onboarding.urdf import Finding, read_urdf
from handover_robots.planning.arm import Arm, Array, corners_of
from handover_robots.planning.collision import link_of

POINTS = 20_000
"""The points on each mesh, beside its corners."""
ROUNDING_M = 5e-6


@dataclass(frozen=True, slots=True)
class LinkEnclosure:
    """A link of the URDF with the meshes, the link of the robot that it is, and how far it is outside."""

    link: str
    robot_link: str
    outside_mm: float


@dataclass(frozen=True, slots=True)
class ShapeReport:
    """The shapes of a robot beside the meshes of its manufacturer."""

    joints: tuple[tuple[str, str], ...]
    links: tuple[LinkEnclosure, ...]
    unmapped: dict[str, str]
    """The links with meshes that are not compared, and why."""
    without_mesh: tuple[str, ...]
    """The links of the robot that have shapes, and no mesh to compare with."""
    findings: tuple[Finding, ...]
    comparison: Comparison

    def as_json(self) -> dict[str, Any]:
        """Return the report for JSON."""
        comparison = asdict(self.comparison)
        return {
            "joints": [{"robot": own, "meshes": other} for own, other in self.joints],
            "links": [asdict(link) for link in self.links],
            "unmapped": [{"link": link, "reason": reason} for link, reason in self.unmapped.items()],
            "without_mesh": list(self.without_mesh),
            "findings": [asdict(finding) for finding in self.findings],
            **comparison,
        }


def measure_shapes(model: RobotModel, meshes: str, configurations: int, seed: int) -> ShapeReport:
    """Compare the shapes of a robot with the meshes of a URDF. Raises `UsageError`."""
    findings: list[Finding] = []
    mapping, surfaces = mapped_surfaces(model, meshes, findings)
    arm = Arm(model)
    links = tuple(
        LinkEnclosure(link, place.link, _outside_mm(arm, place.link, surfaces[link]))
        for link, place in mapping.places.items()
    )
    of_robot: dict[str, list[Surface]] = {}
    for link, place in mapping.places.items():
        of_robot.setdefault(place.link, []).extend(surfaces[link])
    decided = decide(arm, of_robot, configurations, seed)
    always = {pair for pair in decided.pairs if decided.share_touching(pair) >= ALWAYS_SHARE}
    own = dict.fromkeys(link_of(item.name) for item in arm.geometry.geometryObjects)
    return ShapeReport(
        mapping.joints,
        links,
        mapping.unmapped,
        tuple(link for link in own if link not in of_robot),
        tuple(findings),
        compare(arm, decided, always & model.disabled_pairs),
    )


def mapped_surfaces(
    model: RobotModel, meshes: str, findings: list[Finding]
) -> tuple[Mapping, dict[str, list[Surface]]]:
    """Return the mapping of a URDF with meshes, and the surfaces of its links in the frames of ours."""
    path = find_urdf(meshes)
    try:
        root = parse_robot_xml(read_urdf(path), "URDF")
        surfaces = read_surfaces(root, path, findings)
        mapping = map_links(model, root, list(surfaces))
    except UsageError as fault:
        raise UsageError("\n".join(f"{path}: {line}" for line in str(fault).splitlines())) from None
    return mapping, {
        link: [surface.moved(place.pose) for surface in surfaces[link]]
        for link, place in mapping.places.items()
    }


def _outside_mm(arm: Arm, link: str, surfaces: Sequence[Surface]) -> float:
    """Return how far the surfaces of a link reach out of all shapes that are fixed to it."""
    frames = arm.pin_model.frames
    own = frames[arm.pin_model.getFrameId(link, pin.FrameType.BODY)]
    points = np.concatenate([surface_points(surface.triangles, POINTS) for surface in surfaces])
    points = points @ own.placement.rotation.T + own.placement.translation
    shapes = [
        (item.geometry, (points - item.placement.translation) @ item.placement.rotation)
        for item in arm.geometry.geometryObjects
        if item.parentJoint == own.parentJoint
    ]
    outside = np.ones(len(points), dtype=bool)
    for shape, local in shapes:
        outside[outside] = np.logical_not(_contains(shape, local[outside]))
    beyond_m = [_distance_m(shape, local[outside]) for shape, local in shapes]
    if not outside.any() or not beyond_m:
        return 0.0 if beyond_m else round(1000 * float(np.linalg.norm(points, axis=1).max()), 3)
    return round(1000 * float(np.min(beyond_m, axis=0).max()), 3)


def _contains(shape: Any, points: Array) -> Array:
    """Return which points are in a shape, in its frame."""
    if isinstance(shape, coal.ConvexBase):
        planes = ConvexHull(corners_of(shape)).equations
        return np.asarray((points @ planes[:, :3].T + planes[:, 3]).max(axis=1) <= ROUNDING_M)
    return np.asarray(_distance_m(shape, points) <= ROUNDING_M)


def _distance_m(shape: Any, points: Array) -> Array:
    """Return how far points are outside of a shape, in its frame; 0 inside."""
    if isinstance(shape, coal.Box):
        return np.asarray(np.linalg.norm(np.maximum(np.abs(points) - shape.halfSide, 0.0), axis=1))
    if isinstance(shape, coal.Sphere):
        return np.asarray(np.maximum(np.linalg.norm(points, axis=1) - shape.radius, 0.0))
    if isinstance(shape, coal.Capsule | coal.Cylinder):
        beyond = np.maximum(np.abs(points[:, 2]) - shape.halfLength, 0.0)
        across = np.hypot(points[:, 0], points[:, 1])
        if isinstance(shape, coal.Capsule):
            return np.asarray(np.maximum(np.hypot(across, beyond) - shape.radius, 0.0))
        return np.asarray(np.hypot(np.maximum(across - shape.radius, 0.0), beyond))
    request, here, point = coal.DistanceRequest(), coal.Transform3s.Identity(), coal.Sphere(1e-9)
    distances_m = [
        coal.distance(shape, here, point, coal.Transform3s(np.eye(3), at), request, coal.DistanceResult())
        for at in points
    ]
    return np.maximum(distances_m, 0.0)
