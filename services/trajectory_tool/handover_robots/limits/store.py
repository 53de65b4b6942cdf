"""What people decided about the limits of the robots, stored durably in one small file.

It has the required sources, the mode, the validated speed of the end effector, the measured stop, and who
decided what and why. The file is replaced atomically.
"""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    ConfigDict,
    Field,
    FiniteFloat,
    ValidationError,
    model_validator,
)

from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover.formats.strict_json import StrictModel
from handover.formats.validation import Moment
from handover.telemetry import get_logger

log = get_logger(__name__)

MAX_DECISIONS = 1000

Mode = Literal["normal", "reduced"]
Text = Annotated[str, Field(min_length=1, max_length=200)]


class _Stored(StrictModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SafeSpeed(_Stored):
    """The highest speed of the tool with an end effector that was validated, in m/s, and when."""

    end_effector: Text
    speed_mps: Annotated[FiniteFloat, Field(gt=0, le=10)]
    validated_at: Moment


class MeasuredStop(_Stored):
    """The stop of the robot as measured: it moves on for `delay_s`, then slows down."""

    delay_s: Annotated[FiniteFloat, Field(ge=0, le=10)]
    deceleration_mps2: Annotated[FiniteFloat, Field(gt=0, le=1000)]
    measured_at: Moment


class Decision(_Stored):
    """What a person did, and why."""

    what: Text
    name: Text
    reason: str = ""
    at: Moment = Field(default_factory=lambda: datetime.now(UTC))


class RobotRecord(_Stored):
    """The record of one robot."""

    limit_sources: tuple[str, ...] = ()
    people_sensors: tuple[str, ...] = ()
    mode: Mode = "normal"
    safe_speeds: dict[Text, SafeSpeed] = Field(default_factory=dict)
    """By end effector."""
    stop: MeasuredStop | None = None
    decisions: tuple[Decision, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _of_one_end_effector(cls, values: Any) -> Any:
        """Accept the file of an earlier release, with one speed."""
        if not isinstance(values, dict) or "safe_speed" not in values:
            return values
        speed = values["safe_speed"]
        rest = {name: value for name, value in values.items() if name != "safe_speed"}
        return rest if speed is None else {**rest, "safe_speeds": {speed["end_effector"]: speed}}

    def decided(self, what: str, name: str, reason: str = "", **values: object) -> "RobotRecord":
        """Return the record after a decision of a person, with changed values."""
        decision = Decision(what=what, name=name, reason=reason)
        decisions = (*self.decisions, decision)[-MAX_DECISIONS:]
        return self.model_copy(update={**values, "decisions": decisions})


class _File(_Stored):
    robots: dict[str, RobotRecord] = Field(default_factory=dict)


class LimitStore:
    """The file. Raises `UsageError` if it is damaged."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._is_saved = True
        self._is_reported = False
        try:
            self._file = _File.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            self._file = _File()
        except OSError as error:
            raise UsageError(f"the limits of the robots, {path}, cannot be read: {error.strerror}") from None
        except ValidationError as error:
            raise UsageError(
                f"the limits of the robots, {path}, are damaged ({error.errors()[0]['msg']}); restore the "
                "file from a backup, or delete it and enter the limits again"
            ) from None

    def of(self, robot: str) -> RobotRecord:
        """Return the record of a robot."""
        return self._file.robots.get(robot, RobotRecord())

    def put(self, robot: str, record: RobotRecord) -> None:
        """Store the record of a robot durably. Raises `OSError`; nothing is changed then."""
        file = _File(robots={**self._file.robots, robot: record})
        self._write(file)
        self._file = file

    def put_lower(self, robot: str, record: RobotRecord) -> None:
        """Let a record hold that only lowers the speed; store it now, or with `save` when possible."""
        self._file = _File(robots={**self._file.robots, robot: record})
        self._is_saved = False
        self.save()

    def save(self) -> None:
        """Store what holds and is not stored yet, if that is possible."""
        if self._is_saved:
            return
        try:
            self._write(self._file)
        except OSError as error:
            if not self._is_reported:
                log.warning("a lower limit is not stored yet", path=str(self.path), reason=error.strerror)
            self._is_reported = True

    def _write(self, file: _File) -> None:
        replace_durably(self.path, file.model_dump_json(indent=1).encode())
        self._is_saved, self._is_reported = True, False
