"""Rules: which values of which devices are compared with what, and what happens then.

A rule has a check (`LimitCheck`, `RateCheck`, …). A value is abnormal, normal, or between both, which is the
hysteresis: an Alert is raised after the value was abnormal for `forS`, and cleared after it was normal again
for `clearAfterS`. A value between both changes nothing.
"""

import re
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import yaml
from pydantic import Field, ValidationError, field_validator, model_validator

from handover.errors import UsageError
from handover.formats.validation import fault_text
from handover_datamodels.states import Severity
from handover_devices.model.description import Part

MAX_RULES: Final = 500
_RULE_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_PATTERN: Final = r"^[A-Za-z0-9_.*?-]{1,64}$"


class LimitCheck(Part):
    """A value below `minimum` or above `maximum` is abnormal; normal is what is inside by `hysteresis`."""

    type: Literal["limits"] = "limits"
    minimum: float | None = None
    maximum: float | None = None
    hysteresis: float = Field(0.0, ge=0)

    @model_validator(mode="after")
    def _has_limit(self) -> Self:
        low, high = self.minimum, self.maximum
        if low is None and high is None:
            raise ValueError("limits need a minimum, a maximum or both")
        if low is not None and high is not None and low + self.hysteresis >= high - self.hysteresis:
            raise ValueError("minimum + hysteresis must be less than maximum - hysteresis")
        return self


class RateCheck(Part):
    """A value that changes by more than `max_per_s` a second, on average over `over_s`, is abnormal."""

    type: Literal["rateOfChange"] = "rateOfChange"
    max_per_s: float = Field(gt=0)
    over_s: float = Field(10.0, gt=0, le=86_400)
    hysteresis: float = Field(0.2, ge=0, lt=1, description="normal is a rate less by this fraction")


class SilenceCheck(Part):
    """No value for `after_s` is abnormal; a value is normal."""

    type: Literal["silence"] = "silence"
    after_s: float = Field(gt=0, le=30 * 86_400)


class ZScoreCheck(Part):
    """A value far from the mean of those before it is abnormal, in standard deviations.

    Mean and deviation are those of about the last `window` values, weighted exponentially.
    """

    type: Literal["zScore"] = "zScore"
    threshold: float = Field(4.0, ge=1, le=100)
    window: int = Field(300, ge=20, le=100_000)
    minimum_values: int = Field(60, ge=10, le=100_000, description="values before the first judgement")
    minimum_deviation: float = Field(
        0.0, ge=0, description="the standard deviation counts as at least this, such as the sensor's noise"
    )
    hysteresis: float = Field(0.3, ge=0, lt=1, description="normal is a distance less by this fraction")


class SeasonalCheck(Part):
    """A value far from those at the same time of the day (or week) in the history is abnormal."""

    type: Literal["seasonal"] = "seasonal"
    threshold: float = Field(4.0, ge=1, le=100)
    period: Literal["day", "week"] = "day"
    interval_min: int = Field(30, ge=5, le=240, description="minutes that are summarized")
    history_days: int = Field(28, ge=2, le=400)
    minimum_periods: int = Field(3, ge=2, le=50, description="days or weeks before the first judgement")
    minimum_deviation: float = Field(0.0, ge=0)
    hysteresis: float = Field(0.3, ge=0, lt=1)


Check = Annotated[
    LimitCheck | RateCheck | SilenceCheck | ZScoreCheck | SeasonalCheck, Field(discriminator="type")
]


class ProcessToStart(Part):
    """A process that begins with the Alert, for example an inspection by a robot.

    It gets the `parameters`, and `device`, `value`, `measured` and `alert` besides.
    """

    definition: str = Field(min_length=1, max_length=300, description="the name of a deployed definition")
    parameters: dict[str, Any] = Field(default_factory=dict)
    cooldown_s: float = Field(600.0, ge=0, description="no second start for the same value within this time")


class Rule(Part):
    """A rule; `device` and `value` are names, or patterns with `*` and `?`."""

    device: str = Field("*", pattern=_PATTERN)
    value: str = Field("*", pattern=_PATTERN)
    check: Check
    for_s: float = Field(
        0.0, ge=0, le=86_400, description="seconds that the value is abnormal before the Alert"
    )
    clear_after_s: float = Field(
        0.0, ge=0, le=86_400, description="seconds of normal values that end the Alert"
    )
    severity: Severity = Severity.MEDIUM
    description: str = Field("", max_length=500, description="what people should know or do")
    start_process: ProcessToStart | None = None
    enabled: bool = True

    def concerns(self, device: str, value: str) -> bool:
        """Return whether the rule is for this value of this device."""
        return self.enabled and fnmatchcase(device, self.device) and fnmatchcase(value, self.value)


class RuleFile(Part):
    """The content of a file of rules."""

    rules: dict[str, Rule] = Field(max_length=MAX_RULES)

    @field_validator("rules")
    @classmethod
    def _have_names(cls, rules: dict[str, Rule]) -> dict[str, Rule]:
        wrong = [name for name in rules if not is_rule_name(name)]
        if wrong:
            raise ValueError(f'"{wrong[0][:64]}" is no name: 1 to 64 letters, digits, "_", "." or "-"')
        return rules


def is_rule_name(name: str) -> bool:
    """Return whether `name` can be the name of a rule."""
    return _RULE_NAME.fullmatch(name) is not None


def read_rules(file: Path) -> dict[str, Rule]:
    """Return the rules of a YAML file by name; raise `UsageError` that names the place and the fault."""
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UsageError(f"the rules {file} cannot be read: {error}; correct HANDOVER_DEVICE_RULES") from None
    try:
        return RuleFile.model_validate(content).rules
    except ValidationError as error:
        raise UsageError(f"the rules {file}: {fault_text(error, 'the file')}") from None
