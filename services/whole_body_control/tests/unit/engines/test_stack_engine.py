"""The stack of tasks on COMAN: it reaches, keeps its feet, obeys limits, and answers what has no meaning."""

import numpy as np
import pinocchio as pin
import pytest

from handover_humanoid.engines.stack_engine import StackEngine
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.robots import humanoid
from handover_humanoid.solvers.cascade import Cascade
from handover_humanoid.solvers.hierarchical import Hierarchical
from handover_humanoid.solvers.problem import Solver
from handover_humanoid.tasks.base import Stack, Task
from handover_humanoid.tasks.constraints import Contact, JointLimits, SupportPolygon
from handover_humanoid.tasks.tasks import (
    AngularMomentumTask,
    CentreOfMassTask,
    GazeTask,
    OrientationTask,
    PoseTask,
    RelativePoseTask,
    posture,
)

DT_S = 0.01
COMAN = humanoid("coman")


class Body:
    """COMAN in its standing pose, with the usual tasks."""

    def __init__(self) -> None:
        self.kinematics = Kinematics(COMAN)
        self.q = self.kinematics.standing("stand")
        self.kinematics.update(self.q)
        self.limits = JointLimits(self.kinematics)
        self.left_sole = self.keeps("l_sole")
        self.right_sole = self.keeps("r_sole")
        com = self.kinematics.centre_of_mass()
        self.com = CentreOfMassTask("com", com)
        self.waist = OrientationTask("waist", "Waist")
        self.posture = posture(self.kinematics, "stand")

    def keeps(self, link: str) -> PoseTask:
        return PoseTask(link, link, self.kinematics.pose(link).copy())

    def hand(self, offset: Array) -> PoseTask:
        target = self.kinematics.pose("RSoftHand").copy()
        target.translation = target.translation + offset
        return PoseTask("right hand", "RSoftHand", target, axes=(True,) * 3 + (False,) * 3)

    def run(self, stack: Stack, cycles: int, solver: Solver | None = None) -> StackEngine:
        engine = StackEngine(self.kinematics, stack, solver)
        for _ in range(cycles):
            step = engine.step(self.q, DT_S)
            assert step.fault == ""
            assert (np.abs(step.velocity[6:]) <= self.limits.velocity + 1e-6).all()
            self.q = step.q
        self.kinematics.update(self.q)
        return engine

    def error(self, task: Task) -> float:
        return float(np.linalg.norm(task.error(self.kinematics)))


@pytest.fixture
def body() -> Body:
    return Body()


@pytest.mark.parametrize("solver", [Cascade(), Hierarchical()], ids=lambda solver: solver.name)
def test_the_hand_reaches_while_the_feet_stay(body: Body, solver: Solver) -> None:
    hand = body.hand(np.array([0.1, -0.02, 0.15]))
    stack = (body.left_sole & body.right_sole) / body.com / hand / body.waist / body.posture << body.limits
    body.run(stack, 150, solver)
    assert body.error(hand) < 2e-3
    assert body.error(body.left_sole) < 1e-4
    assert body.error(body.right_sole) < 1e-4
    assert body.error(body.com) < 1e-3
    assert body.error(body.waist) < 1e-2


def test_a_target_beyond_reach_costs_no_level_above(body: Body) -> None:
    hand = body.hand(np.array([2.0, 0.0, 0.0]))
    stack = (body.left_sole & body.right_sole) / body.com / hand / body.posture << body.limits
    engine = body.run(stack, 200)
    assert body.error(hand) > 1.0
    before = engine.step(body.q, DT_S)
    after = engine.step(before.q, DT_S)
    assert after.velocity == pytest.approx(before.velocity, abs=0.1)  # the stretched arm does not tremble
    assert body.error(body.left_sole) < 1e-3
    assert body.error(body.com) < 5e-3
    joints = body.q[7:]
    assert (joints >= body.limits.lower - 1e-6).all()
    assert (joints <= body.limits.upper + 1e-6).all()


def test_contacts_as_constraints_keep_the_feet_exactly(body: Body) -> None:
    hand = body.hand(np.array([0.05, 0.0, 0.1]))
    stack = body.com / hand / body.waist / body.posture << (
        Contact("l_sole"),
        Contact("r_sole"),
        body.limits,
    )
    body.run(stack, 150)
    assert body.error(hand) < 2e-3
    assert body.error(body.left_sole) < 1e-3


