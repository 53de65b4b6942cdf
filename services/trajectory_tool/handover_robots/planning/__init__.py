"""Motion planning: from a target to a collision-free trajectory within the limits of the joints.

A pure library without I/O. It needs the extra `motion` (pinocchio, coal, OMPL, toppra); nothing outside of
this folder imports those. Lengths are in m, angles in rad, times in s, in the frame of the robot's base.

    arm          kinematics of a robot model: forward, Jacobian, bounds of its motion
    collision    the robot among obstacles: checks with a margin, distances, colliding pairs
    tracked_distances  all distances along a motion, in a tenth of the time of computing each
    inverse      inverse kinematics: joint positions for a pose of the tool
    motions      certified checks of joint-space lines, shortcuts
    search       RRT-Connect of OMPL
    straight     straight motion of the tool
    timing       paths to trajectories within velocity, acceleration and jerk
    planner      all of it for one request, with reasons for what is impossible
"""

from importlib.util import find_spec


def is_available() -> bool:
    """Return whether the extra `motion` is installed."""
    return all(find_spec(name) is not None for name in ("pinocchio", "coal", "ompl", "toppra"))
