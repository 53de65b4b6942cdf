"""Parameters: the workParameters of a Task for the robot, validated before any motion.

A fault names the parameter, the rule and a correct value.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from handover.performer import TaskFailed
from services.trajectory_tool import poses

SILENT = frozenset({"operation", "description"})
"""Parameters that describe the work, not its execution."""

DOWN = (1.0, 0.0, 0.0, 0.0)


def _number(value: Any) -> Any:
    if isinstance(value, bool | str):
        raise ValueError("must be a number")  # noqa: TRY004 - pydantic wants ValueError
    return value


def _last_part(value: Any) -> Any:
    return value.rsplit(":", 1)[-1] if isinstance(value, str) and value.startswith("urn:") else value


def _unit(quaternion: poses.Quaternion) -> poses.Quaternion:
    length = math.hypot(*quaternion)
    if abs(length - 1) > 0.01:
        raise ValueError(f"must be a quaternion [x, y, z, w] of length 1; this one has {length:.3f}")
    x, y, z, w = quaternion
    return (x / length, y / length, z / length, w / length)


Number = Annotated[float, BeforeValidator(_number), Field(allow_inf_nan=False)]
Name = Annotated[str, BeforeValidator(_last_part), Field(min_length=1)]
"""The name of a bin, fixture or part; of a URN the last part is used."""


class _Given(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class GivenPose(_Given):
    """A position in m and a quaternion (x, y, z, w); by default the tool points straight down."""

    position: tuple[Number, Number, Number]
    orientation: Annotated[tuple[Number, Number, Number, Number], AfterValidator(_unit)] = DOWN

    @property
    def pose(self) -> poses.Pose:
        """Return the pose for computations."""
        return poses.Pose(self.position, self.orientation)


class Home(_Given):
    """Move home; `speed` scales the robot's normal speed, in every operation."""

    speed: Annotated[Number, Field(ge=0.01, le=1)] = 1.0


class MoveTo(Home):
    """Move to joint positions (rad, or m for prismatic joints), or the tool to a pose."""

    joints: Annotated[tuple[Number, ...], Field(min_length=1)] | None = None
    pose: GivenPose | None = None

    @model_validator(mode="after")
    def _one_target(self) -> Self:
        if (self.joints is None) == (self.pose is None):
            raise ValueError(
                'needs either "joints" (a position for each joint, in rad or m) or "pose", and not both'
            )
        return self


class MoveLinear(Home):
    """Move the tool on a straight line to a pose; `toolSpeed` limits its speed in m/s."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    pose: GivenPose
    tool_speed: Annotated[Number | None, Field(gt=0, le=5, alias="toolSpeed")] = None


class Scan(Home):
    """Look for a part in a bin."""

    bin: Name


class Pick(Home):
    """Pick a part at a pose, by name or from a bin; by default the last detected part."""

    part: Name | None = None
    pose: GivenPose | None = None
    bin: Name | None = None


class Place(Home):
    """Put the held part into a fixture or at a pose."""

    location: Name | None = None
    pose: GivenPose | None = None

    @model_validator(mode="after")
    def _one_target(self) -> Self:
        if (self.location is None) == (self.pose is None):
            raise ValueError('needs either "location" (the name of a fixture) or "pose", and not both')
        return self


def read(model: type[Home], operation: str, values: Mapping[str, Any]) -> Home:
    """Return the parameters of `operation` as `model`. Raises `TaskFailed` with all faults."""
    try:
        return model.model_validate({name: value for name, value in values.items() if name not in SILENT})
    except ValidationError as error:
        faults = "; ".join(_explained(model, operation, dict(fault)) for fault in error.errors())
        raise TaskFailed(faults) from None


def _explained(model: type[Home], operation: str, fault: Mapping[str, Any]) -> str:
    where = ".".join(str(part) for part in fault["loc"])
    rule = str(fault["msg"]).removeprefix("Value error, ")
    if fault["type"] == "extra_forbidden":
        known = ", ".join(model.model_fields)
        return f'{operation} knows no parameter "{where}"; it knows {known}'
    if not where:
        return f"{operation} {rule}"
    return f'parameter "{where}" of {operation}: {rule[:1].lower()}{rule[1:]}'
