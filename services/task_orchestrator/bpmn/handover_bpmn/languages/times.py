"""Times in expressions: reading, writing and calculating with the ISO 8601 texts that JSON has for them."""

import re
from datetime import UTC, date, datetime, timedelta

from handover.formats.durations import MICROSECONDS_PER_S, Duration, add_months, parse_duration
from handover_bpmn.languages.base import NOW, ExpressionError, Variables

_S_PER_DAY = 86_400
_MOMENT = re.compile(r"\d{4}-\d\d-\d\d(T\d\d:\d\d.*)?", re.ASCII | re.DOTALL)


def read_now(variables: Variables) -> datetime:
    """Return the present time: that of `variables` if they have one, else that of the system."""
    text = variables.get(NOW)
    if text is None:
        return datetime.now(UTC)
    moment = read_datetime(text) if isinstance(text, str) else None
    if moment is None:
        raise ExpressionError(f"the present time {text!r} is no ISO 8601 moment")
    return moment


def read_datetime(text: str) -> datetime | None:
    """Return the moment, or the begin of the date, that `text` represents; None if it is neither."""
    if len(text) > 64 or _MOMENT.fullmatch(text) is None:
        return None
    # Camunda may add the region: 2026-05-01T08:00:00+02:00[Europe/Berlin]
    text = text.partition("[")[0]
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def read_duration(text: str) -> Duration | None:
    """Return the duration, possibly negative, that `text` represents; None if it is none."""
    negative = text.startswith("-")
    try:
        duration = parse_duration(text.removeprefix("-"))
    except ValueError:
        return None
    return Duration(-duration.months, -duration.microseconds) if negative else duration


def shift(moment: datetime, duration: Duration, sign: int = 1) -> datetime:
    """Return `moment` moved by `duration`; raise `ExpressionError` outside the years 1 to 9999."""
    try:
        moved = add_months(moment, sign * duration.months)
        return moved + timedelta(microseconds=sign * duration.microseconds)
    except (OverflowError, ValueError):
        raise ExpressionError("a moment is outside the years 1 to 9999") from None


def write_moment(moment: datetime) -> str:
    """Return `moment` as ISO 8601, with `Z` for UTC."""
    text = moment.isoformat()
    return text.removesuffix("+00:00") + "Z" if text.endswith("+00:00") else text


def write_duration(duration: Duration) -> str:
    """Return `duration` as ISO 8601; one of mixed signs is written by its sign as a whole."""
    months, microseconds = duration.months, duration.microseconds
    sign = "-" if months < 0 or (months == 0 and microseconds < 0) else ""
    years, months = divmod(abs(months), 12)
    seconds, fraction = divmod(abs(microseconds), MICROSECONDS_PER_S)
    days, seconds = divmod(seconds, _S_PER_DAY)
    hours, seconds = divmod(seconds, 3600)
    minutes, seconds = divmod(seconds, 60)
    text = "".join(f"{count}{unit}" for count, unit in ((years, "Y"), (months, "M"), (days, "D")) if count)
    clock = "".join(f"{count}{unit}" for count, unit in ((hours, "H"), (minutes, "M")) if count)
    if seconds or fraction:
        clock += f"{seconds}.{fraction:06}".rstrip("0").rstrip(".") + "S" if fraction else f"{seconds}S"
    if clock:
        text += f"T{clock}"
    return f"{sign}P{text}" if text else "PT0S"


def days_between(start: date, end: date) -> Duration:
    """Return the duration from `start` to `end`, negative if `end` is earlier."""
    difference = end - start
    return Duration(0, difference // timedelta(microseconds=1))
