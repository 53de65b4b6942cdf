"""What a control session commands in shared control, on a clock that jumps: the same on any machine."""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from handover_datamodels.streams import HumanInput
from handover_robots.control.session import ControlSession
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Pose, Vector
from services.trajectory_tool.tests.unit.conftest import Worker

EVERY_S = 0.02
TIMEOUT_S = 0.1
STOP_S = 0.5
"""More than a UR10 takes to rest from the speeds of control."""


class Hand:
    """A person whose inputs are a function of the time since the begin, 50 a second; None sends nothing."""

    def __init__(
        self, worker: Worker, session: ControlSession, inputs: Callable[[float], dict[str, Any] | None]
    ) -> None:
        self.seen: list[tuple[float, Joints]] = []
        self._time, self._session, self._given = worker.time, session, inputs
        self._unit = worker.unit
        self._began_s = self._sent_s = worker.time.time_s
        self._seq = 0
        self._ends_s = math.inf

    def send(self, now_s: float) -> None:
        """Send what is due; called at each wait of the robot."""
        self.seen.append((now_s - self._began_s, self._unit.robot.commanded()))
        if now_s - self._sent_s < EVERY_S - 1e-6:
            return
        self._sent_s = now_s
        members = self._given(now_s - self._began_s) if now_s < self._ends_s else {"held": False}
        if members is not None:
            self._seq += 1
            self._session.receive(HumanInput(seq=self._seq, **members))

    async def act(self, duration_s: float) -> None:
        """Send for a time; the robot moves as the inputs say, and then comes to rest."""
        self._ends_s = self._began_s + duration_s
        self._time.on_wait = self.send
        while self._time.time_s < self._ends_s:
            if not await self._session.advance():
                self._time.wait(EVERY_S)
        self._time.on_wait = lambda now_s: None

    def at(self, time_s: float) -> Pose:
        """Return the commanded pose of the tool at a time."""
        return self._unit.model.tool_pose(self.joints_at(time_s))

    def joints_at(self, time_s: float) -> Joints:
        """Return the commanded joints at a time."""
        return min(self.seen, key=lambda seen: abs(seen[0] - time_s))[1]


def session_of(worker: Worker) -> ControlSession:
    return ControlSession(worker.unit, (), now=lambda: worker.time.time_s)


def held(**members: Any) -> dict[str, Any]:
    return {"held": True, **members}


def after_a_release(inputs: Callable[[float], dict[str, Any] | None]) -> Callable[[float], Any]:
    return lambda now_s: {"held": False} if now_s < 3 * EVERY_S else inputs(now_s)


@pytest.mark.parametrize("mix", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("ends", ["released", "silent"])
async def test_the_dead_man_control_holds_at_every_mix(worker: Worker, mix: float, ends: str) -> None:
    last = {"held": False, "mix": mix} if ends == "released" else None
    moved = held(mix=mix, linear=(0.0, 0.0, 0.1 if mix < 1 else 0.0))
    async with session_of(worker) as session:
        hand = Hand(worker, session, after_a_release(lambda now_s: moved if now_s < 1.0 else last))
        await hand.act(3.0)
    assert hand.at(0.9).distance_m(hand.at(0.5)) > 0.01
    waited_s = TIMEOUT_S if ends == "silent" else 0.0
    rest = hand.at(1.0 + EVERY_S + waited_s + STOP_S)
    assert hand.at(2.9).distance_m(rest) == pytest.approx(0, abs=1e-9)


async def test_a_limit_leads_to_no_wind_up(worker: Worker) -> None:
    """A joint is pressed against its limit for a short and for a long time; it comes back alike from both."""
    ways = []
    for pressed_s in (12.0, 20.0):

        def there_and_back(now_s: float, pressed_s: float = pressed_s) -> dict[str, Any]:
            return held(joints=(0.0, 0.0, 0.0, 0.0, 0.0, 0.9 if now_s < pressed_s else -0.3))

        async with session_of(worker) as session:
            hand = Hand(worker, session, after_a_release(there_and_back))
            await hand.act(pressed_s + 1.0)
        limit_rad = worker.unit.model.joints[5].upper
        assert limit_rad is not None
        at_limit = hand.joints_at(pressed_s)[5]
        assert limit_rad - 0.02 < at_limit <= limit_rad, "it is at the limit"
        ways.append([at_limit - hand.joints_at(pressed_s + later_s)[5] for later_s in (0.2, 0.5, 0.9)])
    assert ways[0] == pytest.approx(ways[1], abs=0.01)
    assert ways[0][1] > 0.08


@pytest.mark.parametrize(("asked", "is_arbitrated"), [(1.0, False), (0.9, True)])
async def test_a_person_who_steers_away_from_the_goal_is_never_overridden(
    worker: Worker, *, asked: float, is_arbitrated: bool
) -> None:
    for direction in ((0.0, 0.0, 1.0), (0.5, 0.1, 1.0)):
        x, y, z = (0.15 * part / math.hypot(*direction) for part in direction)

        def to_the_goal_then_away(now_s: float, away: Vector = (x, y, z)) -> dict[str, Any]:
            linear = (0.0, 0.0, 0.0) if now_s < 7.0 else away
            return held(mix=asked, arbitration=is_arbitrated, linear=linear)

        async with session_of(worker) as session:
            hand = Hand(worker, session, after_a_release(to_the_goal_then_away))
            await hand.act(7.6)
            assert session.shared.mix == 0.0 or direction != (0.0, 0.0, 1.0)
            goals = session._goals
        begin, end = hand.at(7.0), hand.at(7.5)
        if asked == 1.0 and not is_arbitrated:
            assert min(begin.distance_m(goal) for goal in goals.values()) < 0.002, "it was at a goal"
        moved = np.subtract(end.position, begin.position)
        assert float(moved @ (x, y, z)) / 0.15 > 0.03, direction


async def test_the_mix_rises_by_its_rate_in_a_motion(worker: Worker) -> None:
    mixes: list[tuple[float, float]] = []
    async with session_of(worker) as session:

        def autonomous(now_s: float) -> dict[str, Any]:
            mixes.append((now_s, session.shared.mix))
            return held(mix=1.0)

        await Hand(worker, session, after_a_release(autonomous)).act(1.6)
    for (before_s, before), (now_s, now) in pairwise(mixes):
        assert now - before <= (now_s - before_s) * 1.0 + 0.01
    assert mixes[-1][1] == pytest.approx(1.0)
    assert mixes[len(mixes) // 3][1] < 0.6
