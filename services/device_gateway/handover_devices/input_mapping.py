"""Mappings: what the axes of an input device mean for a robot.

An axis moves one component of the velocity of the tool. With `rate` its value is a velocity (joysticks,
haptic devices with a spring); with `position` its change is one (motion capture, handhelds, gloves): the tool
follows the hand while the dead-man control is held, and the hand can return while it is not.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import ConfigDict, Field, FiniteFloat
from pydantic.alias_generators import to_camel

from handover.formats.strict_json import StrictModel
from handover_datamodels.streams import HumanInput

COMPONENTS: Final = ("x", "y", "z", "rx", "ry", "rz")
MAX_GAP_S: Final = 0.1
MAX_SPEED: Final = 10.0
"""Of `HumanInput`; the service of the robot limits it further."""
AxisName = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_.-]{0,63}$")]


class _Part(StrictModel):
    model_config = ConfigDict(extra="forbid", frozen=True, alias_generator=to_camel, populate_by_name=True)


class AxisMapping(_Part):
    """One axis: `scale` is in m/s or rad/s for a value of 1, or m or rad for a change of 1."""

    axis: AxisName
    scale: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 1.0
    dead_zone: Annotated[FiniteFloat, Field(ge=0, lt=1)] = 0.0
    kind: Literal["rate", "position"] = "rate"


class InputMapping(_Part):
    """The axes of a device by the component of the velocity that they move."""

    x: AxisMapping | None = None
    y: AxisMapping | None = None
    z: AxisMapping | None = None
    rx: AxisMapping | None = None
    ry: AxisMapping | None = None
    rz: AxisMapping | None = None


class AxisInput(_Part):
    """The raw form of `HumanInput`: values of axes by name, to be mapped."""

    type: Literal["human_input"] = "human_input"
    seq: Annotated[int, Field(ge=0, le=2**53)]
    held: bool
    axes: Annotated[dict[AxisName, FiniteFloat], Field(max_length=32)]
    gripper: Literal["open", "close"] | None = None


class MappedAxes:
    """Maps the inputs of one device; times are monotonic, in s."""

    def __init__(self, mapping: InputMapping) -> None:
        self._mapping = mapping
        self._before: tuple[float, Mapping[str, float]] | None = None

    def input_of(self, axis_input: AxisInput, now_s: float) -> HumanInput:
        """Return the input for the robot."""
        before, self._before = self._before, (now_s, axis_input.axes) if axis_input.held else None
        velocity = [
            self._velocity(getattr(self._mapping, component), axis_input.axes, before, now_s)
            for component in COMPONENTS
        ]
        return HumanInput(
            seq=axis_input.seq,
            held=axis_input.held,
            linear=tuple(velocity[:3]),
            angular=tuple(velocity[3:]),
            gripper=axis_input.gripper,
        )

    @staticmethod
    def _velocity(
        axis: AxisMapping | None,
        axes: Mapping[str, float],
        before: tuple[float, Mapping[str, float]] | None,
        now_s: float,
    ) -> float:
        if axis is None or axis.axis not in axes:
            return 0.0
        value = axes[axis.axis]
        if axis.kind == "rate":
            beyond = max(abs(value) - axis.dead_zone, 0.0) / (1 - axis.dead_zone)
            return _limited(math.copysign(beyond, value) * axis.scale)
        if before is None or axis.axis not in before[1] or not 0 < now_s - before[0] <= MAX_GAP_S:
            return 0.0
        change = value - before[1][axis.axis]
        return _limited(change * axis.scale / (now_s - before[0]))


def _limited(speed: float) -> float:
    return max(-MAX_SPEED, min(MAX_SPEED, speed))


def written(human_input: HumanInput, overrides: Mapping[str, Any]) -> str:
    """Return an input as JSON text, with the settings of the person who drives."""
    return human_input.model_copy(update=dict(overrides)).model_dump_json(by_alias=True, exclude_none=True)
