"""The UR10 of Universal Robots (CB3) with a parallel gripper, and the bin-picking cell that it comes with."""

from dataclasses import replace
from pathlib import Path

from handover_robots.robots.universal_robots import UrKinematics, read_ur

FOLDER = Path(__file__).parent

KINEMATICS = UrKinematics(d1=0.1273, a2=-0.612, a3=-0.5723, d4=0.163941, d5=0.1157, d6=0.0922)

ROBOT = replace(
    read_ur(
        FOLDER,
        "ur10",
        name="UR10",
        kinematics=KINEMATICS,
        max_payload_kg=10.0,
        scene=FOLDER / "bin_picking.yaml",
    ),
    driver_scenes={"physics": FOLDER / "bin_picking_physics.yaml"},
)
