"""Values and operators of FEEL: null instead of an error where types do not fit, and a budget per evaluation.

Values are those of JSON and, within an expression, dates (`date`, `datetime`), durations and ranges.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, date, datetime, time
from typing import Any, TypeAlias

from handover.formats.durations import Duration
from handover_bpmn.languages.base import MAX_ITEMS, MAX_NUMBER, ExpressionError, Json
from handover_bpmn.languages.times import (
    days_between,
    read_datetime,
    read_duration,
    shift,
    write_duration,
    write_moment,
)

FeelValue: TypeAlias = Any

MAX_STEPS = 200_000
"""Steps of an evaluation: some four tokens that a loop evaluates, or an item that a function visits."""

MAX_STRING = 64 * MAX_ITEMS
"""Characters of a text that an expression may create."""


class Budget:
    """The steps that an evaluation may still take."""

    __slots__ = ("left",)

    def __init__(self) -> None:
        self.left = MAX_STEPS

    def spend(self, steps: int) -> None:
        """Take `steps`; raise `ExpressionError` if no more are left."""
        self.left -= steps
        if self.left < 0:
            raise ExpressionError(
                f"the evaluation was stopped after {MAX_STEPS} steps; use shorter lists or fewer loops"
            )


@dataclass(frozen=True, slots=True)
class Range:
    """A range such as `[1..3]`, or `(1..3)` without its ends."""

    start: FeelValue
    end: FeelValue
    has_start: bool = True
    has_end: bool = True

    def includes(self, value: FeelValue, budget: Budget) -> bool | None:
        """Return whether `value` is within the range; None if they cannot be compared."""
        above, below = order(value, self.start, budget), order(value, self.end, budget)
        if above is None or below is None:
            return None
        return (above >= 0 if self.has_start else above > 0) and (below <= 0 if self.has_end else below < 0)


def is_number(value: FeelValue) -> bool:
    """Return whether `value` is a number; booleans are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def number(value: float) -> int | float:
    """Return `value`, as integer if it is one; raise `ExpressionError` if JSON would lose it."""
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ExpressionError("a number must be finite")
        return int(value) if value.is_integer() and abs(value) <= MAX_NUMBER else value
    if abs(value) > MAX_NUMBER:
        raise ExpressionError("a number grew too large")
    return value


def text(value: str, budget: Budget) -> str:
    """Return a new text; raise `ExpressionError` if it is too long."""
    if len(value) > MAX_STRING:
        raise ExpressionError(f"a text has at most {MAX_STRING} characters")
    budget.spend(len(value) >> 6)
    return value


def order(left: FeelValue, right: FeelValue, budget: Budget) -> int | None:
    """Return -1, 0 or 1 as `left` is before, equal to or after `right`; None if they cannot be compared."""
    if is_number(left) and is_number(right):
        pass
    elif isinstance(left, str) and isinstance(right, str):
        budget.spend(len(left) >> 8)
    elif isinstance(left, Duration) and isinstance(right, Duration):
        if bool(left.months) is bool(right.months) or not (left.microseconds or right.microseconds):
            left, right = (left.months, left.microseconds), (right.months, right.microseconds)
        else:
            return None
    elif isinstance(left, datetime) and isinstance(right, datetime):
        if (left.tzinfo is None) is not (right.tzinfo is None):
            return None
    elif type(left) is not type(right) or not isinstance(left, date):
        return None
    return int(left > right) - int(left < right)


def is_same(left: FeelValue, right: FeelValue, budget: Budget) -> bool | None:  # noqa: PLR0911 - one a type
    """Return whether `left = right`; None if their types differ. Null equals null only."""
    if type(left) is int and type(right) is int:
        return left == right
    if left is None or right is None:
        return left is right
    if isinstance(left, bool) or isinstance(right, bool):
        return left is right if isinstance(left, bool) and isinstance(right, bool) else None
    if isinstance(left, str) and isinstance(right, str):
        budget.spend(len(left) >> 8)
        return left == right
    if is_number(left) and is_number(right):
        return bool(left == right)
    if isinstance(left, list) and isinstance(right, list):
        budget.spend(1 + min(len(left), len(right)))
        return len(left) == len(right) and all(
            is_same(a, b, budget) is True for a, b in zip(left, right, strict=True)
        )
    if isinstance(left, dict) and isinstance(right, dict):
        budget.spend(1 + len(left))
        return left.keys() == right.keys() and all(
            is_same(value, right[key], budget) is True for key, value in left.items()
        )
    return None if type(left) is not type(right) else bool(left == right)


