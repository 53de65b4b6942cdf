"""Throws: planned here, beside the control cycle, and sent to it as numbers with the wish.

How it works:

1. A plan takes some 0.1 s, and a second where a place is out of reach; then the throw is refused.
2. The throw of a hand that has not rehearsed yet (`Rehearsals`) waits for that, but its request does not: it
   is `preparing`. A stop, or another behaviour, meanwhile refuses it.
3. A hand practises: the cycle reports where the ball will land by its own estimate at the release, and the
   next throw aims off by what it missed.
"""

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final, TypeVar

import numpy as np

from handover.errors import Problem, UsageError
from handover.messages import message, with_code
from handover.telemetry import get_logger
from handover_humanoid.behaviours.throwing import Practice, aimed_throw
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.patterns.throwing import OutOfReach, PlannedThrow, ThrowPlanner
from handover_humanoid.running.motion import Motion
from handover_humanoid.running.rehearsals import Rehearsals

log = get_logger(__name__)

POSE: Final = "stand"
MAX_REFUSALS: Final = 32
"""The last refusals that are known by their number."""

T = TypeVar("T")


class ThrowState(StrEnum):
    """How far a request for a throw is; after `planned` the control cycle has it."""

    PLANNING = "planning"
    PREPARING = "preparing"
    PLANNED = "planned"
    REFUSED = "refused"


@dataclass
class _Request:
    number: int
    target: tuple[float, float, float]
    hand: str
    state: ThrowState = ThrowState.PLANNING
    problem: Problem | None = None
    """Why it is refused."""
    is_possible: asyncio.Event = field(default_factory=asyncio.Event)
    """Set when it is known whether the hand can throw there."""

    @property
    def grip(self) -> str:
        return f"{self.hand}_hand"

    @property
    def is_pending(self) -> bool:
        return self.state in {ThrowState.PLANNING, ThrowState.PREPARING}


