"""ISO 8601 durations (`P1M`, `PT15M`), and the periods into which they divide time.

A month is a calendar month in UTC, whatever its length (clause 4.5.19 of ETSI GS CIM 009).
"""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Final

from handover.formats.durations import MAX_YEARS, add_months, parse_duration
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import MICROS, shown

MAX_TIME: Final = 253_402_300_799 * MICROS
"""The end of the year 9999, the last time in the calendar."""

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_DAY: Final = 86_400 * MICROS


@dataclass(frozen=True, slots=True)
class Duration:
    """Calendar months and microseconds; without both, the duration spans all the time."""

    months: int
    micros: int

    @property
    def is_everything(self) -> bool:
        """Return whether one period spans all the time (PT0S)."""
        return not (self.months or self.micros)

    def boundary(self, origin: int, count: int) -> int:
        """Return the start of period number `count` from `origin`, at most `MAX_TIME`."""
        start = origin + count * self.micros
        if self.months:
            try:
                start += _plus_months(origin, count * self.months) - origin
            except OverflowError:
                return MAX_TIME
        return min(start, MAX_TIME)

    def number(self, origin: int, at: int) -> int:
        """Return the number of the period from `origin` that contains `at`; `at` is not before `origin`."""
        if not self.months:
            return (at - origin) // self.micros
        longest = self.months * 31 * _DAY + self.micros
        number = max(0, (at - origin) // longest)
        while self.boundary(origin, number + 1) <= at < MAX_TIME:
            number += 1
        return number


def read_duration(text: str, what: str) -> Duration:
    """Return an ISO 8601 duration; raise a problem (400) that names `what` for invalid text."""
    try:
        duration = parse_duration(text)
    except ValueError:
        raise bad_request_data(
            f"{what} is a duration of ISO 8601 such as PT1H, P1D or P1M (PT0S for all the time), "
            f"of at most {MAX_YEARS} years, not {shown(text)}"
        ) from None
    return Duration(duration.months, duration.microseconds)


def _plus_months(origin: int, months: int) -> int:
    moved = add_months(_EPOCH + timedelta(microseconds=origin), months)
    return (moved - _EPOCH) // timedelta(microseconds=1)
