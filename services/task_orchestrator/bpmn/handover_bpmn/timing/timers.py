"""Timers as BPMN writes them: moments, durations, repeating intervals and cron expressions.

A moment is `2026-05-01T08:00:00+02:00`, a duration `PT5M`. A cycle is an ISO 8601 repeating interval or a
cron expression:

- `R3/PT1M`: three times, one minute apart, the first one minute after the timer starts; `R/PT1M` without end.
- `R3/2026-05-01T08:00:00Z/PT1M`: three times, the first at that moment. Moments that have passed when the
  timer starts are skipped and count.
- `R3/PT1M/2026-05-01T08:00:00Z`: as `R3/PT1M`, but never after that moment.
- cron with five fields (minute, hour, day of month, month, day of week; either day matches), or with six or
  seven (second first, year last; both days must match). Fields are in UTC unless the text starts with a time
  zone, as in `TZ=Europe/Berlin 0 8 * * MON-FRI`. Sunday is 0 or 7 and Monday 1; but an expression with `?` or
  seven fields is one of Quartz (Camunda 7), in which Sunday is 1 and Saturday 7. Names mean the same in both.
- `@hourly`, `@daily`, `@midnight`, `@weekly`, `@monthly`, `@yearly` and `@annually`.
"""

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from typing import TypeAlias
from zoneinfo import ZoneInfo

from croniter import CroniterBadDateError, croniter

from handover.formats.durations import MICROSECONDS_PER_S, Duration, parse_duration

MAX_CHARACTERS = 200
MAX_REPETITIONS = 1_000_000
MIN_INTERVAL_US = MICROSECONDS_PER_S // 100
"""A shorter interval between two moments of a cycle is refused if it repeats more than `MAX_FAST` times."""
MAX_FAST = 1000

_REPEAT = re.compile(r"R(-1|\d{0,9})/", re.ASCII)
_TIME = re.compile(r"P(\d|T\d)|\d{4}-?\d\d|R(-1|\d*)/|@[a-z]+\Z|(TZ|CRON_TZ)=\S+ ", re.ASCII)
_CRON = re.compile(r"[\d*?][\w*?,/#-]*(\s+[\w*?,/#-]+){4,6}", re.ASCII)
_ZONE = re.compile(r"(?:CRON_)?TZ=(\S+)\s+", re.ASCII)
_WORD = re.compile(r"[A-Z]+")
_RANGE_OF_ONE = re.compile(r"\b0*(\w+)-0*\1(?:/[1-9]\d*)?(?![\w/-])", re.ASCII)
_WEEKDAY = re.compile(r"(\d+|[A-Z]{3})(?:-(\d+|[A-Z]{3}))?(/\d+|#\d|L)?", re.ASCII)
_WEEKDAYS = ("SUN", "MON", "TUE", "WED", "THU", "FRI", "SAT")
_MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")
_MACROS = {
    "@hourly": "0 * * * *",
    "@daily": "0 0 * * *",
    "@midnight": "0 0 * * *",
    "@weekly": "0 0 * * 0",
    "@monthly": "0 0 1 * *",
    "@yearly": "0 0 1 1 *",
    "@annually": "0 0 1 1 *",
}


def read_moment(text: str) -> datetime:
    """Return the moment `text` in UTC; raise `ValueError` if it is none or has no time zone."""
    # Camunda may add the region: 2026-05-01T08:00:00+02:00[Europe/Berlin]
    try:
        moment = datetime.fromisoformat(text.strip().partition("[")[0])
    except ValueError:
        raise ValueError(f'"{text}" is no moment; write it like 2026-05-01T08:00:00Z') from None
    if moment.tzinfo is None:
        raise ValueError(f'"{text}" has no time zone; end it with Z or an offset such as +02:00')
    try:
        return moment.astimezone(UTC)
    except OverflowError:
        raise ValueError(f'"{text}" is outside the years 1 to 9999 in UTC') from None


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
    """Return whether a timer's text is a time itself, not an expression that yields one."""
    text = text.strip()
    return _TIME.match(text) is not None or _CRON.fullmatch(text) is not None


