"""The Panda of Franka Emika (7 joints) with its hand, and its bin-picking cell in the simulations.

Limits: Franka Control Interface, "Robot and interface specifications".
"""

from pathlib import Path

from handover_robots.model.robot_model import Finger
from handover_robots.robots.urdf import read_model

FOLDER = Path(__file__).parent
JOINTS = tuple(f"panda_joint{number}" for number in range(1, 8))
HALF_PART_M = 0.015

ROBOT = read_model(
    FOLDER / "panda.urdf",
    name="Panda",
    flange="panda_link8",
    tip="panda_hand_tcp",
    srdf=FOLDER / "panda.srdf",
    max_payload_kg=3.0,
    driver_scenes={
        "simulated": FOLDER / "bin_picking.yaml",
        "physics": FOLDER / "bin_picking_physics.yaml",
    },
    max_acceleration=dict(zip(JOINTS, (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0), strict=True)),
    max_jerk=dict(zip(JOINTS, (7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0), strict=True)),
    labels={
        name: {"en": f"Joint {number}", "de": f"Gelenk {number}", "fi": f"Nivel {number}"}
        for number, name in enumerate(JOINTS, 1)
    },
    fingers=(
        Finger("panda_finger_joint1", opened=0.04, closed=0.0, holding=HALF_PART_M),
        Finger("panda_finger_joint2", opened=0.04, closed=0.0, holding=HALF_PART_M),
    ),
)
