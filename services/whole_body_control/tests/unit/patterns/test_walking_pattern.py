"""The pattern generator keeps the ZMP inside of the standing feet, goes where it should, and stops level."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_humanoid.balance.contact_forces import nearest_in_sole
from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.footsteps import (
    Footsteps,
    Stance,
    StepLimits,
    Wish,
    swing_position,
)
from handover_humanoid.patterns.pendulum import Pendulum, PendulumState
from handover_humanoid.patterns.regions import Footprint, Region, turn
from handover_humanoid.patterns.walking import TOLERATED_M, WalkingPattern
from handover_humanoid.patterns.zmp_control import MARGIN_M, PERIOD_S, Unplannable, ZmpControl

SOLE = np.array([[0.13, 0.05], [0.13, -0.05], [-0.07, -0.05], [-0.07, 0.05]])
LIMITS = StepLimits(width_m=0.15, min_width_m=0.12, max_width_m=0.22, max_length_m=0.1)
START = Stance(Footprint("left", 0.0, 0.075), Footprint("right", 0.0, -0.075))
PENDULUM = Pendulum(0.515)
STILL = Wish(np.zeros(2))


def walker() -> WalkingPattern:
    return WalkingPattern(ZmpControl(PENDULUM), LIMITS, SOLE, START)


def feet_down(stance: Stance) -> tuple[Footprint, ...]:
    return (stance.support,) if stance.phase == "single" else (stance.left, stance.right)


def test_the_rate_of_the_pendulum_is_that_of_coman() -> None:
    assert PENDULUM.omega == pytest.approx(4.36, abs=0.01)
    with pytest.raises(ValueError, match="high"):
        Pendulum(0.0)


@given(seed=st.integers(0, 2**32 - 1), dt_s=st.floats(0.001, 0.2))
def test_the_pendulum_obeys_its_equation(seed: int, dt_s: float) -> None:
    """Two halves are a whole, the energy of the capture point grows with omega, and x'' = omega² (x - p)."""
    rng = np.random.default_rng(seed)
    state, rate = PendulumState(*rng.normal(size=(3, 2))), rng.normal(size=2)
    whole = PENDULUM.advance(state, rate, dt_s)
    halves = PENDULUM.advance(PENDULUM.advance(state, rate, dt_s / 2), rate, dt_s / 2)
    assert np.array([whole.com, whole.velocity, whole.zmp]) == pytest.approx(
        np.array([halves.com, halves.velocity, halves.zmp]), abs=1e-9
    )
    a, b = PENDULUM.transition(dt_s)  # what the planner uses
    by_matrix = a @ np.vstack([state.com, state.velocity, state.zmp]) + np.outer(b, rate)
    assert np.vstack([whole.com, whole.velocity, whole.zmp]) == pytest.approx(by_matrix, abs=1e-9)
    soon = PENDULUM.advance(state, rate, 1e-6)
    acceleration = (soon.velocity - state.velocity) / 1e-6
    assert acceleration == pytest.approx(PENDULUM.omega**2 * (state.com - state.zmp), abs=1e-3)
    fixed = PENDULUM.advance(state, np.zeros(2), dt_s)
    away = PENDULUM.capture_point(state) - state.zmp
    assert PENDULUM.capture_point(fixed) - state.zmp == pytest.approx(
        np.exp(PENDULUM.omega * dt_s) * away, abs=1e-9
    )


@given(
    wishes=st.lists(
        st.tuples(st.floats(-0.1, 0.1), st.floats(-0.05, 0.05), st.floats(-0.1, 0.1)), min_size=1, max_size=4
    )
)
@settings(max_examples=10)
def test_the_planned_zmp_stays_a_centimetre_inside(wishes: list[tuple[float, float, float]]) -> None:
    pattern = walker()
    for ahead, aside, yaw_rate in wishes:
        for _ in range(17):
            step = pattern.step(Wish(np.array([ahead, aside]), yaw_rate))
            assert step.plan.excess_m == 0.0
            region = Region.of(feet_down(step.stance), SOLE)
            first, second = step.plan.states[:2]
            for share in (0.0, 0.3, 0.7, 1.0):
                zmp = first.zmp + share * (second.zmp - first.zmp)
                assert region.room_m(zmp) >= MARGIN_M - 1e-6
            reach = step.stance.left.place - step.stance.right.place
            assert LIMITS.min_width_m - 1e-6 <= np.linalg.norm(reach) <= 0.3


@given(ahead=st.floats(-0.1, 0.1), aside=st.floats(-0.04, 0.04))
@settings(max_examples=10)
def test_the_robot_goes_as_fast_as_wanted_and_stops_level(ahead: float, aside: float) -> None:
    pattern = walker()
    wanted = np.array([ahead, aside])
    for _ in range(40):
        pattern.step(Wish(wanted))
    before = pattern.state.com
    for _ in range(32):  # two strides
        pattern.step(Wish(wanted))
    if np.linalg.norm(wanted) > LIMITS.min_speed_mps:
        assert (pattern.state.com - before) / 3.2 == pytest.approx(wanted, abs=0.01)
    for _ in range(60):
        last = pattern.step(STILL)
    assert last.stance.phase == "standing"
    assert np.linalg.norm(last.plan.states[0].velocity) < 0.01
    assert (last.stance.left.place - last.stance.right.place)[1] == pytest.approx(LIMITS.width_m, abs=1e-3)


@given(on=st.integers(20, 36), off=st.integers(1, 12), aside=st.floats(-0.05, 0.05))
@settings(max_examples=20)
def test_a_robot_that_is_to_walk_on_while_it_stops_first_comes_over_a_foot(
    on: int, off: int, aside: float
) -> None:
    pattern, wish = walker(), Wish(np.array([0.06, aside]))
    for period in range(on + off + 10):
        step = pattern.step(STILL if on <= period < on + off else wish)
        assert step.plan.excess_m < 1e-4


def test_a_step_that_began_is_finished() -> None:
    pattern = walker()
    wish = Wish(np.array([0.08, 0.0]))
    while pattern.stance.phase != "single":
        pattern.step(wish)
    phases = [pattern.step(STILL).stance.phase for _ in range(LIMITS.single + 1)]
    assert phases == ["single"] * LIMITS.single + ["double"]


def test_a_push_moves_the_landing_towards_the_capture_point() -> None:
    pushed, calm = walker(), walker()
    wish = Wish(np.array([0.05, 0.0]))
    while pushed.stance.phase != "single":
        pushed.step(wish)
        calm.step(wish)
    aside = np.array([0.02, 0.02 if calm.stance.swing == "left" else -0.02])
    with_push, without = pushed.step(wish, aside), calm.step(wish)
    assert with_push.stance.landing is not None
    assert without.stance.landing is not None
    moved = with_push.stance.landing.place - without.stance.landing.place
    assert moved == pytest.approx(aside * (1 - TOLERATED_M / 0.02), abs=1e-9)


def test_a_push_that_no_motion_can_take_is_reported() -> None:
    pattern = walker()
    state = pattern.state
    fallen = PendulumState(state.com, np.array([2.0, 0.0]), state.zmp)
    control = ZmpControl(PENDULUM)
    plan = control.plan(fallen, [START.region(SOLE)] * control.samples, np.zeros(2))
    assert plan.excess_m > 0.05
    assert np.isfinite(plan.zmp_velocities).all()


def test_what_is_not_finite_is_refused() -> None:
    pattern = walker()
    with pytest.raises(Unplannable, match="not finite"):
        pattern.step(Wish(np.array([np.nan, 0.0])))
    with pytest.raises(Unplannable, match="16 samples"):
        ZmpControl(PENDULUM).plan(pattern.state, [], np.zeros(2))


def test_step_limits_that_contradict_are_named() -> None:
    with pytest.raises(ValueError, match="side by side"):
        StepLimits(width_m=0.1, min_width_m=0.12, max_width_m=0.2, max_length_m=0.1)


@given(x=st.floats(-0.3, 0.3), y=st.floats(-0.3, 0.3))
def test_what_is_walked_of_a_wish_is_what_the_steps_make_of_it(x: float, y: float) -> None:
    steps, wish = Footsteps(LIMITS, PERIOD_S), Wish(np.array([x, y]))
    stance, moved, periods = START, [np.zeros(2)], 2 * (LIMITS.single + LIMITS.double)
    for _ in range(6):
        for _ in range(periods):
            stance = steps.after(stance, wish)
        moved.append((stance.left.place + stance.right.place) / 2)
    assert steps.walked(wish).velocity == pytest.approx(
        (moved[-1] - moved[-2]) / (periods * PERIOD_S), abs=1e-9
    )


@given(rate=st.floats(-2, 2))
def test_what_is_turned_of_a_wish_is_what_the_steps_make_of_it(rate: float) -> None:
    steps, wish = Footsteps(LIMITS, PERIOD_S), Wish(np.zeros(2), rate)
    stance, turned, periods = START, [0.0], 2 * (LIMITS.single + LIMITS.double)
    for _ in range(6):
        for _ in range(periods):
            stance = steps.after(stance, wish)
        turned.append((stance.left.yaw + stance.right.yaw) / 2)
    assert steps.walked(wish).yaw_rate == pytest.approx((turned[-1] - turned[-2]) / (periods * PERIOD_S))


@given(
    x=st.floats(-1, 1), y=st.floats(-1, 1), rate=st.floats(-2, 2), swing=st.sampled_from(["left", "right"])
)
def test_feet_never_cross(x: float, y: float, rate: float, swing: str) -> None:
    single = Stance(START.left, START.right, "single", 6, swing)  # type: ignore[arg-type]
    placed = Footsteps(LIMITS, PERIOD_S).placed(single, Wish(np.array([x, y]), rate))
    assert placed.landing is not None
    apart = placed.landing.y - single.support.y
    assert LIMITS.min_width_m - 1e-9 <= abs(apart) <= LIMITS.max_width_m + 1e-9
    assert (apart > 0) == (swing == "left")
    assert abs(placed.landing.x - single.support.x) <= LIMITS.max_length_m + 1e-9


def test_a_swing_begins_and_ends_at_rest() -> None:
    landing = Footprint("left", 0.1, 0.08)

    def at(share: float) -> Array:
        return swing_position(START.left, landing, share, 0.03)

    assert at(0.0) == pytest.approx([0.0, 0.075, 0.0])
    assert at(1.0) == pytest.approx([0.1, 0.08, 0.0])
    assert at(0.5)[2] == pytest.approx(0.03)
    for end in (0.0, 1.0):
        assert at(end) == pytest.approx(at(abs(end - 1e-4)), abs=1e-9)


@given(*[st.floats(-1.0, 1.0)] * 4, st.floats(-3.0, 3.0))
def test_the_nearest_point_of_a_sole_is_within_and_nearest(
    x: float, y: float, foot_x: float, foot_y: float, yaw: float
) -> None:
    foot, point = Footprint("left", foot_x, foot_y, yaw), np.array([x, y])
    sole = np.array([[0.1, 0.05], [0.1, -0.04], [-0.06, -0.04], [-0.06, 0.05]])
    nearest = nearest_in_sole(foot, sole, point, 0.01)
    region = Region.of([foot], sole)
    assert region.room_m(nearest) >= 0.01 - 1e-9
    inside = foot.to_ground(np.random.default_rng(0).uniform([-0.05, -0.03], [0.09, 0.04], size=(50, 2)))
    assert (np.linalg.norm(inside - point, axis=1) >= np.linalg.norm(nearest - point) - 1e-9).all()
    if region.room_m(point) >= 0.01:
        assert nearest == pytest.approx(point)
    assert turn(yaw) @ turn(-yaw) == pytest.approx(np.eye(2))