@dataclass(frozen=True, slots=True)
class RepeatingInterval:
    """A repeating interval of ISO 8601; `count` moments, without end if it is None."""

    interval: Duration
    count: int | None
    start: datetime | None = None
    end: datetime | None = None

    def first(self, since: datetime) -> datetime:
        """Return when a timer that was started at `since` is due for the first time.

        Raises `ValueError` if it is never due.
        """
        try:
            if self.start is None:
                moment = self.interval.after(since)
            else:
                index = 0 if self.start >= since else self._index_after(self.start, since)
                if self.count is not None and index >= self.count:
                    raise ValueError(f"all {self.count} repetitions since {self.start.isoformat()} are over")
                moment = self._moment(self.start, index)
        except OverflowError:
            raise ValueError("a timer is due after the year 9999") from None
        if self.end is not None and moment > self.end:
            raise ValueError(f"the cycle ends at {self.end.isoformat()}, before it is due")
        return moment

    def next(self, after: datetime, done: int) -> datetime | None:
        """Return the moment that follows the moment `after`; None if there is none.

        `done` counts the moments that have passed, `after` included.
        """
        if self.count is not None and done >= self.count:
            return None
        try:
            if self.start is None:
                moment = self.interval.after(after)
            elif not (self.interval.months or self.interval.microseconds):
                moment = self.start
            else:
                index = self._index_after(self.start, after)
                if self.count is not None and index >= self.count:
                    return None
                moment = self._moment(self.start, index)
        except OverflowError:
            return None
        return None if self.end is not None and moment > self.end else moment

    def next_after(self, due: datetime, now: datetime) -> datetime | None:
        """Return the first moment of the series from its moment `due` that is later than `now`.

        In constant time, however long ago `due` was. It does not count; use it for a cycle without `count`.
        """
        origin = self.start or due
        try:
            moment = self._moment(origin, self._index_after(origin, max(due, now)))
        except OverflowError:
            return None
        return None if self.end is not None and moment > self.end else moment

    def _moment(self, origin: datetime, index: int) -> datetime:
        whole = Duration(self.interval.months * index, self.interval.microseconds * index)
        return whole.after(origin)

    def _index_after(self, origin: datetime, moment: datetime) -> int:
        """Return the least index of a moment of the series from `origin` that is later than `moment`.

        All moments of a series without length are `origin`, so after it none is left.
        """
        if not (self.interval.months or self.interval.microseconds):
            return 0 if origin > moment else MAX_REPETITIONS
        passed = (moment - origin) // timedelta(microseconds=1)
        # A month has 28 to 31 days, so the estimate is never too high.
        longest = self.interval.months * 31 * 86_400 * MICROSECONDS_PER_S + self.interval.microseconds
        index = max(0, passed // longest)
        while self._moment(origin, index) <= moment:
            index += 1
        return index


@dataclass(frozen=True, slots=True)
class CronSchedule:
    """A cron expression in the notation of croniter, with seconds first if it has more than five fields."""

    text: str
    fields: str
    zone: ZoneInfo | None = None

    def first(self, since: datetime) -> datetime:
        """Return the first moment after `since`; raise `ValueError` if there is none within 50 years."""
        moment = self.next(since, 0)
        if moment is None:
            raise ValueError(f'"{self.text}" has no moment in the next 50 years')
        return moment

    def next(self, after: datetime, done: int) -> datetime | None:
        """Return the moment that follows `after`; None if there is none within 50 years."""
        del done  # a cron expression repeats without end
        is_extended = len(self.fields.split()) > 5
        try:
            schedule = croniter(
                self.fields,
                after.astimezone(self.zone or UTC),
                ret_type=datetime,
                day_or=not is_extended,
                second_at_beginning=is_extended,
            )
            moment: datetime = schedule.get_next(datetime)
        except (CroniterBadDateError, OverflowError):
            return None
        return moment.astimezone(UTC)

    def next_after(self, due: datetime, now: datetime) -> datetime | None:
        """Return the first moment that is later than `due` and `now`."""
        return self.next(max(due, now), 0)


Cycle: TypeAlias = RepeatingInterval | CronSchedule


@lru_cache(maxsize=1024)
def parse_cycle(text: str) -> Cycle:
    """Return the repeating interval or cron expression `text`; raise `ValueError` if it is none."""
    stripped = text.strip()
    if len(stripped) > MAX_CHARACTERS:
        raise ValueError(f"a cycle has at most {MAX_CHARACTERS} characters, not {len(stripped)}")
    repeat = _REPEAT.match(stripped)
    if repeat is not None:
        return _parse_repeating(stripped, repeat.group(1), stripped[repeat.end() :])
    return _parse_cron(stripped)


def _parse_repeating(text: str, repetitions: str, rest: str) -> RepeatingInterval:
    count = None if repetitions in {"", "-1"} else int(repetitions)
    if count is not None and not 1 <= count <= MAX_REPETITIONS:
        raise ValueError(f'"{text}" repeats 1 to {MAX_REPETITIONS} times, or without end as in R/PT1M')
    parts = rest.split("/")
    start = end = None
    if len(parts) == 1:
        interval = parse_duration(parts[0])
    elif len(parts) == 2 and parts[1].startswith("P"):
        start, interval = read_moment(parts[0]), parse_duration(parts[1])
    elif len(parts) == 2 and parts[0].startswith("P"):
        interval, end = parse_duration(parts[0]), read_moment(parts[1])
    elif len(parts) == 2:
        start = read_moment(parts[0])
        length = read_moment(parts[1]) - start
        interval = Duration(0, length // timedelta(microseconds=1))
    else:
        raise ValueError(f'"{text}" is no cycle such as R3/PT1M or R3/2026-05-01T08:00:00Z/PT1M')
    if interval.months == 0 and interval.microseconds < 0:
        raise ValueError(f'"{text}" ends before it begins')
    is_fast = interval.months == 0 and interval.microseconds < MIN_INTERVAL_US
    if is_fast and (count is None or count > MAX_FAST):
        raise ValueError(
            f'"{text}" repeats in less than {MIN_INTERVAL_US // 1000} ms; it may {MAX_FAST} times at most'
        )
    return RepeatingInterval(interval, count, start, end)


def _parse_cron(text: str) -> CronSchedule:
    zone = None
    expression = text
    if (match := _ZONE.match(text)) is not None:
        zone, expression = _read_zone(match.group(1)), text[match.end() :]
    expression = _MACROS.get(expression.lower(), expression).upper()
    # croniter reads a range of one value, such as `5-5`, as all values.
    fields = [_RANGE_OF_ONE.sub(r"\1", field) for field in expression.split()]
    if not 5 <= len(fields) <= 7 or _CRON.fullmatch(expression) is None:
        raise ValueError(
            f'"{text[:64]}" is no cycle; write R3/PT1M, or a cron expression of 5 to 7 fields, or @daily'
        )
    is_quartz = "?" in expression or len(fields) == 7
    weekday_index = 4 if len(fields) == 5 else 5
    for index, field in enumerate(fields):
        for word in _WORD.findall(field):
            if word not in _words(index - (weekday_index - 4)):
                raise ValueError(f'"{text}": "{word}" cannot stand in field {index + 1}')
        if field == "?" and index not in {weekday_index, weekday_index - 2}:
            raise ValueError(f'"{text}": `?` can only stand for the day of the month or of the week')
    try:
        fields[weekday_index] = _read_weekdays(fields[weekday_index], is_quartz=is_quartz)
        schedule = CronSchedule(text, " ".join("*" if field == "?" else field for field in fields), zone)
        croniter.expand(schedule.fields, second_at_beginning=len(fields) > 5)
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise ValueError(f'"{text}" is no cron expression: {error}') from None
    return schedule


def _words(index: int) -> frozenset[str]:
    """Return the words of a field; 2 is the day of the month, 3 the month, 4 the day of the week."""
    match index:
        case 2:
            return frozenset({"L", "W"})
        case 3:
            return frozenset(_MONTHS)
        case 4:
            return frozenset({*_WEEKDAYS, "L", *(f"{day}L" for day in _WEEKDAYS)})
    return frozenset()


def _read_weekdays(field: str, *, is_quartz: bool) -> str:
    """Return the days of the week with 0 to 6 from Sunday, and the last of a month as croniter has it."""
    if field in {"*", "?"} or field.startswith("*/"):
        return field
    if field == "L":
        return "6" if is_quartz else "0"
    days = []
    for part in field.split(","):
        match = _WEEKDAY.fullmatch(part)
        if match is None:
            raise ValueError(f"{part} is no day of the week")
        first, last, suffix = match.groups()
        day = _read_weekday(first, is_quartz=is_quartz)
        if suffix == "L":
            days.append(f"L{day}")
        elif last is not None:
            # A range may wrap around, so the days are listed.
            final = _read_weekday(last, is_quartz=is_quartz)
            days += [str((day + shift) % 7) for shift in range(0, (final - day) % 7 + 1, _step(suffix))]
        elif suffix is not None and suffix.startswith("/"):
            days += [str(following) for following in range(day, 7, _step(suffix))]
        else:
            days.append(f"{day}{suffix or ''}")
    return ",".join(days)


def _step(suffix: str | None) -> int:
    step = int(suffix[1:]) if suffix is not None and suffix.startswith("/") else 1
    if step == 0:
        raise ValueError("a step is at least 1")
    return step


def _read_weekday(text: str, *, is_quartz: bool) -> int:
    if text in _WEEKDAYS:
        return _WEEKDAYS.index(text)
    number = int(text)
    if is_quartz:
        if not 1 <= number <= 7:
            raise ValueError(f"the day of the week is 1 (Sunday) to 7 (Saturday), not {number}")
        return number - 1
    if not 0 <= number <= 7:
        raise ValueError(f"the day of the week is 0 (Sunday) to 7 (Sunday), not {number}")
    return number % 7


def _read_zone(name: str) -> ZoneInfo:
    try:
        return ZoneInfo(name)
    except (OSError, ValueError, KeyError):
        raise ValueError(f'"{name[:64]}" is no time zone such as Europe/Berlin') from None
