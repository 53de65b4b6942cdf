"""The cycles of a machine: at their pace, and after a late one neither at once nor in a burst."""

from hypothesis import given
from hypothesis import strategies as st

from handover_cases.running.machine_runner import PERIOD_S, next_due_s


def test_a_cycle_in_time_is_followed_a_period_after_it_was_due() -> None:
    assert next_due_s(10.0, 10.0 + 0.4 * PERIOD_S) == 10.0 + PERIOD_S


@given(st.floats(0, 1e6), st.floats(0, 100))
def test_after_a_late_cycle_half_a_period_passes_at_least(due_s: float, late_s: float) -> None:
    wait_s = next_due_s(due_s, due_s + late_s) - (due_s + late_s)
    assert 0.49 * PERIOD_S <= wait_s <= 1.01 * PERIOD_S
