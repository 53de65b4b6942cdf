"""Memory: the state of the cell that survives a power cut.

One small file, replaced atomically before and after every action of a gripper and at the end of every motion.
It includes the Task of each gripper's last action, so that no part is picked or placed twice, and an action
that was begun, so that its unknown outcome is found after a crash.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover.telemetry import get_logger
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Pose
from handover_robots.scene.contents import Contents, Grip

log = get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Act:
    """The gripper gripped or released `part` at `pose` for the Task `task`; `place` is its bin or fixture."""

    task: str
    kind: Literal["gripped", "released"]
    part: str
    pose: Pose
    place: str | None = None


@dataclass(frozen=True, slots=True)
class BegunAct:
    """The gripper began to grip or to release for the Task `task`; no outcome was recorded."""

    task: str
    kind: Literal["grip", "release"]


@dataclass(frozen=True, slots=True)
class RobotMemory:
    """The state of one robot; `seen` is the part of its last successful scan."""

    joint_names: tuple[str, ...]
    joints: Joints
    gripper_closed: bool
    held: str | None = None
    last_act: Act | None = None
    seen: str | None = None
    begun: BegunAct | None = None
    grip: Grip | None = None
    """How the gripper holds the part, if that is known."""


@dataclass(frozen=True, slots=True)
class Memory:
    """The state of the cell, whose scene `scene` identifies."""

    scene: str
    contents: Contents
    robots: Mapping[str, RobotMemory] = field(default_factory=dict)


_FORM = TypeAdapter(Memory)


class MemoryFile:
    """The file of the memory."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self, scene: str, robots: Mapping[str, Sequence[str]]) -> Memory | None:
        """Return the memory of `scene` with the known of `robots`, which are given with their joint names.

        None if there is no memory, or that of another scene. Raises `UsageError` when the file cannot be read
        or is invalid.
        """
        try:
            written = self.path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise UsageError(
                f"the state of the cell, {self.path}, cannot be read: {error.strerror}"
            ) from None
        try:
            memory = _FORM.validate_json(written)
        except ValidationError:
            memory = None
        if memory is None or any(
            len(robot.joints) != len(robot.joint_names) for robot in memory.robots.values()
        ):
            raise UsageError(
                f"the state of the cell, {self.path}, is damaged; delete it to start with the initial cell"
            )
        if memory.scene != scene:
            log.warning("scene changed, the cell starts with its initial contents", file=str(self.path))
            return None
        robots_known = {
            name: robot
            for name, robot in memory.robots.items()
            if name in robots and robot.joint_names == tuple(robots[name])
        }
        for name in robots.keys() - robots_known.keys():
            log.info("no stored state of the robot, it starts at home", robot=name)
        return Memory(memory.scene, memory.contents, robots_known)

    def save(self, memory: Memory) -> None:
        """Write the memory atomically and durably. Raises `OSError`."""
        replace_durably(self.path, _FORM.dump_json(memory))
