"""The messages of streams to a robot: speed limits, input of people, where people are, and images of them.

Each is one JSON text of a WebSocket. They are no entities: a control loop never waits for the broker. Nothing
here is a safety-rated function.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator
from pydantic.alias_generators import to_camel

STALE_S, PEOPLE_STALE_S = 3.0, 0.5
STALE_PERIODS = 3.0
DEFAULT_TIMEOUT_S, MAX_TIMEOUT_S = 10.0, 20.0
MAX_PEOPLE = 64
MAX_SCAN_RANGES, MAX_DEPTH_SIDE = 4096, 320
SOURCE_PATTERN = r"^[A-Za-z0-9_.:-]{1,64}$"


Speed = Annotated[FiniteFloat, Field(ge=-10, le=10)]


class StreamMessage(BaseModel):
    """One JSON text of a WebSocket, in camelCase without unknown members."""

    model_config = ConfigDict(extra="forbid", frozen=True, alias_generator=to_camel, populate_by_name=True)


class SpeedLimitReport(StreamMessage):
    """One message of the stream: how fast a robot may move.

    `stamp` is in s since 1970 and increases with each report of a source. `period` is the time to the next
    report, `timeout` the age at which the robot stops, both in s. `fraction` is that of the speed of the
    motion; `max_speed` that of the tool in m/s.
    """

    source: Annotated[str, Field(pattern=SOURCE_PATTERN)]
    stamp: Annotated[FiniteFloat, Field(ge=0)]
    fraction: Annotated[FiniteFloat, Field(ge=0, le=1)] = 1.0
    max_speed: Annotated[FiniteFloat, Field(gt=0, le=10)] | None = None
    reason: Annotated[str, Field(min_length=1, max_length=200)]
    person: Annotated[str, Field(pattern=r"^urn:[!-~]{1,200}$")] | None = None
    period: Annotated[FiniteFloat, Field(gt=0, le=5)] = 1.0
    timeout: Annotated[FiniteFloat, Field(ge=1, le=MAX_TIMEOUT_S)] = DEFAULT_TIMEOUT_S

    @model_validator(mode="after")
    def _lowers(self) -> "SpeedLimitReport":
        if self.stale_s >= self.timeout:
            raise ValueError("timeout must be longer than 3 s and three periods")
        return self

    @property
    def stale_s(self) -> float:
        """Return the age at which the report is stale."""
        return max(STALE_S, STALE_PERIODS * self.period)


class SeenPerson(StreamMessage):
    """A person at a place in m, in the frame of the cell.

    The id is constant while the sensor follows them. They are within `radius` m of the place. `age` is how
    old the place is at the stamp of the report, in s.
    """

    id: Annotated[str, Field(pattern=SOURCE_PATTERN)]
    x: Annotated[FiniteFloat, Field(ge=-1000, le=1000)]
    y: Annotated[FiniteFloat, Field(ge=-1000, le=1000)]
    radius: Annotated[FiniteFloat, Field(ge=0, le=10)] = 0.0
    age: Annotated[FiniteFloat, Field(ge=0, le=60)] = 0.0

    @property
    def point(self) -> tuple[float, float]:
        """Return the place."""
        return self.x, self.y


class PeopleReport(StreamMessage):
    """One message of the stream: everybody whom a sensor sees, and the fields of a safety scanner.

    An empty `people` says that nobody is there. `stamp` is in s since 1970 and increases; `period` is the
    time to the next report in s. The fields are true while they are infringed, and null without a scanner.
    """

    source: Annotated[str, Field(pattern=SOURCE_PATTERN)]
    stamp: Annotated[FiniteFloat, Field(ge=0)]
    people: Annotated[tuple[SeenPerson, ...], Field(max_length=MAX_PEOPLE)]
    period: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.1
    warning_field: bool | None = None
    protective_field: bool | None = None

    @property
    def stale_s(self) -> float:
        """Return the age at which the report is stale."""
        return max(PEOPLE_STALE_S, STALE_PERIODS * self.period)


class _FromScene(StreamMessage):
    """A measurement of the sensor `source` of the scene; `stamp` and `period` as for the places of people."""

    source: Annotated[str, Field(pattern=SOURCE_PATTERN)]
    stamp: Annotated[FiniteFloat, Field(ge=0)]
    period: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.1


class ScanReport(_FromScene):
    """One scan of a lidar in its horizontal plane: a range in m for each angle in rad, counterclockwise.

    An angle of 0 is the x axis of the lidar. A range is null where nothing was measured.
    """

    angle_min: Annotated[FiniteFloat, Field(ge=-7, le=7)]
    angle_increment: Annotated[FiniteFloat, Field(gt=0, le=0.2)]
    ranges: Annotated[
        tuple[Annotated[FiniteFloat, Field(ge=0, le=200)] | None, ...],
        Field(min_length=1, max_length=MAX_SCAN_RANGES),
    ]


class DepthReport(_FromScene):
    """One image of a depth camera: distances along the optical axis in mm, 0 where nothing was measured.

    `depth` has them row by row from the top, as unsigned 16-bit little-endian integers in base64.
    """

    width: Annotated[int, Field(ge=8, le=MAX_DEPTH_SIDE)]
    height: Annotated[int, Field(ge=8, le=MAX_DEPTH_SIDE)]
    depth: Annotated[str, Field(min_length=4, max_length=4 * MAX_DEPTH_SIDE * MAX_DEPTH_SIDE)]


class HumanInput(StreamMessage):
    """One message of an input device: how a person wants a robot to move, 20 times a second or more.

    The type is `input` over a WebSocket and `human_input` over TCP.

    `held` is the state of the dead-man control; the robot moves only while it is true. `linear` (m/s) and
    `angular` (rad/s) are the velocity of the tool in axes of the cell or of the tool (`frame`); `joints`
    (rad/s, m/s) take their place. `mix` is m of shared control, from 0 (the person alone) to 1 (autonomous);
    with `arbitration` it is the most that the robot may choose. `gripper` acts once for each change of `seq`.
    `gamma` scales the velocities: that of this person and device, by default that of the session.
    """

    type: Literal["input", "human_input"] = "input"
    seq: Annotated[int, Field(ge=0, le=2**53)]
    held: bool
    linear: Annotated[tuple[Speed, ...], Field(min_length=3, max_length=3)] = (0.0, 0.0, 0.0)
    angular: Annotated[tuple[Speed, ...], Field(min_length=3, max_length=3)] = (0.0, 0.0, 0.0)
    frame: Literal["cell", "tool"] = "cell"
    joints: Annotated[tuple[Speed, ...], Field(min_length=1, max_length=32)] | None = None
    mix: Annotated[FiniteFloat, Field(ge=0, le=1)] = 0.0
    arbitration: bool = False
    gripper: Literal["open", "close"] | None = None
    gamma: Annotated[FiniteFloat, Field(gt=0, le=2)] | None = None


STREAMS: dict[str, type[BaseModel]] = {
    model.__name__: model for model in (SpeedLimitReport, PeopleReport, ScanReport, DepthReport, HumanInput)
}
"""The messages by name."""
