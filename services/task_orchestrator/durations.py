"""Times as BPMN writes them: an ISO 8601 duration (`PT5M`) or a moment (`2026-05-01T08:00:00+02:00`)."""

import calendar
import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

_DURATION = re.compile(
    r"P(?=\d|T\d)(?:(?P<years>\d{1,3})Y)?(?:(?P<months>\d{1,4})M)?(?:(?P<weeks>\d{1,5})W)?(?:(?P<days>\d{1,6})D)?"
    r"(?:T(?=\d)(?:(?P<hours>\d{1,7})H)?(?:(?P<minutes>\d{1,9})M)?(?:(?P<seconds>\d{1,9}(?:[.,]\d{1,6})?)S)?)?",
    re.ASCII,
)

_TIME = re.compile(r"P(\d|T\d)|\d{4}-?\d\d", re.ASCII)


@dataclass(frozen=True, slots=True)
class Duration:
    """A length of time; months are counted by the calendar from the moment it starts."""

    months: int
    rest: timedelta

    def after(self, moment: datetime) -> datetime:
        """Return the moment that lies this duration after `moment`."""
        index = moment.month - 1 + self.months
        year, month = moment.year + index // 12, index % 12 + 1
        day = min(moment.day, calendar.monthrange(year, month)[1])
        return moment.replace(year=year, month=month, day=day) + self.rest


def read_duration(text: str) -> Duration:
    """Return the duration `text` says; raise `ValueError` if it is none."""
    found = _DURATION.fullmatch(text.strip())
    if found is None:
        raise ValueError(f'"{text}" is no ISO 8601 duration such as PT30S, PT5M or P1DT12H')
    part = {name: float((value or "0").replace(",", ".")) for name, value in found.groupdict().items()}
    months = int(part.pop("years") * 12 + part.pop("months"))
    return Duration(months, timedelta(**part))


def read_moment(text: str) -> datetime:
    """Return the moment `text` says, in UTC; raise `ValueError` if it is none or has no time zone."""
    moment = datetime.fromisoformat(text.strip())
    if moment.tzinfo is None:
        raise ValueError(f'"{text}" has no time zone; end it with Z or an offset such as +02:00')
    return moment.astimezone(UTC)


def due(text: str, since: datetime) -> datetime:
    """Return when a timer that says `text` and was started at `since` is due.

    Raises `ValueError` when it is neither a duration nor a moment, or lies beyond the calendar.
    """
    try:
        return read_duration(text).after(since) if text.strip().startswith("P") else read_moment(text)
    except OverflowError:
        raise ValueError(f'"{text}" lies beyond the calendar') from None


def looks_like_time(text: str) -> bool:
    """Say whether a timer's text is a duration or a moment itself, not an expression that gives one."""
    return _TIME.match(text.strip()) is not None
