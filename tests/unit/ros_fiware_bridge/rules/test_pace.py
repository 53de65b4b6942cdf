"""Pace: what is told, how often, and how little must have changed."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ros_fiware_bridge.mapping.values import DeadBand
from ros_fiware_bridge.rules.pace import Pace, differs

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
def test_what_counts_as_another_value(before: Any, now: Any, band: DeadBand | None, is_another: bool) -> None:
    assert differs(before, now, band) is is_another


def test_a_rule_without_a_wish_tells_everything() -> None:
    pace = Pace()
    pace.told("e", {"a": 1}, 0.0)
    assert pace.is_news("e", {"a": 1}, 0.0)
    assert pace.waits_s("e", 0.0) == 0.0


def test_an_entity_is_told_at_most_so_often_and_each_on_its_own() -> None:
    pace = Pace(every_s=1.0)
    pace.told("e", {"a": 1}, 10.0)
    assert pace.waits_s("e", 10.25) == 0.75
    assert pace.waits_s("e", 11.0) == 0.0
    assert pace.waits_s("other", 10.25) == 0.0


def test_without_change_there_is_a_sign_of_life_all_the_same() -> None:
    pace = Pace(on_change=True, at_least_every_s=30.0)
    pace.told("e", {"a": 1}, 0.0)
    assert not pace.is_news("e", {"a": 1}, 29.9)
    assert pace.is_news("e", {"a": 1}, 30.0)
    assert pace.is_news("e", {"a": 2}, 1.0)
    assert pace.is_news("e", {"a": 1, "b": 1}, 1.0)


def test_what_the_broker_does_not_have_is_news_again() -> None:
    pace = Pace(on_change=True)
    pace.told("e", {"a": 1}, 0.0)
    pace.forget("e")
    assert pace.is_news("e", {"a": 1}, 0.0)


@given(st.lists(st.floats(-100, 100), min_size=1, max_size=50))
def test_what_is_told_is_never_further_from_the_truth_than_the_dead_band(values: list[float]) -> None:
    pace = Pace(dead_bands={"a": ONE})
    told: float | None = None
    for value in values:
        if pace.is_news("e", {"a": value}, 0.0):
            pace.told("e", {"a": value}, 0.0)
            told = value
        assert told is not None
        assert abs(value - told) <= 1.0


def test_of_many_entities_the_oldest_are_forgotten() -> None:
    pace = Pace(on_change=True, most_entities=2)
    for name in "abc":
        pace.told(name, {"v": 1}, 0.0)
    assert [pace.is_news(name, {"v": 1}, 0.0) for name in "abc"] == [True, False, False]
