"""Friction and linear momentum in a stack: beside dense quadratic programs, forces, and physics."""

from dataclasses import replace

import daqp
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_humanoid.engines.stack_engine import DAMPING, StackEngine
from handover_humanoid.model.kinematics import GRAVITY_MPS2, Array, Kinematics
from handover_humanoid.robots import humanoid
from handover_humanoid.tasks.base import NO_BOUND
from handover_humanoid.tasks.constraints import Contact, Friction, JointLimits
from handover_humanoid.tasks.tasks import CentreOfMassTask, LinearMomentumTask, posture

COMAN = humanoid("coman")
SOLES = ("left_sole", "right_sole")
DT_S = 0.01
BEND_MPS2 = 0.5
"""Of a path that a velocity of 0.7 m/s bends within a cycle: the constraint is linear in velocities."""
UP = np.array([0.0, 0.0, GRAVITY_MPS2])
wishes = st.tuples(*[st.floats(-3.0, 3.0, allow_subnormal=False)] * 3).map(np.array)


def standing(*, on_ice: float | None = None) -> tuple[Kinematics, Array]:
    contacts = {
        name: contact if on_ice is None else replace(contact, friction=on_ice)
        for name, contact in COMAN.contacts.items()
    }
    kinematics = Kinematics(replace(COMAN, contacts=contacts))
    q = kinematics.standing("stand")
    kinematics.update(q)
    return kinematics, q


def edges(rotation: Array, coefficient: float) -> Array:
    """The generators of a cone with eight edges, as rows."""
    turns = [
        pin.exp3(np.array([0.0, 0.0, k * np.pi / 4])) @ np.array([coefficient, 0.0, 1.0]) for k in range(8)
    ]
    return np.array(turns) @ rotation.T


@settings(max_examples=25, deadline=None)
@given(wishes, wishes, st.floats(0.05, 1.0))
def test_the_stack_with_friction_is_the_dense_program_with_a_force_for_each_edge(
    wanted: Array, before: Array, coefficient: float
) -> None:
    """The reference has the forces of the contacts as variables, and knows nothing of faces or levels."""
    kinematics, q = standing(on_ice=coefficient)
    before[2] = 0.1 * before[2]
    com = CentreOfMassTask("com", kinematics.centre_of_mass(), velocity=wanted)
    friction = Friction(SOLES)
    friction.velocity_before = 0.1 * before
    step = StackEngine(kinematics, com << friction).step(q, DT_S)
    jacobian = kinematics.centre_of_mass_jacobian()
    rays = np.vstack(
        [edges(kinematics.pose(COMAN.contacts[name].link).rotation, coefficient) for name in SOLES]
    )
    n, k = jacobian.shape[1], len(rays)
    # Variables: velocities and the acceleration that each edge makes. J v - dt rays' l = v_before - dt g
    matrix = np.vstack([np.hstack([jacobian, -DT_S * rays.T]), np.hstack([np.zeros((k, n)), np.eye(k)])])
    equal = friction.velocity_before - DT_S * UP
    lower = np.concatenate([equal, np.zeros(k)])
    upper = np.concatenate([equal, np.full(k, NO_BOUND)])
    hessian = np.zeros((n + k, n + k))
    hessian[:n, :n] = jacobian.T @ jacobian + DAMPING * np.eye(n)
    hessian[n:, n:] = 1e-10 * np.eye(k)
    gradient = np.concatenate([-jacobian.T @ wanted, np.zeros(k)])
    solution, _, flag, _ = daqp.solve(
        hessian, gradient, matrix, upper, lower, np.zeros(3 + k, dtype=np.int32)
    )
    assert flag > 0
    assert not step.relaxed
    assert jacobian @ step.velocity == pytest.approx(jacobian @ solution[:n], abs=2e-4)
    force = (jacobian @ step.velocity - friction.velocity_before) / DT_S + UP
    assert np.hypot(*force[:2]) <= coefficient * force[2] + 1e-3


