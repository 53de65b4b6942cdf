"""A humanoid as a MuJoCo model: its URDF with a free joint, flat soles, drives and sensors, on flat ground.

The shapes of the URDF touch the ground, but not each other: self-collision is a constraint of the motion, and
capsules overlap at the joints. Meshes are left out; the soles are boxes below the corners of the contacts.
"""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from lxml import etree

from handover.errors import UsageError
from handover.formats.robot_xml import parse_robot_xml
from handover_humanoid.model.humanoid import ContactSurface, Humanoid
from handover_humanoid.model.kinematics import GRAVITY_MPS2

STEP_S = 0.002
SOLE_THICKNESS_M = 0.02
STIFF = (2 * STEP_S, 1.0)
"""Time constant in s and damping ratio of contacts, as stiff as the step allows."""

MIN_INERTIA_KGM2 = 1e-6
INERTIA_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
GROUND, ROBOT = 1, 2
"""The kinds of shapes: those of the robot, and what else has its kind, touch the ground."""
FREE_JOINT = "floating base"
INERTIAL_SITE = "inertial:"
WRENCH_SITE = "wrench:"


def build(humanoid: Humanoid, ground_friction: float = 1.0, add: Callable[[Any], None] | None = None) -> Any:
    """Return a compiled MuJoCo model. Raises `UsageError` for what MuJoCo cannot use.

    The drives are those of the joints, in the order of the model: servos of position with a limited force.
    `add` may add more to the world of the specification.
    """
    root, capsules = _without_meshes(humanoid)
    try:
        spec = mujoco.MjSpec.from_string(etree.tostring(root).decode())
        _set_options(spec)
        _add_ground(spec, ground_friction)
        _change_shapes(spec, humanoid, capsules)
        spec.body(humanoid.root).add_freejoint(name=FREE_JOINT)
        for contact in humanoid.contacts.values():
            _add_sole(spec, contact)
        _add_drives(spec, humanoid)
        _add_sensors(spec, humanoid)
        _remove_markers(spec, humanoid)
        if add is not None:
            add(spec)
        return spec.compile()
    except (ValueError, AttributeError) as error:
        raise UsageError(f"MuJoCo cannot simulate {humanoid.name}: {error}") from None


def _without_meshes(humanoid: Humanoid) -> tuple[Any, set[str]]:
    """Return the URDF with options for MuJoCo, and the names of the collision shapes that are capsules."""
    root = parse_robot_xml(humanoid.urdf, "URDF")
    capsules = {str(capsule.get("name")) for capsule in root.iterfind("link/collision_checking/capsule")}
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision_checking")]:
            link.remove(shape)
        for shape in link.findall("collision"):
            if shape.find("geometry/mesh") is not None:
                link.remove(shape)
        inertia = link.find("inertial/inertia")
        if inertia is not None:
            _spread_out(inertia)
    options = etree.SubElement(etree.SubElement(root, "mujoco"), "compiler")
    options.set("fusestatic", "false")
    options.set("balanceinertia", "true")
    return root, capsules


def _spread_out(inertia: Any) -> None:
    """Give a point mass, as URDFs have them, the least inertia that MuJoCo accepts."""
    ixx, ixy, ixz, iyy, iyz, izz = (float(inertia.get(key)) for key in INERTIA_KEYS)
    least = np.linalg.eigvalsh(np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]))[0]
    if least < MIN_INERTIA_KGM2:
        for key, value in (("ixx", ixx), ("iyy", iyy), ("izz", izz)):
            inertia.set(key, repr(value + MIN_INERTIA_KGM2 - float(least)))


def _set_options(spec: Any) -> None:
    option = spec.option
    option.timestep = STEP_S
    option.gravity = [0.0, 0.0, -GRAVITY_MPS2]
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0


def _add_ground(spec: Any, friction: float) -> None:
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        contype=GROUND,
        conaffinity=ROBOT,
        condim=3,
        friction=[friction, 0.005, 0.0001],
        solref=list(STIFF),
    )


