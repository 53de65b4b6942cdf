"""The model of a humanoid as JSON: what the page shows as a tree, and draws."""

from typing import Any

from handover_humanoid.model.humanoid import Humanoid


def model_view(model: Humanoid) -> dict[str, Any]:
    """Return chains with their joints (rad, rad/s, N m), sensors, contacts, stacks and default poses."""
    by_name = {joint.name: joint for joint in model.joints}

    def joint_view(name: str) -> dict[str, Any]:
        joint = by_name[name]
        return {
            "name": name,
            "lower": joint.lower,
            "upper": joint.upper,
            "velocity": joint.max_velocity,
            "effort": joint.max_effort,
            "gain": joint.gains.stiffness,
            "damping": joint.gains.damping,
        }

    return {
        "name": model.name,
        "massKg": round(model.mass_kg, 3),
        "root": model.root,
        "joints": list(model.joint_names),
        "chains": [
            {
                "name": chain.name,
                "base": chain.base,
                "tip": chain.tip,
                "joints": [joint_view(name) for name in chain.joints],
            }
            for chain in model.chains.values()
        ],
        "groups": {name: list(members) for name, members in model.groups.items()},
        "sensors": {
            "inertial": list(model.sensors.inertial),
            "forceTorque": dict(model.sensors.force_torque),
        },
        "contacts": [
            {
                "name": contact.name,
                "link": contact.link,
                "corners": [list(corner) for corner in contact.corners],
                "friction": contact.friction,
            }
            for contact in model.contacts.values()
        ],
        "hands": {
            name: {"arm": grip.arm, "link": grip.link, "point": list(grip.point)}
            for name, grip in model.grips.items()
        },
        "stack": {
            "throwing": [["left_sole", "right_sole"], ["com"], ["throwing arm"], ["waist"], ["posture"]],
            "walking": [["com", "swing foot"], ["waist"], ["posture"]],
        },
        "defaultPoses": {name: dict(pose) for name, pose in model.poses.items()},
        "notes": list(model.notes),
    }
