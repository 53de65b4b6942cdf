"""Links keep their distance: rows are the derivatives of distances, and a hand cannot enter the torso."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_humanoid.engines.stack_engine import StackEngine
from handover_humanoid.model.kinematics import Kinematics
from handover_humanoid.robots import humanoid
from handover_humanoid.solvers.cascade import Cascade
from handover_humanoid.solvers.hierarchical import Hierarchical
from handover_humanoid.solvers.problem import Solver
from handover_humanoid.tasks.base import NO_BOUND, Constraint
from handover_humanoid.tasks.constraints import JointLimits
from handover_humanoid.tasks.self_collision import ROW_BLOCK, SelfCollision
from handover_humanoid.tasks.tasks import PoseTask, posture

COMAN = humanoid("coman")
DT_S = 0.01


@pytest.fixture(scope="module")
def kinematics() -> Kinematics:
    return Kinematics(COMAN)


@pytest.fixture(scope="module")
def collision(kinematics: Kinematics) -> SelfCollision:
    return SelfCollision(kinematics)


@given(seed=st.integers(0, 2**32 - 1))
def test_rows_are_the_derivatives_of_distances(
    kinematics: Kinematics, collision: SelfCollision, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    q = kinematics.standing("stand")
    q[7:] = np.clip(q[7:] + rng.normal(scale=0.3, size=29), *np.array(_limits()).T)
    v = rng.normal(size=35)
    kinematics.update(q)
    bounds = collision.bounds(kinematics, q, DT_S)
    near = {
        pair: distance_m for pair, distance_m in collision.distances(kinematics).items() if distance_m < 0.05
    }
    assert len(bounds.lower) % ROW_BLOCK == 0
    assert (bounds.lower > -NO_BOUND).sum() == len(near)
    rates = bounds.matrix[: len(near)] @ v
    after = []
    for step in (1e-6, -1e-6):
        kinematics.update(kinematics.integrate(q, v, step))
        moved = collision.distances(kinematics)
        after.append([moved[pair] for pair in near])
    measured = (np.array(after[0]) - np.array(after[1])) / 2e-6
    apart = np.array(list(near.values())) > 1e-3  # where shapes overlap, the deepest points may jump
    # The nearest points of nearly parallel capsules and of boxes jump from end to end: no derivative there.
    agrees = np.abs(measured - rates) < 5e-3
    assert (agrees | ~apart).mean() >= 0.8


def _limits() -> list[tuple[float, float]]:
    return [(joint.lower, joint.upper) for joint in COMAN.joints]


@pytest.mark.parametrize("solver", [Cascade(), Hierarchical()], ids=lambda solver: solver.name)
def test_a_hand_that_is_sent_into_the_torso_stops_before_it(kinematics: Kinematics, solver: Solver) -> None:
    assert nearest_m(kinematics, solver, is_checked=False) < -0.01
    assert nearest_m(kinematics, solver, is_checked=True) > 0.003


def nearest_m(kinematics: Kinematics, solver: Solver, *, is_checked: bool) -> float:
    """Return the smallest distance of any pair while the left hand is sent into the torso."""
    q = kinematics.standing("hands_forward")
    kinematics.update(q)
    collision = SelfCollision(kinematics)
    left, right = (PoseTask(link, link, kinematics.pose(link).copy()) for link in ("l_sole", "r_sole"))
    torso = pin.SE3(np.eye(3), kinematics.pose("DWYTorso").translation)
    hand = PoseTask("hand", "LSoftHand", torso, axes=(True,) * 3 + (False,) * 3)
    limits: list[Constraint] = [JointLimits(kinematics)]
    constraints = [*limits, collision] if is_checked else limits
    stack = (left & right) / hand / posture(kinematics, "stand") << constraints
    engine = StackEngine(kinematics, stack, solver)
    nearest = np.inf
    for _ in range(100):
        step = engine.step(q, DT_S)
        assert step.fault == ""
        q = step.q
        kinematics.update(q)
        nearest = min(nearest, *collision.distances(kinematics).values())
    return float(nearest)


@pytest.mark.parametrize("pose", COMAN.poses)
def test_the_poses_of_coman_touch_nothing(
    kinematics: Kinematics, collision: SelfCollision, pose: str
) -> None:
    q = kinematics.standing(pose)
    kinematics.update(q)
    assert min(collision.distances(kinematics).values()) > 0.005
    assert (collision.bounds(kinematics, q, DT_S).lower < 0).all()  # to stand still is allowed


def test_links_that_touch_are_moved_apart(kinematics: Kinematics, collision: SelfCollision) -> None:
    q = kinematics.standing("stand")
    q[7 + COMAN.index("LHipLat")] -= 0.2
    q[7 + COMAN.index("RHipLat")] += 0.2
    kinematics.update(q)
    assert min(collision.distances(kinematics).values()) < 0
    lower = collision.bounds(kinematics, q, DT_S).lower
    assert 0 < lower.max() <= collision.MAX_PARTING_MPS


def test_what_cannot_be_checked_is_answered(kinematics: Kinematics) -> None:
    with pytest.raises(UsageError, match="not checked"):
        SelfCollision(Kinematics(dataclasses.replace(COMAN, collision_pairs=frozenset())))
    with pytest.raises(ValueError, match="watched"):
        SelfCollision(kinematics, min_distance_m=0.2)
