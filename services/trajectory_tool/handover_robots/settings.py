"""The settings of the trajectory tool, in addition to the common ones."""

from pathlib import Path

from pydantic import Field

from handover.extensions import Service
from handover.service_addresses import TRAJECTORY, BridgeAddress, TrajectoryAddress
from handover.settings import Names, Settings


class TrajectorySettings(TrajectoryAddress, BridgeAddress, Settings):
    """The robot, its limits and its cell."""

    cell_file: Path | None = Field(
        None,
        description="YAML file of the cell: robots with model, place, driver and limits, and the scene; "
        "one robot if absent",
    )
    robot: str = Field(
        "simulated",
        description="the robot driver, where no cell file names robots: simulated, physics, ros (an arm "
        "behind the ROS bridge), or one that a package registers: ur (Universal Robots) is ours",
    )
    robot_model: str = Field(
        "ur10",
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="the robot, where no cell file names robots: ur10, ur5e, panda, one of another package, "
        "or one that `handover robot add` has made",
    )
    robot_speed: float = Field(
        0.6, gt=0, le=1, description="the maximum speed of the robot, as a fraction of its joint limits"
    )
    control_hz: float = Field(125.0, ge=20, le=1000, description="control cycles per second")
    scene_file: Path | None = Field(
        None, description="YAML file of the scene: bins, parts, fixtures; that of the cell or robot if absent"
    )
    detection_rate: float = Field(
        0.7, ge=0, le=1, description="probability that the simulated camera detects a part"
    )
    neighbour_wait_s: float = Field(
        30.0, ge=0, description="how long a motion waits for another robot that is in its way, in s"
    )
    scan_seed: int = Field(
        174, description="seed of the simulated camera and of the simulated parts; it determines the scans"
    )
    simulation_pace: float = Field(
        1.0,
        ge=0,
        le=100,
        description="simulated seconds in a second, where robot is physics; 0: as fast as possible",
    )
    limit_sources: Names = Field(
        (), description="sources of speed limits without which no robot moves, separated by commas"
    )
    people_sensors: Names = Field(
        (), description="sensors of people without which no robot moves, separated by commas"
    )
    people_entities: bool = Field(
        False,
        description="read the places of people from the relativePosition of Person entities in the broker",
    )
    separation_hold_s: float = Field(
        2.0,
        ge=0,
        le=60,
        description="how long sensors must report the distance after a stop before a robot continues, in s",
    )

    @property
    def notify_url(self) -> str:
        """Return the URL for notifications; each robot has a path below it."""
        return f"{self.trajectory_tool}/notifications"

    @property
    def arm_url(self) -> str:
        """Return the URL of the WebSocket for arms of the ROS bridge."""
        return f"ws{self.ros_bridge.removeprefix('http')}/arm"


SERVICE = Service(TRAJECTORY, "handover_robots", TrajectorySettings, "trajectory_port")