def _change_shapes(spec: Any, humanoid: Humanoid, capsules: set[str]) -> None:
    """Make the shapes touch the ground only; those of a foot leave this to its sole."""
    feet = {_moving_link(humanoid, contact.link) for contact in humanoid.contacts.values()}
    for geom in spec.geoms:
        if geom.name == "ground":
            continue
        geom.mass, geom.group = 0.0, 3
        if geom.name in capsules:
            geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
        is_foot = geom.parent.name in feet
        geom.contype, geom.conaffinity = 0 if is_foot else ROBOT, 0
        geom.solref = list(STIFF)


def _moving_link(humanoid: Humanoid, link: str) -> str:
    """Return the link that carries this one: below its next moving joint towards the root."""
    above = {
        joint.find("child").get("link"): joint
        for joint in parse_robot_xml(humanoid.urdf, "URDF").findall("joint")
    }
    while link in above and above[link].get("type") == "fixed":
        link = above[link].find("parent").get("link")
    return link


def _add_sole(spec: Any, contact: ContactSurface) -> None:
    corners = np.array(contact.corners)
    middle, half = (corners.max(axis=0) + corners.min(axis=0)) / 2, np.ptp(corners, axis=0) / 2
    spec.body(contact.link).add_geom(
        name=contact.name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[*middle[:2], middle[2] + SOLE_THICKNESS_M / 2],
        size=[*half[:2], SOLE_THICKNESS_M / 2],
        contype=ROBOT,
        conaffinity=0,
        friction=[contact.friction, 0.005, 0.0001],
        solref=list(STIFF),
        mass=0.0,
        condim=3,
    )


def _add_drives(spec: Any, humanoid: Humanoid) -> None:
    for joint in humanoid.joints:
        spec.joint(joint.name).armature = humanoid.drive_inertia
        drive = spec.add_actuator(
            name=joint.name,
            target=joint.name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            forcelimited=True,
            forcerange=[-joint.max_effort, joint.max_effort],
        )
        drive.set_to_position(kp=joint.gains.stiffness, kv=joint.gains.damping)


def _add_sensors(spec: Any, humanoid: Humanoid) -> None:
    inertial = mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_ACCELEROMETER
    for link in humanoid.sensors.inertial:
        spec.body(link).add_site(name=INERTIAL_SITE + link)
        for kind in inertial:
            _add_sensor(spec, kind, INERTIAL_SITE + link)
    for joint, link in humanoid.sensors.force_torque.items():
        # A force sensor shows what a body exerts on its parent, so it is placed on the link that moves.
        carrier = _moving_link(humanoid, link)
        position, quaternion = _place_of(spec, link, carrier)
        spec.body(carrier).add_site(name=WRENCH_SITE + joint, pos=position, quat=quaternion)
        for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
            _add_sensor(spec, kind, WRENCH_SITE + joint)


def _remove_markers(spec: Any, humanoid: Humanoid) -> None:
    """Remove links without mass and shape at the ends of chains, which cost a tenth of the time of a step.

    Links that the ball, people or sensors are fixed to stay.
    """
    used = {humanoid.root, *(grip.link for grip in humanoid.grips.values())}
    while True:
        markers = [
            body
            for body in spec.bodies[1:]  # the first is the world
            if body.mass == 0.0
            and body.name not in used
            and not (body.bodies or body.joints or body.geoms or body.sites)
        ]
        if not markers:
            return
        for body in markers:
            spec.delete(body)


def _place_of(spec: Any, link: str, carrier: str) -> tuple[list[float], list[float]]:
    """Return the place of a link in the frame of the link that carries it over fixed joints."""
    position, quaternion = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    body = spec.body(link)
    while body.name != carrier:
        turned, product = np.zeros(3), np.zeros(4)
        mujoco.mju_rotVecQuat(turned, position, np.asarray(body.quat))
        mujoco.mju_mulQuat(product, np.asarray(body.quat), quaternion)
        position, quaternion, body = turned + np.asarray(body.pos), product, body.parent
    return position.tolist(), quaternion.tolist()


def _add_sensor(spec: Any, kind: Any, site: str) -> None:
    spec.add_sensor(name=f"{kind.name}:{site}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)
