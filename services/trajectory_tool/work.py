"""Work: one Task in the hands of the robot, from its first motion to its last.

It knows how far it has come and how long it will take, and comes to rest where it is when it may not go on.
"""

import asyncio
from collections.abc import Iterator
from typing import Protocol

from services.trajectory_tool.cell import Cell
from services.trajectory_tool.memory import Act
from services.trajectory_tool.robot import Joints


class Steering(Protocol):
    """Whoever may hold the work up or end it."""

    def may_go(self) -> bool:
        """Say whether the work may go on; cheap, asked in each cycle of control from its thread."""

    async def rest(self) -> None:
        """Return when the work, which is at rest, may go on; raise if it is not wanted any more."""


class Work:
    """The motions and acts of the gripper of one Task, at `speed` (0 to 1 of what the joints may do)."""

    def __init__(self, task: str, operation: str, cell: Cell, steering: Steering, speed: float) -> None:
        self.task = task
        self.operation = operation
        self.cell = cell
        self._steering = steering
        self._speed = speed
        self._ahead: list[float] = []
        self._in_hand_s = 0.0
        self._moving = False
        self._total_s = 0.0
        self._progress = 0.0

    def intend(self, *steps: Joints | float) -> None:
        """Say what is ahead: joints to move to in rad, and acts that take so many seconds.

        Raises `RobotFault` when there is no such motion.
        """
        self._ahead = list(self._durations(steps))
        self._total_s = sum(self._ahead)

    def remaining_s(self) -> float:
        """Return how long the work still takes if nothing holds it up."""
        return max(self.cell.robot.remaining_s(), self._in_hand_s) + sum(self._ahead)

    def progress(self) -> float:
        """Return how far the work is, from 0 to 1; it never goes back.

        A motion that has just come to rest tells nothing until it is known whether it rests at its target.
        """
        just_at_rest = self._moving and self.cell.robot.remaining_s() == 0.0
        if self._total_s > 0 and not just_at_rest:
            self._progress = max(self._progress, min(1 - self.remaining_s() / self._total_s, 1.0))
        return self._progress

    async def go(self, target: Joints) -> None:
        """Move to joints in rad, resting on the way as often as it must; at rest there when it returns."""
        self._begin_next()
        self._in_hand_s = 0.0
        while not await self._move(target):
            await self.cell.remember()
            await self._steering.rest()
            self._in_hand_s = 0.0
        await self.cell.remember()

    async def _move(self, target: Joints) -> bool:
        self._moving = True
        try:
            arrived = await self.cell.robot.move(target, self._speed, self._may_go)
            if not arrived:
                self._in_hand_s = self.cell.robot.estimate_s(self.cell.joints, target, self._speed)
            return arrived
        finally:
            self._moving = False

    def _may_go(self) -> bool:
        """Ask whether the motion may go on; from where it may not, its way to the target is still ahead."""
        may_go = self._steering.may_go()
        if not may_go and self._in_hand_s == 0.0:
            self._in_hand_s = self.cell.robot.remaining_s()
        return may_go

    async def grip(self) -> str | None:
        """Close the gripper; return the part it holds then, None (and open) if there is none."""
        await self._begin_act()
        return await self.cell.grip(self.task)

    async def release(self, place: str | None) -> None:
        """Open the gripper; what it held lies in the fixture `place`, or just where it is."""
        await self._begin_act()
        await self.cell.release(self.task, place)

    async def wait(self, seconds: float) -> None:
        """Stand still for so long, the camera looking."""
        await self._begin_act()
        await asyncio.sleep(seconds)

    def done_before(self) -> Act | None:
        """Return what the gripper has already done for this Task, in a run that was cut short perhaps."""
        return self.cell.done_for(self.task)

    async def _begin_act(self) -> None:
        while not self._steering.may_go():
            await self._steering.rest()
        self._begin_next()

    def _begin_next(self) -> None:
        self._in_hand_s = self._ahead.pop(0) if self._ahead else 0.0

    def _durations(self, steps: tuple[Joints | float, ...]) -> Iterator[float]:
        here = self.cell.joints
        for step in steps:
            if isinstance(step, tuple):
                yield self.cell.robot.estimate_s(here, step, self._speed)
                here = step
            else:
                yield step
