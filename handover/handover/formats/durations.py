"""Durations of ISO 8601, such as `PT5M`, `P1DT12H` or `P1M`.

Years and months have no fixed length, so a duration has two parts: months of the calendar, and microseconds.
"""

import calendar
import re
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

MICROSECONDS_PER_S: Final = 1_000_000
MAX_YEARS: Final = 10_000
"""A longer duration leaves the calendar from every moment."""

_FORMAT: Final = re.compile(
    r"P(?=\d|T\d)(?:(\d{1,9})Y)?(?:(\d{1,9})M)?(?:(\d{1,9})W)?(?:(\d{1,9})D)?"
    r"(?:T(?=\d)(?:(\d{1,12})H)?(?:(\d{1,12})M)?(?:(\d{1,12})(?:[.,](\d{1,9}))?S)?)?",
    re.ASCII,
)
_DAY_S: Final = 86_400


@dataclass(frozen=True, slots=True)
class Duration:
    """A length of time; `months` are counted by the calendar from the moment at which it starts."""

    months: int
    microseconds: int

    def after(self, moment: datetime) -> datetime:
        """Return the moment this duration after `moment`; raise `OverflowError` after the year 9999."""
        return add_months(moment, self.months) + timedelta(microseconds=self.microseconds)

    @property
    def nominal_s(self) -> float:
        """Return the length in seconds with years of 365 days and other months of 30 days."""
        years, months = divmod(self.months, 12)
        return (years * 365 + months * 30) * _DAY_S + self.microseconds / MICROSECONDS_PER_S


def parse_duration(text: str) -> Duration:
    """Return the duration that `text` represents; raise `ValueError` for other texts.

    Fractions of a second are cut off after microseconds. A duration of more than `MAX_YEARS` is refused.
    """
    match = _FORMAT.fullmatch(text)
    if match is None:
        raise ValueError(f'"{text[:64]}" is no ISO 8601 duration such as PT30S, PT5M or P1DT12H')
    *whole, fraction = match.groups()
    years, months, weeks, days, hours, minutes, seconds = (int(part or 0) for part in whole)
    months += 12 * years
    seconds += (((weeks * 7 + days) * 24 + hours) * 60 + minutes) * 60
    if months > 12 * MAX_YEARS or seconds > MAX_YEARS * 366 * _DAY_S:
        raise ValueError(f'"{text[:64]}" is longer than {MAX_YEARS} years, which the calendar does not reach')
    microseconds = int((fraction or "")[:6].ljust(6, "0"))
    return Duration(months, seconds * MICROSECONDS_PER_S + microseconds)


def add_months(moment: datetime, months: int) -> datetime:
    """Return the same day and time `months` later; the last day of the month where that day does not exist.

    Raises `OverflowError` after the year 9999.
    """
    index = moment.month - 1 + months
    year, month = moment.year + index // 12, index % 12 + 1
    if year > 9999:
        raise OverflowError(f"{months} months after {moment.isoformat()} is after the year 9999")
    day = min(moment.day, calendar.monthrange(year, month)[1])
    return moment.replace(year=year, month=month, day=day)
