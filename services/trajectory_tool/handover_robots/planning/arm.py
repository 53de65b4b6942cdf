"""The kinematics of an arm by pinocchio, made from a robot model.

Joints beside the chain to the tool, such as fingers, are locked. The collision geometry comes from the
`<collision>` elements of the URDF; cylinders that `<collision_checking>` lists are capsules. An element may
have a `<hull>` beside its `<geometry>`, which other readers of a URDF skip: the corners of a convex polytope
within the plain shape, as x y z in m in the frame of its `<origin>`. The polytope is what is checked for
collision, and the plain shape is what has to be simple: obstacles for other robots, bodies in the physics.
"""

import math
from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from handover.errors import UsageError
from handover_robots.model.poses import Frame, Pose
from handover_robots.model.robot_model import RobotModel

Array = NDArray[np.float64]

MIN_HULL_M = 1e-4
CONTINUOUS_RANGE_RAD = 2 * math.pi
"""A continuous joint is planned within one full turn in both directions."""


class Arm:
    """A robot model for computations; not thread-safe, so each thread makes its own.

    `geometry` has the shapes that are checked for collision, `solids` the plain shapes around them.
    Raises `UsageError` for a URDF that pinocchio cannot use.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.n = len(model.joints)
        try:
            self.pin_model, self.solids = _built(model)
            self.geometry = _with_hulls(self.solids, read_hulls(model.urdf))
        except (ValueError, RuntimeError) as error:
            raise UsageError(f"the URDF of {model.name} cannot be used for planning: {error}") from None
        self.data = self.pin_model.createData()
        self.tip = self.pin_model.getFrameId(model.tip, pin.FrameType.BODY)  # a joint may have the same name
        self.lower = np.array([_bound(joint.lower, -CONTINUOUS_RANGE_RAD) for joint in model.joints])
        self.upper = np.array([_bound(joint.upper, CONTINUOUS_RANGE_RAD) for joint in model.joints])
        self.is_turning = np.array([joint.kind != "prismatic" for joint in model.joints])
        self._link_joints = {
            frame.name: frame.parentJoint
            for frame in self.pin_model.frames
            if frame.type == pin.FrameType.BODY
        }

    def tool(self, joints: Sequence[float] | Array) -> Any:
        """Return the pose of the tool's tip as a `pinocchio.SE3`."""
        pin.forwardKinematics(self.pin_model, self.data, np.asarray(joints, dtype=np.float64))
        return pin.updateFramePlacement(self.pin_model, self.data, self.tip).copy()

    def tool_pose(self, joints: Sequence[float] | Array) -> Pose:
        """Return the pose of the tool's tip."""
        return pose_of(self.tool(joints))

    def tool_speed_mps(self, joints: Array, velocities: Array) -> float:
        """Return the speed of the tool's tip."""
        pin.forwardKinematics(self.pin_model, self.data, joints, velocities)
        frame = pin.getFrameVelocity(self.pin_model, self.data, self.tip, pin.LOCAL)
        return float(np.linalg.norm(frame.linear))

    def fastest_mps(self, joints: Array, velocities: Array) -> float:
        """Return the speed of the fastest end of a link: of a joint or the tool's tip."""
        tool_mps = self.tool_speed_mps(joints, velocities)
        moving = range(1, self.pin_model.njoints)
        return max(tool_mps, *(float(np.linalg.norm(self.data.v[joint].linear)) for joint in moving))

    def tool_positions(self, path: Array) -> Array:
        """Return the positions of the tool's tip along a path, one row for each."""
        return np.array([self.tool(joints).translation for joints in path])

    def jacobian(self, joints: Array) -> Array:
        """Return the Jacobian of the tip (6 rows) in axes of the base, at the tip."""
        return np.asarray(
            pin.computeFrameJacobian(
                self.pin_model, self.data, joints, self.tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
        )

    def manipulability(self, joints: Array) -> float:
        """Return the smallest singular value of the Jacobian: 0 in a singularity."""
        return float(np.linalg.svd(self.jacobian(joints), compute_uv=False)[-1])

    def joint_of_link(self, link: str) -> int:
        """Return the number of the joint that moves `link`, 0 for a link that is fixed to the base."""
        return int(self._link_joints[link])

    def is_within(self, joints: Array, tolerance: float = 1e-9) -> bool:
        """Return whether the joints are within their position limits."""
        return bool(np.all(joints >= self.lower - tolerance) and np.all(joints <= self.upper + tolerance))

    def equivalents(self, joints: Array) -> list[Array]:
        """Return `joints` with every combination of full turns within the limits; empty without any."""
        choices: list[list[float]] = []
        for number, value in enumerate(joints):
            turns = (-2, -1, 0, 1, 2) if self.is_turning[number] else (0,)
            values = [float(value) + 2 * math.pi * turn for turn in turns]
            low, high = self.lower[number] - 1e-9, self.upper[number] + 1e-9
            choices.append([min(max(v, low + 1e-9), high - 1e-9) for v in values if low <= v <= high])
        solutions: list[list[float]] = [[]]
        for values in choices:
            solutions = [[*start, value] for start in solutions for value in values]
        return [np.array(solution) for solution in solutions]

    def nearest_equivalent(self, joints: Array, near: Array) -> Array | None:
        """Return `joints` turned by full turns as near to `near` as the limits allow; None without any."""
        result = joints.copy()
        turning = self.is_turning
        result[turning] += 2 * math.pi * np.round((near[turning] - joints[turning]) / (2 * math.pi))
        for _ in range(2):
            result = np.where(turning & (result > self.upper + 1e-9), result - 2 * math.pi, result)
            result = np.where(turning & (result < self.lower - 1e-9), result + 2 * math.pi, result)
        return np.clip(result, self.lower, self.upper) if self.is_within(result) else None

    def reach_of(self, item: Any) -> Array:
        """Return for each joint how far a point of a geometry moves at most for 1 rad (or 1 m) of the joint.

        A bound for all configurations: the distance from the axis to the next joint across the axis, and
        from there the sum of the lengths to the far end of the geometry. 0 for joints that do not move it.
        """
        bounds = np.zeros(self.n)
        number = item.parentJoint
        if number == 0:
            return bounds
        centre, radius = _bounding_sphere(item.geometry)
        centre = item.placement.act(centre)
        far = float(np.linalg.norm(centre)) + radius
        bounds[number - 1] = _across(centre, self._axis(number)) + radius
        if isinstance(item.geometry, coal.Capsule):
            ends = [
                item.placement.act(np.array([0.0, 0.0, side * item.geometry.halfLength])) for side in (1, -1)
            ]
            across = max(_across(end, self._axis(number)) for end in ends)
            bounds[number - 1] = across + item.geometry.radius
            far = max(float(np.linalg.norm(end)) for end in ends) + item.geometry.radius
        if isinstance(item.geometry, coal.ConvexBase):
            corners = corners_of(item.geometry) @ item.placement.rotation.T + item.placement.translation
            bounds[number - 1] = max(_across(corner, self._axis(number)) for corner in corners)
            far = float(np.linalg.norm(corners, axis=1).max())
        while number > 1:
            offset = self.pin_model.jointPlacements[number].translation
            travel = 0.0 if self.is_turning[number - 1] else float(np.abs(self._range(number)).max())
            number -= 1
            bounds[number - 1] = _across(offset, self._axis(number)) + travel + far
            far += float(np.linalg.norm(offset)) + travel
        return np.where(self.is_turning[: self.n], bounds, np.sign(bounds))

    def _range(self, number: int) -> Array:
        return np.array([self.lower[number - 1], self.upper[number - 1]])

    def _axis(self, number: int) -> Array:
        subspace = np.asarray(self.pin_model.joints[number].createData().S).reshape(6)
        return subspace[3:] if self.is_turning[number - 1] else subspace[:3]


def se3_of(pose: Pose) -> Any:
    """Return a pose as a `pinocchio.SE3`."""
    return _se3(pose.frame())


def pose_of(placement: Any) -> Pose:
    """Return a `pinocchio.SE3` as a pose."""
    rows = placement.rotation.tolist()
    x, y, z = placement.translation.tolist()
    return Pose.of(Frame((tuple(rows[0]), tuple(rows[1]), tuple(rows[2])), (x, y, z)))


def _se3(frame: Frame) -> Any:
    return pin.SE3(np.array(frame.rotation), np.array(frame.position))


def _bound(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _built(model: RobotModel) -> tuple[Any, Any]:
    text = _without_continuous(model.urdf)
    full = pin.buildModelFromXML(text)
    geometry = pin.buildGeomFromUrdfString(full, text, pin.GeometryType.COLLISION)
    wanted = set(model.joint_names)
    opened = {finger.joint: finger.opened for finger in model.fingers}
    reference = pin.neutral(full)
    locked = []
    for number in range(1, full.njoints):
        if full.names[number] not in wanted:
            locked.append(number)
            reference[full.joints[number].idx_q] = opened.get(full.names[number], 0.0)
    reduced, geometry = pin.buildReducedModel(full, geometry, locked, reference)
    names = [str(name) for name in reduced.names][1:]
    if names != list(model.joint_names):
        raise ValueError(
            f"its joints are {', '.join(names)}, and {', '.join(model.joint_names)} are expected"
        )
    _require_shapes(text, geometry)
    _mount(reduced, geometry, _se3(model.base))
    return reduced, geometry


def _require_shapes(urdf: str, geometry: Any) -> None:
    """Raise `ValueError` for links whose collision shapes the reader of the URDF has dropped.

    It does so for a fault elsewhere in the link, such as an inertia without `ixy`, with a line on stderr.
    """
    names = {item.name for item in geometry.geometryObjects}
    dropped = [
        str(link.get("name"))
        for link in etree.fromstring(urdf.encode(), _parser()).findall("link")
        for number, collision in enumerate(link.findall("collision"))
        if collision.find("geometry") is not None and f"{link.get('name')}_{number}" not in names
    ]
    if dropped:
        raise ValueError(
            f"the collision shapes of {', '.join(dict.fromkeys(dropped))} cannot be read; give their "
            "<inertial> all of mass, ixx, ixy, ixz, iyy, iyz and izz, and their <geometry> valid sizes"
        )


def read_hulls(urdf: str) -> dict[str, Array]:
    """Return the corners of the `<hull>` elements by the names that pinocchio gives their shapes.

    Raises `ValueError` for one that has no volume.
    """
    hulls: dict[str, Array] = {}
    for link in etree.fromstring(urdf.encode(), _parser()).findall("link"):
        for number, collision in enumerate(link.findall("collision")):
            if (corners := hull_of(collision)) is not None:
                hulls[f"{link.get('name')}_{number}"] = corners
    return hulls


def hull_of(collision: Any) -> Array | None:
    """Return the corners of the `<hull>` of a collision element; None without one. Raises `ValueError`."""
    hull = collision.find("hull")
    if hull is None:
        return None
    try:
        corners = np.array([float(value) for value in (hull.text or "").split()]).reshape(-1, 3)
    except ValueError:
        corners = np.zeros((0, 3))
    if len(corners) < 4 or not np.isfinite(corners).all():
        raise ValueError(
            f'the <hull> of the shape "{collision.get("name", "")}" must have the x y z of four corners or '
            "more; without a <hull> its <geometry> is checked"
        )
    return corners


def convex(corners: Array) -> Any:
    """Return the convex hull of points as a shape of coal. Raises `ValueError` where it has no volume."""
    thickness_m = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)[-1]
    if thickness_m < MIN_HULL_M:  # coal ends the process for some
        raise ValueError(f"a <hull> is thinner than {MIN_HULL_M} m; leave it out, or make it thicker")
    points = coal.StdVec_Vec3s()
    for corner in corners:
        points.append(corner)
    return coal.Convex.convexHull(points, True, "Qt")


def corners_of(shape: Any) -> Array:
    """Return the corners of a convex shape of coal, in its own frame."""
    return np.array([shape.point(number) for number in range(shape.num_points)])


def _with_hulls(solids: Any, hulls: dict[str, Array]) -> Any:
    geometry = solids.copy()
    for item in geometry.geometryObjects:
        if item.name in hulls:
            item.geometry = convex(hulls[item.name])
    return geometry


def _parser() -> Any:
    return etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)


