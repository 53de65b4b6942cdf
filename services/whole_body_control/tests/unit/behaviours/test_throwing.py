"""Throws of a ball: planned within the limits of the arm, out of the simulated hand, and learned from."""

import numpy as np
import pytest
from hypothesis import Phase as Phases
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_humanoid.behaviours.rehearsal import FILE, read_rehearsals
from handover_humanoid.behaviours.simulated_throw import SimulatedThrow
from handover_humanoid.behaviours.throwing import Phase, Practice, ThrowingController, aimed_throw
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.model.kinematics import BASE_POSITIONS, BASE_VELOCITIES, Kinematics
from handover_humanoid.patterns import ballistics
from handover_humanoid.patterns.throwing import OutOfReach, PlannedThrow, ThrowPlanner
from handover_humanoid.robots import folder, humanoid
from handover_humanoid.simulation.ball import RADIUS_M, RobotWithBall, build_with_ball
from handover_humanoid.simulation.simulated_robot import TYPICAL_NOISE
from handover_humanoid.tasks.self_collision import SelfCollision

COMAN = humanoid("coman")
KINEMATICS = Kinematics(COMAN)
STANDING = KINEMATICS.standing("stand")
TARGET = np.array([0.8, 0.1, 0.5])

coordinates = st.floats(-2.0, 2.0, width=32)
points = st.tuples(coordinates, coordinates, coordinates).map(np.array)


def planner(hand: str) -> ThrowPlanner:
    return ThrowPlanner(KINEMATICS, STANDING, COMAN.grips[hand])


@given(points, points, st.floats(0.05, 3.0))
def test_a_ball_lands_where_its_release_velocity_sends_it(
    start: np.ndarray, landing: np.ndarray, flight_s: float
) -> None:
    velocity = ballistics.release_velocity(start, landing, flight_s)
    assert ballistics.position_after(start, velocity, flight_s) == pytest.approx(landing, abs=1e-9)
    peak = ballistics.peak_height(start, velocity)
    assert peak >= max(start[2], landing[2]) - 1e-9
    arrives = ballistics.time_to_fall(start, velocity, float(landing[2]))
    if velocity[2] - 9.81 * flight_s <= -1e-3:  # it comes down at the landing place
        assert arrives == pytest.approx(flight_s, abs=1e-6)
    assert np.isnan(ballistics.landing_point(start, velocity, peak + 0.01)).all()


@settings(max_examples=5, phases=[Phases.explicit, Phases.reuse, Phases.generate])
@given(
    st.sampled_from(["left_hand", "right_hand"]),
    st.floats(0.6, 0.9),
    st.floats(-0.2, 0.2),
    st.floats(0.4, 0.6),
    st.one_of(st.none(), st.floats(0.35, 0.5)),
)
def test_a_planned_throw_obeys_every_limit_and_lands(
    hand: str, distance_m: float, direction_rad: float, height_m: float, flight_s: float | None
) -> None:
    target = np.array([distance_m * np.cos(direction_rad), distance_m * np.sin(direction_rad), height_m])
    try:
        throw = planner(hand).plan(target, flight_s)
    except OutOfReach:
        assume(False)
    joints = [COMAN.joints[index] for index in COMAN.indices(throw.grip.arm)]
    for time_s in np.linspace(0.0, throw.duration_s, 100):
        positions, velocities = throw.joints(time_s)
        for joint, position, velocity in zip(joints, positions, velocities, strict=True):
            assert joint.lower <= position <= joint.upper
            assert abs(velocity) <= joint.max_velocity
    released, velocity = throw.joints(throw.swing_s)
    q, v = STANDING.copy(), np.zeros(KINEMATICS.n_velocities)
    arm = np.array(COMAN.indices(throw.grip.arm))
    q[BASE_POSITIONS + arm], v[BASE_VELOCITIES + arm] = released, velocity
    place, jacobian = KINEMATICS.point(q, throw.grip.link, np.array(throw.grip.point))
    assert ballistics.position_after(place, jacobian @ v, throw.flight_s) == pytest.approx(target, abs=2e-3)
    assert flight_s is None or throw.flight_s == flight_s
    require_clear(throw)


