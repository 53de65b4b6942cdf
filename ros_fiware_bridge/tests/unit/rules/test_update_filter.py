"""The update filter: rate limit, change detection and dead bands."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.mapping.values import DeadBand
from handover_ros.rules.update_filter import UpdateFilter, differs

ONE = DeadBand(absolute=1.0)
TENTH = DeadBand(relative=0.1)


@pytest.mark.parametrize(
    ("before", "now", "band", "is_another"),
    [
        (1.0, 1.0, None, False),
        (1.0, 1.5, None, True),
        (1.0, 2.0, ONE, False),
        (1.0, 2.1, ONE, True),
        (100.0, 110.0, TENTH, False),
        (100.0, 111.0, TENTH, True),
        (0.0, 0.001, TENTH, True),
        (0.0, 0.001, DeadBand(absolute=0.01, relative=0.1), False),
        ([1.0, 2.0], [1.5, 2.5], ONE, False),
        ([1.0, 2.0], [1.5, 3.5], ONE, True),
        ([1.0], [1.0, 1.0], ONE, True),
        ({"x": 1.0}, {"x": 1.5}, ONE, False),
        ({"x": 1.0}, {"y": 1.0}, ONE, True),
        ("idle", "busy", ONE, True),
        (1, True, None, True),
        (True, True, ONE, False),
    ],
)
def test_values_differ_by_more_than_the_dead_band(
    before: Any, now: Any, band: DeadBand | None, is_another: bool
) -> None:
    assert differs(before, now, band) is is_another


def test_without_options_every_state_is_written() -> None:
    update_filter = UpdateFilter()
    update_filter.record("e", {"a": 1}, 0.0)
    assert update_filter.is_change("e", {"a": 1}, 0.0)
    assert update_filter.wait_s("e", 0.0) == 0.0


def test_the_rate_of_each_entity_is_limited() -> None:
    update_filter = UpdateFilter(every_s=1.0)
    update_filter.record("e", {"a": 1}, 10.0)
    assert update_filter.wait_s("e", 10.25) == 0.75
    assert update_filter.wait_s("e", 11.0) == 0.0
    assert update_filter.wait_s("other", 10.25) == 0.0


def test_an_unchanged_state_is_written_at_intervals() -> None:
    update_filter = UpdateFilter(on_change=True, at_least_every_s=30.0)
    update_filter.record("e", {"a": 1}, 0.0)
    assert not update_filter.is_change("e", {"a": 1}, 29.9)
    assert update_filter.is_change("e", {"a": 1}, 30.0)
    assert update_filter.is_change("e", {"a": 2}, 1.0)
    assert update_filter.is_change("e", {"a": 1, "b": 1}, 1.0)


def test_a_forgotten_state_is_a_change() -> None:
    update_filter = UpdateFilter(on_change=True)
    update_filter.record("e", {"a": 1}, 0.0)
    update_filter.forget("e")
    assert update_filter.is_change("e", {"a": 1}, 0.0)


@given(st.lists(st.floats(-100, 100), min_size=1, max_size=50))
def test_the_written_value_is_within_the_dead_band(values: list[float]) -> None:
    update_filter = UpdateFilter(dead_bands={"a": ONE})
    written: float | None = None
    for value in values:
        if update_filter.is_change("e", {"a": value}, 0.0):
            update_filter.record("e", {"a": value}, 0.0)
            written = value
        assert written is not None
        assert abs(value - written) <= 1.0


def test_the_oldest_entities_are_forgotten_over_the_limit() -> None:
    update_filter = UpdateFilter(on_change=True, max_entities=2)
    for name in "abc":
        update_filter.record(name, {"v": 1}, 0.0)
    assert [update_filter.is_change(name, {"v": 1}, 0.0) for name in "abc"] == [True, False, False]
