"""What a robot shares with the others of its cell: scene, parts, planned volumes and stored state."""

from pathlib import Path
from typing import Any, Protocol

from handover_robots.cell.manual_mode import ManualMode
from handover_robots.cell.memory import MemoryFile
from handover_robots.cell.motion import SharedSpace
from handover_robots.driver_base.context import Peer
from handover_robots.limits.neighbours import MovingRobots
from handover_robots.limits.store import LimitStore
from handover_robots.model.joints import Joints
from handover_robots.model.robot_model import RobotModel
from handover_robots.scene.contents import Contents
from handover_robots.scene.scene import Scene
from handover_robots.scene.vision import Camera
from handover_robots.settings import TrajectorySettings


class SharedCell(Protocol):
    """A `RobotCell` as its robots use it."""

    settings: TrajectorySettings
    folder: Path
    """Of the stored state."""
    plan_folder: Path
    """Of the cell file, to which the paths in it are relative."""
    scene: Scene
    contents: Contents
    camera: Camera
    file: MemoryFile
    space: SharedSpace
    manual: ManualMode
    moving: MovingRobots
    limit_store: LimitStore
    shared: dict[str, dict[str, Any]]
    """What each driver keeps for all of its robots."""

    @property
    def has_several_robots(self) -> bool:
        """Return whether robots may meet."""

    def home_of(self, model: RobotModel) -> Joints:
        """Return the home position of a robot in the scene."""

    def stored_joints(self, name: str) -> Joints:
        """Return the joints of a robot that were stored last, or its home."""

    def peers_of(self, driver: str) -> dict[str, Peer]:
        """Return the robots of a driver."""

    async def remember(self) -> None:
        """Store the state of the cell durably. Raises `OSError`."""
