"""Simulated physics by MuJoCo: an arm with a gripper, loose parts, sensors and a depth camera.

It needs the extra `physics`; nothing outside of this folder imports MuJoCo. Lengths are in m, angles in rad,
times in s, forces in N, in the frame of the cell.

    world_model    the MuJoCo model of the robots, a scene and its parts
    arm            the servo, the gripper and the sensors of one robot
    simulation     steps of 2 ms of all arms and parts, with contacts and saved state
    depth_camera   depth images by ray casting, without graphics
    pacing         the stepping thread, in real time or at another pace
    shared_world   the world that all robots of a cell share
    robot          the driver `physics`
"""

from importlib.util import find_spec


def is_available() -> bool:
    """Return whether the extra `physics` is installed."""
    return all(find_spec(name) is not None for name in ("mujoco", "cv2"))
