"""The messages of streams to a robot: speed limits, and the places of people.

Each is one JSON text of a WebSocket. They are no entities: a control loop never waits for the broker. Nothing
here is a safety-rated function.
"""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator
from pydantic.alias_generators import to_camel

STALE_S, PEOPLE_STALE_S = 3.0, 0.5
STALE_PERIODS = 3.0
DEFAULT_TIMEOUT_S, MAX_TIMEOUT_S = 10.0, 20.0
MAX_PEOPLE = 64
SOURCE_PATTERN = r"^[A-Za-z0-9_.:-]{1,64}$"


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, alias_generator=to_camel, populate_by_name=True)


class SpeedLimitReport(_Message):
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


class SeenPerson(_Message):
    """A person at a place in m, in the frame of the cell.

    The id is constant while the sensor follows them.
    """

    id: Annotated[str, Field(pattern=SOURCE_PATTERN)]
    x: Annotated[FiniteFloat, Field(ge=-1000, le=1000)]
    y: Annotated[FiniteFloat, Field(ge=-1000, le=1000)]

    @property
    def point(self) -> tuple[float, float]:
        """Return the place."""
        return self.x, self.y


class PeopleReport(_Message):
    """One message of the stream: everybody whom a sensor sees, and the fields of a safety scanner.

    An empty `people` says that nobody is there. `stamp` is in s since 1970 and increases; `period` is the
    time to the next report in s.
    """

    source: Annotated[str, Field(pattern=SOURCE_PATTERN)]
    stamp: Annotated[FiniteFloat, Field(ge=0)]
    people: Annotated[tuple[SeenPerson, ...], Field(max_length=MAX_PEOPLE)]
    period: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.1
    warning_field: bool = False
    protective_field: bool = False

    @property
    def stale_s(self) -> float:
        """Return the age at which the report is stale."""
        return max(PEOPLE_STALE_S, STALE_PERIODS * self.period)


STREAMS: dict[str, type[BaseModel]] = {model.__name__: model for model in (SpeedLimitReport, PeopleReport)}
"""The messages by name."""
