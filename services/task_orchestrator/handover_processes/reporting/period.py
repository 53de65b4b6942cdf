"""Period: the time that a report is about, as a request names it."""

from datetime import datetime, timedelta
from typing import Final

from handover.errors import Problem
from handover.messages import message
from handover_processes.tally import HOUR_MS, Period, hour_of, milliseconds

MAX_DAYS: Final = 366
DEFAULT_PERIOD: Final = timedelta(days=7)


def read_period(since: datetime | None, until: datetime | None, now: datetime) -> Period:
    """Return the hours that contain the time from `since` to `until`: by default the last seven days.

    Raises `Problem` 422 if the period is empty or longer than `MAX_DAYS`.
    """
    end = now if until is None else until
    begin = end - DEFAULT_PERIOD if since is None else since
    if begin >= end:
        raise _refused(
            message("statistics.empty_period", "the period is empty: since must be before until; swap them")
        )
    if end - begin > timedelta(days=MAX_DAYS):
        raise _refused(
            message(
                "statistics.long_period",
                "the period has {days} days; a report covers {max_days} days at most",
                days=(end - begin).days,
                max_days=MAX_DAYS,
            )
        )
    return Period(hour_of(begin), -(-milliseconds(end) // HOUR_MS))


def _refused(why: str) -> Problem:
    return Problem(422, "Bad period", why)
