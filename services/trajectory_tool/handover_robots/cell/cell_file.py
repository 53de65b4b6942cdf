"""The cell file: the robots of a cell, each with its place, driver and limits, and the scene around them.

    name: two arms at a table
    scene: table.yaml                 # a file beside this one, or the scene itself
    robots:
      ur10-1: {model: ur10}
      panda-1:
        model: panda                  # a known robot, or the folder of one
        base: {position: [1.2, 0.0, 0.0], yaw_deg: 180}
        driver: ros
        settings: {arm: arm-2}        # of the driver
        speed: 0.4
        limits: {velocity: [1, 1, 1, 1, 2, 2, 2]}
        end_effector: gripper-a       # its validated speed holds
        safety_scanner: {warning_input: 1, protective_input: 0}
        contact_force_n: 60           # at the wrist

Without a file, a cell has one robot, which the settings name.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import yaml
from pydantic import Field, FiniteFloat, ValidationError, model_validator

from handover.errors import UsageError
from handover.formats.validation import ClosedModel
from handover_robots.limits.contact_table import ContactEntry
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Pose
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Limits
from handover_robots.people.scanner_fields import SafetyScanner
from handover_robots.scene.scene import Name
from handover_robots.settings import TrajectorySettings

Positive = Annotated[FiniteFloat, Field(gt=0)]
PerJoint = Annotated[tuple[Positive, ...], Field(min_length=1)]

MAX_FILE_BYTES = 1024 * 1024
MAX_ROBOTS = 64


class Base(ClosedModel):
    """Where a robot stands in the frame of the cell: turned by `yaw_deg`, or by a quaternion (x, y, z, w)."""

    position: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    yaw_deg: FiniteFloat | None = None
    orientation: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None = None

    @model_validator(mode="after")
    def _one_orientation(self) -> Self:
        if self.yaw_deg is not None and self.orientation is not None:
            raise ValueError('has "yaw_deg" or "orientation", not both')
        if self.orientation is not None and abs(math.hypot(*self.orientation) - 1) > 0.01:
            raise ValueError('"orientation" must be a quaternion [x, y, z, w] of length 1')
        return self

    @property
    def pose(self) -> Pose:
        """Return the pose of the root link."""
        if self.orientation is not None:
            length = math.hypot(*self.orientation)
            x, y, z, w = (value / length for value in self.orientation)
            return Pose(self.position, (x, y, z, w))
        half = math.radians(self.yaw_deg or 0.0) / 2
        return Pose(self.position, (0.0, 0.0, math.sin(half), math.cos(half)))


class LimitOverrides(ClosedModel):
    """Limits in place of those of the model, one value for each joint from the base to the flange."""

    velocity: PerJoint | None = None
    acceleration: PerJoint | None = None
    jerk: PerJoint | None = None


class RobotEntry(ClosedModel):
    """One robot of a cell; `speed` is the maximum fraction of its joint limits."""

    model: Annotated[str, Field(min_length=1)] = "ur10"
    base: Base = Base()
    driver: str = "simulated"
    settings: dict[str, Any] = Field(default_factory=dict)
    speed: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.6
    limits: LimitOverrides = LimitOverrides()
    home: tuple[FiniteFloat, ...] | None = None
    end_effector: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """The mounted end effector, whose validated speed holds."""
    safety_scanner: SafetyScanner | None = None
    contact_force_n: Positive | None = None
    """A change of the force at the wrist that stops a motion."""
    contact: ContactEntry | None = None
    """How people may be touched."""

    def limits_of(self, name: str, model: RobotModel) -> Limits:
        """Return the limits of motion. Raises `UsageError` for another number of values than joints."""
        own, overrides = model.limits, self.limits
        return Limits(
            _per_joint(name, "velocity", overrides.velocity, own.velocity),
            _per_joint(name, "acceleration", overrides.acceleration, own.acceleration),
            _per_joint(name, "jerk", overrides.jerk, own.jerk),
        )

    def mounted(self, model: RobotModel) -> RobotModel:
        """Return the model at its place in the cell."""
        base = self.base.pose
        return model if base == Base().pose else model.mounted(base.frame())


class _CellFile(ClosedModel):
    name: str = "cell"
    robots: Annotated[dict[Name, RobotEntry], Field(min_length=1, max_length=MAX_ROBOTS)]
    scene: Path | dict[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class CellPlan:
    """What a cell consists of. `scene` is a file, the content of one, or None for that of the robot."""

    robots: Mapping[str, RobotEntry]
    scene: Path | Mapping[str, Any] | None
    folder: Path
    """Relative paths start here."""
    file: Path | None = None
    scene_driver: str | None = None
    """The driver that decides which scene of its model a robot has; by default its own."""


def cell_plan(settings: TrajectorySettings) -> CellPlan:
    """Return the robots and the scene: of the cell file, or one robot. Raises `UsageError`."""
    path = settings.cell_file
    if path is None:
        entry = RobotEntry(model=settings.robot_model, driver=settings.robot, speed=settings.robot_speed)
        return CellPlan({f"{settings.robot_model}-1": entry}, settings.scene_file, Path())
    written = _read(path)
    scene: Path | Mapping[str, Any] | None = written.scene
    if isinstance(scene, Path):
        scene = path.parent / scene
    return CellPlan(written.robots, settings.scene_file or scene, path.parent, path)


def _read(path: Path) -> _CellFile:
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UsageError(f"the cell file {path} has more than {MAX_FILE_BYTES >> 20} MB")
        written = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"the cell file {path} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"the cell file {path} is not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(written, Mapping):
        raise UsageError(f"the cell file {path} must have robots and a scene")
    try:
        return _CellFile.model_validate(written)
    except ValidationError as error:
        lines = (f"cell file {path}: {_place(fault['loc'])}: {fault['msg']}" for fault in error.errors())
        raise UsageError("\n".join(lines)) from None


def _per_joint(robot: str, limit: str, overrides: Joints | None, own: Joints) -> Joints:
    if overrides is None:
        return own
    if len(overrides) != len(own):
        raise UsageError(
            f"robots.{robot}.limits.{limit} has {len(overrides)} values, and the robot has {len(own)} "
            "joints; give one value for each joint"
        )
    return overrides


def _place(location: tuple[Any, ...]) -> str:
    return ".".join(str(part) for part in location) or "file"
