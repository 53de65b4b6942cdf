"""Runs one machine: 20 cycles a second, its history for the chart, and one trial at a time."""

import asyncio
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from handover.control.speed_limits import Allowed
from handover.errors import Problem
from handover.messages import text_of
from handover.runtime.background_tasks import BackgroundTasks
from handover.telemetry import get_logger
from handover_cases.body_link import BodyLink
from handover_cases.machine import MAX_STEP_S, Case, Machine, Seen
from handover_cases.metrics import CYCLES, FRACTION, STOPS
from handover_cases.trial import STOPPED_BY_PERSON, Trial, TrialFailed

log = get_logger(__name__)

PERIOD_S: Final = 0.05
POINT_EVERY_S: Final = 0.5
MAX_POINTS: Final = 1300
"""Of the chart: a little more than the ten minutes of the longest trial."""


@dataclass(frozen=True, slots=True)
class Point:
    """The values of the chart at a time, in s since 1970."""

    at_s: float
    values: dict[str, float]


def next_due_s(due_s: float, now_s: float) -> float:
    """Return when the cycle after the one of `due_s` is due: half a period from now at the earliest.

    So a late cycle is followed neither at once nor by those that were missed.
    """
    return max(due_s, now_s - PERIOD_S / 2) + PERIOD_S


class MachineRunner:
    """The machine of one case, with the link to the body of its person."""

    def __init__(self, case: Case, link: BodyLink, tasks: BackgroundTasks) -> None:
        self.case = case
        self.link = link
        self.machine: Machine = case.make()
        self.points: deque[Point] = deque(maxlen=MAX_POINTS)
        self.trial: Trial | None = None
        self.on_cycle: Callable[[MachineRunner], None] = lambda _: None
        self.allowed = Allowed("body", 0.0)
        self._tasks = tasks
        self._trial_task: asyncio.Task[None] | None = None
        self._point_s = 0.0

    async def run(self) -> None:
        """Compute cycles until cancelled."""
        clock = asyncio.get_running_loop().time
        before_s = due_s = clock()
        while True:
            due_s = next_due_s(due_s, clock())
            await asyncio.sleep(due_s - clock())
            now_s = clock()
            passed_s, before_s = now_s - before_s, now_s
            CYCLES.observe(passed_s)
            self.cycle(min(passed_s, MAX_STEP_S))

    def cycle(self, dt_s: float) -> None:
        """Compute one cycle."""
        now_s = time.monotonic()
        self.allowed = self.link.allowed(now_s)
        FRACTION.labels(self.case.name).set(self.allowed.fraction)
        self.machine.step(Seen(now_s, dt_s, self.link.body, self.allowed))
        self.link.do(self.machine.acts())
        if now_s - self._point_s >= POINT_EVERY_S:
            self._point_s = now_s
            self.points.append(Point(time.time(), dict(self.machine.state().chart)))
        self.on_cycle(self)

    async def start(self, options: Mapping[str, Any]) -> None:
        """Let the machine move as the person chooses. Raises `Problem` for options that it does not take."""
        self.machine.configure(options)
        self.machine.start()
        await self.machine.saved()

    def stop(self) -> None:
        """Stop the machine, and its trial."""
        STOPS.labels(self.case.name, "person").inc()
        self.machine.stop()
        if self.trial is not None and self.trial.is_running:
            self.trial.failure = STOPPED_BY_PERSON
            self.trial.is_running = False
            if self._trial_task is not None:
                self._trial_task.cancel()

    async def reset(self) -> None:
        """Release a stop of the limit, at human state and here. Raises `Problem` while it is not possible."""
        await self.link.reset()

    def begin_trial(self, duration_s: float | None, *, consents_to_model: bool = False) -> None:
        """Begin a trial. Raises `Problem` 409 while one runs."""
        if self.trial is not None and self.trial.is_running:
            raise Problem.translated(
                409,
                "Trial runs",
                "case.trial_runs",
                "a trial of {case} runs already; stop it first",
                case=self.case.name,
            )
        self.trial = Trial(
            duration_s,
            consents_to_model,
            on_reset=self.reset,
            is_permitted=lambda: self.link.allowed(time.monotonic()).fraction > 0,
        )
        self._trial_task = self._tasks.start(self._perform, self.trial)

    async def _perform(self, trial: Trial) -> None:
        try:
            await self.machine.perform_trial(trial)
        except TrialFailed as failed:
            trial.failure = text_of(failed)
        except Exception as error:
            trial.failure = f"{type(error).__name__}: {error}"
            raise
        finally:
            self.machine.stop()
            trial.is_running = False
