"""Simulated physics by MuJoCo: an arm with a gripper, loose parts, sensors and a depth camera.

It needs the extra `physics`; nothing outside of this folder imports MuJoCo. Lengths are in m, angles in rad,
times in s, forces in N, in the frame of the cell.

    world_model    the MuJoCo model of a robot, a scene and its parts
    simulation     steps of 2 ms: joint servo, gripper, contacts, sensors, saved state
    depth_camera   depth images by ray casting, without graphics
    pacing         the clock of the simulation, in real time or another pace
    robot          the driver `physics`
"""

from importlib.util import find_spec


def is_available() -> bool:
    """Return whether the extra `physics` is installed."""
    return all(find_spec(name) is not None for name in ("mujoco", "cv2"))
