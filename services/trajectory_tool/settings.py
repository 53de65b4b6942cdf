"""The settings of the trajectory tool, beside those that every component shares."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from handover.settings import Settings
from services.trajectory_tool.trajectory import Limits

PerJoint = tuple[Annotated[float, Field(gt=0, allow_inf_nan=False)], ...]


class TrajectorySettings(Settings):
    """Which robot is moved, how fast, and in which cell."""

    trajectory_port: int = Field(54220, ge=1, le=65535, description="REST and WebSocket port of the tool")
    trajectory_url: str | None = Field(
        None, description="where the broker reaches the trajectory tool; http://host:port of it if absent"
    )
    robot: str = Field(
        "simulated",
        description="what moves: simulated (a UR10), ros (an arm of a ROS graph, through the ROS bridge), or "
        "a robot that another package registers",
    )
    ros_arm: str = Field(
        "arm-1",
        pattern=r"^[A-Za-z0-9_.:-]+$",
        description="the Device of the arm that the ROS bridge moves, where robot is ros",
    )
    robot_name: str = Field(
        "ur10-1", pattern=r"^[A-Za-z0-9_.-]+$", description="the robot, as the last part of its Device's id"
    )
    robot_speed: float = Field(
        0.6, gt=0, le=1, description="how fast the robot moves at most, as a fraction of its joint limits"
    )
    control_hz: float = Field(125.0, ge=20, le=1000, description="cycles of control a second")
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
        0.7, ge=0, le=1, description="how often the simulated camera sees a part that is there"
    )
    scan_seed: int = Field(174, description="seed of the simulated camera: the same seed, the same scans")

    @property
    def notify_url(self) -> str:
        """Return where the broker sends notifications of Tasks."""
        return f"{self.url_of(self.trajectory_port, self.trajectory_url)}/notifications"

    @property
    def limits(self) -> Limits:
        """Return what the joints may do at most."""
        return Limits(
            self.max_joint_speed_rad_s, self.max_joint_acceleration_rad_s2, self.max_joint_jerk_rad_s3
        )
