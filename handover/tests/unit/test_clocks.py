"""Lifetimes and steady times under clocks that jump."""

from hypothesis import given
from hypothesis import strategies as st

from handover.runtime.clocks import SET_BACK_S, Lifetime, SteadyTime, steady_s

SECONDS = st.floats(0, 1e5)
JUMPS = st.floats(-1e5, 1e5)


@given(life_s=st.floats(1, 1e4), passed_s=SECONDS, jump_s=JUMPS)
def test_nothing_outlives_its_life_by_any_clock(life_s: float, passed_s: float, jump_s: float) -> None:
    life = Lifetime.begin(life_s, steady=lambda: 50.0, wall=lambda: 1e9)
    age_s = life.age_s(steady=lambda: 50.0 + passed_s, wall=lambda: 1e9 + passed_s + jump_s)
    is_over = life.is_over(steady=lambda: 50.0 + passed_s, wall=lambda: 1e9 + passed_s + jump_s)
    assert age_s >= passed_s - 1e-3
    assert is_over == (age_s >= life_s)
    if passed_s + jump_s < -SET_BACK_S - 1e-3:
        assert is_over, "a wall clock that was set back says nothing about the age"
    if abs(jump_s) <= 1e-3:
        assert abs(age_s - passed_s) <= 1e-2, "without a jump it is the time that has passed"


@given(passed_s=SECONDS, jump_s=JUMPS)
def test_a_steady_time_does_not_jump(passed_s: float, jump_s: float) -> None:
    steady, wall = [50.0], [1e9]
    now_s = SteadyTime(steady=lambda: steady[0], wall=lambda: wall[0])
    before_s = now_s()
    steady[0] += passed_s
    wall[0] += passed_s + jump_s
    assert abs(now_s() - before_s - passed_s) < 1e-3


def test_the_steady_clock_runs() -> None:
    before_s = steady_s()
    assert steady_s() >= before_s
