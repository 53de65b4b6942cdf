"""Live documents follow the poses of a person, a headset does not wait for the next period."""

import asyncio

import pytest

from handover_humanoid.running.inputs import PersonInputs, PoseMessage
from handover_humanoid.running.live_pace import FOLLOWS_FROM_HZ, Pace

HOUR_S = 3600.0
WITHIN_S = 60.0
POSE = PoseMessage(kind="pose", t=1.0)


async def begun(pace: Pace) -> asyncio.Task[None]:
    """Return the wait for the next document, after it had several turns of the loop."""
    waiting = asyncio.create_task(pace.next())
    for _ in range(10):
        await asyncio.sleep(0)
    return waiting


async def test_a_document_follows_a_pose_before_its_period_is_over() -> None:
    inputs = PersonInputs()
    with inputs.poses.followed() as pose:
        pace = Pace(HOUR_S, pose, least_s=0.0)
        for _ in range(2):  # a pose counts once
            waiting = await begun(pace)
            assert not waiting.done()
            inputs.receive(POSE)
            await asyncio.wait_for(waiting, WITHIN_S)


async def test_a_pose_that_came_while_a_document_was_sent_is_not_forgotten() -> None:
    inputs = PersonInputs()
    with inputs.poses.followed() as pose:
        inputs.receive(POSE)
        await asyncio.wait_for(Pace(HOUR_S, pose, least_s=0.0).next(), WITHIN_S)


async def test_documents_come_by_their_period_without_a_person() -> None:
    with PersonInputs().poses.followed() as pose:
        pace = Pace(1.0 / FOLLOWS_FROM_HZ, pose)
        for _ in range(3):
            await asyncio.wait_for(pace.next(), WITHIN_S)


@pytest.mark.parametrize("least_s", [None, HOUR_S])
async def test_poses_do_not_make_documents_more_frequent_than_a_reader_wants(least_s: float | None) -> None:
    inputs = PersonInputs()
    with inputs.poses.followed() as pose:
        waiting = await begun(Pace(HOUR_S, pose, least_s))  # a page on a desk
        inputs.receive(POSE)
        for _ in range(10):
            await asyncio.sleep(0)
        assert not waiting.done()
        waiting.cancel()
