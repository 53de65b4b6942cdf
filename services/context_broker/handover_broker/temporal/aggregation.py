"""Aggregation of series of values by period (clause 4.5.19 of ETSI GS CIM 009).

Numbers have all methods; a boolean counts as 1 or 0 and a list as its length. Texts and dates have min and
max. All other values can only be counted.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import orjson

from handover_broker.model.validation import written_time
from handover_broker.temporal.durations import MAX_TIME, Duration

COUNTED_ONLY: Final = frozenset(
    {"Relationship", "ListRelationship", "LanguageProperty", "VocabProperty", "JsonProperty", "GeoProperty"}
)
"""Types of attributes whose values have no order."""
_MAX_INTEGER: Final = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Aggregation:
    """The requested methods, and the duration of each period."""

    methods: tuple[str, ...]
    period: Duration


@dataclass(frozen=True, slots=True)
class Period:
    """A period with its values; times in microseconds since 1970."""

    start: int
    end: int
    values: list[Any]


@dataclass(frozen=True, slots=True)
class Total:
    """The aggregated values of a period by method; None where a method does not apply to the values."""

    start: int
    end: int
    values: dict[str, Any]


def periods(points: Sequence[tuple[int, Any]], duration: Duration, origin: int, end: int) -> list[Period]:
    """Split `points` (time and value, oldest first) into periods from `origin` on; empty periods are left
    out.

    `end` is the end of the single period that spans all the time (PT0S).
    """
    if not points:
        return []
    if duration.is_everything:
        return [Period(origin, end, [value for _, value in points])]
    result: list[Period] = []
    until = -1
    for at, value in points:
        if at >= until and not (result and until >= MAX_TIME):
            number = duration.number(origin, at)
            until = duration.boundary(origin, number + 1)
            result.append(Period(duration.boundary(origin, number), until, []))
        result[-1].values.append(value)
    return result


def totals(spans: Iterable[Period], kind: str, methods: Iterable[str]) -> list[Total]:
    """Return the aggregated values of each period."""
    wanted = tuple(methods)
    return [
        Total(period.start, period.end, {method: measure(method, kind, period.values) for method in wanted})
        for period in spans
    ]


def written_totals(all_totals: Iterable[Total], methods: Iterable[str]) -> dict[str, list[list[Any]]]:
    """Return the aggregated values by method, each with the start and end of its period."""
    result: dict[str, list[list[Any]]] = {method: [] for method in methods}
    for total in all_totals:
        start, end = written_time(total.start), written_time(total.end)
        for method, value in total.values.items():
            if value is not None:
                result[method].append([value, start, end])
    return result


def measure(method: str, kind: str, values: Sequence[Any]) -> Any:
    """Return the aggregation of `values` (not empty), None if the method does not apply."""
    if method == "totalCount":
        return len(values)
    if method == "distinctCount":
        return len({orjson.dumps(value, option=orjson.OPT_SORT_KEYS) for value in values})
    if kind in COUNTED_ONLY:
        return None
    numbers = [number for value in values if (number := _number(value)) is not None]
    if numbers:
        return _fitting(METHODS[method](numbers))
    texts = [text for value in values if (text := _text(value)) is not None]
    if texts and method in _ORDERED:
        return _ORDERED[method](texts)
    return None


def _number(value: Any) -> float | None:
    if isinstance(value, list):
        return len(value)
    if isinstance(value, dict):
        value = value.get("@value")
    return value if isinstance(value, int | float) else None


def _text(value: Any) -> str | None:
    if isinstance(value, dict):
        value = value.get("@value")
    return value if isinstance(value, str) else None


def _fitting(number: float) -> float | None:
    """Return a number as JSON can carry it: integers up to 64 bits, booleans as numbers; None if it
    cannot."""
    if isinstance(number, int):
        return int(number) if abs(number) <= _MAX_INTEGER else float(number)
    return number if math.isfinite(number) else None


def _sum(numbers: Sequence[float]) -> float:
    if all(isinstance(number, int) for number in numbers):
        return sum(numbers)
    try:
        return math.fsum(numbers)
    except OverflowError:
        return sum(float(number) for number in numbers)


def _average(numbers: Sequence[float]) -> float:
    return _sum(numbers) / len(numbers)


def _deviation(numbers: Sequence[float]) -> float:
    """Return the population standard deviation; that of a sample needs two values."""
    mean = _average(numbers)
    return math.sqrt(
        _sum([(float(number) - mean) * (float(number) - mean) for number in numbers]) / len(numbers)
    )


def _sum_of_squares(numbers: Sequence[float]) -> float:
    return _sum([number * number for number in numbers])


METHODS: Final[dict[str, Callable[[Sequence[float]], float]]] = {
    "totalCount": len,
    "distinctCount": len,
    "sum": _sum,
    "avg": _average,
    "min": min,
    "max": max,
    "stddev": _deviation,
    "sumsq": _sum_of_squares,
}
"""The methods of the standard with their functions for numbers."""
_ORDERED: Final[dict[str, Callable[[Sequence[str]], str]]] = {"min": min, "max": max}
