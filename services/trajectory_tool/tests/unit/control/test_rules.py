"""Rules of control: leases, the dead-man control, equation 1, arbitration, and which goal is meant."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.control.dead_man import TIMEOUT_S, DeadMan
from handover.control.lease import Leases
from handover_robots.cell.kinematics import Kinematics
from handover_robots.control import tool_motion
from handover_robots.control.intent import IntentPrediction
from handover_robots.control.shared_control import (
    BESIDE_AT_M,
    DEEP_M,
    MAX_MIX_RATE,
    ApproachSpeeds,
    Mixer,
    approach,
    arbitrated,
    blended,
    rotation_vector,
    steers_away,
)
from handover_robots.control.tool_motion import joint_velocities
from handover_robots.model.poses import Pose, pointing_down
from handover_robots.planning import is_available
from handover_robots.robots import ROBOTS

UNIT = (0.0, 0.0, 0.0, 1.0)
shares = st.floats(0, 1)
speeds = st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6).map(np.array)


def test_one_person_at_a_time_controls_a_robot() -> None:
    leases = Leases(now=lambda: 7.0)
    assert leases.acquire("ur10-1", "s1", "anna", "Anna") is not None
    assert leases.acquire("ur10-1", "s2", "ben", "Ben") is None
    assert leases.acquire("ur10-2", "s2", "ben", "Ben") is not None
    leases.release("ur10-1", "s2")
    assert leases.holds("ur10-1", "s1"), "another session cannot release it"
    leases.revoke("ur10-1")
    assert not leases.holds("ur10-1", "s1")
    assert leases.acquire("ur10-1", "s3", "ben", "Ben") is not None


@given(st.lists(st.tuples(st.floats(0, 0.3), st.booleans()), max_size=40))
def test_motion_needs_a_release_before_it_and_messages_without_a_gap(steps: list[tuple[float, bool]]) -> None:
    """A reference that looks back over all messages agrees with the state machine."""
    control, now_s, history = DeadMan(), 0.0, []
    for wait_s, is_held in steps:
        now_s += wait_s
        control.receive(now_s, is_held=is_held)
        history.append((now_s, is_held))
        expected = is_held and any(
            not held
            and all(
                b[0] - a[0] <= TIMEOUT_S
                for a, b in zip(history[number:], history[number + 1 :], strict=False)
            )
            for number, (_, held) in enumerate(history)
        )
        assert control.permits(now_s) == expected
        assert not control.permits(now_s + TIMEOUT_S + 0.001)


def test_a_button_that_is_stuck_moves_nothing_after_a_stop() -> None:
    control = DeadMan()
    control.receive(0.0, is_held=False)
    control.receive(0.05, is_held=True)
    assert control.permits(0.05)
    control.disarm()
    control.receive(0.1, is_held=True)
    assert not control.permits(0.1)
    assert control.needs_release(0.1)


@given(shares, st.floats(0.1, 2), speeds, speeds)
def test_the_velocity_is_that_of_equation_1(
    mix: float, gamma: float, human: np.ndarray, robot: np.ndarray
) -> None:
    expected = [(1 - mix) * gamma * h + mix * r for h, r in zip(human, robot, strict=True)]
    assert blended(mix, gamma, human, robot) == pytest.approx(expected)
    assert blended(0.0, gamma, human, robot) == pytest.approx(gamma * human)
    assert blended(1.0, gamma, human, robot) == pytest.approx(robot)


@given(st.lists(st.tuples(shares, st.floats(0, 0.1), st.booleans()), max_size=50))
def test_the_mix_rises_slowly_and_falls_at_once(steps: list[tuple[float, float, bool]]) -> None:
    mixer, before = Mixer(), 0.0
    for asked, dt_s, is_away in steps:
        mix = mixer.step(asked, dt_s, is_away=is_away)
        assert 0 <= mix <= asked or mix == 0
        assert mix <= before + MAX_MIX_RATE * dt_s + 1e-12
        if is_away:
            assert mix == 0
        before = mix


@given(shares, shares, st.floats(0, 3), shares)
def test_arbitration_never_exceeds_what_the_person_permits(
    asked: float, confidence: float, distance_m: float, effort: float
) -> None:
    mix = arbitrated(asked, confidence, distance_m, effort)
    assert 0 <= mix <= asked
    assert arbitrated(asked, confidence, distance_m / 2, effort) >= mix
    assert arbitrated(asked, confidence, distance_m, effort / 2) >= mix
    assert arbitrated(asked, 0.0, distance_m, effort) == 0


def test_a_person_who_steers_or_turns_away_is_recognized() -> None:
    here, goal = Pose((0.0, 0.0, 0.0), UNIT), Pose((0.3, 0.0, 0.0), (0.0, 0.0, 0.1, 0.995))
    assert steers_away(np.array([-0.1, 0.02, 0.0, 0.0, 0.0, 0.0]), here, goal)
    assert not steers_away(np.array([0.05, 0.1, 0.0, 0.0, 0.0, 0.0]), here, goal)
    assert not steers_away(np.zeros(6), here, goal)
    assert steers_away(np.array([0.05, 0.0, 0.0, 0.0, 0.0, -0.2]), here, goal)
    assert not steers_away(np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.2]), here, goal)


@given(speeds, st.floats(0, 0.01))
def test_at_the_goal_every_command_of_some_speed_steers_away(human: np.ndarray, beside_m: float) -> None:
    goal = Pose((0.3, 0.1, 0.2), UNIT)
    here = goal.moved((beside_m, 0.0, 0.0))
    if np.linalg.norm(human[:3]) > 0.1:
        assert steers_away(human, here, goal)


@given(st.floats(-3.1, 3.1), st.lists(st.floats(-1, 1), min_size=3, max_size=3))
def test_the_rotation_between_two_poses_is_the_shorter_way(angle: float, axis: list[float]) -> None:
    length = math.hypot(*axis)
    if length < 1e-3:
        return
    x, y, z = (part / length for part in axis)
    half = angle / 2
    turned = Pose(
        (0.0, 0.0, 0.0), (x * math.sin(half), y * math.sin(half), z * math.sin(half), math.cos(half))
    )
    vector = rotation_vector(Pose((0.0, 0.0, 0.0), UNIT), turned)
    assert vector == pytest.approx([angle * x, angle * y, angle * z], abs=1e-6)


def test_the_autonomous_motion_leads_to_its_goal_and_ends_there() -> None:
    goal = Pose((0.4, -0.2, 0.1), (0.0, 0.0, 1.0, 0.0))
    dt_s, limits = 0.01, ApproachSpeeds()
    position, angle = np.zeros(3), 0.0
    for _ in range(3000):
        x, y, z = position
        here = Pose((x, y, z), (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)))
        twist = approach(here, goal, limits)
        assert np.linalg.norm(twist[:3]) <= limits.max_linear_mps + 1e-9
        assert np.linalg.norm(twist[3:]) <= limits.max_angular_rps + 1e-9
        position += twist[:3] * dt_s
        angle += float(twist[5]) * dt_s
    assert position == pytest.approx(goal.position, abs=1e-3)
    assert abs(angle) == pytest.approx(math.pi, abs=1e-3)


@given(st.lists(st.floats(-0.4, 0.4), min_size=3, max_size=3))
@settings(max_examples=20)
def test_the_autonomous_motion_comes_along_the_tool_axis_and_withdraws_before_it_moves_sideways(
    offset: list[float],
) -> None:
    goal, speeds_ = pointing_down((0.4, 0.0, 0.1)), ApproachSpeeds()
    position = np.add(goal.position, offset)
    for _ in range(1500):
        x, y, z = position
        twist = approach(Pose((x, y, z), goal.orientation), goal, speeds_)
        beside_m, height_m = math.hypot(x - 0.4, y), z - 0.1
        if beside_m > BESIDE_AT_M and height_m < speeds_.clearance_m - DEEP_M:
            assert twist[:2] == pytest.approx([0, 0], abs=1e-9)
            assert twist[2] > 0
        position += twist[:3] * 0.01
    assert position == pytest.approx(goal.position, abs=1e-3)


def test_the_goal_that_is_steered_to_becomes_the_most_probable() -> None:
    goals = {
        "apple": Pose((0.5, 0.3, 0.0), UNIT),
        "cube": Pose((0.5, -0.3, 0.0), UNIT),
        "cup": Pose((-0.5, 0.0, 0.0), UNIT),
    }
    intent = IntentPrediction()
    intent.set_goals(goals)
    assert intent.best() == ("apple", 0.0)
    here = np.zeros(3)
    for _ in range(100):
        direction = np.subtract(goals["cube"].position, here)
        human = np.concatenate([0.1 * direction / np.linalg.norm(direction), np.zeros(3)])
        intent.observe(Pose(tuple(here), UNIT), human, goals, 0.02, 0.25)
        here = here + human[:3] * 0.02
    name, confidence = intent.best() or ("", 0.0)
    assert name == "cube"
    assert confidence > 0.5
    assert sum(intent.probabilities().values()) == pytest.approx(1)
    before = intent.probabilities()
    intent.observe(Pose(tuple(here), UNIT), np.zeros(6), goals, 1.0, 0.25)
    assert intent.probabilities() == before, "a person at rest says nothing"
    for _ in range(150):  # a change of mind
        direction = np.subtract(goals["apple"].position, here)
        human = np.concatenate([0.2 * direction / np.linalg.norm(direction), np.zeros(3)])
        intent.observe(Pose(tuple(here), UNIT), human, goals, 0.02, 0.25)
        here = here + human[:3] * 0.02
    assert (intent.best() or ("", 0.0))[0] == "apple"


@pytest.mark.parametrize("name", ["ur10", "panda"])
@given(data=st.data())
def test_the_jacobian_is_the_derivative_of_the_pose(name: str, data: st.DataObject) -> None:
    model = ROBOTS.load(name)
    joints = tuple(data.draw(st.floats(-1.2, 1.2)) for _ in model.joints)
    step = 1e-6
    here = model.tool_pose(joints)
    for number, (linear, angular) in enumerate(model.jacobian(joints)):
        moved = list(joints)
        moved[number] += step
        there = model.tool_pose(tuple(moved))
        assert np.subtract(there.position, here.position) / step == pytest.approx(linear, abs=1e-4)
        assert rotation_vector(here, there) / step == pytest.approx(angular, abs=1e-3)


@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6), speeds)
def test_joints_stay_within_their_speeds_and_the_tool_keeps_its_direction(
    joints: list[float], twist: np.ndarray
) -> None:
    model = ROBOTS.load("ur10")
    jacobian = np.array([(*linear, *angular) for linear, angular in model.jacobian(tuple(joints))]).T
    limits = [0.3 * limit for limit in model.limits.velocity]
    velocities = joint_velocities(jacobian, twist, limits)
    assert np.all(np.abs(velocities) <= np.array(limits) + 1e-9)
    if np.linalg.svd(jacobian, compute_uv=False)[-1] > 0.08 and np.linalg.norm(twist) > 1e-3:
        moved = jacobian @ velocities
        cosine = float(moved @ twist) / (np.linalg.norm(moved) * np.linalg.norm(twist))
        assert cosine > 0.999


@pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
@pytest.mark.parametrize("robot", ["ur10", "panda"])
def test_the_short_way_to_joint_velocities_is_that_of_the_singular_values(
    robot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = ROBOTS.load(robot)
    kinematics, chance, short = Kinematics(model), np.random.default_rng(7), 0
    for _ in range(300):
        joints = tuple(
            float(
                chance.uniform(
                    -2.5 if joint.lower is None else joint.lower, 2.5 if joint.upper is None else joint.upper
                )
            )
            for joint in model.joints
        )
        jacobian = kinematics.jacobian(joints)
        in_python = np.array([(*linear, *angular) for linear, angular in model.jacobian(joints)]).T
        np.testing.assert_allclose(jacobian, in_python, atol=1e-9)
        assert kinematics.tool_pose(joints).distance_m(model.tool_pose(joints)) < 1e-9
        twist = chance.uniform(-1, 1, 6)
        fast = tool_motion.joint_velocities(jacobian, twist, model.limits.velocity)
        with monkeypatch.context() as without:
            short += tool_motion._undamped(jacobian, twist) is not None
            without.setattr(tool_motion, "_undamped", lambda *_: None)
            exact = tool_motion.joint_velocities(jacobian, twist, model.limits.velocity)
        np.testing.assert_allclose(fast, exact, rtol=1e-7, atol=1e-9)
    assert 30 < short < 300
