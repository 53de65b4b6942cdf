"""Calendar: how long an agent was on shift in a period."""

from collections.abc import Iterator
from datetime import UTC, date, datetime, timedelta

from handover_processes.allocation.agents import UNLIMITED, Agent, Shift

Interval = tuple[datetime, datetime]


def available_ms(agent: Agent | None, begins: datetime, ends: datetime) -> int:
    """Return the time in ms that an agent could work: its shifts, or always, times its capacity."""
    whole = max(timedelta(), ends - begins)
    if agent is None:
        return _milliseconds(whole)
    on_shift = sum(_joined(_shifts(agent, begins, ends)), timedelta()) if agent.shifts else whole
    capacity = 1 if agent.capacity >= UNLIMITED else max(1, agent.capacity)
    return _milliseconds(on_shift) * capacity


def _shifts(agent: Agent, begins: datetime, ends: datetime) -> Iterator[Interval]:
    for shift in agent.shifts:
        day = begins.astimezone(shift.zone).date() - timedelta(
            days=1
        )  # a night shift begins on the day before
        while datetime.combine(day, shift.begins, shift.zone) < ends:
            if day.isoweekday() == shift.weekday:
                first, last = _times(shift, day)
                yield max(first, begins), min(last, ends)
            day += timedelta(days=1)


def _times(shift: Shift, day: date) -> Interval:
    next_day = day + timedelta(days=1) if shift.ends <= shift.begins else day
    begins = datetime.combine(day, shift.begins, shift.zone)
    return begins.astimezone(UTC), datetime.combine(next_day, shift.ends, shift.zone).astimezone(UTC)


def _joined(intervals: Iterator[Interval]) -> Iterator[timedelta]:
    """Yield the lengths of intervals, counting times once in which several overlap."""
    reached: datetime | None = None
    for begins, ends in sorted(intervals):
        first = begins if reached is None else max(begins, reached)
        if ends > first:
            yield ends - first
            reached = ends


def _milliseconds(span: timedelta) -> int:
    return round(span / timedelta(milliseconds=1))
