"""Aggregation: periods of calendar and clock, and the methods for each type of value."""

from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.model.validation import MICROS, written_time
from handover_broker.temporal.aggregation import METHODS, measure, periods, totals, written_totals
from handover_broker.temporal.durations import (
    MAX_TIME,
    Duration,
    read_duration,
)

HOUR = 3600 * MICROS
DAY = 24 * HOUR


def micros(text: str) -> int:
    return (datetime.fromisoformat(text) - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1)


@pytest.mark.parametrize(
    ("text", "months", "length"),
    [
        ("PT1H", 0, HOUR),
        ("P1D", 0, DAY),
        ("P2W", 0, 14 * DAY),
        ("P1Y2M", 14, 0),
        ("P3Y6M4DT12H30M5S", 42, 4 * DAY + 12 * HOUR + 1805 * MICROS),
        ("PT0.25S", 0, MICROS // 4),
        ("PT0S", 0, 0),
        ("P0D", 0, 0),
    ],
)
def test_a_duration_is_parsed(text: str, months: int, length: int) -> None:
    assert read_duration(text, "d") == Duration(months, length)


@pytest.mark.parametrize(
    "text", ["", "P", "PT", "1H", "P1H", "PT1D", "P-1D", "P1.5D", "P99999999D", "p1d", "P1DT"]
)
def test_an_invalid_duration_is_refused(text: str) -> None:
    with pytest.raises(Problem) as refused:
        read_duration(text, "aggrPeriodDuration")
    assert refused.value.status == 400
    assert "aggrPeriodDuration" in (refused.value.detail or "")


@given(st.text(alphabet="PT0123456789YMWDHS.,", max_size=12))
def test_any_text_is_a_duration_or_refused(text: str) -> None:
    try:
        found = read_duration(text, "d")
    except Problem:
        return
    if not found.is_everything:
        assert found.boundary(0, 1) <= MAX_TIME
        assert found.number(0, 5 * DAY) >= 0


def test_months_are_calendar_months() -> None:
    origin = micros("2024-01-31T00:00:00+00:00")
    month = read_duration("P1M", "d")
    starts = [written_time(month.boundary(origin, count)) for count in range(4)]
    assert starts == [
        "2024-01-31T00:00:00Z", "2024-02-29T00:00:00Z", "2024-03-31T00:00:00Z", "2024-04-30T00:00:00Z"
    ]  # fmt: skip


def test_a_time_with_an_offset_lies_in_the_period_of_its_instant() -> None:
    day = read_duration("P1D", "d")
    origin = micros("2024-05-01T00:00:00+00:00")
    assert day.number(origin, micros("2024-05-02T01:30:00+03:00")) == 0
    assert day.number(origin, micros("2024-05-01T22:30:00-03:00")) == 1


@given(
    st.integers(0, 400).filter(bool) | st.just(1),
    st.sampled_from(["months", "hours"]),
    st.integers(0, 4 * 10**9),
    st.integers(0, 10**9),
)
def test_every_time_lies_in_its_period(count: int, unit: str, start_s: int, later_s: int) -> None:
    duration = Duration(count, 0) if unit == "months" else Duration(0, count * HOUR)
    origin = start_s * MICROS
    at = origin + later_s * MICROS
    number = duration.number(origin, at)
    assert duration.boundary(origin, number) <= at < duration.boundary(origin, number + 1)


@given(
    st.lists(st.tuples(st.integers(0, 100 * DAY), st.integers(-100, 100)), max_size=30),
    st.sampled_from(["PT1H", "P1D", "P1M", "P7DT3H", "PT0S"]),
)
def test_periods_hold_every_point_once_and_in_order(points: list[tuple[int, int]], text: str) -> None:
    points.sort(key=lambda point: point[0])
    found = periods(points, read_duration(text, "d"), 0, 100 * DAY + 1)
    assert [value for period in found for value in period.values] == [said for _, said in points]
    assert all(period.values for period in found)
    assert all(one.end <= other.start for one, other in pairwise(found))
    rest = iter(points)
    for period in found:
        for _ in period.values:
            assert period.start <= next(rest)[0] < period.end


NUMBERS = [2, 4, 4, 4, 5, 5, 7, 9]


@pytest.mark.parametrize(
    ("method", "value"),
    [
        ("totalCount", 8), ("distinctCount", 5), ("sum", 40), ("avg", 5), ("min", 2), ("max", 9),
        ("stddev", 2), ("sumsq", 232),
    ],
)  # fmt: skip
def test_numbers_have_every_method(method: str, value: float) -> None:
    assert measure(method, "Property", NUMBERS) == value


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ([True, False, True, True], {"totalCount": 4, "distinctCount": 2, "sum": 3, "avg": 0.75, "max": 1}),
        (
            [[1, 2], [], [1, 2, 3, 4]],
            {"distinctCount": 3, "sum": 6, "avg": 2, "min": 0, "max": 4, "sumsq": 20},
        ),
        (["b", "a", "b"], {"distinctCount": 2, "min": "a", "max": "b", "sum": None, "avg": None}),
        ([{"a": 1, "b": 2}, {"b": 2, "a": 1}], {"totalCount": 2, "distinctCount": 1, "min": None}),
        (
            [
                {"@type": "DateTime", "@value": "2024-01-02T00:00:00Z"},
                {"@type": "DateTime", "@value": "2023"},
            ],
            {"min": "2023", "max": "2024-01-02T00:00:00Z", "avg": None},
        ),
    ],
)
def test_other_values_have_the_applicable_methods(said: list[Any], expected: dict[str, Any]) -> None:
    assert {method: measure(method, "Property", said) for method in expected} == expected


def test_relationships_can_only_be_counted() -> None:
    said = ["urn:a", "urn:b", "urn:a"]
    found = {method: measure(method, "Relationship", said) for method in METHODS}
    assert {method: value for method, value in found.items() if value is not None} == {
        "totalCount": 3,
        "distinctCount": 2,
    }


def test_sums_beyond_64_bits_are_valid_json_numbers() -> None:
    assert measure("sum", "Property", [2**62, 2**62, 2**62]) == float(3 * 2**62)
    assert isinstance(measure("sumsq", "Property", [2**62]), float)
    assert measure("sum", "Property", [1e308, 1e308]) is None


def test_an_inapplicable_method_has_no_rows() -> None:
    found = totals(periods([(0, "a"), (5, 3)], read_duration("PT1S", "d"), 0, 6), "Property", ["avg", "max"])
    rows = written_totals(found, ["avg", "max"])
    assert rows == {
        "avg": [[3, "1970-01-01T00:00:00Z", "1970-01-01T00:00:01Z"]],
        "max": [[3, "1970-01-01T00:00:00Z", "1970-01-01T00:00:01Z"]],
    }