@settings(max_examples=20, deadline=None)
@given(wishes, st.floats(0.05, 1.0))
def test_on_ice_the_body_accelerates_no_faster_than_friction_allows(
    wanted: Array, coefficient: float
) -> None:
    """Over cycles, with contacts and limits: the accelerations of the centre of mass, by differences."""
    kinematics, q = standing(on_ice=coefficient)
    place = kinematics.centre_of_mass() + 0.05 * wanted * np.array([1.0, 1.0, 0.2])
    com, friction = CentreOfMassTask("com", place, gain=20.0), Friction(SOLES)
    contacts = [Contact(COMAN.contacts[name].link) for name in SOLES]
    stack = com / posture(kinematics, "stand") << [*contacts, JointLimits(kinematics), friction]
    engine, places = StackEngine(kinematics, stack), [kinematics.centre_of_mass()] * 2
    for _ in range(12):
        step = engine.step(q, DT_S)
        assert not step.fault
        q = step.q
        kinematics.update(q)
        places.append(kinematics.centre_of_mass())
        if not step.relaxed:
            force = np.diff(places[-3:], n=2, axis=0)[0] / DT_S**2 + UP
            assert np.hypot(*force[:2]) <= coefficient * force[2] + BEND_MPS2


def test_sloped_contacts_push_together() -> None:
    """Two soles that lean against each other can make forces that neither makes alone."""
    kinematics, q = standing(on_ice=0.2)
    for name, angle in (("LAnkLat", 0.3), ("RAnkLat", -0.3)):
        q[7 + COMAN.index(name)] += angle
    kinematics.update(q)
    both = Friction(SOLES).bounds(kinematics, q, DT_S)
    pseudo = np.linalg.pinv(kinematics.centre_of_mass_jacobian())
    for force, is_possible in ((UP, True), (np.array([5.0, 0.0, 5.0]), False)):
        velocity = pseudo @ (DT_S * (force - UP))
        assert bool((both.matrix @ velocity <= both.upper + 1e-9).all()) is is_possible
        alone = [Friction((name,)).bounds(kinematics, q, DT_S) for name in SOLES]
        assert not any((bounds.matrix @ velocity <= bounds.upper + 1e-9).all() for bounds in alone)


@settings(max_examples=25, deadline=None)
@given(wishes, st.floats(0.5, 3.0))
def test_linear_momentum_is_that_of_the_limbs_and_shares_a_level_as_a_dense_program_does(
    momentum: Array, weight: float
) -> None:
    kinematics, q = standing()
    task = LinearMomentumTask("momentum", momentum)
    rest = posture(kinematics, "hands_forward", gain=2.0)
    step = StackEngine(kinematics, (weight * task & rest) << JointLimits(kinematics)).step(q, DT_S)
    a, b = task.rows(kinematics), rest.rows(kinematics)
    whole = (
        weight * a.jacobian.T @ a.jacobian + b.jacobian.T @ b.jacobian + DAMPING * np.eye(len(step.velocity))
    )
    free = np.linalg.solve(whole, weight * a.jacobian.T @ a.velocity + b.jacobian.T @ b.velocity)
    limits = JointLimits(kinematics).bounds(kinematics, q, DT_S)
    if (limits.matrix @ free <= limits.upper).all() and (limits.matrix @ free >= limits.lower).all():
        assert step.velocity == pytest.approx(free, abs=1e-6)
    kinematics.update(q, step.velocity)
    of_limbs = pin.computeCentroidalMomentum(kinematics.pin_model, kinematics.data).linear
    assert a.jacobian @ step.velocity == pytest.approx(of_limbs, abs=1e-9)


def test_no_momentum_means_that_the_centre_of_mass_rests() -> None:
    kinematics, q = standing()
    before = kinematics.centre_of_mass()
    stack = LinearMomentumTask("momentum") / posture(kinematics, "hands_forward", gain=2.0)
    engine = StackEngine(kinematics, stack << JointLimits(kinematics))
    for _ in range(50):
        q = engine.step(q, DT_S).q
    kinematics.update(q)
    assert kinematics.centre_of_mass() == pytest.approx(before, abs=2e-3)


@pytest.mark.parametrize("share", [0.0, 1.5, float("nan")])
def test_a_share_of_friction_that_cannot_be_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match="share of the friction"):
        Friction(SOLES, share)
