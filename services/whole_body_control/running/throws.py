"""Throws: planned here, beside the control cycle, and sent to it as numbers with the wish.

A plan takes some 0.1 s, and a second where a place is out of reach. Each hand rehearses in a simulation
before its first throw, and practises: the cycle reports where the ball will land by its own estimate at the
release, and the next throw aims off by what it missed.
"""

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import numpy as np

from handover.errors import Problem, UsageError
from handover.messages import message
from handover.telemetry import get_logger
from services.whole_body_control.behaviours.rehearsal import rehearse
from services.whole_body_control.behaviours.throwing import Practice
from services.whole_body_control.model.humanoid import Humanoid
from services.whole_body_control.model.kinematics import Array, Kinematics
from services.whole_body_control.patterns.throwing import OutOfReach, Throw, ThrowPlanner
from services.whole_body_control.running.motion import Motion
from services.whole_body_control.solvers.compiled import fastest_solver

log = get_logger(__name__)

POSE: Final = "stand"
REHEARSED: Final = np.array([0.8, 0.0, 0.5])
"""Where a hand rehearses to throw, in m: within the reach of every hand."""
MAX_REFUSALS: Final = 32
"""The last refusals that are known by their number."""


class Throws:
    """The throws of one humanoid, one at a time; `values` returns the newest state of the cycle."""

    def __init__(self, humanoid: Humanoid, motion: Motion, values: Callable[[], Mapping[str, float]]) -> None:
        self._humanoid, self._motion, self._values = humanoid, motion, values
        self._planners: dict[str, ThrowPlanner] = {}
        self._practice, self._base = Practice(), np.zeros(2)
        self._worker = ThreadPoolExecutor(1, "throw-planning")  # the planners are not thread-safe
        self._number = 0
        self._refused: dict[int, str] = {}
        self._planning: asyncio.Task[None] | None = None
        self._aimed: dict[int, tuple[str, Array]] = {}
        """Hand and aim of throws whose landing is not known yet, by number."""

    def close(self) -> None:
        """End the planning."""
        if self._planning is not None:
            self._planning.cancel()
        self._worker.shutdown(wait=False, cancel_futures=True)

    def request(self, target: Sequence[float], hand: str) -> int:
        """Ask for a throw to `target` in m, in the frame between the soles; return its number at once.

        Raises `Problem` 409 or 422. Whether it can be planned is known later: see `refusal`.
        """
        number = self._new_number(target)
        self._planning = asyncio.create_task(self._plan(number, target, hand))
        return number

    async def throw(self, target: Sequence[float], hand: str) -> int:
        """Ask for a throw and return its number when it is planned. Raises `Problem`: 409, 422."""
        number = self.request(target, hand)
        assert self._planning is not None  # noqa: S101 - `request` has made it
        await asyncio.shield(self._planning)
        refused = self.refusal(number)
        if refused is not None:
            raise Problem(422, "Out of reach", refused)
        return number

    def refusal(self, number: int) -> str | None:
        """Return why a throw was refused, None if it was not."""
        return self._refused.get(number)

    def learn(self) -> None:
        """Learn from the newest state how the last throw went."""
        values = self._values()
        number = int(values.get("throw_number", 0.0))
        predicted = np.array([values.get(f"predicted.{axis}", math.nan) for axis in "xyz"])
        if number in self._aimed and np.isfinite(predicted).all():
            grip, aimed = self._aimed.pop(number)
            self._practice.learn(grip, self._base, aimed, predicted)

    def _new_number(self, target: Sequence[float]) -> int:
        if self._planning is not None and not self._planning.done():
            raise Problem(
                409,
                "Throw planned",
                message("humanoid.throw_planned", "another throw is being planned; wait for it"),
            )
        self._motion.require_throwing(target)
        known = int(self._values().get("throw_number", 0.0))  # of a cycle that an earlier service started
        self._number = max(self._number, known) + 1
        return self._number

    async def _plan(self, number: int, target: Sequence[float], hand: str) -> None:
        try:
            aimed, throw = await asyncio.get_running_loop().run_in_executor(
                self._worker, self._planned, np.array(target, dtype=np.float64), hand
            )
            self._motion.require_throwing(target)  # a stop may have come meanwhile
        except OutOfReach as error:
            self._refuse(number, _farthest(error))
        except UsageError as error:
            self._refuse(number, str(error))
        except Problem as error:
            self._refuse(number, str(error.detail))
        else:
            self._aimed = {number: (f"{hand}_hand", aimed)}
            self._motion.set_throw(number, target, hand, throw)

    def _planned(self, target: Array, hand: str) -> tuple[Array, Throw]:
        """Return where to aim, and the throw that does; runs in the worker."""
        name = f"{hand}_hand"
        planner = self._planners.get(name) or self._prepared(name, target)
        aimed = self._practice.aim(name, self._base, target)
        try:
            return aimed, planner.plan(aimed)
        except OutOfReach:
            return target, planner.plan(target)  # the place itself, where aiming off is beyond reach

    def _prepared(self, name: str, target: Array) -> ThrowPlanner:
        """Return the planner of a hand, which has rehearsed unless the place is beyond its reach."""
        grip = self._humanoid.grips.get(name)
        if grip is None:
            there = ", ".join(self._humanoid.grips) or "none"
            raise UsageError(f"{self._humanoid.name} has no {name} that throws; it has: {there}")
        kinematics = Kinematics(self._humanoid)
        start = kinematics.standing(POSE)
        self._base = start[:2].copy()
        planner = ThrowPlanner(kinematics, start, grip)
        planner.plan(target)  # the refusal does not wait for the rehearsal
        rehearse(self._practice, self._humanoid, [name], REHEARSED, fastest_solver())
        self._planners[name] = planner
        return planner

    def _refuse(self, number: int, reason: str) -> None:
        log.info("throw refused", number=number, reason=reason)
        self._refused[number] = reason
        for old in list(self._refused)[:-MAX_REFUSALS]:
            del self._refused[old]


def _farthest(error: OutOfReach) -> str:
    if error.nearest is None:
        return message("humanoid.throw_unreachable", "this hand cannot throw there, nor nearer on that line")
    x, y, z = (f"{value:.2f}" for value in error.nearest)
    return message(
        "humanoid.throw_too_far",
        "this hand cannot throw there; the farthest place on that line is {x} m ahead, {y} m to the left, "
        "{z} m up",
        x=x,
        y=y,
        z=z,
    )
