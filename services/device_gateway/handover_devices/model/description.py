"""The description of a device: what it measures, which commands it takes, and for a robot its joints.

It is what a client sends and receives as JSON (camelCase). A robot's joints are values as well: telemetry may
have the position of each joint by its name, in rad, for a prismatic joint in m.
"""

from enum import StrEnum
from typing import Any, Literal, Self

from jsonschema import Draft202012Validator
from jsonschema.exceptions import SchemaError
from pydantic import ConfigDict, Field, field_validator, model_validator
from pydantic.alias_generators import to_camel

from handover.formats.strict_json import StrictModel
from handover_devices.model.units import is_unit_code
from handover_devices.protocol.messages import MAX_VALUES, is_device_name, is_value_name

CANCEL = "cancel"
"""The command that ends another one; each device that takes commands knows it."""


class Part(StrictModel):
    """A part of a description: frozen, without unknown members."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        alias_generator=to_camel,
        validate_by_name=True,
        validate_by_alias=True,
        serialize_by_alias=True,
        allow_inf_nan=False,
    )


class DeviceKind(StrEnum):
    """What a device is."""

    ROBOT_ARM = "robotArm"
    MOBILE_ROBOT = "mobileRobot"
    HUMANOID = "humanoid"
    GRIPPER = "gripper"
    SENSOR = "sensor"
    ACTUATOR = "actuator"
    WEARABLE = "wearable"
    INPUT_DEVICE = "inputDevice"
    CAMERA = "camera"
    EDGE = "edge"
    OTHER = "other"


ROBOTS = frozenset({DeviceKind.ROBOT_ARM, DeviceKind.MOBILE_ROBOT, DeviceKind.HUMANOID})


class CommandKind(StrEnum):
    """How often a command may reach the device.

    A `motion` is sent at most once and only while the device is connected. An `action` waits for the device
    and is sent again to the same run of its program, which knows the ids it has executed. A `setting` can be
    repeated without harm.
    """

    MOTION = "motion"
    ACTION = "action"
    SETTING = "setting"


class Sensor(Part):
    """A value that the device measures; a change within `dead_band` is not written to the broker."""

    name: str
    unit: str | None = Field(None, description="UN/CEFACT code, for example CEL")
    minimum: float | None = None
    maximum: float | None = None
    dead_band: float = Field(0.0, ge=0)
    description: str = Field("", max_length=500)

    @field_validator("name")
    @classmethod
    def _is_name(cls, name: str) -> str:
        return _checked_name(name)

    @field_validator("unit")
    @classmethod
    def _is_code(cls, unit: str | None) -> str | None:
        if unit is not None and not is_unit_code(unit):
            raise ValueError(f'"{unit[:20]}" is no UN/CEFACT code, such as CEL for degrees Celsius')
        return unit

    @model_validator(mode="after")
    def _has_range(self) -> Self:
        if self.minimum is not None and self.maximum is not None and self.minimum >= self.maximum:
            raise ValueError(f"{self.name}: minimum must be less than maximum")
        return self


class Joint(Part):
    """A joint of a robot with its limits, in rad and s; of a prismatic joint in m and s."""

    name: str
    type: Literal["revolute", "continuous", "prismatic"] = "revolute"
    lower: float | None = None
    upper: float | None = None
    max_velocity: float | None = Field(None, gt=0)
    max_acceleration: float | None = Field(None, gt=0)
    max_effort: float | None = Field(None, gt=0, description="N m; N of a prismatic joint")

    @field_validator("name")
    @classmethod
    def _is_name(cls, name: str) -> str:
        return _checked_name(name)

    @model_validator(mode="after")
    def _has_limits(self) -> Self:
        has_both = self.lower is not None and self.upper is not None
        if self.type == "continuous":
            if self.lower is not None or self.upper is not None:
                raise ValueError(f"{self.name}: a continuous joint has no lower and upper limit")
        elif not has_both or self.lower >= self.upper:  # type: ignore[operator]
            raise ValueError(f"{self.name}: a {self.type} joint has a lower limit less than its upper limit")
        return self


class Gripper(Part):
    """The gripper of a robot."""

    type: Literal["parallel", "vacuum", "magnetic", "hand", "other"] = "parallel"
    max_width: float | None = Field(None, gt=0, description="m")
    max_force: float | None = Field(None, gt=0, description="N")


class CommandSpecification(Part):
    """A command that the device takes; `parameters` is the JSON Schema of its parameters."""

    name: str
    kind: CommandKind
    description: str = Field("", max_length=500)
    parameters: dict[str, Any] | None = None

    @field_validator("name")
    @classmethod
    def _is_name(cls, name: str) -> str:
        if name == CANCEL:
            raise ValueError(f'"{CANCEL}" ends another command; each device has it without naming it')
        return _checked_name(name)

    @field_validator("parameters")
    @classmethod
    def _is_schema(cls, schema: dict[str, Any] | None) -> dict[str, Any] | None:
        if schema is not None:
            try:
                Draft202012Validator.check_schema(schema)
            except SchemaError as error:
                raise ValueError(f"parameters is no JSON Schema: {error.message[:200]}") from None
            if "$ref" in str(schema):
                raise ValueError("a JSON Schema of parameters must not have $ref; write it out")
        return schema


class Placement(Part):
    """Where the device is: the URN of a Location, coordinates, or x, y, z in m in its Location."""

    location: str | None = Field(None, max_length=256)
    coordinates: tuple[float, float] | None = Field(None, description="longitude, latitude (WGS 84)")
    relative_position: tuple[float, float, float] | None = None

    @field_validator("coordinates")
    @classmethod
    def _is_on_earth(cls, place: tuple[float, float] | None) -> tuple[float, float] | None:
        if place is not None and not (abs(place[0]) <= 180 and abs(place[1]) <= 90):
            raise ValueError("coordinates are longitude (-180 to 180), then latitude (-90 to 90)")
        return place


class DeviceDescription(Part):
    """Everything that is registered about a device."""

    kind: DeviceKind
    title: str = Field("", max_length=100, description="what people call it")
    description: str = Field("", max_length=2000)
    manufacturer: str = Field("", max_length=100)
    model: str = Field("", max_length=100)
    serial_number: str = Field("", max_length=100)
    degrees_of_freedom: int | None = Field(None, ge=1, le=200)
    joints: tuple[Joint, ...] = Field((), max_length=200)
    gripper: Gripper | None = None
    sensors: tuple[Sensor, ...] = Field((), max_length=MAX_VALUES)
    commands: tuple[CommandSpecification, ...] = Field((), max_length=64)
    skills: tuple[str, ...] = Field((), max_length=64)
    placement: Placement = Placement()
    edge: str | None = Field(None, description="the edge that may relay this device")

    @field_validator("edge")
    @classmethod
    def _is_edge(cls, edge: str | None) -> str | None:
        if edge is not None and not is_device_name(edge):
            raise ValueError("edge must be the name of a device of kind edge")
        return edge

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        names = [joint.name for joint in self.joints] + [sensor.name for sensor in self.sensors]
        if len(names) > MAX_VALUES:
            raise ValueError(f"a device has at most {MAX_VALUES} joints and sensors")
        _require_unique("joint or sensor", names)
        _require_unique("command", [command.name for command in self.commands])
        if self.kind is DeviceKind.EDGE and (self.edge is not None or self.commands):
            raise ValueError(
                'an edge takes no commands, and is not relayed by another edge: leave out "commands" and '
                '"edge", and let it connect to the centre'
            )
        if self.joints and self.kind not in ROBOTS | {DeviceKind.GRIPPER}:
            raise ValueError(f'a device of kind "{self.kind}" has no joints; a robot or gripper has')
        return self

    @property
    def values(self) -> dict[str, Sensor]:
        """The values that telemetry may have, by name: sensors, and the positions of joints."""
        joints = {
            joint.name: Sensor(
                name=joint.name,
                unit="MTR" if joint.type == "prismatic" else "C81",
                minimum=joint.lower,
                maximum=joint.upper,
                dead_band=0.001,
            )
            for joint in self.joints
        }
        return joints | {sensor.name: sensor for sensor in self.sensors}

    def command(self, name: str) -> CommandSpecification | None:
        """Return the command called `name`."""
        return next((command for command in self.commands if command.name == name), None)


def _checked_name(name: str) -> str:
    if not is_value_name(name):
        raise ValueError("a name has 1 to 64 letters, digits, '_', '.' or '-', a letter or '_' first")
    return name


def _require_unique(what: str, names: list[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f'the {what} "{twice[0]}" is there twice; give each a name of its own')