def add(left: FeelValue, right: FeelValue, budget: Budget) -> FeelValue:
    """Return the sum of numbers or durations, the later date, or the joined text; else null."""
    if is_number(left) and is_number(right):
        return number(left + right)
    if isinstance(left, str) and isinstance(right, str):
        return text(left + right, budget)
    if isinstance(left, Duration):
        if isinstance(right, Duration):
            return Duration(left.months + right.months, left.microseconds + right.microseconds)
        left, right = right, left
    if isinstance(left, date) and isinstance(right, Duration):
        return _moved(left, right, 1)
    return None


def subtract(left: FeelValue, right: FeelValue, budget: Budget) -> FeelValue:
    """Return a difference of numbers or durations, the time between dates, or an earlier date; else null."""
    if is_number(left) and is_number(right):
        return number(left - right)
    if isinstance(left, Duration) and isinstance(right, Duration):
        return Duration(left.months - right.months, left.microseconds - right.microseconds)
    if isinstance(left, date) and isinstance(right, Duration):
        return _moved(left, right, -1)
    if order(left, right, budget) is not None and isinstance(left, date):
        return days_between(right, left)
    return None


def multiply(left: FeelValue, right: FeelValue, budget: Budget) -> FeelValue:
    """Return the product of numbers, or of a duration and a number; else null."""
    del budget
    if is_number(left) and is_number(right):
        return number(left * right)
    if isinstance(right, Duration):
        left, right = right, left
    if isinstance(left, Duration) and is_number(right):
        return _scaled(left, right)
    return None


def divide(left: FeelValue, right: FeelValue, budget: Budget) -> FeelValue:
    """Return the quotient of numbers, durations, or a duration and a number; null for a divisor of 0."""
    del budget
    if isinstance(left, Duration) and isinstance(right, Duration):
        return _ratio(left, right)
    if not is_number(right) or right == 0:
        return None
    if is_number(left):
        return number(left / right)
    return _scaled(left, 1 / right) if isinstance(left, Duration) else None


def _ratio(left: Duration, right: Duration) -> FeelValue:
    """Return how often `right` fits into `left`; null for different kinds of durations, and for one of 0."""
    if not (left.months or right.months):
        return number(left.microseconds / right.microseconds) if right.microseconds else None
    if left.microseconds or right.microseconds or not right.months:
        return None
    return number(left.months / right.months)


def power(left: FeelValue, right: FeelValue, budget: Budget) -> FeelValue:
    """Return `left` to the power of `right`; null where that is no real number."""
    del budget
    if not (is_number(left) and is_number(right)):
        return None
    try:
        result = float(left) ** float(right)
    except ZeroDivisionError:
        return None
    return number(result) if isinstance(result, float) else None


def read_path(value: FeelValue, name: str, budget: Budget) -> FeelValue:
    """Return `value.name`: the entry of an object, those of the objects of a list, or a part of a date."""
    if isinstance(value, dict):
        return value.get(name)
    if isinstance(value, list):
        budget.spend(len(value))
        return [read_path(item, name, budget) if not isinstance(item, list) else None for item in value]
    if isinstance(value, Range) and name in {"start", "end"}:
        return getattr(value, name)
    if isinstance(value, datetime) and name == "timezone":
        raise ExpressionError("the part .timezone of a date and time is not supported")
    if isinstance(value, datetime) and name in {"hour", "minute", "second"}:
        return getattr(value, name)
    if isinstance(value, date):
        return value.isoweekday() if name == "weekday" else _date_part(value, name)
    return _duration_part(value, name) if isinstance(value, Duration) else None


