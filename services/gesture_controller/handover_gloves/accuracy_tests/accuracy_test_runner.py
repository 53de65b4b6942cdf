"""The accuracy test runner: runs tests with worn gloves, in testing mode, so that no Task is answered.

A trial ends for the person only after it has been written to the database. A test that a restart interrupts
is marked as interrupted at the next start, and continues with the trial that it had reached.
"""

import asyncio
import secrets
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, Self
from uuid import uuid4

from sqlalchemy.exc import SQLAlchemyError

from handover.database.outage import in_database
from handover.errors import Problem
from handover.telemetry import get_logger
from handover_datamodels.times import iso
from handover_gloves.accuracy_tests.report import first_recognized
from handover_gloves.accuracy_tests.store import AccuracyTest, AccuracyTestStore
from handover_gloves.accuracy_tests.trials import Observation, Phase, Plan, Progress, Trial, draw_order
from handover_gloves.accuracy_tests.views import TestState, TestSummary
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.known_gloves import KnownGloves
from handover_gloves.recognition.gestures import Gestures
from handover_gloves.recognition.hold import LONG_AGO

log = get_logger(__name__)

MAX_TRIALS = 5000
MAX_SEED = 2**31


class RunningTest:
    """A running test: its plan, its progress and its glove."""

    def __init__(self, test: AccuracyTest, glove: Glove, progress: Progress) -> None:
        self.test = test
        self.glove = glove
        self.progress = progress
        self.last: Trial | None = None
        self.was_testing = glove.modes.testing
        """True if the glove was in testing mode before."""

    def view(self) -> dict[str, Any]:
        """Return what the screen shows."""
        plan, progress = self.test.plan, self.progress
        is_over = progress.done >= len(plan.asked) or progress.phase.is_over
        gesture = None if is_over else plan.asked[progress.done]
        return {
            "id": self.test.id,
            "phase": progress.phase.value,
            "reason": progress.reason,
            "asked": {"gesture": gesture, "code": plan.codes[gesture]}
            if gesture is not None and progress.phase is Phase.ASKED
            else None,
            "done": progress.done,
            "trials": len(plan.asked),
            "round": min(plan.round_of(progress.done) + 1, len(plan.order)),
            "rounds": len(plan.order),
            "heldMs": round(progress.hold.held_ms) if progress.phase is Phase.ASKED else 0,
            "holdMs": plan.hold_ms,
            "askedForMs": self._asked_for_ms(),
            "limitMs": plan.limit_ms,
            "last": self._last(),
        }

    def _asked_for_ms(self) -> int:
        progress = self.progress
        if progress.phase is not Phase.ASKED or progress.since_s is None or progress.seen_s is None:
            return 0
        return round((progress.seen_s - progress.since_s) * 1000)

    def _last(self) -> dict[str, Any] | None:
        if self.last is None:
            return None
        return {
            "asked": self.last.asked,
            "outcome": self.last.outcome.value,
            "first": first_recognized(self.last),
            "recognizedMs": self.last.recognized_ms,
        }


