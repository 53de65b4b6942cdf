"""The bodies of requests."""

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, FiniteFloat, model_validator
from pydantic.alias_generators import to_camel

from handover.formats.strict_json import StrictModel
from handover.formats.validation import Moment
from handover_body.people.consent import Purpose

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
Bpm = Annotated[FiniteFloat, Field(ge=30, le=220)]


class Body(StrictModel):
    """A JSON object in camelCase without unknown members."""

    model_config = ConfigDict(extra="forbid", frozen=True, alias_generator=to_camel, populate_by_name=True)


class PersonChange(Body):
    """The baseline of a person: `age` in years, or both heart rates; and the curve of the speed limit.

    Without a curve it spans 30 % to 60 % of the heart rate reserve of the baseline.
    """

    age: Annotated[FiniteFloat, Field(ge=14, le=100)] | None = None
    rest_bpm: Bpm | None = None
    maximum_bpm: Bpm | None = None
    free_bpm: Bpm | None = None
    strained_bpm: Bpm | None = None
    least_fraction: Annotated[FiniteFloat, Field(ge=0, lt=1)] = 0.2

    @model_validator(mode="after")
    def _is_complete(self) -> "PersonChange":
        if (self.rest_bpm is None) != (self.maximum_bpm is None):
            raise ValueError("give both restBpm and maximumBpm, or the age")
        if (self.free_bpm is None) != (self.strained_bpm is None):
            raise ValueError("give both freeBpm and strainedBpm, or neither")
        return self


class ConsentGiven(Body):
    """What the person allows until `ends`, and who was there; `person` if it was the person alone."""

    purposes: Annotated[frozenset[Purpose], Field(min_length=1)]
    ends: Moment
    given_by: Annotated[str, Field(min_length=1, max_length=200)]


class SensorChange(Body):
    """A sensor of a person: its driver by name, and the settings of that driver."""

    person: Name
    driver: Annotated[str, Field(min_length=1, max_length=64)]
    settings: dict[str, Any] = Field(default_factory=dict)


class RecordingStart(Body):
    """What is recorded, and who started it; with accounts that is the caller."""

    label: Annotated[str, Field(max_length=200)] = ""
    started_by: Annotated[str, Field(min_length=1, max_length=200)]


class MarkerGiven(Body):
    """An event for the time line of a recording; `at` is now if absent."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    text: Annotated[str, Field(max_length=500)] = ""
    at: Moment | None = None


class Reset(Body):
    """Who has looked and ends the stop."""

    name: Annotated[str, Field(min_length=1, max_length=200)]


class RecordingView(Body):
    """A recording. SHA-256 and `size`, in bytes, are those of the decrypted MCAP file.

    `interrupted`: it waits to be closed, for example for the key.
    """

    id: str
    label: str
    state: Literal["running", "ended", "interrupted"]
    started: datetime
    started_by: str
    ended: datetime | None
    end_reason: str | None
    sha256: str | None
    size: int | None
    messages: int | None
    deleted_after: datetime


class ConsentView(Body):
    """A consent as it is now; `purposes` is empty when it has ended."""

    purposes: list[Purpose]
    given: datetime
    ends: datetime
    given_by: str
    withdrawn: datetime | None


class LeftOutView(Body):
    """A signal or channel of a sensor of which nothing is computed, and why."""

    name: str
    reason: str
    reason_code: str | None
    reason_parameters: dict[str, Any] | None


class SensorStateView(Body):
    """A sensor: what it is and how it does. `problem` says what a person should know."""

    name: str
    driver: str
    settings: dict[str, Any]
    link: str | None
    battery: float | None
    has_contact: bool | None
    fault: str | None
    """While it lasts, and some seconds longer."""
    problem: str
    problem_code: str | None
    problem_parameters: dict[str, Any] | None
    signals: list[str]
    left_out: list[LeftOutView]


class RobotLinkView(Body):
    """A robot that is limited by the person; `problem` is empty while it gets limits."""

    robot: str
    problem: str


class LimitView(Body):
    """The speed limit: fraction of the speed, and the curve that it follows."""

    fraction: float
    is_stopped: bool
    reason: str
    held_by: list[str]
    """Sensors with a fault, for which the limit does not rise now."""
    free_bpm: float
    strained_bpm: float
    least_fraction: float
    robots: list[RobotLinkView]


class PersonView(Body):
    """A person without values. `recording` is the id of the one that runs."""

    person: str
    pseudonym: str
    rest_bpm: float
    maximum_bpm: float
    baseline_method: str
    consent: ConsentView | None
    purposes: list[Purpose]
    is_monitored: bool
    recording: str | None
    sensors: list[SensorStateView]
    limit: LimitView | None


class SensorValueView(Body):
    """The value of one sensor."""

    sensor: str
    value: float | str
    quality: float
    status: str
    age_s: float
    method: str


class ValueView(Body):
    """A feature: the fused value, its age in s and those of the sensors."""

    name: str
    value: float | str
    unit: str | None
    quality: float
    status: str
    age_s: float
    method: str
    is_calibrated: bool
    disagree: bool
    sensors: list[SensorValueView]


class StateView(Body):
    """The state of a person now."""

    person: str
    pseudonym: str
    values: list[ValueView]
    exertion: float | None
    strain: float
    is_strained: bool
    limit: LimitView | None


class HistoryValue(Body):
    """One value of the history."""

    at: datetime
    value: float | str | None
    quality: float
    status: str


class DriverView(Body):
    """A driver of sensors, and the JSON Schema of its settings."""

    name: str
    description: str
    settings: dict[str, Any]


class FoundView(Body):
    """A device that was found."""

    address: str
    name: str
    rssi_dbm: int | None


class HistoryPoint(Body):
    """The valid values of a part of the time around `at`."""

    at: datetime
    least: float
    mean: float
    most: float
    values: int


class HistoryDuration(Body):
    """How long a text held, in s."""

    value: str
    seconds: float


class AccessView(Body):
    """Somebody looked at the data of a person, or changed it; `subject` is a random id, `action` a route."""

    number: int
    at: datetime
    subject: str
    name: str | None
    """Of the account at its last access, also after the account was deleted; None: in local mode."""
    is_own: bool
    """The caller did it."""
    action: str
    is_reading: bool