def _date_part(value: date, name: str) -> FeelValue:
    return getattr(value, name) if name in {"year", "month", "day"} else None


def _duration_part(value: Duration, name: str) -> FeelValue:
    if name in {"years", "months"}:
        whole = abs(value.months) // 12 if name == "years" else abs(value.months) % 12
        return whole if value.months >= 0 else -whole
    seconds = abs(value.microseconds) // 1_000_000
    parts = {"days": seconds // 86_400, "hours": seconds // 3600 % 24, "minutes": seconds // 60 % 60}
    part = {**parts, "seconds": seconds % 60}.get(name)
    return part if part is None or value.microseconds >= 0 else -part


def to_date(value: FeelValue) -> date | None:
    """Return the date of a text, date, or date and time; None for anything else."""
    if isinstance(value, datetime):
        return value.date()
    if isinstance(value, date):
        return value
    if not isinstance(value, str):
        return None
    moment = read_datetime(value)
    return None if moment is None else moment.date()


def to_datetime(value: FeelValue) -> datetime | None:
    """Return the date and time of a text, date (its midnight in UTC), or date and time; None for others."""
    if isinstance(value, datetime):
        return value
    if isinstance(value, date):
        return datetime.combine(value, time(), UTC)
    if isinstance(value, str) and "@" in value:
        raise ExpressionError(
            f'"{value[:60]}" names a time zone, which is not supported; write its offset, as in +02:00'
        )
    return read_datetime(value) if isinstance(value, str) else None


def to_duration(value: FeelValue) -> Duration | None:
    """Return the duration of a text or duration; None for anything else."""
    if isinstance(value, Duration):
        return value
    return read_duration(value) if isinstance(value, str) else None


def to_json(value: FeelValue, budget: Budget) -> Json:  # noqa: PLR0911 - one return a type
    """Return `value` with dates and durations as ISO 8601 texts; a range is an object."""
    if isinstance(value, str):
        budget.spend(len(value) >> 6)
        return value
    if value is None or isinstance(value, int | float):
        return value
    if isinstance(value, list):
        budget.spend(len(value))
        return [to_json(item, budget) for item in value]
    if isinstance(value, dict):
        budget.spend(len(value))
        return {key: to_json(item, budget) for key, item in value.items()}
    if isinstance(value, datetime):
        return write_moment(value)
    if isinstance(value, date):
        return value.isoformat()
    if isinstance(value, Duration):
        return write_duration(value)
    if isinstance(value, Range):
        return {"start": to_json(value.start, budget), "end": to_json(value.end, budget)}
    raise ExpressionError(f"{type(value).__name__} is no JSON value")


def _moved(moment: date, duration: Duration, sign: int) -> date:
    if isinstance(moment, datetime):
        return shift(moment, duration, sign)
    return shift(datetime.combine(moment, time()), duration, sign).date()


def _scaled(duration: Duration, factor: float) -> Duration:
    months, microseconds = duration.months * factor, duration.microseconds * factor
    if not (abs(months) < MAX_NUMBER and abs(microseconds) < 1000 * MAX_NUMBER):
        raise ExpressionError("a duration grew too large")
    return Duration(int(months), round(microseconds))


def has_type(value: FeelValue, name: str) -> bool:
    """Return whether `value` is an instance of the FEEL type `name`; null has the type `null` only."""
    return _TYPES[name](value)


_TYPES: dict[str, Callable[[FeelValue], bool]] = {
    "Any": lambda value: value is not None,
    "null": lambda value: value is None,
    "number": is_number,
    "string": lambda value: isinstance(value, str),
    "boolean": lambda value: isinstance(value, bool),
    "list": lambda value: isinstance(value, list),
    "context": lambda value: isinstance(value, dict),
    "date and time": lambda value: isinstance(value, datetime),
    "date": lambda value: isinstance(value, date) and not isinstance(value, datetime),
    "days and time duration": lambda value: isinstance(value, Duration) and not value.months,
    "years and months duration": lambda value: isinstance(value, Duration) and not value.microseconds,
}
TYPES = tuple(_TYPES)
