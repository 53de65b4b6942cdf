"""The UR10 of Universal Robots (CB3) with a parallel gripper, and the bin-picking cell that it comes with."""

from pathlib import Path

from services.trajectory_tool.robot_model import Finger, read_model
from services.trajectory_tool.robots.ur10.kinematics import nearest

FOLDER = Path(__file__).parent
HALF_PART_M = 0.015

ROBOT = read_model(
    FOLDER / "ur10.urdf",
    name="UR10",
    flange="gripper",
    tip="tip",
    home={
        "shoulder_lift_joint": -1.5708,
        "elbow_joint": 1.5708,
        "wrist_1_joint": -1.5708,
        "wrist_2_joint": -1.5708,
    },
    max_acceleration=8.0,
    max_jerk=80.0,
    labels={
        "shoulder_pan_joint": {"en": "Base", "de": "Basis", "fi": "Jalusta"},
        "shoulder_lift_joint": {"en": "Shoulder", "de": "Schulter", "fi": "Olkapää"},
        "elbow_joint": {"en": "Elbow", "de": "Ellbogen", "fi": "Kyynärpää"},
        "wrist_1_joint": {"en": "Wrist 1", "de": "Handgelenk 1", "fi": "Ranne 1"},
        "wrist_2_joint": {"en": "Wrist 2", "de": "Handgelenk 2", "fi": "Ranne 2"},
        "wrist_3_joint": {"en": "Wrist 3", "de": "Handgelenk 3", "fi": "Ranne 3"},
    },
    fingers=(
        Finger("finger_left_joint", opened=0.034, closed=0.0, holding=HALF_PART_M),
        Finger("finger_right_joint", opened=0.034, closed=0.0, holding=HALF_PART_M),
    ),
    inverse=nearest,
    scene=FOLDER / "bin_picking.yaml",
)
