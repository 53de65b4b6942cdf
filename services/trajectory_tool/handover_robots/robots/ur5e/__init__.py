"""The UR5e of Universal Robots with a parallel gripper, and its bin-picking cell in the simulations."""

from dataclasses import replace
from pathlib import Path

from handover_robots.robots.universal_robots import UrKinematics, read_ur

FOLDER = Path(__file__).parent

KINEMATICS = UrKinematics(d1=0.1625, a2=-0.425, a3=-0.3922, d4=0.1333, d5=0.0997, d6=0.0996)

ROBOT = replace(
    read_ur(FOLDER, "ur5e", name="UR5e", kinematics=KINEMATICS, max_payload_kg=5.0),
    driver_scenes={
        "simulated": FOLDER / "bin_picking.yaml",
        "physics": FOLDER / "bin_picking_physics.yaml",
    },
)
