"""The MuJoCo model of a cell: the robots from their URDFs, the scene, and loose parts.

The obstacles of the scene are fixed. Parts are boxes of the scene's size that slide, tip and fall; those
outside of the cell wait weightless beside it. What belongs to a robot has its name and a slash before its own
name.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import mujoco
import numpy as np

from handover.errors import UsageError
from handover_robots.model.poses import Frame
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
from handover_robots.physics.robot_bodies import (
    ANYTHING,
    CAMERA_GROUP,
    HINGE_ARMATURE_KG_M2,
    PART_FRICTION,
    SCENERY,
    SCENERY_GROUP,
    STEP_S,
    STIFF,
    ArmNames,
    add_robot,
    add_shape,
)
from handover_robots.scene.scene import Scene

GRAVITY_MPS2 = 9.81
PART_DENSITY_KG_M3 = 1200.0
ROLLING_FRICTION_M = 0.001
"""Of objects that are no boxes: fruit is not perfectly round, and comes to rest."""

DEFAULT_PART_SIZE_M = (0.024, 0.06, 0.024)
PARKED_AT = (5.0, 5.0, 5.0)

CLOSING_ALONG_Y = Frame(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0))
"""A frame whose x axis is the y axis of the tip."""


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
        name: add_robot(spec, model, f"{name}/", SCENERY << number)
        for number, (name, model) in enumerate(models.items(), 1)
    }
    size = scene.gripper.part_size_m or DEFAULT_PART_SIZE_M
    parts = tuple(f"part:{number}" for number in range(part_count))
    mass_kg = scene.gripper.part_mass_kg
    density = PART_DENSITY_KG_M3 if mass_kg is None else mass_kg / math.prod(size)
    for number, part in enumerate(parts):
        _add_part(spec, part, size, density).pos = list(parked_at(number))
    objects = {}
    for loose in objects_of(scene):
        objects[loose.name] = len(parts)
        _add_object(spec, f"object:{loose.name}", loose).pos = list(parked_at(len(parts)))
        parts = (*parts, f"object:{loose.name}")
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
    arm = add_robot(spec, model, "", SCENERY << 1)
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
    points = []
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    for geom in range(first, first + count):
        middle, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
        matrix = data.geom_xmat[geom].reshape(3, 3)
        for signs in product((-1, 1), repeat=3):
            corner = data.geom_xpos[geom] + matrix @ (middle + half * np.array(signs))
            points.append(rotation.T @ (corner - origin))
    corners = np.array(points)
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
        contype=SCENERY,
        conaffinity=SCENERY,
    )
    for number, solid in enumerate(solids):
        add_shape(
            spec,
            spec.worldbody,
            f"{solid.name}:{number}",
            solid.shape,
            solid.pose,
            contype=SCENERY,
            conaffinity=ANYTHING,
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
        contype=SCENERY,
        conaffinity=ANYTHING,
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
            add_shape(
                spec,
                body,
                f"{own}:shape{shape_number}",
                shape,
                pose,
                mass=link.mass_kg / len(link.shapes),
                contype=SCENERY,
                conaffinity=ANYTHING,
                condim=6,
                friction=[loose.friction, 0.01, ROLLING_FRICTION_M],
                priority=2,
                solref=list(STIFF),
                group=SCENERY_GROUP,
            )
        bodies.append(body)
    return bodies[0]
