"""Durations as ISO 8601 writes them (`P1M`, `PT15M`), and the periods that a time line is cut into by them.

A month is a month of the calendar in UTC, whatever its length; clause 4.5.19 of ETSI GS CIM 009.
"""

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Final

from services.context_broker.api.problems import bad_request_data
from services.context_broker.api.words import shown

MICROS: Final = 1_000_000
"""Microseconds in a second: times here are whole microseconds since 1970."""
MAX_MONTHS: Final = 12 * 10_000
MAX_TIME: Final = 253_402_300_799 * MICROS
"""The end of the year 9999: the calendar knows nothing after it."""

_DURATION: Final = re.compile(
    r"P(?=.)(?:(\d{1,5})Y)?(?:(\d{1,6})M)?(?:(\d{1,7})W)?(?:(\d{1,7})D)?"
    r"(?:T(?=.)(?:(\d{1,9})H)?(?:(\d{1,9})M)?(?:(\d{1,11})(?:[.,](\d{1,6}))?S)?)?",
    re.ASCII,
)
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_DAY: Final = 86_400 * MICROS


@dataclass(frozen=True, slots=True)
class Duration:
    """Months of the calendar, and microseconds; nothing of both stands for all the time there is."""

    months: int
    micros: int

    @property
    def is_everything(self) -> bool:
        """Say whether one period spans the whole time (PT0S)."""
        return not (self.months or self.micros)

    def boundary(self, origin: int, count: int) -> int:
        """Return where period number `count` from `origin` begins, at most `LAST_TIME`."""
        start = origin + count * self.micros
        if self.months:
            try:
                start += _plus_months(origin, count * self.months) - origin
            except (OverflowError, ValueError):
                return MAX_TIME
        return min(start, MAX_TIME)

    def number(self, origin: int, at: int) -> int:
        """Return the number of the period from `origin` that `at` lies in; `at` is not before `origin`."""
        if not self.months:
            return (at - origin) // self.micros
        longest = self.months * 31 * _DAY + self.micros
        number = max(0, (at - origin) // longest)
        while self.boundary(origin, number + 1) <= at < MAX_TIME:
            number += 1
        return number


def read_duration(given: str, what: str) -> Duration:
    """Return an ISO 8601 duration; raise a problem (400) that names `what` for anything else."""
    found = _DURATION.fullmatch(given)
    if found is None:
        raise bad_request_data(
            f"{what} is a duration of ISO 8601 such as PT1H, P1D or P1M (PT0S for all the time), "
            f"not {shown(given)}"
        )
    *whole, fraction = found.groups()
    years, months, weeks, days, hours, minutes, seconds = (int(part or 0) for part in whole)
    micros = (((weeks * 7 + days) * 24 + hours) * 60 + minutes) * 60 + seconds
    months += years * 12
    if months > MAX_MONTHS or micros * MICROS > MAX_TIME:
        raise bad_request_data(f"{what} is longer than the calendar ({shown(given)}); ask for PT0S instead")
    return Duration(months, micros * MICROS + int((fraction or "0").ljust(6, "0")))


def written_time(at: int) -> str:
    """Return a time as NGSI-LD writes it, its fraction only if it has one."""
    seconds, micros = divmod(at, MICROS)
    text = (_EPOCH + timedelta(seconds=seconds)).strftime("%Y-%m-%dT%H:%M:%S")
    return f"{text.rjust(19, '0')}.{micros:06}Z" if micros else f"{text.rjust(19, '0')}Z"


def _plus_months(origin: int, months: int) -> int:
    moment = _EPOCH + timedelta(microseconds=origin)
    years, month = divmod(moment.month - 1 + months, 12)
    day = moment.day
    while True:
        try:
            moved = moment.replace(year=moment.year + years, month=month + 1, day=day)
            break
        except ValueError:  # the month is shorter: its last day is meant
            if day <= 28:
                raise
            day -= 1
    return (moved - _EPOCH) // timedelta(microseconds=1)
