"""COMAN walks, turns, stops and is pushed in MuJoCo; its estimate is compared with the truth."""

import gc
import tracemalloc
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from handover_humanoid.behaviours.simulated_walk import SimulatedWalk, WalkRecord
from handover_humanoid.behaviours.walking import WalkingController
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.patterns.footsteps import Wish
from handover_humanoid.patterns.zmp_control import MARGIN_M
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.body_model import build
from handover_humanoid.simulation.simulated_robot import QUIET, TYPICAL_NOISE, SimulatedRobot
from handover_humanoid.solvers.hierarchical import Hierarchical

COMAN = humanoid("coman")
MODEL = build(COMAN)
STILL = Wish(np.zeros(2))
SPEED_MPS, YAW_RATE = 0.08, 0.1


def walk(*, noisy: bool) -> SimulatedWalk:
    controller = WalkingController(COMAN, Hierarchical())
    noise = TYPICAL_NOISE if noisy else QUIET
    return SimulatedWalk(controller, SimulatedRobot(COMAN, controller.start, noise, 1, MODEL))


@dataclass
class Walked:
    record: WalkRecord
    walk: SimulatedWalk
    truth: Array
    estimate: Array


@pytest.fixture(scope="module")
def walked() -> Walked:
    """Return a walk of four seconds ahead and to the left, with noise, and two seconds to stop."""
    run = walk(noisy=True)
    wish = Wish(np.array([SPEED_MPS, 0.0]), YAW_RATE)
    record = run.run(6.5, lambda time_s: wish if 0.2 <= time_s < 4.2 else STILL)
    return Walked(record, run, run.robot.true_configuration(), run.controller.estimator.q.copy())


def test_it_goes_where_it_is_sent_and_then_stands_on_both_feet(walked: Walked) -> None:
    assert not walked.record.has_fallen
    assert not any(state.fault for state in walked.record.states)
    stance = walked.record.states[-1].stance
    assert stance.phase == "standing"
    assert (stance.left.x + stance.right.x) / 2 > 0.7 * 4.0 * SPEED_MPS
    planned = (stance.left.place + stance.right.place) / 2 + [0.03, 0.0]
    kinematics = Kinematics(COMAN)
    kinematics.update(walked.truth)
    assert kinematics.centre_of_mass()[:2] == pytest.approx(planned, abs=0.05)
    yaw = 2 * np.arctan2(walked.truth[5], walked.truth[6])
    assert yaw == pytest.approx(stance.left.yaw, abs=0.06)
    assert stance.left.yaw > 0.2


def test_it_keeps_to_the_plan(walked: Walked) -> None:
    assert walked.record.tracking_rms_m() < 0.01
    assert walked.record.planned_room_m.min() >= MARGIN_M - 1e-6
    assert walked.record.is_single.sum() > 100
    assert walked.record.share_inside() >= 0.9


def test_the_estimate_follows_the_truth_but_for_the_drift_of_the_steps(walked: Walked) -> None:
    walked_m = float(np.linalg.norm(walked.truth[:2]))
    assert walked.estimate[:3] == pytest.approx(walked.truth[:3], abs=0.02 + 0.05 * walked_m)
    assert walked.estimate[3:5] == pytest.approx(walked.truth[3:5], abs=0.01)
    velocity = walked.walk.controller.estimator.v
    assert velocity[:6] == pytest.approx(walked.walk.robot.true_velocity()[:6], abs=0.05)


@pytest.mark.parametrize("impulse", [(10.0, 0.0), (-10.0, 0.0), (0.0, 5.0)], ids=str)
def test_a_push_is_survived_while_it_stands(impulse: tuple[float, float]) -> None:
    run = walk(noisy=False)
    run.run(0.3, lambda _: STILL)
    run.robot.push(np.array([*impulse, 0.0]))
    record = run.run(1.6, lambda _: STILL)
    assert not record.has_fallen
    assert np.abs(record.com - record.reference).max() > 0.01  # the push was felt
    assert np.linalg.norm(record.states[-1].com_velocity) < 0.1


def test_a_sensor_that_is_not_finite_leaves_the_last_command() -> None:
    run = walk(noisy=False)
    run.run(0.02, lambda _: STILL)
    before = run.command.positions.copy(), run.command.torques.copy()
    run.sensors.gyroscope[1] = np.nan
    state = run.controller.step(run.sensors, run.command)
    assert "not finite" in state.fault
    assert (run.command.positions == before[0]).all()
    assert (run.command.torques == before[1]).all()
    assert run.controller.step(walk(noisy=False).sensors, run.command).fault == ""


def test_an_estimate_that_has_drifted_far_in_place_and_yaw_does_not_disturb_it() -> None:
    run = walk(noisy=True)
    controller, ahead = run.controller, Wish(np.array([SPEED_MPS, 0.0]))
    run.run(2.0, lambda _: ahead)
    estimator, drift = controller.estimator, np.array([0.5, -0.3, 0.0])
    turned = pin.exp3(np.array([0.0, 0.0, 1.0]))
    estimator._rotation = turned @ estimator._rotation
    estimator._position = turned @ estimator._position + drift
    for foot in estimator.feet.values():
        foot.anchor = turned @ foot.anchor + drift
    start = run.robot.true_configuration()[0]
    record = run.run(4.0, lambda _: ahead)
    assert not record.has_fallen
    assert record.tracking_rms_m() < 0.01
    assert run.robot.true_configuration()[0] > start + 0.15
    reference = controller.on_estimate(controller.state.reference.com)  # as the state of the cycle has it
    assert np.linalg.norm(reference - estimator.com[:2]) < 0.02
    assert np.linalg.norm(controller.state.reference.com - estimator.com[:2]) > 0.2


def test_a_control_period_allocates_little_and_keeps_nothing() -> None:
    controller, ahead = WalkingController(COMAN), Wish(np.array([SPEED_MPS, 0.0]))
    run = SimulatedWalk(controller, SimulatedRobot(COMAN, controller.start, TYPICAL_NOISE, 1, MODEL))
    run.run(1.0, lambda _: ahead)
    gc.collect()
    gc.disable()
    tracemalloc.start(1)
    try:
        peaks = []
        for _ in range(40):
            run.robot.read(run.sensors)
            tracemalloc.reset_peak()
            before, _ = tracemalloc.get_traced_memory()
            run.controller.step(run.sensors, run.command)
            peaks.append(tracemalloc.get_traced_memory()[1] - before)
            run.robot.write(run.command)
            run.robot.wait()
    finally:
        tracemalloc.stop()
        gc.enable()
    assert np.median(peaks) < 10_000  # short-lived arrays of a few values; a Jacobian alone has 1,680 bytes
