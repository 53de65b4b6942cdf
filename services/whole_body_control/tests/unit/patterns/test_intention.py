"""The intention of a person who holds the hands: direction, continuity of sign, caps, hysteresis, faults."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_humanoid.model.kinematics import BASE_VELOCITIES, Array, Kinematics
from handover_humanoid.patterns.intention import (
    ArmState,
    IntentionLimits,
    IntentionReference,
    arm_state,
    hand_place,
)
from handover_humanoid.robots import humanoid

COMAN = humanoid("coman")
ARMS = {"left_arm": "LSoftHand", "right_arm": "RSoftHand"}
LIMITS = IntentionLimits(threshold=0.01)
DT_S = 0.02


def weak_along(axis: Array, sigma: float, displacement: Array, strong: float = 0.4) -> ArmState:
    """Return an arm that loses its mobility along `axis`."""
    left, _ = np.linalg.qr(np.column_stack([axis, np.eye(3)[:, :2] + 0.1]))
    values = np.zeros((3, 7))
    values[np.arange(3), np.arange(3)] = [sigma, strong, strong]
    return ArmState(left @ values, displacement)


def settled(reference: IntentionReference, arms: dict[str, ArmState]) -> Array:
    for _ in range(100):
        intention = reference.update(arms, DT_S)
    return intention.velocity


@pytest.mark.parametrize("way", [1.0, -1.0], ids=["pulled ahead", "pushed back"])
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_coman_goes_where_its_hands_are_moved(way: float, yaw: float) -> None:
    """Joint springs do not matter here: the hands are placed by inverse kinematics of each arm."""
    kinematics = Kinematics(COMAN)
    q = kinematics.standing("hands_forward")
    q[3:7] = [0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)]
    kinematics.update(q)
    rest = {arm: hand_place(kinematics, hand) for arm, hand in ARMS.items()}
    at_rest = {arm: arm_state(kinematics, arm, hand, rest[arm]) for arm, hand in ARMS.items()}
    values = [np.linalg.svd(task.jacobian, compute_uv=False) for task in at_rest.values()]
    threshold = 0.7 * float(np.prod(values[0]))
    reference = IntentionReference(IntentionLimits(threshold))
    assert not reference.update(at_rest, DT_S).is_active
    for _ in range(200):
        for arm, hand in ARMS.items():
            state = arm_state(kinematics, arm, hand, rest[arm])
            error = np.array([0.3 * way, 0.0, 0.0]) - state.displacement
            step = np.linalg.lstsq(state.jacobian, 0.05 * error, rcond=0.05)[0]
            joints = np.array(COMAN.indices(arm))
            moved = q[7 + joints] + step
            lower = [COMAN.joints[index].lower for index in joints]
            upper = [COMAN.joints[index].upper for index in joints]
            q[7 + joints] = np.clip(moved, lower, upper)
            kinematics.update(q)
    arms = {arm: arm_state(kinematics, arm, hand, rest[arm]) for arm, hand in ARMS.items()}
    velocity = settled(reference, arms)
    assert way * velocity[0] > 0.02
    assert abs(velocity[1]) < 0.1 * abs(velocity[0])  # both arms alike: no sideways part


@given(angle=st.floats(0.0, 6.28), sigma=st.floats(0.0, 0.05))
def test_the_direction_is_that_of_the_hand(angle: float, sigma: float) -> None:
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    velocity = settled(IntentionReference(LIMITS), {"left": weak_along(-axis, sigma, 0.1 * axis)})
    if sigma > 1e-3:
        assert velocity / np.linalg.norm(velocity) == pytest.approx(axis[:2], abs=1e-6)


@given(
    seeds=st.lists(st.integers(0, 2**32 - 1), min_size=2, max_size=40),
    cap=st.none() | st.floats(0.0, 0.2),
)
def test_speed_and_acceleration_are_capped_whatever_the_arms_do(seeds: list[int], cap: float | None) -> None:
    reference, before = IntentionReference(LIMITS), np.zeros(2)
    for seed in seeds:
        rng = np.random.default_rng(seed)
        arms = {
            name: ArmState(rng.normal(scale=rng.choice([1e-9, 0.1, 1.0]), size=(3, 7)), rng.normal(size=3))
            for name in ("left", "right")
        }
        velocity = reference.update(arms, DT_S, cap).velocity
        assert np.linalg.norm(velocity - before) <= LIMITS.max_mps2 * DT_S + 1e-12
        assert np.linalg.norm(velocity) <= LIMITS.max_mps + 1e-12
        before = velocity
    for _ in range(100):
        velocity = reference.update(arms, DT_S, cap).velocity
    if cap is not None:
        assert np.linalg.norm(velocity) <= cap + 1e-9


@given(turns=st.lists(st.floats(-0.2, 0.2), min_size=1, max_size=60))
def test_the_sign_does_not_jump_while_the_hand_is_near_its_rest(turns: list[float]) -> None:
    """Within the deadband the direction turns with the arm, and never reverses between two cycles."""
    reference, angle = IntentionReference(LIMITS), 0.0
    axis = np.array([1.0, 0.0, 0.0])
    before = settled(reference, {"left": weak_along(axis, 0.02, 0.1 * axis)})
    for number, change in enumerate(turns):
        angle += change
        axis = np.array([np.cos(angle), np.sin(angle), 0.0]) * (-1) ** number  # the sign of an SVD is random
        noise = 0.01 * np.array([np.sin(7.0 * number), np.cos(5.0 * number), 0.0])
        velocity = settled(reference, {"left": weak_along(axis, 0.02, noise)})
        assert velocity @ before > 0
        before = velocity


def test_a_hand_on_the_other_side_reverses_the_direction() -> None:
    reference, axis = IntentionReference(LIMITS), np.array([1.0, 0.0, 0.0])
    assert settled(reference, {"left": weak_along(axis, 0.02, 0.1 * axis)})[0] > 0
    assert settled(reference, {"left": weak_along(axis, 0.02, -0.1 * axis)})[0] < 0


def test_the_threshold_has_a_hysteresis() -> None:
    axis = np.array([1.0, 0.0, 0.0])

    def at(share: float) -> dict[str, ArmState]:
        return {"left": weak_along(axis, share * LIMITS.threshold / 0.16, 0.1 * axis)}

    reference = IntentionReference(LIMITS)
    seen = [reference.update(at(share), DT_S).is_active for share in (1.1, 0.95, 1.1, 1.2, 1.1, 0.95)]
    assert seen == [False, True, True, False, False, True]


def test_one_weak_arm_suffices_and_both_add_up() -> None:
    ahead, left = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    arms = {"left": weak_along(left, 0.02, 0.1 * left), "right": weak_along(ahead, 0.1, 0.1 * ahead)}
    velocity = settled(IntentionReference(LIMITS), arms)
    damped = [sigma / (sigma**2 + LIMITS.damping_m**2) for sigma in (0.1, 0.02)]
    ratio = velocity[0] / velocity[1]
    assert ratio == pytest.approx(damped[0] / damped[1], rel=1e-6)


def test_a_vertical_intention_moves_nothing() -> None:
    up = np.array([0.0, 0.0, 1.0])
    velocity = settled(IntentionReference(LIMITS), {"left": weak_along(up, 0.02, 0.1 * up)})
    assert velocity == pytest.approx(np.zeros(2), abs=1e-9)


def test_a_measurement_that_is_not_finite_stops_the_robot_softly_and_is_named() -> None:
    reference, axis = IntentionReference(LIMITS), np.array([1.0, 0.0, 0.0])
    good = weak_along(axis, 0.02, 0.1 * axis)
    before = settled(reference, {"left": good, "right": good})
    broken = ArmState(np.full((3, 7), np.nan), np.zeros(3))
    intention = reference.update({"left": good, "right": broken}, DT_S)
    assert "right" in intention.fault
    assert np.linalg.norm(intention.velocity - before) == pytest.approx(LIMITS.max_mps2 * DT_S)
    assert settled(reference, {"left": good, "right": broken}) == pytest.approx(np.zeros(2), abs=1e-12)


@pytest.mark.parametrize("name", ["threshold", "gain_m2ps", "damping_m", "max_mps", "max_mps2"])
def test_limits_without_meaning_are_named(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        IntentionLimits(**{"threshold": 0.01, name: 0.0})


def test_the_state_of_an_arm_has_the_joints_of_the_arm() -> None:
    kinematics = Kinematics(COMAN)
    kinematics.update(kinematics.standing("stand"))
    state = arm_state(kinematics, "left_arm", "LSoftHand", np.zeros(3))
    columns = BASE_VELOCITIES + np.array(COMAN.indices("left_arm"))
    assert state.jacobian == pytest.approx(kinematics.jacobian("LSoftHand")[:3, columns])
    assert state.jacobian.shape == (3, 7)
