"""The lead of the hands as an intention: direction, caps that keep it, hysteresis, faults, forces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.intention import ArmState
from handover_humanoid.patterns.lead import HoldStiffness, LeadLimits, LeadReference, hand_force

LIMITS = LeadLimits()
DT_S = 0.02
finite = st.floats(-2.0, 2.0)


def arm(lead: Array, seed: int = 0) -> ArmState:
    return ArmState(np.random.default_rng(seed).normal(scale=0.3, size=(3, 7)), np.zeros(3), lead)


def settled(reference: LeadReference, *leads: Array) -> Array:
    arms = {str(number): arm(lead) for number, lead in enumerate(leads)}
    for _ in range(150):
        intention = reference.update(arms, DT_S)
    return intention.velocity


@given(angle=st.floats(-3.14, 3.14), length=st.floats(0.09, 0.4), height=finite)
def test_the_velocity_has_the_direction_of_the_lead_and_is_slower_to_the_side(
    angle: float, length: float, height: float
) -> None:
    lead = np.array([length * np.cos(angle), length * np.sin(angle), height])
    velocity = settled(LeadReference(), lead, lead)
    assert velocity @ lead[:2] == pytest.approx(np.linalg.norm(velocity) * length, rel=1e-6)
    assert np.linalg.norm(velocity) <= LIMITS.max_mps + 1e-9
    assert abs(velocity[1]) <= LIMITS.max_left_mps + 1e-9


@given(places=st.lists(st.tuples(finite, finite), min_size=1, max_size=40), cap=st.none() | st.floats(0, 0.2))
def test_speed_and_acceleration_are_capped_whatever_the_hands_do(
    places: list[tuple[float, float]], cap: float | None
) -> None:
    reference, before = LeadReference(), np.zeros(2)
    for ahead, left in places:
        velocity = reference.update({"left": arm(np.array([ahead, left, 0.0]))}, DT_S, cap).velocity
        assert np.linalg.norm(velocity - before) <= LIMITS.max_mps2 * DT_S + 1e-12
        assert np.linalg.norm(velocity) <= LIMITS.max_mps + 1e-12
        before = velocity


def test_it_begins_farther_out_than_it_ends_and_rests_in_between() -> None:
    reference = LeadReference()

    def moves(ahead_m: float) -> bool:
        return bool(settled(reference, np.array([ahead_m, 0.0, 0.0])).any())

    assert [moves(distance_m) for distance_m in (0.09, 0.11, 0.07, 0.04, 0.09)] == [
        False,
        True,
        True,
        False,
        False,
    ]


def test_a_shock_of_a_foot_that_lands_does_not_turn_it() -> None:
    reference, ahead = LeadReference(), np.array([0.15, 0.0, 0.0])
    settled(reference, ahead)
    shock = arm(np.array([-0.8, 0.4, 0.0]))
    velocity = reference.update({"left": shock, "right": shock}, DT_S).velocity
    assert velocity[0] > 0
    assert abs(np.arctan2(velocity[1], velocity[0])) < np.radians(5)


def swaying(step: int, sway_m: float) -> float:
    return float(sway_m * np.sin(2 * np.pi * step * DT_S / 1.6))


@given(
    stiffness=st.floats(18.0, 60.0),
    sway_m=st.floats(0.02, 0.04),
    angle=st.floats(-3.14, 3.14),
    seed=st.integers(0, 99),
)
def test_the_stiffness_of_a_person_is_found_from_the_sway_of_the_hands(
    stiffness: float, sway_m: float, angle: float, seed: int
) -> None:
    hold, random = HoldStiffness(), np.random.default_rng(seed)
    person = 0.15 * np.array([np.cos(angle), np.sin(angle)])
    for step in range(800):
        hand = np.array([0.02, swaying(step, sway_m)])
        force = stiffness * (person - hand) + random.normal(scale=0.05 * stiffness * sway_m, size=2)
        estimate = hold.update(hand, force, DT_S)
    assert estimate == pytest.approx(stiffness, rel=0.3)


def test_a_person_who_changes_the_lead_is_not_taken_for_a_soft_one() -> None:
    hold, followed = HoldStiffness(), 0.0
    for step in range(800):
        ahead = 0.15 if step // 100 % 2 else -0.15
        followed += 0.1 * (0.2 * ahead - followed)  # compliant arms follow a little
        hand = np.array([followed, swaying(step, 0.02)])
        estimate = hold.update(hand, 40.0 * (np.array([ahead, 0.0]) - hand), DT_S)
    assert estimate == pytest.approx(40.0, rel=0.25)
    assert hold.update(np.array([np.nan, 0.0]), np.zeros(2), DT_S) == estimate
    hold.restart()
    assert hold.npm == HoldStiffness.DEFAULT_NPM


def test_hands_that_lead_apart_do_not_move_it() -> None:
    apart = np.array([0.2, 0.0, 0.0])
    assert settled(LeadReference(), apart, -apart) == pytest.approx(np.zeros(2))


def test_a_measurement_that_is_not_finite_stops_it_softly_and_is_named() -> None:
    reference, ahead = LeadReference(), np.array([0.2, 0.0, 0.0])
    before = settled(reference, ahead)
    broken = {"left": arm(ahead), "right": arm(np.array([np.nan, 0.0, 0.0]))}
    intention = reference.update(broken, DT_S)
    assert "right" in intention.fault
    assert np.linalg.norm(intention.velocity - before) == pytest.approx(LIMITS.max_mps2 * DT_S)
    for _ in range(50):
        intention = reference.update({}, DT_S)
    assert not intention.velocity.any()


@given(seed=st.integers(0, 2**32 - 1))
def test_the_force_at_a_hand_is_found_from_the_torques_that_it_makes(seed: int) -> None:
    random = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(random.normal(size=(7, 3)))
    jacobian = np.linalg.qr(random.normal(size=(3, 3)))[0] @ np.diag(random.uniform(0.1, 0.5, 3)) @ axes.T
    force = random.normal(scale=5.0, size=3)
    assert hand_force(jacobian, jacobian.T @ force) == pytest.approx(force, rel=0.02, abs=0.1)
    assert np.isfinite(hand_force(np.zeros((3, 7)), np.ones(7))).all()


@pytest.mark.parametrize(
    "name", ["gain_ps", "stop_m", "smoothing_s", "max_lead_mps", "max_mps", "max_left_mps", "start_m"]
)
def test_limits_without_meaning_are_named(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        LeadLimits(**{name: 0.0})
