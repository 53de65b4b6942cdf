"""Bodies and drives of the MuJoCo model: a robot from its URDF, and shapes.

Links take their masses and collision shapes from the URDF. Links of one robot do not collide with each
other: the planner checks that, and its capsules overlap at the joints. Those of different robots do.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from lxml import etree

from handover_robots.model.obstacles import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from handover_robots.model.poses import Frame, Pose
from handover_robots.model.robot_model import RobotModel

STEP_S = 0.002

PART_FRICTION = 0.6
PAD_FRICTION = 0.9
"""Sliding friction: parts on everything, and the rubber of the fingers."""

JOINT_ARMATURE_KG_M2 = 0.1
FINGER_ARMATURE_KG = 0.3
HINGE_ARMATURE_KG_M2 = 2e-5
"""Inertia of the drives, seen from the joint."""

MAX_FINGER_FORCE_N = 40.0
FINGER_DAMPING = 800.0
DEFAULT_EFFORT_NM = 100.0

STIFF = (2 * STEP_S, 1.0)
"""Time constant in s and damping ratio of contacts, as stiff as the step allows."""

SCENERY = 1
"""The bit of contact of scenery and parts. Each robot has a further one, and touches all but its own."""
ANYTHING = 2**31 - 1

SCENERY_GROUP, ROBOT_GROUP, CAMERA_GROUP = 0, 3, 4


@dataclass(frozen=True, slots=True)
class ArmNames:
    """What an arm is made of: `joints` as in its URDF, and the names in the model that end with `_id`."""

    prefix: str
    joints: tuple[str, ...]
    fingers: tuple[str, ...]
    opened: float
    """The position of the open fingers."""

    @property
    def joint_ids(self) -> tuple[str, ...]:
        """Return the joints, and the drives with the same names."""
        return tuple(self.prefix + name for name in self.joints)

    @property
    def finger_ids(self) -> tuple[str, ...]:
        """Return the joints of the fingers, and the drives with the same names."""
        return tuple(self.prefix + name for name in self.fingers)

    @property
    def tip_id(self) -> str:
        """Return the site at the tip of the tool."""
        return f"{self.prefix}tip"

    @property
    def force_id(self) -> str:
        """Return the sensor of the force at the wrist."""
        return f"{self.prefix}wrist_force"

    @property
    def torque_id(self) -> str:
        """Return the sensor of the torque at the wrist."""
        return f"{self.prefix}wrist_torque"


def add_robot(spec: Any, model: RobotModel, prefix: str, bit: int) -> ArmNames:
    """Add the links and the drives of a robot, whose links touch everything but `bit`."""
    spec.compiler.degree = False
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)
    urdf = etree.fromstring(model.urdf.encode(), parser)
    links = {link.get("name"): link for link in urdf.findall("link")}
    below: dict[str, list[Any]] = {}
    children = set()
    for joint in urdf.findall("joint"):
        below.setdefault(joint.find("parent").get("link"), []).append(joint)
        children.add(joint.find("child").get("link"))
    root = next(name for name in links if name not in children)
    opened = model.fingers[0].opened if model.fingers else 0.0
    names = ArmNames(prefix, model.joint_names, tuple(finger.joint for finger in model.fingers), opened)
    moved = {*names.joints, *names.fingers}
    tip_parent = _rigid_parent(urdf, model.tip)

    def add(link: str, body: Any) -> None:
        is_finger = _finger_of(urdf, link) in names.fingers
        _add_link(spec, body, links[link], prefix, bit, is_finger=is_finger)
        for joint in below.get(link, []):
            child = joint.find("child").get("link")
            origin = _origin(joint)
            made = body.add_body(name=prefix + child, pos=list(origin.position), quat=_quaternion(origin))
            if joint.get("name") in moved:
                _add_joint(made, joint, prefix, is_finger=joint.get("name") in names.fingers)
            add(child, made)

    base = Pose.of(model.base)
    top = spec.worldbody.add_body(name=prefix + root, pos=list(base.position), quat=_quaternion(base))
    add(root, top)
    _add_drives(spec, names, _efforts(urdf))
    spec.body(prefix + model.tip).add_site(name=names.tip_id)
    wrist = f"{prefix}wrist"
    spec.body(prefix + tip_parent).add_site(name=wrist)
    for kind, name in (
        (mujoco.mjtSensor.mjSENS_FORCE, names.force_id),
        (mujoco.mjtSensor.mjSENS_TORQUE, names.torque_id),
    ):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=wrist)
    return names


def _rigid_parent(urdf: Any, tip: str) -> str:
    """Return the child link of the last fixed joint before the tip: what the wrist sensor carries."""
    above = {joint.find("child").get("link"): joint for joint in urdf.findall("joint")}
    link = tip
    while above[link].get("type") == "fixed":
        parent = above[link].find("parent").get("link")
        if above[parent].get("type") != "fixed":
            return link if link != tip else parent
        link = parent
    return link


def _finger_of(urdf: Any, link: str) -> str | None:
    for joint in urdf.findall("joint"):
        if joint.find("child").get("link") == link:
            return str(joint.get("name"))
    return None


def _add_link(spec: Any, body: Any, link: Any, prefix: str, bit: int, *, is_finger: bool) -> None:
    inertial = link.find("inertial")
    if inertial is not None:
        pose = _origin(inertial)
        inertia = inertial.find("inertia")
        body.mass = float(inertial.find("mass").get("value"))
        body.ipos = list(pose.position)
        body.iquat = _quaternion(pose)
        body.fullinertia = [float(inertia.get(name)) for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
        body.explicitinertial = True
    capsules = {capsule.get("name") for capsule in link.findall("collision_checking/capsule")}
    for number, collision in enumerate(link.findall("collision")):
        name = collision.get("name") or f"{link.get('name')}_{number}"
        shape = _shape(collision.find("geometry"), is_capsule=collision.get("name") in capsules)
        if shape is None:
            continue
        friction = PAD_FRICTION if is_finger else PART_FRICTION
        add_shape(
            spec,
            body,
            prefix + name,
            shape,
            _origin(collision),
            contype=bit,
            conaffinity=ANYTHING & ~bit,
            condim=4,
            friction=[friction, 0.01, 0.0001],
            solref=list(STIFF),
            priority=1 if is_finger else 0,
            group=ROBOT_GROUP,
            mass=0.0,
        )


def _shape(geometry: Any, *, is_capsule: bool) -> Shape | None:
    box, cylinder, sphere = (geometry.find(kind) for kind in ("box", "cylinder", "sphere"))
    if box is not None:
        width, depth, height = map(float, box.get("size").split())
        return Box((width, depth, height))
    if cylinder is not None:
        kind = Capsule if is_capsule else Cylinder
        return kind(float(cylinder.get("radius")), float(cylinder.get("length")))
    if sphere is not None:
        return Sphere(float(sphere.get("radius")))
    return None


def add_shape(spec: Any, body: Any, name: str, shape: Shape, pose: Pose, **options: Any) -> None:
    """Add a shape to a body, with the `options` of MuJoCo."""
    where = {"name": name, "pos": list(pose.position), "quat": _quaternion(pose), **options}
    match shape:
        case Box((width, depth, height)):
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[width / 2, depth / 2, height / 2], **where)
        case Cylinder(radius, length):
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[radius, length / 2, 0.0], **where)
        case Capsule(radius, length):
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius, length / 2, 0.0], **where)
        case Sphere(radius):
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0], **where)
        case Mesh(file, scale):
            spec.add_mesh(name=name, file=str(file.resolve()), scale=list(scale))
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, **where)


def _add_joint(body: Any, joint: Any, prefix: str, *, is_finger: bool) -> None:
    limit = joint.find("limit")
    slides = joint.get("type") == "prismatic"
    is_limited = joint.get("type") != "continuous"
    axis = joint.find("axis")
    body.add_joint(
        name=prefix + joint.get("name"),
        type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
        axis=[1.0, 0.0, 0.0] if axis is None else [float(value) for value in axis.get("xyz").split()],
        limited=int(is_limited),
        range=[float(limit.get("lower")), float(limit.get("upper"))] if is_limited else [0.0, 0.0],
        armature=FINGER_ARMATURE_KG if is_finger else JOINT_ARMATURE_KG_M2,
    )


def _add_drives(spec: Any, names: ArmNames, efforts: Mapping[str, float]) -> None:
    """Add torque drives for the joints, and force-limited velocity drives for coupled fingers."""
    for joint, name in zip(names.joints, names.joint_ids, strict=True):
        effort = efforts.get(joint) or DEFAULT_EFFORT_NM
        drive = spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrllimited=True,
            ctrlrange=[-effort, effort],
        )
        drive.set_to_motor()
    fingers = names.finger_ids
    for name in fingers:
        drive = spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            forcelimited=True,
            forcerange=[-MAX_FINGER_FORCE_N, MAX_FINGER_FORCE_N],
        )
        drive.set_to_velocity(FINGER_DAMPING)
    for name in fingers[1:]:
        spec.add_equality(
            name=f"{name} follows",
            type=mujoco.mjtEq.mjEQ_JOINT,
            name1=name,
            name2=fingers[0],
            data=[0.0, 1.0, *[0.0] * 10],
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            solref=list(STIFF),
        )


def _efforts(urdf: Any) -> Mapping[str, float]:
    efforts = {}
    for joint in urdf.findall("joint"):
        limit = joint.find("limit")
        if limit is not None:
            efforts[joint.get("name")] = float(limit.get("effort") or 0.0)
    return efforts


def _origin(element: Any) -> Pose:
    origin = element.find("origin")
    xyz = [0.0] * 3 if origin is None else [float(v) for v in (origin.get("xyz") or "0 0 0").split()]
    rpy = [0.0] * 3 if origin is None else [float(v) for v in (origin.get("rpy") or "0 0 0").split()]
    roll, pitch, yaw = rpy
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]).tolist(), np.sin([roll, pitch, yaw]).tolist()
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return Pose.of(Frame(rows, (xyz[0], xyz[1], xyz[2])))


def _quaternion(pose: Pose) -> list[float]:
    """Return the orientation in MuJoCo's order: w, x, y, z."""
    x, y, z, w = pose.orientation
    return [w, x, y, z]
