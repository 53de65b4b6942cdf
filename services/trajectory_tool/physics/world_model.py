"""The MuJoCo model of a cell: the robot from its URDF, the scene, and loose parts.

Links take their masses and collision shapes from the URDF. The obstacles of the scene are fixed. Parts are
boxes of the scene's size that slide, tip and fall; those outside of the cell wait weightless beside it. Links
of the robot do not collide with each other: the planner checks that, and its capsules overlap at the joints.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import mujoco
import numpy as np
from lxml import etree

from handover.errors import UsageError
from services.trajectory_tool.obstacles import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from services.trajectory_tool.perception.depth_image import Array
from services.trajectory_tool.perception.grasps import Fingers
from services.trajectory_tool.poses import Frame, Pose
from services.trajectory_tool.robot_model import RobotModel
from services.trajectory_tool.scene import Scene

STEP_S = 0.002
GRAVITY_MPS2 = 9.81

PART_DENSITY_KG_M3 = 1200.0
PART_FRICTION = 0.6
PAD_FRICTION = 0.9
"""Sliding friction: parts on everything, and the rubber of the fingers."""

JOINT_ARMATURE_KG_M2 = 0.1
FINGER_ARMATURE_KG = 0.3
"""Inertia of the drives, seen from the joint."""

MAX_FINGER_FORCE_N = 40.0
FINGER_DAMPING = 800.0
DEFAULT_EFFORT_NM = 100.0
DEFAULT_PART_SIZE_M = (0.024, 0.06, 0.024)
PARKED_AT = (5.0, 5.0, 5.0)

STIFF = (2 * STEP_S, 1.0)
"""Time constant in s and damping ratio of contacts, as stiff as the step allows."""

_SCENERY, _ROBOT = 1, 2
"""Bits of contact: scenery and parts, and the robot, which touches both but not itself."""

SCENERY_GROUP, ROBOT_GROUP, CAMERA_GROUP = 0, 3, 4


@dataclass(frozen=True, slots=True)
class WorldModel:
    """A compiled model with the names of what it is made of."""

    mujoco: Any
    joints: tuple[str, ...]
    fingers: tuple[str, ...]
    parts: tuple[str, ...]
    tip: str
    part_size_m: tuple[float, float, float]


def build(model: RobotModel, scene: Scene, part_count: int) -> WorldModel:
    """Return the model of a cell with `part_count` parts. Raises `UsageError` for what MuJoCo cannot use."""
    spec = mujoco.MjSpec()
    spec.modelname = scene.name
    option = spec.option
    option.timestep = STEP_S
    option.gravity = [0.0, 0.0, -GRAVITY_MPS2]
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    _add_scenery(spec, scene)
    fingers = _add_robot(spec, model)
    size = scene.gripper.part_size_m or DEFAULT_PART_SIZE_M
    parts = tuple(f"part:{number}" for number in range(part_count))
    for number, part in enumerate(parts):
        _add_part(spec, part, size, parked_at(number))
    try:
        compiled = spec.compile()
    except ValueError as error:
        raise UsageError(f"MuJoCo cannot simulate {model.name} in {scene.name}: {error}") from None
    return WorldModel(compiled, model.joint_names, fingers, parts, model.tip, size)


def parked_at(number: int) -> tuple[float, float, float]:
    """Return where a part outside of the cell waits."""
    x, y, z = PARKED_AT
    return (x + 0.2 * (number % 10), y + 0.2 * (number // 10), z)


def fingers_of(model: RobotModel) -> Fingers:
    """Return the opened fingers and the palm behind them, from the collision shapes of the URDF.

    Raises `UsageError` for a gripper without two fingers that close along x of the tip.
    """
    spec = mujoco.MjSpec()
    names = _add_robot(spec, model)
    compiled = spec.compile()
    data = mujoco.MjData(compiled)
    for finger in model.fingers:
        data.qpos[compiled.joint(finger.joint).qposadr[0]] = finger.opened
    mujoco.mj_forward(compiled, data)
    tip = compiled.site("tip").id
    bodies = [int(compiled.joint(name).bodyid[0]) for name in names]
    boxes = [_bounds(compiled, data, body, tip) for body in bodies]
    if len(boxes) != 2 or max(float(low[0]) for low, _ in boxes) <= 0:
        raise UsageError(
            f"bin picking needs a gripper with two fingers that close along x; {model.name} has none"
        )
    (low, high) = max(boxes, key=lambda box: float(box[0][0]))
    palm_low, palm_high = _bounds(compiled, data, int(compiled.body_parentid[bodies[0]]), tip)
    length = float(-low[2])
    return Fingers(
        opening=2 * float(low[0]),
        thickness=float(high[0] - low[0]),
        width=float(high[1] - low[1]),
        length=length,
        palm=(
            float(palm_high[0] - palm_low[0]),
            float(palm_high[1] - palm_low[1]),
            max(float(-length - palm_low[2]), 0.01),
        ),
    )


def _bounds(model: Any, data: Any, body: int, tip: int) -> tuple[Array, Array]:
    """Return the corners of the box around the shapes of a body, in the frame of the tip."""
    rotation, origin = data.site_xmat[tip].reshape(3, 3), data.site_xpos[tip]
    found = []
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    for geom in range(first, first + count):
        middle, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
        matrix = data.geom_xmat[geom].reshape(3, 3)
        for signs in product((-1, 1), repeat=3):
            corner = data.geom_xpos[geom] + matrix @ (middle + half * np.array(signs))
            found.append(rotation.T @ (corner - origin))
    corners = np.array(found)
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
            conaffinity=_SCENERY | _ROBOT,
            friction=[PART_FRICTION, 0.005, 0.0001],
            group=CAMERA_GROUP if solid.name in scene.cameras else SCENERY_GROUP,
        )


def _add_part(spec: Any, name: str, size: tuple[float, float, float], at: tuple[float, float, float]) -> None:
    body = spec.worldbody.add_body(name=name, pos=list(at), gravcomp=1.0)
    body.add_freejoint(name=name)
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[side / 2 for side in size],
        density=PART_DENSITY_KG_M3,
        contype=_SCENERY,
        conaffinity=_SCENERY | _ROBOT,
        condim=4,
        friction=[PART_FRICTION, 0.005, 0.0001],
        solref=list(STIFF),
        group=SCENERY_GROUP,
    )


def _add_robot(spec: Any, model: RobotModel) -> tuple[str, ...]:
    """Add the links and the drives; return the joints of the fingers."""
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
    fingers = tuple(finger.joint for finger in model.fingers)
    moved = {*model.joint_names, *fingers}
    tip_parent = _rigid_parent(urdf, model.tip)

    def add(link: str, body: Any) -> None:
        _add_link(spec, body, links[link], is_finger=bool(fingers) and _finger_of(urdf, link) in fingers)
        for joint in below.get(link, []):
            child = joint.find("child").get("link")
            origin = _origin(joint)
            made = body.add_body(name=child, pos=list(origin.position), quat=_quaternion(origin))
            if joint.get("name") in moved:
                _add_joint(made, joint, is_finger=joint.get("name") in fingers)
            add(child, made)

    base = Pose.of(model.base)
    top = spec.worldbody.add_body(name=root, pos=list(base.position), quat=_quaternion(base))
    add(root, top)
    _add_drives(spec, model, urdf)
    tip = spec.body(model.tip)
    tip.add_site(name="tip")
    wrist = spec.body(tip_parent)
    wrist.add_site(name="wrist")
    for kind, name in (
        (mujoco.mjtSensor.mjSENS_FORCE, "wrist_force"),
        (mujoco.mjtSensor.mjSENS_TORQUE, "wrist_torque"),
    ):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="wrist")
    return fingers


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


def _add_link(spec: Any, body: Any, link: Any, *, is_finger: bool) -> None:
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
            name,
            shape,
            _origin(collision),
            contype=_ROBOT,
            conaffinity=_SCENERY,
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


def _add_joint(body: Any, joint: Any, *, is_finger: bool) -> None:
    limit = joint.find("limit")
    slides = joint.get("type") == "prismatic"
    is_limited = joint.get("type") != "continuous"
    axis = joint.find("axis")
    body.add_joint(
        name=joint.get("name"),
        type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
        axis=[1.0, 0.0, 0.0] if axis is None else [float(value) for value in axis.get("xyz").split()],
        limited=int(is_limited),
        range=[float(limit.get("lower")), float(limit.get("upper"))] if is_limited else [0.0, 0.0],
        armature=FINGER_ARMATURE_KG if is_finger else JOINT_ARMATURE_KG_M2,
    )


def _add_drives(spec: Any, model: RobotModel, urdf: Any) -> None:
    """Add torque drives for the joints, and force-limited velocity drives for coupled fingers."""
    efforts = _efforts(urdf)
    for name in model.joint_names:
        effort = efforts.get(name) or DEFAULT_EFFORT_NM
        drive = spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrllimited=True,
            ctrlrange=[-effort, effort],
        )
        drive.set_to_motor()
    fingers = [finger.joint for finger in model.fingers]
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