class AccuracyTestRunner:
    """All accuracy tests of the controller; an asynchronous context manager."""

    def __init__(self, store: AccuracyTestStore, gloves: KnownGloves, gestures: Gestures) -> None:
        self._store = store
        self._gloves = gloves
        self._gestures = gestures
        self._running: dict[str, RunningTest] = {}
        self._writing: set[asyncio.Task[None]] = set()
        self._watchers: dict[str, Callable[[bool], None]] = {}

    async def __aenter__(self) -> Self:
        await asyncio.to_thread(self._store.prepare)
        for test in await asyncio.to_thread(self._store.tests):
            if not test.phase.is_over and test.phase is not Phase.INTERRUPTED:
                await self._save_phase(test.id, Phase.INTERRUPTED, "the gesture controller was restarted")
        return self

    async def __aexit__(self, *_: object) -> None:
        for running in list(self._running.values()):
            self._release(running)
        if self._writing:
            await asyncio.wait(self._writing)

    async def begin(
        self,
        glove: Glove,
        gestures: Sequence[str] | None,
        rounds: int,
        *,
        seed: int | None,
        hold_ms: float,
        limit_ms: float,
        breaks: bool,
    ) -> TestState:
        """Begin a test with `glove` (`gestures` None: all) and return it; raises `Problem`."""
        self._require_no_other_test(glove)
        codes = self._codes(gestures)
        if len(codes) * rounds > MAX_TRIALS:
            raise Problem.translated(
                422,
                "Too long",
                "accuracy_test.too_long",
                "{gestures} gestures in {rounds} rounds are more than {limit} trials",
                gestures=len(codes),
                rounds=rounds,
                limit=MAX_TRIALS,
            )
        if hold_ms >= limit_ms:
            raise Problem.translated(
                422,
                "Too short",
                "accuracy_test.too_short",
                "the time limit must be longer than a gesture has to be kept",
            )
        used_seed = secrets.randbelow(MAX_SEED) if seed is None else seed
        gap_ms = glove.reader.config.timing.gap_ms
        plan = Plan(codes, draw_order(codes, rounds, used_seed), used_seed, hold_ms, limit_ms, gap_ms, breaks)
        began_at = iso(datetime.now(UTC))
        test = AccuracyTest(str(uuid4()), glove.name, glove.person, plan, Phase.REST, "", began_at, None)
        await in_database(self._store.add, test)
        self._start(RunningTest(test, glove, Progress()))
        log.info("accuracy test begins", test=test.id, glove=glove.name, trials=len(plan.asked))
        return await self.find(test.id)

    async def resume(self, test_id: str) -> TestState:
        """Resume after a break or an interruption; raise `Problem` 409 if the test does not wait."""
        running = self._running.get(test_id)
        if running is None:
            test = await self._stored(test_id)
            if test.phase.is_over:
                raise Problem.translated(
                    409,
                    "Over",
                    "accuracy_test.ended",
                    "this test is {phase}; begin another",
                    phase=test.phase.value,
                )
            glove = self._gloves.named(test.glove)
            self._require_no_other_test(glove)
            done = len(await asyncio.to_thread(self._store.trials, test_id))
            running = RunningTest(test, glove, Progress(done, Phase.INTERRUPTED))
        if not running.progress.phase.waits_for_resume:
            raise Problem.translated(
                409,
                "Is on its way",
                "accuracy_test.not_waiting",
                "this test waits for nothing: {phase}",
                phase=running.progress.phase.value,
            )
        self._require_no_other_test(running.glove, but=test_id)
        await self._save_phase(test_id, Phase.REST, "")
        running.progress = running.progress.resumed()
        self._start(running)
        return await self.find(test_id)

    async def stop(self, test_id: str) -> TestState:
        """Stop a test; its trials are kept and reported. A finished test stays unchanged."""
        test = await self._stored(test_id)
        running = self._running.get(test_id)
        if running is not None:
            running.progress = running.progress.stopped()
            self._release(running)
        if not test.phase.is_over:
            await self._save_phase(test_id, Phase.STOPPED, "")
        return await self.find(test_id)

    async def delete(self, test_id: str) -> None:
        """Delete a test with its trials; raise `Problem` 404 if there is none."""
        running = self._running.get(test_id)
        if running is not None:
            running.progress = running.progress.stopped()
            self._release(running)
        if not await in_database(self._store.delete, test_id):
            raise _unknown(test_id)

    async def all(self) -> list[TestSummary]:
        """Return all tests, the latest first."""
        return [self._summary(test) for test in await asyncio.to_thread(self._store.tests)]

    async def find(self, test_id: str) -> TestState:
        """Return a test and, while it runs, its view; raise `Problem` 404 if there is none."""
        test = await self._stored(test_id)
        running = self._running.get(test_id)
        return {**self._summary(test), "live": running.view() if running else None}

    async def trials(self, test_id: str) -> tuple[AccuracyTest, list[tuple[Trial, str]]]:
        """Return a test with its trials and their end times; raise `Problem` 404 if there is none."""
        return await self._stored(test_id), await asyncio.to_thread(self._store.trials, test_id)

    # Running tests

    def _start(self, running: RunningTest) -> None:
        self._running[running.test.id] = running
        glove = running.glove
        if running.test.id not in self._watchers:
            running.was_testing = glove.modes.testing

            def watch(_: bool) -> None:
                self._observe(running)

            self._watchers[running.test.id] = watch
            glove.observers.watchers.add(watch)
        glove.observers.accuracy_test = running.view
        glove.switch(testing=True, filtering=None)

    def _release(self, running: RunningTest) -> None:
        """Release the glove; must not be called by one of its watchers."""
        self._running.pop(running.test.id, None)
        watch = self._watchers.pop(running.test.id, None)
        if watch is not None:
            running.glove.observers.watchers.discard(watch)
        if running.glove.observers.accuracy_test == running.view:
            running.glove.observers.accuracy_test = None
        running.glove.switch(testing=running.was_testing, filtering=None)

    def _observe(self, running: RunningTest) -> None:
        """Process a frame or a change of the glove."""
        glove, progress = running.glove, running.progress
        if progress.phase.is_over:
            return
        if not glove.modes.testing:
            self._interrupt(running, "testing mode was switched off")
            return
        at_s = glove.reader.state.hold.seen_s
        if not glove.is_connected or at_s in {progress.seen_s, LONG_AGO}:
            return
        look = Observation(at_s, glove.reader.state.states, glove.reader.state.gesture)
        running.progress, trial = progress.after(look, running.test.plan)
        if trial is not None:
            self._run_later(self._save_trial(running, trial))

    async def _save_trial(self, running: RunningTest, trial: Trial) -> None:
        """Write a trial, then continue with the next one."""
        try:
            await asyncio.to_thread(self._store.add_trial, running.test.id, trial, datetime.now(UTC))
        except SQLAlchemyError as error:
            log.warning("a trial was not stored", test=running.test.id, error=str(error))
            self._interrupt(running, "the trial could not be written to the database; resume to repeat it")
            return
        if running.progress.phase is not Phase.NOTED:
            return  # stopped or interrupted meanwhile
        running.last = trial
        running.progress = running.progress.noted(running.test.plan)
        phase = running.progress.phase
        if phase is Phase.FINISHED or phase.waits_for_resume:
            with suppress(Problem):
                await self._save_phase(running.test.id, phase, "")
        if phase is Phase.FINISHED:
            self._release(running)
            log.info("accuracy test is finished", test=running.test.id)

    def _interrupt(self, running: RunningTest, reason: str) -> None:
        running.progress = running.progress.interrupted(reason)

        async def save_interruption() -> None:
            self._release(running)
            with suppress(Problem):
                await self._save_phase(running.test.id, Phase.INTERRUPTED, reason)

        running.was_testing = running.was_testing and running.glove.modes.testing
        self._run_later(save_interruption())

    def _run_later(self, act: Awaitable[None]) -> None:
        task = asyncio.ensure_future(act)
        self._writing.add(task)
        task.add_done_callback(self._writing.discard)

    # Database

    async def _save_phase(self, test_id: str, phase: Phase, reason: str) -> None:
        ended_at = datetime.now(UTC) if phase.is_over else None
        await in_database(self._store.set_phase, test_id, phase, reason, ended_at)

    async def _stored(self, test_id: str) -> AccuracyTest:
        test = await asyncio.to_thread(self._store.test, test_id)
        if test is None:
            raise _unknown(test_id)
        return test

    def _summary(self, test: AccuracyTest) -> TestSummary:
        running = self._running.get(test.id)
        progress = running.progress if running else None
        return {
            "id": test.id,
            "glove": test.glove,
            "person": test.person,
            "phase": progress.phase if progress else test.phase,
            "reason": progress.reason if progress else test.reason,
            "beganAt": test.began_at,
            "endedAt": test.ended_at,
            "gestures": list(test.plan.codes),
            "rounds": len(test.plan.order),
            "trials": len(test.plan.asked),
            "seed": test.plan.seed,
        }

    def _codes(self, gestures: Sequence[str] | None) -> dict[str, str]:
        if gestures is None:
            return dict(self._gestures.codes)
        codes: dict[str, str] = {}
        for name in gestures:
            gesture = self._gestures.find(name)
            if gesture is None:
                raise Problem.translated(
                    422,
                    "Unknown gesture",
                    "accuracy_test.unknown_gesture",
                    'there is no gesture "{name}"; {hint}',
                    name=name,
                    hint=self._gestures.like(name),
                )
            if gesture in self._gestures.composites:
                parts = " and ".join(f'"{part.gesture}"' for part in self._gestures.parts_of(gesture))
                raise Problem.translated(
                    422,
                    "Composed gesture",
                    "accuracy_test.composed_gesture",
                    '"{known}" is composed of {parts}; an accuracy test asks for one shape of one '
                    "hand at a time, so test those instead",
                    known=gesture,
                    parts=parts,
                )
            codes[gesture] = self._gestures.codes[gesture]
        return codes

    def _require_no_other_test(self, glove: Glove, but: str | None = None) -> None:
        other = next((test for test in self._running.values() if test.glove is glove), None)
        if other is not None and other.test.id != but:
            raise Problem.translated(
                409,
                "Is being tested",
                "accuracy_test.glove_in_test",
                "{glove} is in the middle of the test {test}; finish or stop that first",
                glove=glove.name,
                test=other.test.id,
            )


def _unknown(test_id: str) -> Problem:
    return Problem.translated(
        404,
        "Unknown test",
        "accuracy_test.unknown_test",
        'there is no accuracy test "{test_id}"; /tests lists those there are',
        test_id=test_id,
    )
