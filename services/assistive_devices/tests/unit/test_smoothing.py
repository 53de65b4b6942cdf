"""Smoothing of commands and limits: no overshoot, and never a rise above the target."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_cases.model.smoothing import AT_REST, Smoothed, within_rate

STEPS = st.lists(st.tuples(st.floats(-2, 2), st.floats(0, 0.3)), max_size=60)


def test_the_worked_example() -> None:
    value, found = AT_REST, []
    for step in range(1, 41):
        value = value.step(1.0, 0.05, 0.5)
        if step in {10, 20, 40}:
            found.append(round(value.value, 2))
    assert found == [0.26, 0.59, 0.91]


@settings(max_examples=60)
@given(steps=STEPS)
def test_the_value_stays_within_the_targets_and_never_moves_away(steps: list[tuple[float, float]]) -> None:
    value, low, high = AT_REST, 0.0, 0.0
    for target, dt_s in steps:
        before, value = value, value.step(target, dt_s, 0.4)
        low, high = min(low, target), max(high, target)
        assert low - 1e-9 <= value.value <= high + 1e-9
        assert abs(value.value - target) <= abs(before.value - target) + 1e-9


def test_large_steps_are_stable() -> None:
    assert AT_REST.step(1.0, 1000.0, 0.1).value == pytest.approx(1.0)


def test_a_target_that_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="must be a finite number"):
        Smoothed(0.5).step(math.nan, 0.05, 0.4)


@given(value=st.floats(-2, 2), target=st.floats(-2, 2), dt_s=st.floats(0, 0.2))
def test_a_rate_limits_the_magnitude(value: float, target: float, dt_s: float) -> None:
    limited = within_rate(value, target, 0.6, 0.9, dt_s)
    assert abs(limited) <= abs(value) + 0.6 * dt_s + 1e-9
    assert abs(limited) >= abs(value) - 0.9 * dt_s - 1e-9
    assert abs(limited) <= max(abs(value), abs(target)) + 1e-9
    assert value * limited >= 0, "a change of sign passes through 0"