def require_clear(throw: PlannedThrow) -> None:
    """The arm touches nothing of the robot on its way."""
    collision, arm = SelfCollision(KINEMATICS), np.array(COMAN.indices(throw.grip.arm))
    q = STANDING.copy()
    for time_s in np.linspace(0.0, throw.duration_s, 8):
        q[BASE_POSITIONS + arm] = throw.joints(time_s)[0]
        KINEMATICS.update(q)
        nearest, distance_m = min(collision.distances(KINEMATICS).items(), key=lambda item: item[1])
        assert distance_m > 0, nearest


def test_the_motion_is_continuous_and_at_rest_at_its_ends() -> None:
    throw = planner("right_hand").plan(TARGET)
    times = np.arange(0.0, throw.duration_s, 1e-4)
    positions = np.array([throw.joints(time_s)[0] for time_s in times])
    velocities = np.array([throw.joints(time_s)[1] for time_s in times])
    assert np.gradient(positions, 1e-4, axis=0)[1:-1] == pytest.approx(velocities[1:-1], abs=1e-3)
    assert np.abs(np.diff(velocities, axis=0)).max() < 0.01
    for end in (0.0, throw.duration_s):
        assert np.abs(throw.joints(end)[1]).max() == 0


def test_a_place_beyond_reach_is_refused_with_the_nearest_one_that_is_not() -> None:
    with pytest.raises(
        OutOfReach, match=r"cannot throw to \(3\.00, 0\.00, 0\.50\) m: .* 95\.0% is allowed"
    ) as far:
        planner("right_hand").plan(np.array([3.0, 0.0, 0.5]))
    assert far.value.nearest is not None
    assert planner("right_hand").plan(far.value.nearest).usage <= 0.95
    assert 0.9 < far.value.nearest[0] < 1.4


