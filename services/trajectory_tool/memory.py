"""Memory: the state of the simulated robot and its cell that survives a power cut.

One small file, replaced atomically at every action of the gripper and at the end of every motion. It includes
the Task of the gripper's last action, so that no part is picked or placed twice.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from handover.errors import UsageError
from handover.telemetry import get_logger
from services.trajectory_tool.contents import Contents
from services.trajectory_tool.poses import Pose
from services.trajectory_tool.robot import Joints

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
class Memory:
    """The state of the cell, which `scene` identifies; `seen` is the part of the last successful scan."""

    scene: str
    joints: Joints
    gripper_closed: bool
    contents: Contents
    last_act: Act | None = None
    seen: str | None = None


_FORM = TypeAdapter(Memory)


class MemoryFile:
    """The file of the memory."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self, scene: str, joint_count: int) -> Memory | None:
        """Return the memory of `scene`; None if there is none, or of another scene or robot.

        Raises `UsageError` when the file cannot be read or is invalid.
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
        is_of_this_cell = memory is not None and memory.scene == scene
        if memory is None or (is_of_this_cell and len(memory.joints) != joint_count):
            raise UsageError(
                f"the state of the cell, {self.path}, is damaged; delete it to start with the initial cell"
            )
        if not is_of_this_cell:
            log.warning(
                "scene or robot changed, the cell starts with its initial contents", file=str(self.path)
            )
            return None
        return memory

    def save(self, memory: Memory) -> None:
        """Write the memory atomically and durably. Raises `OSError`."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        new = self.path.with_suffix(".new")
        with new.open("wb") as file:
            file.write(_FORM.dump_json(memory))
            file.flush()
            os.fsync(file.fileno())
        new.replace(self.path)
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
