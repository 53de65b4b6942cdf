"""What a model needs to be controlled: a pose `stand` with both soles flat on the ground, and bent knees.

Stretched legs are no fault: the robot stands. It does not walk, since the motion of a leg along itself is
lost then: COMAN with straight knees falls within seconds.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.spatial import ConvexHull

from handover.errors import UsageError
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import GRAVITY_MPS2, Array, Kinematics

STAND: Final = "stand"
"""The pose that every humanoid has, and begins with."""
SOLES: Final = ("left_sole", "right_sole")
HANDS: Final = ("left_hand", "right_hand")
MAX_TILT_RAD: Final = 0.1
MAX_STEP_M: Final = 0.01
"""How far one sole may be above the other."""
MIN_LEG_SHARE: Final = 0.03
"""The least speed of a sole in its weakest direction, as a share of that of the tip of a rod as long as the
leg. COMAN has 0.149, and 0.03 with knees that are bent by 0.17 rad."""


def require_stance(humanoid: Humanoid) -> Humanoid:
    """Return the humanoid, with a note for legs that are stretched when it stands.

    Raises `UsageError` with a line for each reason why it cannot stand.
    """
    kinematics = Kinematics(humanoid)
    q = kinematics.standing(STAND)
    kinematics.update(q)
    faults = list(_stance_faults(kinematics))
    if faults:
        raise UsageError("\n".join(faults))
    legs = stretched_legs(kinematics)
    if not legs:
        return humanoid
    note = (
        f'The pose "{STAND}" stretches {" and ".join(legs)}: the robot stands and does not walk. '
        "Bend the knees by 0.2 rad or more."
    )
    return replace(humanoid, notes=(*humanoid.notes, note))


def stretched_legs(kinematics: Kinematics) -> tuple[str, ...]:
    """Return the chains of the legs that are near a singularity in the pose `stand`."""
    humanoid = kinematics.humanoid
    kinematics.update(kinematics.standing(STAND))
    stretched = []
    for sole in SOLES:
        link = humanoid.contacts[sole].link
        leg = next(chain for chain in humanoid.chains.values() if chain.tip == link)
        columns = 6 + np.array([humanoid.index(joint) for joint in leg.joints])
        moves = kinematics.jacobian(link)[:3, columns]
        length_m = float(
            np.linalg.norm(kinematics.pose(link).translation - kinematics.pose(leg.base).translation)
        )
        weakest = np.linalg.svd(moves, compute_uv=False)[-1] if len(columns) >= 3 else 0.0
        if weakest < MIN_LEG_SHARE * length_m:
            stretched.append(leg.name)
    return tuple(stretched)


def _stance_faults(kinematics: Kinematics) -> Iterator[str]:
    """Yield why the pose `stand`, which `kinematics` is in, is none."""
    humanoid = kinematics.humanoid
    poses = [kinematics.pose(humanoid.contacts[sole].link) for sole in SOLES]
    where = f'in the pose "{STAND}"'
    for sole, pose in zip(SOLES, poses, strict=True):
        tilt = float(np.arccos(np.clip(pose.rotation[2, 2], -1.0, 1.0)))
        if tilt > MAX_TILT_RAD:
            yield (
                f'"{sole}" is tilted by {np.degrees(tilt):.0f}° {where}; the z axis of its link has to point '
                "up, and its x axis ahead"
            )
            return
    yield from _sensor_faults(kinematics)
    left, right = poses
    apart = left.rotation.T @ (left.translation - right.translation)
    if apart[1] <= 0:
        yield f'"{SOLES[0]}" is to the right of "{SOLES[1]}" {where}, seen along its x axis; exchange them'
    if abs(apart[2]) > MAX_STEP_M:
        yield f"the soles are {100 * abs(apart[2]):.1f} cm apart in height {where}; both stand on the ground"
    corners = np.array(
        [
            pose.act(np.array(corner))[:2]
            for sole, pose in zip(SOLES, poses, strict=True)
            for corner in humanoid.contacts[sole].corners
        ]
    )
    edges = ConvexHull(corners).equations
    outside_m = float((edges[:, :2] @ kinematics.centre_of_mass()[:2] + edges[:, 2]).max())
    if outside_m > 0:
        yield f"the centre of mass is {100 * outside_m:.1f} cm outside of the soles {where}; it would fall"
    efforts = _efforts(kinematics)
    for joint, effort in zip(humanoid.joints, efforts, strict=True):
        if effort > joint.max_effort:
            yield (
                f'the joint "{joint.name}" needs {effort:.3g} N m to stand {where}; its effort limit is '
                f"{joint.max_effort:g}"
            )


def _sensor_faults(kinematics: Kinematics) -> Iterator[str]:
    """Yield force-torque sensors of the feet that measure in other axes than those of the sole."""
    humanoid, model = kinematics.humanoid, kinematics.pin_model
    joints = {link: model.frames[model.getFrameId(link)].parentJoint for link in humanoid.links}
    for sole in SOLES:
        link = humanoid.contacts[sole].link
        # Balance reads the first sensor of the foot.
        sensor = next(
            sensor_link
            for sensor_link in humanoid.sensors.force_torque.values()
            if joints[sensor_link] == joints[link]
        )
        turned = kinematics.pose(sensor).actInv(kinematics.pose(link)).rotation
        angle = float(np.arccos(np.clip((np.trace(turned) - 1) / 2, -1.0, 1.0)))
        if angle > MAX_TILT_RAD:
            yield (
                f'the force-torque sensor "{sensor}" is turned by {np.degrees(angle):.0f}° against "{sole}"; '
                "it has to measure in the axes of the sole: name the fixed joint of the sole"
            )


def _efforts(kinematics: Kinematics) -> Array:
    """Return the efforts (n_joints,) of standing at rest, each sole with the half of the weight."""
    humanoid = kinematics.humanoid
    efforts = kinematics.gravity_torques()
    half = np.array([0.0, 0.0, kinematics.total_mass_kg * GRAVITY_MPS2 / 2])
    for sole in SOLES:
        contact = humanoid.contacts[sole]
        pose = kinematics.pose(contact.link)
        arm = pose.rotation @ np.mean(contact.corners, axis=0)
        wrench = np.concatenate([half, np.cross(arm, half)])
        efforts = efforts - (kinematics.jacobian(contact.link).T @ wrench)[6:]
    return np.abs(efforts)
