"""The settings of the trajectory tool, in addition to the common ones."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from handover.errors import UsageError
from handover.settings import Settings
from services.trajectory_tool.robot import Joints
from services.trajectory_tool.trajectory import Limits

PerJoint = tuple[Annotated[float, Field(gt=0, allow_inf_nan=False)], ...]


class TrajectorySettings(Settings):
    """The robot, its limits and its cell."""

    trajectory_port: int = Field(54220, ge=1, le=65535, description="REST and WebSocket port of the tool")
    trajectory_url: str | None = Field(
        None, description="the URL of the trajectory tool for the broker; by default http://host:port"
    )
    robot: str = Field(
        "simulated",
        description="the robot driver: simulated, ros (an arm behind the ROS bridge), or "
        "a driver that another package registers",
    )
    robot_model: str = Field(
        "ur10",
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="the robot: ur10, or one that another package registers, with its joints, limits, "
        "kinematics and 3D view",
    )
    ros_arm: str = Field(
        "arm-1",
        pattern=r"^[A-Za-z0-9_.:-]+$",
        description="the Device of the arm that the ROS bridge moves, where robot is ros",
    )
    robot_name: str | None = Field(
        None,
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="the name of the robot in the id of its Device; by default the model and -1: ur10-1",
    )
    robot_speed: float = Field(
        0.6, gt=0, le=1, description="the maximum speed of the robot, as a fraction of its joint limits"
    )
    control_hz: float = Field(125.0, ge=20, le=1000, description="control cycles per second")
    max_joint_speed_rad_s: PerJoint | None = Field(
        None,
        description="speed limits from the base to the flange, one for each joint (prismatic: m/s); "
        "those of the robot if absent",
    )
    max_joint_acceleration_rad_s2: PerJoint | None = Field(
        None, description="acceleration limits, likewise; those of the robot if absent"
    )
    max_joint_jerk_rad_s3: PerJoint | None = Field(
        None, description="jerk limits, likewise; those of the robot if absent"
    )
    scene_file: Path | None = Field(
        None, description="YAML file of the cell: bins, parts, fixtures; the built-in cell if absent"
    )
    detection_rate: float = Field(
        0.7, ge=0, le=1, description="probability that the simulated camera detects a part"
    )
    scan_seed: int = Field(174, description="seed of the simulated camera; it determines the scans")

    @property
    def robot_id(self) -> str:
        """Return the name of the robot."""
        return self.robot_name or f"{self.robot_model}-1"

    @property
    def notify_url(self) -> str:
        """Return the URL for notifications of Tasks."""
        return f"{self.service_url}/notifications"

    @property
    def service_url(self) -> str:
        """Return the URL of the trajectory tool."""
        return self.url_of(self.trajectory_port, self.trajectory_url)

    def limits_of(self, robot: Limits) -> Limits:
        """Return the limits of the joints, where those of the robot are `robot`. Raises `UsageError`."""
        return Limits(
            self._per_joint("max_joint_speed_rad_s", robot.velocity),
            self._per_joint("max_joint_acceleration_rad_s2", robot.acceleration),
            self._per_joint("max_joint_jerk_rad_s3", robot.jerk),
        )

    def _per_joint(self, field: str, of_the_robot: Joints) -> Joints:
        joints: Joints | None = getattr(self, field)
        if joints is None:
            return of_the_robot
        if len(joints) != len(of_the_robot):
            raise UsageError(
                f"HANDOVER_{field.upper()} has {len(joints)} values, and the robot {self.robot_model} has "
                f"{len(of_the_robot)} joints; give one value for each joint"
            )
        return joints
