"""The engine by projections: levels disturb none above, bounds hold, behaviours run with either engine."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_humanoid.behaviours.simulated_throw import SimulatedThrow
from handover_humanoid.behaviours.simulated_walk import SimulatedWalk
from handover_humanoid.behaviours.walking import WalkingController
from handover_humanoid.engines.choice import EngineName
from handover_humanoid.engines.projection_engine import ProjectionEngine
from handover_humanoid.model.kinematics import BASE_VELOCITIES, Kinematics
from handover_humanoid.patterns.footsteps import Wish
from handover_humanoid.patterns.throwing import ThrowPlanner
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.ball import build_with_ball
from handover_humanoid.simulation.simulated_robot import SimulatedRobot
from handover_humanoid.tasks.constraints import Contact, JointLimits
from handover_humanoid.tasks.tasks import CentreOfMassTask, posture

COMAN = humanoid("coman")
ENGINES: tuple[EngineName, ...] = ("stack", "projections")
DT_S = 0.004


@settings(max_examples=20, deadline=None)
@given(st.tuples(*(3 * [st.floats(-0.05, 0.05)])), st.integers(0, 2**32 - 1))
def test_levels_obey_those_above_contacts_and_limits(offset: tuple[float, float, float], seed: int) -> None:
    kinematics = Kinematics(COMAN)
    q = kinematics.standing("stand")
    kinematics.update(q)
    com = CentreOfMassTask("com", kinematics.centre_of_mass() + offset, gain=1.0)
    task = posture(kinematics, "stand")
    task.target = task.target + np.random.default_rng(seed).normal(scale=0.3, size=len(task.target))
    limits = JointLimits(kinematics)
    soles = [contact.link for contact in COMAN.contacts.values()]
    engine = ProjectionEngine(kinematics, com / task << [*(Contact(link) for link in soles), limits])
    step = engine.step(q, DT_S)
    assert not step.relaxed
    for link in soles:
        assert kinematics.jacobian(link) @ step.velocity == pytest.approx(np.zeros(6), abs=1e-6)
    # The damping of the first level costs 1 % of its speed at most in directions that are not singular.
    reached = kinematics.centre_of_mass_jacobian() @ step.velocity
    assert reached == pytest.approx(np.array(offset), abs=2e-3)
    rows = limits.bounds(kinematics, q, DT_S)
    assert (step.velocity[BASE_VELOCITIES:] >= rows.lower - 1e-5).all()
    assert (step.velocity[BASE_VELOCITIES:] <= rows.upper + 1e-5).all()


def test_values_that_are_not_finite_hold_still_and_say_so() -> None:
    kinematics = Kinematics(COMAN)
    q = kinematics.standing("stand")
    com = CentreOfMassTask("com", np.array([np.nan, 0.0, 0.4]))
    step = ProjectionEngine(kinematics, com / posture(kinematics, "stand")).step(q, DT_S)
    assert "not finite" in step.fault
    assert (step.velocity == 0).all()
    assert (step.q == q).all()


@pytest.mark.parametrize("engine", ENGINES)
def test_it_stands_and_throws_with_either_engine(engine: EngineName) -> None:
    kinematics = Kinematics(COMAN)
    planner = ThrowPlanner(kinematics, kinematics.standing("stand"), COMAN.grips["right_hand"])
    game = SimulatedThrow(COMAN, build_with_ball(COMAN), engine=engine)
    target = np.array([0.8, 0.0, 0.5])
    record = game.throw(planner.plan(target))
    assert np.linalg.norm(record.landed - target) < 0.1
    rotation = game.robot.true_configuration()[3:7]
    assert 2 * np.hypot(rotation[0], rotation[1]) < 0.05, "the robot stands"


@pytest.mark.parametrize("engine", ENGINES)
def test_it_walks_with_either_engine(engine: EngineName) -> None:
    controller = WalkingController(COMAN, engine=engine)
    walk = SimulatedWalk(controller, SimulatedRobot(COMAN, controller.start))
    record = walk.run(2.5, lambda time_s: Wish(np.array([0.1, 0.0]) if time_s > 0.1 else np.zeros(2)))
    assert not record.has_fallen
    assert {state.fault for state in record.states} == {""}
    assert record.is_single.sum() > 100
    assert record.tracking_rms_m() < 0.01
    assert record.planned_room_m.min() >= 0.0099
