"""The settings of the trajectory tool, in addition to the common ones."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from handover.settings import Settings
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
        description="the robot driver: simulated (a UR10), ros (an arm behind the ROS bridge), or "
        "a robot that another package registers",
    )
    ros_arm: str = Field(
        "arm-1",
        pattern=r"^[A-Za-z0-9_.:-]+$",
        description="the Device of the arm that the ROS bridge moves, where robot is ros",
    )
    robot_name: str = Field(
        "ur10-1",
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="the name of the robot in the id of its Device",
    )
    robot_speed: float = Field(
        0.6, gt=0, le=1, description="the maximum speed of the robot, as a fraction of its joint limits"
    )
    control_hz: float = Field(125.0, ge=20, le=1000, description="control cycles per second")
    max_joint_speed_rad_s: PerJoint = Field(
        (2.09, 2.09, 3.14, 3.14, 3.14, 3.14),
        min_length=6,
        max_length=6,
        description="speed limits of the six joints; the defaults are the UR10's",
    )
    max_joint_acceleration_rad_s2: PerJoint = Field(
        (8.0,) * 6, min_length=6, max_length=6, description="acceleration limits of the six joints"
    )
    max_joint_jerk_rad_s3: PerJoint = Field(
        (80.0,) * 6, min_length=6, max_length=6, description="jerk limits of the six joints"
    )
    scene_file: Path | None = Field(
        None, description="YAML file of the cell: bins, parts, fixtures; the built-in cell if absent"
    )
    detection_rate: float = Field(
        0.7, ge=0, le=1, description="probability that the simulated camera detects a part"
    )
    scan_seed: int = Field(174, description="seed of the simulated camera; it determines the scans")

    @property
    def notify_url(self) -> str:
        """Return the URL for notifications of Tasks."""
        return f"{self.url_of(self.trajectory_port, self.trajectory_url)}/notifications"

    @property
    def limits(self) -> Limits:
        """Return the joint limits."""
        return Limits(
            self.max_joint_speed_rad_s, self.max_joint_acceleration_rad_s2, self.max_joint_jerk_rad_s3
        )