@pytest.mark.parametrize(
    ("landing", "flight_s", "said"),
    [
        ([np.nan, 0.0, 0.5], None, "three finite numbers"),
        ([0.8, 0.0], None, "three finite numbers"),
        ([0.1, 0.0, 0.5], None, "0.3 m or more in front"),
        ([-0.8, 0.0, 0.5], None, "0.3 m or more in front"),
        ([0.8, 0.0, 0.5], 3.0, "choose one from 0.2 to 0.8 s"),
    ],
)
def test_what_cannot_be_thrown_is_named(landing: list[float], flight_s: float | None, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        planner("left_hand").plan(np.array(landing), flight_s)


@pytest.mark.nightly
def test_a_refusal_names_the_place_that_was_asked_for_and_aiming_off_is_never_a_reason() -> None:
    """A hand that throws too short aims beyond the target, which may be out of reach where that is not."""
    practice, base = Practice(), STANDING[:2]
    for distance_m in (0.5, 0.6, 0.7, 0.8):
        aimed = np.array([distance_m, 0.0, 0.5])
        practice.learn("right_hand", base, aimed, aimed - [1.0, 0.0, 0.0])
    hand = planner("right_hand")
    with pytest.raises(UsageError):
        hand.plan(practice.aim("right_hand", base, TARGET))
    aimed, throw = aimed_throw(hand, practice, "right_hand", base, TARGET)
    assert aimed.tolist() == throw.landing.tolist() == TARGET.tolist()
    with pytest.raises(OutOfReach, match=r"cannot throw to \(3\.00, -0\.30, 0\.80\) m"):
        aimed_throw(hand, practice, "right_hand", base, np.array([3.0, -0.3, 0.8]))


def test_practice_removes_a_miss_that_grows_to_the_side() -> None:
    practice, base = Practice(), np.zeros(2)
    assert (practice.aim("hand", base, TARGET) == TARGET).all()
    for direction in (-0.3, 0.2, 0.0, 0.3, -0.1, 0.1, -0.2):
        aimed = np.array([0.8 * np.cos(direction), 0.8 * np.sin(direction), 0.5])
        practice.learn("hand", base, aimed, missed_by(aimed))
    practice.learn("hand", base, TARGET, np.full(3, np.nan))
    for direction in (-0.25, 0.15):
        target = np.array([0.8 * np.cos(direction), 0.8 * np.sin(direction), 0.5])
        landed = missed_by(practice.aim("hand", base, target))
        assert np.linalg.norm(landed - target) < 0.008
    assert (practice.aim("other hand", base, TARGET) == TARGET).all()


def missed_by(aimed: np.ndarray) -> np.ndarray:
    """Where a hand throws that throws 5 % too far, and turned a little."""
    return aimed * [1.05, 1.05, 1.0] + [0.0, 0.03 + 0.05 * aimed[1], 0.0]


@pytest.mark.slow
def test_coman_throws_and_the_second_throw_lands_nearer_or_as_near_as_throws_scatter() -> None:
    game = SimulatedThrow(COMAN, build_with_ball(COMAN), noise=TYPICAL_NOISE, seed=1)
    plans, practice = planner("right_hand"), Practice()
    base, missed = game.controller.start[:2], []
    for _ in range(2):
        throw = plans.plan(practice.aim("right_hand", base, TARGET))
        record = game.throw(throw)
        practice.learn("right_hand", base, throw.landing, record.predicted)
        missed.append(float(np.linalg.norm(record.landed - TARGET)))
        assert np.linalg.norm(record.landed - record.predicted) < 0.06
        assert record.phases == tuple(Phase)[1:] + tuple(Phase)[:1]
    assert missed[0] < 0.1
    assert missed[1] < max(0.02, missed[0])  # the first one may land within what throws scatter by
    assert game.robot.ball.position[2] < 3 * RADIUS_M, "the ball lies on the ground"
    rotation = game.robot.true_configuration()[3:7]
    assert 2 * np.hypot(rotation[0], rotation[1]) < 0.05, "the robot stands"


def rehearsed_practice() -> Practice:
    practice = Practice()
    for grip, throws in read_rehearsals(folder("coman") / FILE, COMAN).items():
        practice.restore(grip, throws)
    return practice


def test_what_the_robot_sees_of_its_throws_is_where_they_land_although_its_feet_turn() -> None:
    game, practice = (
        SimulatedThrow(COMAN, build_with_ball(COMAN), noise=TYPICAL_NOISE, seed=1),
        rehearsed_practice(),
    )
    start = game.controller.start[:2]
    for _ in range(3):
        planned = planner("right_hand").plan(practice.aim("right_hand", start, TARGET))
        record = game.throw(planned)
        assert np.linalg.norm(record.predicted - record.landed) < 0.02  # 4 cm with the line between the soles
        assert np.linalg.norm(record.landed - TARGET) < 0.025
        practice.learn("right_hand", start, planned.landing, record.predicted)


def test_one_throw_at_a_time() -> None:
    controller, throw = ThrowingController(COMAN), planner("left_hand").plan(TARGET)
    controller.throw(throw)
    with pytest.raises(ValueError, match="under way"):
        controller.throw(throw)


def test_a_standing_robot_does_not_lean_with_the_drift_of_its_estimate() -> None:
    """Odometry drifts by some millimetres with each throw; a hundred of them once made the robot fall."""
    controller = ThrowingController(COMAN)
    robot = RobotWithBall(COMAN, controller.start, model=build_with_ball(COMAN))
    sensors, command = RobotSensors(COMAN), JointCommand(COMAN)

    def stand(periods: int) -> np.ndarray:
        for _ in range(periods):
            robot.read(sensors)
            controller.step(sensors, command)
            for _ in range(5):
                robot.write(command)
                robot.wait()
        return np.asarray(robot.true_configuration()[:3])

    before = stand(100)
    drift = np.array([0.05, 0.02, 0.0])
    controller.estimator._position += drift
    for foot in controller.estimator.feet.values():
        foot.anchor += drift
    assert stand(150) == pytest.approx(before, abs=0.004)
