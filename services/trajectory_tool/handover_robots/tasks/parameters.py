"""Parameters: the workParameters of a Task for the robot, validated before any motion.

A fault names the parameter, the rule and a correct value.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from handover.formats.validation import ClosedModel
from handover.performer import TaskFailed
from handover_robots.model import poses

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


def _direction(vector: poses.Vector) -> poses.Vector:
    length = math.hypot(*vector)
    if length < 1e-6:
        raise ValueError("must be a direction [x, y, z] of a length above 0")
    x, y, z = vector
    return (x / length, y / length, z / length)


Number = Annotated[float, BeforeValidator(_number), Field(allow_inf_nan=False)]
Name = Annotated[str, BeforeValidator(_last_part), Field(min_length=1)]
"""The name of a bin, fixture or part; of a URN the last part is used."""


class GivenPose(ClosedModel):
    """A position in m and a quaternion (x, y, z, w); by default the tool points straight down."""

    position: tuple[Number, Number, Number]
    orientation: Annotated[tuple[Number, Number, Number, Number], AfterValidator(_unit)] = DOWN

    @property
    def pose(self) -> poses.Pose:
        """Return the pose for computations."""
        return poses.Pose(self.position, self.orientation)


class Home(ClosedModel):
    """Move home; `speed` scales the robot's normal speed, in every operation."""

    speed: Annotated[Number, Field(ge=0.01, le=1)] = 1.0


class Target(ClosedModel):
    """A position of the arm: joint positions (rad, or m), a named position of the SRDF, or a tool pose."""

    joints: Annotated[tuple[Number, ...], Field(min_length=1)] | None = None
    named: Annotated[str, Field(min_length=1)] | None = None
    pose: GivenPose | None = None

    @model_validator(mode="after")
    def _one_target(self) -> Self:
        if sum(target is not None for target in (self.joints, self.named, self.pose)) != 1:
            raise ValueError(
                'needs either "joints" (a position for each joint, in rad or m), "named" (a position of the '
                'SRDF) or "pose", and not both'
            )
        return self


class GivenTilt(ClosedModel):
    """A constraint on the way: `axis` of the tool stays within `maxAngleDeg` of `direction` in the cell."""

    model_config = ConfigDict(populate_by_name=True)

    max_angle_deg: Annotated[Number, Field(gt=0, le=180, alias="maxAngleDeg")] = 10.0
    axis: Annotated[tuple[Number, Number, Number], AfterValidator(_direction)] = (0.0, 0.0, 1.0)
    direction: Annotated[tuple[Number, Number, Number], AfterValidator(_direction)] = (0.0, 0.0, -1.0)


class MoveTo(Target, Home):
    """Move to joint positions (rad, or m for prismatic joints), a named position, or the tool to a pose.

    The arm passes `through` waypoints without a stop, with rounded corners. `tilt` holds on the whole way.
    """

    through: Annotated[tuple[Target, ...], Field(max_length=50)] = ()
    tilt: GivenTilt | None = None


class MoveLinear(Home):
    """Move the tool on a straight line to a pose; `toolSpeed` limits its speed in m/s."""

    model_config = ConfigDict(populate_by_name=True)

    pose: GivenPose
    tool_speed: Annotated[Number | None, Field(gt=0, le=5, alias="toolSpeed")] = None


class Scan(Home):
    """Look for a part in a bin: from the position `view` of the camera, moved by `offset` in m."""

    bin: Name
    view: Annotated[int, Field(ge=0, le=20)] = 0
    offset: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)


class CalibrateCamera(Home):
    """Find out where a camera is mounted: the one in the hand, or the fixed `camera` of the scene.

    The camera in the hand is moved around `target`, a spherical obstacle of the scene. A fixed camera sees at
    least three balls in their places, by default all spherical obstacles; the robot does not move.
    """

    target: Name = "calibration-ball"
    camera: Name | None = None
    targets: Annotated[tuple[Name, ...], Field(max_length=100)] = ()


class Approaching(Home):
    """How the tool comes and leaves: `approachM` and `retreatM`, along the vertical or its own axis."""

    model_config = ConfigDict(populate_by_name=True)

    approach_m: Annotated[Number | None, Field(gt=0, le=1, alias="approachM")] = None
    retreat_m: Annotated[Number | None, Field(gt=0, le=1, alias="retreatM")] = None
    along: Annotated[Literal["vertical", "tool"], Field(alias="approachAlong")] = "vertical"


class Pick(Approaching):
    """Pick a part at a pose, by name or from a bin; by default the last detected part."""

    part: Name | None = None
    pose: GivenPose | None = None
    bin: Name | None = None


class Place(Approaching):
    """Put the held part into a fixture or at a pose."""

    location: Name | None = None
    pose: GivenPose | None = None

    @model_validator(mode="after")
    def _one_target(self) -> Self:
        if (self.location is None) == (self.pose is None):
            raise ValueError('needs either "location" (the name of a fixture) or "pose", and not both')
        return self


class HandOver(Target, Home):
    """Give the held part to a person, or take one: at a pose, after the person's confirmation or contact.

    `part` names a part that is taken. Nothing moves after the gripper has acted.
    """

    model_config = ConfigDict(populate_by_name=True)

    direction: Literal["give", "take"]
    confirmation: Literal["person", "contact"] = "person"
    contact_n: Annotated[Number, Field(gt=0, le=200, alias="contactN")] = 10.0
    timeout_s: Annotated[Number, Field(gt=0, le=3600, alias="timeoutS")] = 120.0
    part: Name | None = None


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
        if len(fault["loc"]) > 1:
            return f'{operation} knows no parameter "{where}"'
        parameters = ", ".join(field.alias or name for name, field in model.model_fields.items())
        return f'{operation} knows no parameter "{where}"; it knows {parameters}'
    if not where:
        return f"{operation} {rule}"
    return f'parameter "{where}" of {operation}: {rule[:1].lower()}{rule[1:]}'
