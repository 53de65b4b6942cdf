"""Which link of a robot is which link of another URDF of it, and how their frames differ.

Both URDFs move their joints of the same name to the same positions, at some random configurations. The axes
of these joints are the same lines in space then, so a rotation and a translation of the other base follow by
least squares (Kabsch for the directions). A link moves with the joint above it. If its frame stays at one
place in the frame of our joint in all configurations, that place is known; if not, the two URDFs differ in
kinematics there, and the link is not mapped.

Example: the base frame of a UR5e is turned by 180 degrees between its controller and its ROS description, and
its wrist has its frames at other ends of the same axes. Both follow from the axes.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from handover.errors import UsageError
from handover_robots.model.robot_model import RobotModel
from handover_robots.onboarding.meshes import Surface, Surfaces
from handover_robots.planning.arm import Array

CONFIGURATIONS = 12
TOLERANCE_M = 5e-4
LEVER_M = 0.3
"""The distance at which a difference in angle counts."""
PARALLEL = 1e-6


@dataclass(frozen=True, slots=True)
class LinkPlace:
    """The link of ours that another link is, and the pose of the other frame in the frame of ours."""

    link: str
    pose: Any


@dataclass
class Mapping:
    """The places of links of another URDF, and why others have none."""

    joints: tuple[tuple[str, str], ...]
    """The joints that both have: our name, and the name in the other URDF."""
    places: dict[str, LinkPlace] = field(default_factory=dict)
    unmapped: dict[str, str] = field(default_factory=dict)

    def surfaces(self, others: Surfaces) -> dict[str, list[Surface]]:
        """Return the surfaces of mapped links by our links, in their frames."""
        mapped: dict[str, list[Surface]] = {}
        for link, shapes in others.items():
            if (place := self.places.get(link)) is not None:
                mapped.setdefault(place.link, []).extend(shape.moved(place.pose) for shape in shapes)
        return mapped


def map_links(model: RobotModel, other: Any, links: Sequence[str]) -> Mapping:
    """Return where `links` of another URDF, given by its root element, are on a robot.

    Raises `UsageError` if the two have no joint in common, or if the axes of these are not the same.
    """
    ours = _kinematics(etree.fromstring(model.urdf.encode()))
    theirs = _kinematics(other)
    names = _common(model, ours, theirs)
    mapping = Mapping(tuple(names.items()))
    ours_at, theirs_at = _configurations(ours, theirs, names)
    base = _base(ours, theirs, names, ours_at, theirs_at)
    poses, why_not = _poses(ours, theirs, names, ours_at, theirs_at, base=base)
    if not links:
        raise UsageError("no link has a mesh, or another shape, that can be read")
    if why_not and len(why_not) == len(names):
        raise UsageError(
            f"the joints of {model.name} and of the URDF with the meshes are not the same: "
            + "; ".join(why_not.values())
        )
    bodies = _bodies(ours)
    for link in links:
        frame = theirs.frames[theirs.getFrameId(link, pin.FrameType.BODY)]
        joint = theirs.names[frame.parentJoint] if frame.parentJoint else ""
        own = next((name for name, same in names.items() if same == joint), "")
        if joint and not own:
            mapping.unmapped[link] = f'it moves with the joint "{joint}", which {model.name} does not have'
        elif own in why_not:
            mapping.unmapped[link] = why_not[own]
        else:
            number = ours.getJointId(own) if own else 0
            same = link if link in bodies[number] else bodies[number][0]
            placed = ours.frames[ours.getFrameId(same, pin.FrameType.BODY)].placement
            mapping.places[link] = LinkPlace(same, placed.inverse() * poses[own] * frame.placement)
    return mapping


def _kinematics(root: Any) -> Any:
    """Return the kinematics of a URDF with one number for each joint; joints with more are fixed."""
    root = copy.deepcopy(root)
    for joint in root.findall("joint"):
        kind = joint.get("type")
        if kind == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = etree.SubElement(joint, "limit", effort="0", velocity="0") if limit is None else limit
            limit.set("lower", str(-np.pi))
            limit.set("upper", str(np.pi))
        elif kind not in {"revolute", "prismatic"}:
            joint.set("type", "fixed")
    try:
        return pin.buildModelFromXML(etree.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise UsageError(f"the URDF with the meshes cannot be used: {error}") from None


def _bodies(model: Any) -> dict[int, list[str]]:
    """Return the links that move with each joint, in the order of the tree; 0 is the base."""
    bodies: dict[int, list[str]] = {number: [] for number in range(model.njoints)}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            bodies[frame.parentJoint].append(frame.name)
    return bodies


def _common(model: RobotModel, ours: Any, theirs: Any) -> dict[str, str]:
    """Return the names of the joints that both have, ours first: the same, with a prefix, or in order.

    Joints with other names are the same in order, if as many are between the same neighbours: of the joints
    a, b, c and a, x, c, b is x. Whether they move alike is decided by their axes.
    """
    own, other = list(ours.names)[1:], list(theirs.names)[1:]
    names = {name: name for name in own if name in other}
    for name in own:
        ends = [
            joint for joint in other if joint.endswith((f"_{name}", f"/{name}")) or name.endswith(f"_{joint}")
        ]
        if name not in names and len(ends) == 1 and ends[0] not in names.values():
            names[name] = ends[0]
    own_gaps = _gaps(model.joint_names, {name: name for name in names})
    for after, gap in _gaps(other, {same: name for name, same in names.items()}).items():
        if len(gap) == len(own_gaps.get(after, ())):
            names |= dict(zip(own_gaps[after], gap, strict=True))
    if not set(names) & set(model.joint_names):
        raise UsageError(
            f"{model.name} and the URDF with the meshes have no joint in common: "
            f"{', '.join(model.joint_names)}; {', '.join(other) or 'none'}; give the joints the same names"
        )
    return names


def _gaps(joints: Sequence[str], mapped: dict[str, str]) -> dict[str, list[str]]:
    """Return the joints that are not known, by our name of the known joint before them; "" at the begin."""
    gaps: dict[str, list[str]] = {}
    after = ""
    for joint in joints:
        if joint in mapped:
            after = mapped[joint]
        else:
            gaps.setdefault(after, []).append(joint)
    return gaps


def _configurations(ours: Any, theirs: Any, names: dict[str, str]) -> tuple[Array, Array]:
    random = np.random.default_rng(0)
    ours_at = np.tile(pin.neutral(ours), (CONFIGURATIONS, 1))
    theirs_at = np.tile(pin.neutral(theirs), (CONFIGURATIONS, 1))
    for name, other in names.items():
        our_axis, their_axis = (
            model.joints[model.getJointId(joint)].idx_q for model, joint in ((ours, name), (theirs, other))
        )
        low = max(ours.lowerPositionLimit[our_axis], theirs.lowerPositionLimit[their_axis], -np.pi)
        high = min(ours.upperPositionLimit[our_axis], theirs.upperPositionLimit[their_axis], np.pi)
        values = random.uniform(low, high, CONFIGURATIONS) if low < high else np.zeros(CONFIGURATIONS)
        ours_at[:, our_axis], theirs_at[:, their_axis] = values, values
    return ours_at, theirs_at


def _axes(model: Any, joints: Array, names: Sequence[str]) -> tuple[Array, Array, Any]:
    """Return the directions and the places of joint axes, and which of them turn."""
    data = model.createData()
    pin.forwardKinematics(model, data, joints)
    directions, places, turning = [], [], []
    for name in names:
        number = model.getJointId(name)
        subspace = np.asarray(model.joints[number].createData().S).reshape(6)
        is_turning = bool(np.abs(subspace[3:]).max() > 0)
        directions.append(data.oMi[number].rotation @ (subspace[3:] if is_turning else subspace[:3]))
        places.append(data.oMi[number].translation.copy())
        turning.append(is_turning)
    return np.array(directions), np.array(places), np.array(turning)


def _base(ours: Any, theirs: Any, names: dict[str, str], ours_at: Array, theirs_at: Array) -> Any:
    """Return the pose of the other base in the frame of ours, by the axes of the common joints."""
    seen = [
        (_axes(ours, our_pose, list(names)), _axes(theirs, their_pose, list(names.values())))
        for our_pose, their_pose in zip(ours_at, theirs_at, strict=True)
    ]
    correlation = np.zeros((3, 3))
    for (own, places, turning), (other, other_places, _) in seen:
        correlation += other.T @ own
        for first in range(len(own) - 1):
            # Directions alone leave the turn about parallel axes open; the way from one to the next does not.
            if (
                turning[first]
                and turning[first + 1]
                and np.linalg.norm(np.cross(*own[first : first + 2])) < PARALLEL
            ):
                ways = [
                    step - axis[first] * (axis[first] @ step)
                    for axis, at in ((own, places), (other, other_places))
                    for step in [at[first + 1] - at[first]]
                ]
                correlation += np.outer(ways[1], ways[0])
    u, _, vt = np.linalg.svd(correlation)
    rotation = vt.T @ np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
    rows, sides = [], []
    for (own, places, turning), (_, other_places, _) in seen:
        for direction, place, other_place, turns in zip(own, places, other_places, turning, strict=True):
            if turns:
                across = np.eye(3) - np.outer(direction, direction)
                rows.append(across)
                sides.append(across @ (place - rotation @ other_place))
    translation = np.zeros(3)
    if rows:
        translation = np.linalg.lstsq(np.concatenate(rows), np.concatenate(sides), rcond=1e-9)[0]
    return pin.SE3(rotation, translation)


def _poses(
    ours: Any, theirs: Any, names: dict[str, str], ours_at: Array, theirs_at: Array, *, base: Any
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the poses of the other joints' frames in those of ours, and why a joint has none.

    The frame of the base has an empty name.
    """
    seen: dict[str, list[Any]] = {name: [] for name in names}
    data, other_data = ours.createData(), theirs.createData()
    for our_pose, their_pose in zip(ours_at, theirs_at, strict=True):
        pin.forwardKinematics(ours, data, our_pose)
        pin.forwardKinematics(theirs, other_data, their_pose)
        for name, other in names.items():
            placed = base * other_data.oMi[theirs.getJointId(other)]
            seen[name].append(data.oMi[ours.getJointId(name)].inverse() * placed)
    poses, why_not = {"": base}, {}
    for name, offsets in seen.items():
        moved = [offsets[0].inverse() * pose for pose in offsets]
        off_m = max(
            float(np.linalg.norm(pose.translation) + LEVER_M * np.linalg.norm(pin.log3(pose.rotation)))
            for pose in moved
        )
        if off_m > TOLERANCE_M:
            why_not[name] = (
                f'what "{name}" moves is up to {1000 * off_m:.1f} mm elsewhere in the other URDF: lengths, '
                "axes or zero positions differ"
            )
        poses[name] = offsets[0]
    return poses, why_not