def _mount(model: Any, geometry: Any, base: Any) -> None:
    """Move everything that is fixed to the root to `base`."""
    for number in range(1, model.njoints):
        if model.parents[number] == 0:
            model.jointPlacements[number] = base * model.jointPlacements[number]
    for number in range(1, model.nframes):
        if model.frames[number].parentJoint == 0:
            model.frames[number].placement = base * model.frames[number].placement
    for item in geometry.geometryObjects:
        if item.parentJoint == 0:
            item.placement = base * item.placement


def _without_continuous(urdf: str) -> str:
    """Return the URDF with continuous joints as revolute ones: pinocchio describes those by two numbers."""
    root = etree.fromstring(urdf.encode(), _parser())
    for joint in root.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = etree.SubElement(joint, "limit", effort="0", velocity="0")
            limit.set("lower", str(-CONTINUOUS_RANGE_RAD))
            limit.set("upper", str(CONTINUOUS_RANGE_RAD))
    return str(etree.tostring(root, encoding="unicode"))


def _bounding_sphere(shape: Any) -> tuple[Array, float]:
    shape.computeLocalAABB()
    return np.asarray(shape.aabb_center), float(shape.aabb_radius)


def _across(vector: Array, axis: Array) -> float:
    """Return the length of a vector across an axis."""
    return float(np.linalg.norm(vector - axis * (axis @ vector)))
