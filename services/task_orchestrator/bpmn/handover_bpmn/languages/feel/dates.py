"""Functions of FEEL over dates and durations."""

import calendar
from collections.abc import Mapping
from datetime import date

from handover.formats.durations import Duration
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.languages.feel.function import Function, typed
from handover_bpmn.languages.feel.values import (
    Budget,
    FeelValue,
    order,
    to_date,
    to_datetime,
    to_duration,
    to_json,
)

_DAYS = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")
_MONTHS = (
    *("January", "February", "March", "April", "May", "June", "July"),
    *("August", "September", "October", "November", "December"),
)


def _date(_: Budget, *parts: FeelValue) -> FeelValue:
    if len(parts) == 1:
        return to_date(parts[0])
    if len(parts) != 3 or not all(isinstance(part, int) and not isinstance(part, bool) for part in parts):
        return None
    try:
        return date(*parts)
    except (ValueError, OverflowError):
        return None


@typed(date)
def _day_of_week(_: Budget, value: date) -> FeelValue:
    return _DAYS[value.weekday()]


@typed(date)
def _month_of_year(_: Budget, value: date) -> FeelValue:
    return _MONTHS[value.month - 1]


@typed(date)
def _last_day_of_month(_: Budget, value: date) -> FeelValue:
    return date(value.year, value.month, calendar.monthrange(value.year, value.month)[1])


@typed(date, date)
def _months_between(budget: Budget, start: date, end: date) -> FeelValue:
    if order(start, end, budget) is None:
        raise ExpressionError(
            "years and months duration() needs two dates, or two dates and times that both have an offset "
            "or both have none"
        )
    first, last = min(start, end), max(start, end)
    months = (last.year - first.year) * 12 + last.month - first.month - (last.day < first.day)
    return Duration(months if start <= end else -months, 0)


def _cycle(budget: Budget, *parts: FeelValue) -> FeelValue:
    """Return the text of a timer that repeats, as the function of Zeebe does."""
    *counts, interval = parts
    if not isinstance(interval, Duration):
        return None
    every = to_json(interval, budget)
    if not counts or counts[0] is None:
        return f"R/{every}"
    count = counts[0]
    return f"R{count}/{every}" if isinstance(count, int) and not isinstance(count, bool) else None


DATE_FUNCTIONS: Mapping[str, Function] = {
    "date": Function(_date, 1, 3),
    "date and time": Function(lambda _, value: to_datetime(value), 1, 1),
    "duration": Function(lambda _, value: to_duration(value), 1, 1),
    "day of week": _day_of_week,
    "month of year": _month_of_year,
    "day of year": typed(date)(lambda _, value: value.timetuple().tm_yday),
    "week of year": typed(date)(lambda _, value: value.isocalendar().week),
    "last day of month": _last_day_of_month,
    "years and months duration": _months_between,
    "cycle": Function(_cycle, 1, 2),
}
