"""The options of the driver `ros`."""

from typing import Literal

from pydantic import Field

from handover.formats.validation import ClosedModel
from handover_datamodels.arm_stream import JOINT_VELOCITIES, ArmSetup, VelocityOutput


class RosOptions(ClosedModel):
    """The settings of the driver: the interfaces of the arm, and the Device with its gripper."""

    arm: str = Field("arm-1", pattern=r"^[A-Za-z0-9_.:-]+$")
    joint_states: str = "/joint_states"
    trajectory_action: str = "/joint_trajectory_controller/follow_joint_trajectory"
    velocity_topic: str | None = None
    velocity_type: Literal["std_msgs/msg/Float64MultiArray", "geometry_msgs/msg/TwistStamped"] = (
        JOINT_VELOCITIES
    )
    twist_frame: str = "base_link"
    watchdog_s: float = Field(0.2, gt=0, le=2)
    max_delay_s: float = Field(0.5, gt=0, le=10)
    """The age up to which joints count as known, and the delay with which an arm may follow."""

    def setup(self, joint_names: tuple[str, ...]) -> ArmSetup:
        """Return the first message to the bridge."""
        velocity = None
        if self.velocity_topic is not None:
            velocity = VelocityOutput(
                topic=self.velocity_topic,
                type=self.velocity_type,
                frame=self.twist_frame,
                watchdog_s=self.watchdog_s,
            )
        return ArmSetup(
            joint_names=joint_names,
            joint_states=self.joint_states,
            trajectory_action=self.trajectory_action,
            velocity=velocity,
        )