class Throws:
    """The throws of one humanoid, one at a time; `values` returns the newest state of the cycle."""

    def __init__(
        self,
        humanoid: Humanoid,
        motion: Motion,
        practice: Practice,
        rehearsals: Rehearsals,
        values: Callable[[], Mapping[str, float]],
    ) -> None:
        self._humanoid, self._motion, self._values = humanoid, motion, values
        self._planners: dict[str, ThrowPlanner] = {}
        self._practice, self._rehearsals, self._base = practice, rehearsals, np.zeros(2)
        self._worker = ThreadPoolExecutor(1, "throw-planning")  # the planners are not thread-safe
        self._number = 0
        self._newest: _Request | None = None
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

        Raises `Problem` 409 or 422. What becomes of it is known later: see `is_pending` and `refusal`.
        """
        return self._request(target, hand).number

    async def throw(self, target: Sequence[float], hand: str) -> int:
        """Ask for a throw and return its number when it is known that the hand can throw there.

        Raises `Problem`: 409, 422.
        """
        asked = self._request(target, hand)
        await asked.is_possible.wait()
        if asked.problem is not None:
            raise asked.problem
        return asked.number

    @property
    def is_busy(self) -> bool:
        """Whether a throw is planned or prepared; another one is not accepted meanwhile."""
        return self._newest is not None and self._newest.is_pending

    def is_pending(self, number: int) -> bool:
        """Return whether a throw is planned or prepared."""
        return self.is_busy and self._newest is not None and self._newest.number == number

    def refusal(self, number: int) -> str | None:
        """Return why a throw was refused, None if it was not."""
        return self._refused.get(number)

    def view(self) -> dict[str, Any] | None:
        """Return the newest request as the live document shows it, None without one."""
        asked = self._newest
        if asked is None:
            return None
        return {
            "number": asked.number,
            "hand": asked.hand,
            "target": asked.target,
            "state": asked.state.value,
            **with_code("reason", "" if asked.problem is None else asked.problem.detail),
        }

    def tick(self) -> None:
        """Follow the newest state: learn how the last throw went, and refuse one that may not be any more."""
        values = self._values()
        number = int(values.get("throw_number", 0.0))
        predicted = np.array([values.get(f"predicted.{axis}", math.nan) for axis in "xyz"])
        if number in self._aimed and np.isfinite(predicted).all():
            grip, aimed = self._aimed.pop(number)
            self._practice.learn(grip, self._base, aimed, predicted)
        asked = self._newest
        if asked is not None and asked.is_pending and not self._require_still(asked):
            assert self._planning is not None  # noqa: S101 - what is pending is planned
            self._planning.cancel()

    def _request(self, target: Sequence[float], hand: str) -> _Request:
        if self.is_busy:
            raise Problem.translated(
                409, "Throw planned", "humanoid.throw_planned", "another throw is being planned; wait for it"
            )
        self._motion.require_throwing(target)
        # Of a cycle that an earlier service started.
        last_number = int(self._values().get("throw_number", 0.0))
        self._number = max(self._number, last_number) + 1
        x, y, z = target
        self._newest = _Request(self._number, (x, y, z), hand)
        self._planning = asyncio.create_task(self._plan(self._newest))
        return self._newest

    def _require_still(self, asked: _Request) -> bool:
        """Refuse a throw that the robot may not make any more, as after a stop; return whether it may."""
        try:
            self._motion.require_throwing(asked.target)
        except Problem as problem:
            self._refuse(asked, problem)
        return asked.is_pending

    async def _plan(self, asked: _Request) -> None:
        target = np.array(asked.target, dtype=np.float64)
        try:
            if not self._rehearsals.is_known(asked.grip):
                await self._in_worker(lambda: self._planner(asked.grip).plan(target))
                if not self._require_still(asked):
                    return
                asked.state = ThrowState.PREPARING
                asked.is_possible.set()
                await self._rehearsals.wait(asked.grip)
            aimed, throw = await self._in_worker(lambda: self._planned(asked.grip, target))
        except OutOfReach as error:
            self._refuse(asked, Problem(422, "Out of reach", _farthest(error)))
        except UsageError as error:
            self._refuse(asked, Problem(422, "Out of reach", str(error)))
        except Exception:  # any error must end the planning, for which others wait
            log.exception("throw not planned", number=asked.number)
            reason = message(
                "humanoid.throw_failed", "the throw could not be planned; the log of the service says why"
            )
            self._refuse(asked, Problem(500, "Not planned", reason))
        else:
            if self._require_still(asked):
                self._aimed = {asked.number: (asked.grip, aimed)}
                self._motion.set_throw(asked.number, asked.target, asked.hand, throw)
                asked.state = ThrowState.PLANNED
        finally:
            asked.is_possible.set()

    async def _in_worker(self, function: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._worker, function)

    def _planned(self, grip: str, target: Array) -> tuple[Array, PlannedThrow]:
        """Return where to aim, and the throw that does; runs in the worker."""
        return aimed_throw(self._planner(grip), self._practice, grip, self._base, target)

    def _planner(self, name: str) -> ThrowPlanner:
        """Return the planner of a hand; runs in the worker. Raises `UsageError`."""
        grip = self._humanoid.grips.get(name)
        if grip is None:
            there = ", ".join(self._humanoid.grips) or "none"
            raise UsageError(f"{self._humanoid.name} has no {name} that throws; it has: {there}")
        if name not in self._planners:
            kinematics = Kinematics(self._humanoid)
            start = kinematics.standing(POSE)
            self._base = start[:2].copy()
            self._planners[name] = ThrowPlanner(kinematics, start, grip)
        return self._planners[name]

    def _refuse(self, asked: _Request, problem: Problem) -> None:
        log.info("throw refused", number=asked.number, reason=str(problem.detail))
        asked.state, asked.problem = ThrowState.REFUSED, problem
        asked.is_possible.set()
        self._refused[asked.number] = problem.detail
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
