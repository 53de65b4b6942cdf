"""Timers as BPMN writes them: an ISO 8601 duration (`PT5M`) or a moment (`2026-05-01T08:00:00+02:00`)."""

import re
from dataclasses import dataclass
from datetime import UTC, datetime

from handover.durations import Duration, parse_duration

_TIME = re.compile(r"P(\d|T\d)|\d{4}-?\d\d", re.ASCII)


def read_moment(text: str) -> datetime:
    """Return the moment `text` in UTC; raise `ValueError` if it is none or has no time zone."""
    moment = datetime.fromisoformat(text.strip())
    if moment.tzinfo is None:
        raise ValueError(f'"{text}" has no time zone; end it with Z or an offset such as +02:00')
    return moment.astimezone(UTC)


def due_at(text: str, since: datetime) -> datetime:
    """Return when a timer with this `text` that was started at `since` is due.

    Raises `ValueError` when `text` is neither a duration nor a moment, or is after the year 9999.
    """
    text = text.strip()
    try:
        return parse_duration(text).after(since) if text.startswith("P") else read_moment(text)
    except OverflowError:
        raise ValueError(f'"{text}" is after the year 9999') from None


def is_time(text: str) -> bool:
    """Return whether a timer's text is a duration or a moment itself, not an expression that yields one."""
    return _TIME.match(text.strip()) is not None


@dataclass(frozen=True, slots=True)
class Cycle:
    """A repeating timer: `R3/PT1M` three times, `R/PT1M` without end."""

    interval: Duration
    count: int | None

    def first(self, since: datetime) -> datetime:
        """Return when a timer that was started at `since` is due for the first time."""
        return self.interval.after(since)

    def next(self, after: datetime, done: int) -> datetime | None:
        """Return when it is due after `after`; None when it was due `done` times and that is enough."""
        return None if self.count is not None and done >= self.count else self.interval.after(after)


def parse_cycle(text: str) -> Cycle:
    """Return the cycle `text`; raise `ValueError` if it is none."""
    repetition, separator, interval = text.strip().partition("/")
    number = repetition[1:]
    if not separator or repetition[:1] != "R" or not (number.isdecimal() or not number):
        raise ValueError(f'"{text}" is no cycle such as R3/PT1M')
    return Cycle(parse_duration(interval), int(number) if number else None)
