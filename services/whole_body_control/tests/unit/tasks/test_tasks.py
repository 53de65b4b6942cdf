"""Each task and constraint of the stack means what it says: its rows are the derivative of its error."""

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_humanoid.engines.stack_engine import StackEngine
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.robots import humanoid
from handover_humanoid.tasks.base import Task
from handover_humanoid.tasks.constraints import Contact, JointLimits, SupportPolygon
from handover_humanoid.tasks.tasks import (
    CentreOfMassTask,
    JointTask,
    OrientationTask,
    PointTask,
    PoseTask,
    posture,
)

COMAN = humanoid("coman")
KINEMATICS = Kinematics(COMAN)
STEP_S, FORWARD = 1e-5, np.array([0.6, 0.3, 0.7])
NEAR = pin.SE3(pin.exp3(np.array([0.1, -0.2, 0.15])), np.array([0.3, -0.2, 0.6]))


def near(link: str) -> pin.SE3:
    """Return a pose that a link is turned and moved against by a little, so that no error wraps."""
    KINEMATICS.update(KINEMATICS.standing("stand"))
    turned = KINEMATICS.pose(link).rotation @ NEAR.rotation
    return pin.SE3(turned, NEAR.translation)


TASKS: dict[str, Callable[[], Task]] = {
    "pose of a frame": lambda: PoseTask("hand", "RSoftHand", near("RSoftHand")),
    "some axes of a pose": lambda: PoseTask("foot", "l_sole", near("l_sole"), axes=(True, False, True) * 2),
    "point": lambda: PointTask("point", "LSoftHand", np.array([0.0, -0.03, 0.02]), FORWARD),
    "centre of mass": lambda: CentreOfMassTask("com", FORWARD),
    "joints": lambda: JointTask("arm", COMAN.indices("right_arm"), np.full(7, 0.2)),
    "posture": lambda: posture(KINEMATICS, "hands_forward"),
}


def state(seed: int) -> tuple[Array, Array]:
    """Return a configuration near to standing, and a velocity."""
    random = np.random.default_rng(seed)
    v = random.normal(scale=0.5, size=KINEMATICS.n_velocities)
    return KINEMATICS.integrate(KINEMATICS.standing("stand"), 0.3 * v, 1.0), random.normal(size=len(v))


@pytest.mark.parametrize("name", TASKS)
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_rows_of_a_task_are_the_derivative_of_its_error(name: str, seed: int) -> None:
    """To the first order: errors of orientation are rotation vectors, whose derivative is exact at 0 only."""
    task = TASKS[name]()
    q, v = state(seed)
    KINEMATICS.update(q)
    rows, before = task.rows(KINEMATICS), task.error(KINEMATICS)
    assert rows.jacobian.shape == (task.size, len(v))
    KINEMATICS.update(KINEMATICS.integrate(q, v, STEP_S))
    change = (task.error(KINEMATICS) - before) / STEP_S
    linear = slice(None) if task.size != 6 and name != "some axes of a pose" else slice(0, task.size // 2)
    assert -(rows.jacobian @ v)[linear] == pytest.approx(change[linear], rel=1e-3, abs=2e-3)


@pytest.mark.parametrize("turn", [np.array([0.3, 0.0, 0.2]), np.array([-0.2, 0.4, -0.3])])
def test_orientations_are_reached_and_the_free_turn_is_free(turn: Array) -> None:
    q, _ = state(7)
    KINEMATICS.update(q)
    hand = KINEMATICS.pose("RSoftHand").copy()
    hand.rotation = pin.exp3(turn) @ hand.rotation
    wrist = PoseTask("hand", "RSoftHand", hand, axes=(False,) * 3 + (True,) * 3)
    waist = OrientationTask("waist", "DWYTorso")
    contacts = (Contact("l_sole"), Contact("r_sole"), JointLimits(KINEMATICS))
    engine = StackEngine(KINEMATICS, (wrist & waist) / posture(KINEMATICS, "stand", 0.1) << contacts)
    for _ in range(150):
        q = engine.step(q, 0.01).q
    KINEMATICS.update(q)
    for task in (wrist, waist):
        assert np.linalg.norm(task.error(KINEMATICS)) < 0.02, task.label


def test_the_centre_of_mass_stays_in_the_support_polygon_of_one_sole() -> None:
    q = KINEMATICS.standing("stand")
    KINEMATICS.update(q)
    away = CentreOfMassTask("com", np.array([0.0, -0.3, 0.5]))
    support = SupportPolygon(("left_sole", "right_sole"), margin_m=0.03, is_capture_point=False)
    contacts = (Contact("l_sole"), Contact("r_sole"), JointLimits(KINEMATICS))
    engine = StackEngine(KINEMATICS, away / posture(KINEMATICS, "stand") << [*contacts, support])
    for _ in range(150):
        q = engine.step(q, 0.01).q
        KINEMATICS.update(q)
        edge = KINEMATICS.pose("r_sole").translation[1] - 0.05
        assert KINEMATICS.centre_of_mass()[1] >= edge + 0.03 - 1e-3
    assert KINEMATICS.centre_of_mass()[1] < -0.02, "it goes as far as it may"
