"""Motion: the joints for a target pose, including the gripper.

A target that is unreachable or outside the limits is refused before the motion.
"""

from dataclasses import dataclass

from handover.messages import message, text_of
from services.trajectory_tool.poses import Frame, Pose
from services.trajectory_tool.robot import JOINT_NAMES, Joints
from services.trajectory_tool.ur10_kinematics import JOINT_LIMIT_RAD, Unreachable, forward, nearest


@dataclass(frozen=True, slots=True)
class Arm:
    """A UR10 with a tool whose tip is `tool_m` beyond the flange."""

    tool_m: float

    @property
    def _tool(self) -> Frame:
        return Frame(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, self.tool_m))

    def tool_pose(self, joints: Joints) -> Pose:
        """Return the pose of the tool's tip for joint angles in rad."""
        return Pose.of(forward(joints) @ self._tool)

    def reach(self, pose: Pose, near: Joints) -> Joints:
        """Return the joints in rad, nearest to `near`, with the tip of the tool at `pose`.

        Raises `Unreachable` with the distance of the pose.
        """
        try:
            return nearest(pose.frame() @ self._tool.inverse(), near)
        except Unreachable as why:
            where = ", ".join(f"{value:.3f}" for value in pose.position)
            raise Unreachable(
                message(
                    "robot.tool_unreachable",
                    "the tool cannot be at ({position}) m: {why}",
                    position=where,
                    why=text_of(why),
                )
            ) from None

    def allow(self, joints: Joints) -> Joints:
        """Return `joints` if each is within its limits. Raises `Unreachable`."""
        for name, angle in zip(JOINT_NAMES, joints, strict=True):
            if abs(angle) > JOINT_LIMIT_RAD:
                raise Unreachable(
                    message(
                        "robot.joint_limit",
                        "{joint} cannot be at {angle} rad: it turns from {lower} to {upper} rad; choose an "
                        "angle in between",
                        joint=name,
                        angle=f"{angle:.3f}",
                        lower=f"{-JOINT_LIMIT_RAD:.3f}",
                        upper=f"{JOINT_LIMIT_RAD:.3f}",
                    )
                )
        return joints
