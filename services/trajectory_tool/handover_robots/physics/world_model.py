"""The MuJoCo model of a cell: the robots from their URDFs, the scene, and loose parts.

Links take their masses and collision shapes from the URDF. The obstacles of the scene are fixed. Parts are
boxes of the scene's size that slide, tip and fall; those outside of the cell wait weightless beside it. Links
of one robot do not collide with each other: the planner checks that, and its capsules overlap at the joints.
Those of different robots do. What belongs to a robot has its name and a slash before its own name.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import mujoco
import numpy as np
from lxml import etree

from handover.errors import UsageError
from handover_robots.model.obstacles import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from handover_robots.model.poses import Frame, Pose
from handover_robots.model.robot_model import RobotModel
from handover_robots.perception.depth_image import Array
from handover_robots.perception.grasps import AT_TIP, Fingers
from handover_robots.physics.loose_objects import (
    HINGE_DAMPING_NMS_RAD,
    HINGE_RANGE_RAD,
    HINGE_STIFFNESS_NM_RAD,
    OBJECTS,
    LooseObject,
)
from handover_robots.scene.scene import Scene

STEP_S = 0.002
GRAVITY_MPS2 = 9.81

PART_DENSITY_KG_M3 = 1200.0
PART_FRICTION = 0.6
PAD_FRICTION = 0.9
"""Sliding friction: parts on everything, and the rubber of the fingers."""

ROLLING_FRICTION_M = 0.001
"""Of objects that are no boxes: fruit is not perfectly round, and comes to rest."""

JOINT_ARMATURE_KG_M2 = 0.1
FINGER_ARMATURE_KG = 0.3
HINGE_ARMATURE_KG_M2 = 2e-5
"""Inertia of the drives, seen from the joint."""

MAX_FINGER_FORCE_N = 40.0
FINGER_DAMPING = 800.0
DEFAULT_EFFORT_NM = 100.0
DEFAULT_PART_SIZE_M = (0.024, 0.06, 0.024)
PARKED_AT = (5.0, 5.0, 5.0)

CLOSING_ALONG_Y = Frame(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0))
"""A frame whose x axis is the y axis of the tip."""

STIFF = (2 * STEP_S, 1.0)
"""Time constant in s and damping ratio of contacts, as stiff as the step allows."""

_SCENERY = 1
"""The bit of contact of scenery and parts. Each robot has a further one, and touches all but its own."""
_ANYTHING = 2**31 - 1

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


@dataclass(frozen=True, slots=True)
class WorldModel:
    """A compiled model with the names of what it is made of."""

    mujoco: Any
    arms: Mapping[str, ArmNames]
    parts: tuple[str, ...]
    """The loose bodies: boxes of `part_size_m`, then the objects of the scene."""
    part_size_m: tuple[float, float, float]
    objects: Mapping[str, int]
    """The numbers of objects by their names, as parts."""


def objects_of(scene: Scene) -> Sequence[LooseObject]:
    """Return the objects of all bins. Raises `UsageError` for one that is unknown or named twice."""
    names = [name for bin_ in scene.bins.values() for name in bin_.objects]
    for number, name in enumerate(names):
        if name not in OBJECTS:
            raise UsageError(f'scene: there is no object "{name}"; there is {", ".join(OBJECTS)}')
        if name in names[:number]:
            raise UsageError(f'scene: the object "{name}" is named twice; each exists once')
    return [OBJECTS[name] for name in names]


def build(models: Mapping[str, RobotModel], scene: Scene, part_count: int) -> WorldModel:
    """Return the model of a cell: its robots by name, and `part_count` parts.

    Raises `UsageError` for what MuJoCo cannot use.
    """
    spec = mujoco.MjSpec()
    spec.modelname = scene.name
    option = spec.option
    option.timestep = STEP_S
    option.gravity = [0.0, 0.0, -GRAVITY_MPS2]
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    _add_scenery(spec, scene)
    arms = {
        name: _add_robot(spec, model, f"{name}/", _SCENERY << number)
        for number, (name, model) in enumerate(models.items(), 1)
    }
    size = scene.gripper.part_size_m or DEFAULT_PART_SIZE_M
    parts = tuple(f"part:{number}" for number in range(part_count))
    mass_kg = scene.gripper.part_mass_kg
    density = PART_DENSITY_KG_M3 if mass_kg is None else mass_kg / math.prod(size)
    for number, part in enumerate(parts):
        _add_part(spec, part, size, density).pos = list(parked_at(number))
    objects = {}
    for one in objects_of(scene):
        objects[one.name] = len(parts)
        _add_object(spec, f"object:{one.name}", one).pos = list(parked_at(len(parts)))
        parts = (*parts, f"object:{one.name}")
    try:
        compiled = spec.compile()
    except ValueError as error:
        names = " and ".join(model.name for model in models.values())
        raise UsageError(f"MuJoCo cannot simulate {names} in {scene.name}: {error}") from None
    return WorldModel(compiled, arms, parts, size, objects)


def parked_at(number: int) -> tuple[float, float, float]:
    """Return where a part outside of the cell waits."""
    x, y, z = PARKED_AT
    return (x + 0.2 * (number % 10), y + 0.2 * (number // 10), z)


def fingers_of(model: RobotModel) -> Fingers:
    """Return the opened fingers and the palm behind them, from the collision shapes of the URDF.

    Raises `UsageError` for a gripper without two fingers that close along x or y of the tip.
    """
    spec = mujoco.MjSpec()
    arm = _add_robot(spec, model, "", _SCENERY << 1)
    compiled = spec.compile()
    data = mujoco.MjData(compiled)
    for finger in model.fingers:
        data.qpos[compiled.joint(finger.joint).qposadr[0]] = finger.opened
    mujoco.mj_forward(compiled, data)
    tip = compiled.site(arm.tip_id).id
    bodies = [int(compiled.joint(name).bodyid[0]) for name in arm.finger_ids]
    for frame in (AT_TIP, CLOSING_ALONG_Y):
        boxes = [_bounds(compiled, data, body, tip, frame) for body in bodies]
        if len(boxes) == 2 and max(float(low[0]) for low, _ in boxes) > 0:
            break
    else:
        raise UsageError(
            f"bin picking needs a gripper with two fingers that close along x or y; {model.name} has none"
        )
    (low, high) = max(boxes, key=lambda box: float(box[0][0]))
    ends = [_bounds(compiled, data, body, tip, frame, near_end=True) for body in bodies]
    end_low, end_high = max(ends, key=lambda box: float(box[0][0]))
    palm_low, palm_high = _bounds(compiled, data, int(compiled.body_parentid[bodies[0]]), tip, frame)
    end = float(high[2])  # the fingers may reach beyond the tip of the URDF
    length = end - float(low[2])
    return Fingers(
        opening=2 * float(low[0]),
        thickness=float(end_high[0] - end_low[0]),
        width=float(end_high[1] - end_low[1]),
        length=length,
        palm=(
            float(palm_high[0] - palm_low[0]),
            float(palm_high[1] - palm_low[1]),
            max(float(low[2] - palm_low[2]), 0.01),
        ),
        frame=Frame(frame.rotation, (0.0, 0.0, end)),
    )


def _bounds(
    model: Any, data: Any, body: int, tip: int, frame: Frame, *, near_end: bool = False
) -> tuple[Array, Array]:
    """Return the corners of the box around the shapes of a body, or the last one, in a frame at the tip."""
    rotation = data.site_xmat[tip].reshape(3, 3) @ np.array(frame.rotation)
    origin = data.site_xpos[tip]
    found = []
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    for geom in range(first, first + count):
        middle, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
        matrix = data.geom_xmat[geom].reshape(3, 3)
        for signs in product((-1, 1), repeat=3):
            corner = data.geom_xpos[geom] + matrix @ (middle + half * np.array(signs))
            found.append(rotation.T @ (corner - origin))
    corners = np.array(found)
    if near_end:
        corners = max(corners.reshape(-1, 8, 3), key=lambda shape: float(shape[:, 2].max()))
    return corners.min(axis=0), corners.max(axis=0)


def _add_scenery(spec: Any, scene: Scene) -> None:
    zones = scene.zones.keys()
    solids = [solid for solid in scene.solids() if solid.name not in zones]
    lowest_m = min((solid.pose.position[2] for solid in solids), default=0.0) - 1.0
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        pos=[0.0, 0.0, lowest_m],
        contype=_SCENERY,
        conaffinity=_SCENERY,
    )
    for number, solid in enumerate(solids):
        _add_shape(
            spec,
            spec.worldbody,
            f"{solid.name}:{number}",
            solid.shape,
            solid.pose,
            contype=_SCENERY,
            conaffinity=_ANYTHING,
            friction=[PART_FRICTION, 0.005, 0.0001],
            group=CAMERA_GROUP if solid.name in scene.cameras else SCENERY_GROUP,
        )


def _add_part(spec: Any, name: str, size: tuple[float, float, float], density: float) -> Any:
    body = spec.worldbody.add_body(name=name, gravcomp=1.0)
    body.add_freejoint(name=name)
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[side / 2 for side in size],
        density=density,
        contype=_SCENERY,
        conaffinity=_ANYTHING,
        condim=4,
        friction=[PART_FRICTION, 0.005, 0.0001],
        solref=list(STIFF),
        group=SCENERY_GROUP,
    )
    return body


def _add_object(spec: Any, name: str, loose: LooseObject) -> Any:
    bodies: list[Any] = []
    for number, link in enumerate(loose.links):
        above = spec.worldbody if link.parent is None else bodies[link.parent]
        own = name if number == 0 else f"{name}:{number}"
        body = above.add_body(name=own, pos=list(link.position), gravcomp=1.0)
        if link.parent is None:
            body.add_freejoint(name=name)
        for axis, direction in enumerate(link.axes):
            body.add_joint(
                name=f"{own}:{axis}",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=list(direction),
                limited=1,
                range=[-HINGE_RANGE_RAD, HINGE_RANGE_RAD],
                stiffness=HINGE_STIFFNESS_NM_RAD,
                damping=HINGE_DAMPING_NMS_RAD,
                armature=HINGE_ARMATURE_KG_M2,
            )
        for shape_number, (shape, pose) in enumerate(link.shapes):
            _add_shape(
                spec,
                body,
                f"{own}:shape{shape_number}",
                shape,
                pose,
                mass=link.mass_kg / len(link.shapes),
                contype=_SCENERY,
                conaffinity=_ANYTHING,
                condim=6,
                friction=[loose.friction, 0.01, ROLLING_FRICTION_M],
                priority=2,
                solref=list(STIFF),
                group=SCENERY_GROUP,
            )
        bodies.append(body)
    return bodies[0]


def _add_robot(spec: Any, model: RobotModel, prefix: str, bit: int) -> ArmNames:
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
    capsules = {one.get("name") for one in link.findall("collision_checking/capsule")}
    for number, collision in enumerate(link.findall("collision")):
        name = collision.get("name") or f"{link.get('name')}_{number}"
        shape = _shape(collision.find("geometry"), is_capsule=collision.get("name") in capsules)
        if shape is None:
            continue
        friction = PAD_FRICTION if is_finger else PART_FRICTION
        _add_shape(
            spec,
            body,
            prefix + name,
            shape,
            _origin(collision),
            contype=bit,
            conaffinity=_ANYTHING & ~bit,
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


def _add_shape(spec: Any, body: Any, name: str, shape: Shape, pose: Pose, **options: Any) -> None:
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
    found = {}
    for joint in urdf.findall("joint"):
        limit = joint.find("limit")
        if limit is not None:
            found[joint.get("name")] = float(limit.get("effort") or 0.0)
    return found


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