def test_the_capture_point_stays_above_the_soles(body: Body) -> None:
    away = CentreOfMassTask("com", np.array([0.5, 0.0, 0.4]))
    support = SupportPolygon(("left_sole", "right_sole"), margin_m=0.02)
    stack = away / body.posture << (Contact("l_sole"), Contact("r_sole"), body.limits, support)
    body.run(stack, 200)
    toes = body.kinematics.pose("l_sole").act(np.array(COMAN.contacts["left_sole"].corners[0]))
    ahead = body.kinematics.centre_of_mass()[0]
    assert ahead <= toes[0] - 0.02 + 2e-3
    assert ahead > toes[0] - 0.05  # it goes as far as it may


def test_gaze_relative_pose_and_momentum(body: Body) -> None:
    gaze = GazeTask("gaze", "gaze", np.array([1.0, 0.3, 0.6]))
    grip = body.kinematics.pose("RSoftHand").actInv(body.kinematics.pose("LSoftHand"))
    hands = RelativePoseTask("hands", "LSoftHand", "RSoftHand", grip)
    hand = body.hand(np.array([0.05, 0.03, 0.05]))
    stack = (body.left_sole & body.right_sole) / body.com / (hand & hands) / gaze / body.posture
    body.run(stack << body.limits, 200)
    assert body.error(hands) < 5e-3
    assert body.error(hand) < 5e-3
    assert body.error(gaze) < 0.02
    quiet = AngularMomentumTask("momentum")
    engine = StackEngine(body.kinematics, Stack((quiet,)) / hand << body.limits)
    step = engine.step(body.q, DT_S)
    assert body.kinematics.momentum_matrix()[3:] @ step.velocity == pytest.approx(np.zeros(3), abs=1e-4)


def test_contradicting_tasks_share_the_error_by_weight(body: Body) -> None:
    up, down = body.hand(np.array([0.0, 0.0, 0.05])), body.hand(np.array([0.0, 0.0, -0.05]))
    stack = (body.left_sole & body.right_sole) / body.com / (3.0 * up & down) / body.posture << body.limits
    body.run(stack, 200)
    assert body.error(up) == pytest.approx(0.025, abs=3e-3)
    assert body.error(down) == pytest.approx(0.075, abs=3e-3)


def test_a_singular_start_is_left_without_a_jump(body: Body) -> None:
    """With straight legs and arms, the most singular pose, motion begins within the limits."""
    straight = body.kinematics.neutral(np.clip(np.zeros(29), body.limits.lower, body.limits.upper))
    body.q = straight
    body.kinematics.update(straight)
    soles = body.keeps("l_sole") & body.keeps("r_sole")
    lower = body.kinematics.centre_of_mass() - np.array([0.0, 0.0, 0.05])
    com = CentreOfMassTask("com", lower)
    body.run(soles / com / body.posture << body.limits, 200)
    assert body.error(com) < 5e-3


def test_not_a_number_holds_still_and_is_named(body: Body) -> None:
    hand = body.hand(np.array([0.1, 0.0, 0.0]))
    hand.target = pin.SE3(np.eye(3), np.full(3, np.nan))
    step = StackEngine(body.kinematics, body.left_sole / hand << body.limits).step(body.q, DT_S)
    assert "level 1" in step.fault
    assert step.velocity == pytest.approx(np.zeros(35))
    assert step.q is body.q


def test_limits_that_contradict_contacts_are_relaxed_and_named(body: Body) -> None:
    far = body.q.copy()
    far[7 + COMAN.index("LKneeSag")] += 10.0  # the joint has to return much faster than its limit of velocity
    body.limits.velocity = np.full(29, 1e3)
    stack = body.com / body.posture << (Contact("l_sole"), Contact("Waist"), body.limits)
    step = StackEngine(body.kinematics, stack).step(far, DT_S)
    assert any("joint limits" in text or "contact" in text for text in step.relaxed)


def test_the_notation_is_shown(body: Body) -> None:
    stack = (body.left_sole & body.right_sole) / body.com / body.posture << body.limits
    assert str(stack) == "(l_sole & r_sole) / com / posture << joint limits"
