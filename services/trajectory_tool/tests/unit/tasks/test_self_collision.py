"""A robot alone in an empty scene does not move through itself."""

from typing import Any

import pytest

from handover.performer import TaskFailed
from handover_robots.model.faults import RobotFault
from handover_robots.planning import is_available

pytestmark = pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")

FOLDED = [0.0, -1.57, 2.9, 0.0, 0.0, 0.0]
"""The elbow is bent so far that the forearm is in the upper arm."""


THROUGH_ITSELF = ((-0.3, -2.0, 2.6, -3.0, -0.4, -1.2), (-1.1, -2.5, 2.6, -0.1, -2.6, 0.1))
"""Two free positions; on the straight way between them the gripper meets the base."""


@pytest.fixture
def alone(worker: Any) -> Any:
    assert not worker.unit.planning.avoids_obstacles
    return worker


async def test_a_position_in_which_the_robot_touches_itself_is_refused_before_it_moves(alone: Any) -> None:
    before = alone.unit.joints
    with pytest.raises(TaskFailed, match="touches"):
        await alone.do("moveTo", joints=FOLDED)
    assert alone.unit.joints == before


async def test_a_way_through_the_robot_itself_is_planned_around(alone: Any) -> None:
    first, second = THROUGH_ITSELF
    await alone.do("moveTo", joints=list(first))
    done = await alone.do("moveTo", joints=list(second))
    assert done["joints"] == pytest.approx(list(second))


async def test_the_limiter_stops_a_motion_into_the_robot_itself(alone: Any) -> None:
    with pytest.raises(RobotFault, match="would touch"):
        await alone.unit.robot.move(tuple(FOLDED), 1.0, lambda: 1.0)
    assert alone.unit.joints[2] < FOLDED[2] - 0.01, "it came to rest before the target"


async def test_commanded_velocities_do_not_lead_the_robot_into_itself(alone: Any) -> None:
    ends_s = alone.time.time_s + 6.0

    def bend_the_elbow() -> tuple[float, ...]:
        return (0.0, 0.0, 0.8, 0.0, 0.0, 0.0)

    await alone.unit.robot.servo(bend_the_elbow, lambda: alone.time.time_s > ends_s, lambda: 1.0)
    assert 2.0 < alone.unit.joints[2] < 3.1
    why = await alone.unit.planning.plan(lambda planner: planner.why_not_free(alone.unit.joints))
    assert why is None
