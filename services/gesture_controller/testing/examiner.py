"""The examiner: conducts accuracy tests with worn gloves, in testing mode: no Task is touched.

A trial is over for the person only once it is in the database. A test that the service did not live to end
is marked interrupted at the next start, and goes on from the trial it had come to.
"""

import asyncio
import secrets
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, Self
from uuid import uuid4

from sqlalchemy.exc import SQLAlchemyError

from datamodels.times import iso
from handover.errors import Problem
from handover.messages import message, text_of
from handover.telemetry import get_logger
from services.gesture_controller.gestures import Gestures
from services.gesture_controller.glove import Glove
from services.gesture_controller.gloves import Gloves
from services.gesture_controller.hold import LONG_AGO
from services.gesture_controller.testing.report import taken_for
from services.gesture_controller.testing.store import StoredTest, TestStore
from services.gesture_controller.testing.trials import Look, Phase, Plan, Progress, Trial, drawn

log = get_logger(__name__)

MOST_TRIALS = 5000
MOST_SEED = 2**31


class Running:
    """A test on its way: its plan, how far it is, and the glove it is done with."""

    def __init__(self, test: StoredTest, glove: Glove, progress: Progress) -> None:
        self.test = test
        self.glove = glove
        self.progress = progress
        self.last: Trial | None = None
        self.tested_before = glove.testing
        """Whether the glove was in testing mode already, and is left so."""

    def view(self) -> dict[str, Any]:
        """Return what the screen shows of the test."""
        plan, progress = self.test.plan, self.progress
        over = progress.done >= len(plan.asked)
        asks = None if over or progress.phase.is_over else plan.asked[progress.done]
        return {
            "id": self.test.id,
            "phase": progress.phase.value,
            "reason": progress.reason,
            "asked": {"gesture": asks, "code": plan.codes[asks]}
            if asks is not None and progress.phase is Phase.ASKED
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
            "first": taken_for(self.last),
            "recognizedMs": self.last.recognized_ms,
        }


class Examiner:
    """All accuracy tests of the controller; an asynchronous context manager while it is on duty."""

    def __init__(self, store: TestStore, gloves: Gloves, gestures: Gestures) -> None:
        self._store = store
        self._gloves = gloves
        self._gestures = gestures
        self._running: dict[str, Running] = {}
        self._writing: set[asyncio.Task[None]] = set()
        self._watchers: dict[str, Callable[[bool], None]] = {}

    async def __aenter__(self) -> Self:
        await asyncio.to_thread(self._store.prepare)
        for test in await asyncio.to_thread(self._store.tests):
            if not test.phase.is_over and test.phase is not Phase.INTERRUPTED:
                await self._keep(test.id, Phase.INTERRUPTED, "the gesture controller was started anew")
        return self

    async def __aexit__(self, *_: object) -> None:
        for running in list(self._running.values()):
            self._let_go(running)
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
    ) -> dict[str, Any]:
        """Begin a test with `glove` (None: all gestures) and return it; raises `Problem` if it cannot be."""
        self._refuse_two_with(glove)
        codes = self._codes(gestures)
        if len(codes) * rounds > MOST_TRIALS:
            raise Problem(
                422,
                "Too long",
                message(
                    "accuracy_test.too_long",
                    "{gestures} gestures in {rounds} rounds are more than {limit} trials",
                    gestures=len(codes),
                    rounds=rounds,
                    limit=MOST_TRIALS,
                ),
            )
        if hold_ms >= limit_ms:
            raise Problem(
                422,
                "Too short",
                message(
                    "accuracy_test.too_short", "the time limit must be longer than a gesture has to be kept"
                ),
            )
        drawn_by = secrets.randbelow(MOST_SEED) if seed is None else seed
        gap_ms = glove.senses.timing.gap_ms
        plan = Plan(codes, drawn(codes, rounds, drawn_by), drawn_by, hold_ms, limit_ms, gap_ms, breaks)
        began_at = iso(datetime.now(UTC))
        test = StoredTest(str(uuid4()), glove.name, glove.person, plan, Phase.REST, "", began_at, None)
        await self._written(self._store.add, test)
        self._take(Running(test, glove, Progress()))
        log.info("accuracy test begins", test=test.id, glove=glove.name, trials=len(plan.asked))
        return await self.one(test.id)

    async def go_on(self, test_id: str) -> dict[str, Any]:
        """Go on after a break or an interruption; `Problem` 409 if the test waits for no word."""
        running = self._running.get(test_id)
        if running is None:
            test = await self._stored(test_id)
            if test.phase.is_over:
                raise Problem(
                    409,
                    "Over",
                    message(
                        "accuracy_test.ended", "this test is {phase}; begin another", phase=test.phase.value
                    ),
                )
            glove = self._gloves.named(test.glove)
            self._refuse_two_with(glove)
            done = len(await asyncio.to_thread(self._store.trials, test_id))
            running = Running(test, glove, Progress(done, Phase.INTERRUPTED))
        if not running.progress.phase.waits_for_word:
            raise Problem(
                409,
                "Is on its way",
                message(
                    "accuracy_test.not_waiting",
                    "this test waits for nothing: {phase}",
                    phase=running.progress.phase.value,
                ),
            )
        self._refuse_two_with(running.glove, but=test_id)
        await self._keep(test_id, Phase.REST, "")
        running.progress = running.progress.gone_on()
        self._take(running)
        return await self.one(test_id)

    async def stop(self, test_id: str) -> dict[str, Any]:
        """Give a test up; its trials stay and are reported. One that is over stays as it is."""
        test = await self._stored(test_id)
        running = self._running.get(test_id)
        if running is not None:
            running.progress = running.progress.stopped()
            self._let_go(running)
        if not test.phase.is_over:
            await self._keep(test_id, Phase.STOPPED, "")
        return await self.one(test_id)

    async def delete(self, test_id: str) -> None:
        """Delete a test and all its trials; `Problem` 404 if there is none."""
        running = self._running.get(test_id)
        if running is not None:
            running.progress = running.progress.stopped()
            self._let_go(running)
        if not await self._written(self._store.delete, test_id):
            raise _unknown(test_id)

    async def all(self) -> list[dict[str, Any]]:
        """Return all tests, the latest first."""
        return [self._summary(test) for test in await asyncio.to_thread(self._store.tests)]

    async def one(self, test_id: str) -> dict[str, Any]:
        """Return a test and, while it is on its way, what its screen shows; `Problem` 404 if none is."""
        test = await self._stored(test_id)
        running = self._running.get(test_id)
        return {**self._summary(test), "live": running.view() if running else None}

    async def trials(self, test_id: str) -> tuple[StoredTest, list[tuple[Trial, str]]]:
        """Return a test with its trials and when each ended; `Problem` 404 if there is none."""
        return await self._stored(test_id), await asyncio.to_thread(self._store.trials, test_id)

    # While a test is on its way

    def _take(self, running: Running) -> None:
        self._running[running.test.id] = running
        glove = running.glove
        if running.test.id not in self._watchers:
            running.tested_before = glove.testing

            def watch(_: bool) -> None:
                self._look(running)

            self._watchers[running.test.id] = watch
            glove.watchers.add(watch)
        glove.examination = running.view
        glove.switch(testing=True, filtering=None)

    def _let_go(self, running: Running) -> None:
        """Give the glove back; not from within a frame of it, whose watchers are being called."""
        self._running.pop(running.test.id, None)
        watch = self._watchers.pop(running.test.id, None)
        if watch is not None:
            running.glove.watchers.discard(watch)
        if running.glove.examination == running.view:
            running.glove.examination = None
        running.glove.switch(testing=running.tested_before, filtering=None)

    def _look(self, running: Running) -> None:
        """Take a frame of the glove, or a change of it, into the test."""
        glove, progress = running.glove, running.progress
        if progress.phase.is_over:
            return
        if not glove.testing:
            self._interrupt(running, "testing mode was switched off")
            return
        at_s = glove.sight.hold.seen_s
        if not glove.connected or at_s in {progress.seen_s, LONG_AGO}:
            return
        look = Look(at_s, glove.sight.states, glove.sight.gesture)
        running.progress, trial = progress.after(look, running.test.plan)
        if trial is not None:
            self._later(self._note(running, trial))

    async def _note(self, running: Running, trial: Trial) -> None:
        """Write a trial down, and only then go on to the next."""
        try:
            await asyncio.to_thread(self._store.add_trial, running.test.id, trial, datetime.now(UTC))
        except SQLAlchemyError as error:
            log.warning("a trial could not be written down", test=running.test.id, error=str(error))
            self._interrupt(running, "the trial could not be written to the database; go on to repeat it")
            return
        if running.progress.phase is not Phase.NOTED:
            return  # given up or interrupted meanwhile
        running.last = trial
        running.progress = running.progress.noted(running.test.plan)
        phase = running.progress.phase
        if phase is Phase.FINISHED or phase.waits_for_word:
            with suppress(Problem):
                await self._keep(running.test.id, phase, "")
        if phase is Phase.FINISHED:
            self._let_go(running)
            log.info("accuracy test is finished", test=running.test.id)

    def _interrupt(self, running: Running, reason: str) -> None:
        running.progress = running.progress.interrupted(reason)

        async def put_down() -> None:
            self._let_go(running)
            with suppress(Problem):
                await self._keep(running.test.id, Phase.INTERRUPTED, reason)

        running.tested_before = running.tested_before and running.glove.testing
        self._later(put_down())

    def _later(self, act: Awaitable[None]) -> None:
        task = asyncio.ensure_future(act)
        self._writing.add(task)
        task.add_done_callback(self._writing.discard)

    # What is kept

    async def _keep(self, test_id: str, phase: Phase, reason: str) -> None:
        ended_at = datetime.now(UTC) if phase.is_over else None
        await self._written(self._store.move, test_id, phase, reason, ended_at)

    async def _written(self, act: Callable[..., Any], *what: Any) -> Any:
        try:
            return await asyncio.to_thread(act, *what)
        except SQLAlchemyError as error:
            raise Problem(
                503,
                "Database away",
                message(
                    "accuracy_test.database_away",
                    "nothing was changed: {error}; try again later",
                    error=text_of(error),
                ),
            ) from None

    async def _stored(self, test_id: str) -> StoredTest:
        test = await asyncio.to_thread(self._store.test, test_id)
        if test is None:
            raise _unknown(test_id)
        return test

    def _summary(self, test: StoredTest) -> dict[str, Any]:
        running = self._running.get(test.id)
        progress = running.progress if running else None
        return {
            "id": test.id,
            "glove": test.glove,
            "person": test.person,
            "phase": (progress.phase if progress else test.phase).value,
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
            known = self._gestures.find(name)
            if known is None:
                raise Problem(
                    422,
                    "Unknown gesture",
                    message(
                        "accuracy_test.unknown_gesture",
                        'there is no gesture "{name}"; {hint}',
                        name=name,
                        hint=self._gestures.like(name),
                    ),
                )
            if known in self._gestures.composed:
                parts = " and ".join(f'"{part.gesture}"' for part in self._gestures.parts_of(known))
                raise Problem(
                    422,
                    "Composed gesture",
                    message(
                        "accuracy_test.composed_gesture",
                        '"{known}" is composed of {parts}; an accuracy test asks for one shape of one '
                        "hand at a time, so test those instead",
                        known=known,
                        parts=parts,
                    ),
                )
            codes[known] = self._gestures.codes[known]
        return codes

    def _refuse_two_with(self, glove: Glove, but: str | None = None) -> None:
        other = next((one for one in self._running.values() if one.glove is glove), None)
        if other is not None and other.test.id != but:
            raise Problem(
                409,
                "Is being tested",
                message(
                    "accuracy_test.glove_in_test",
                    "{glove} is in the middle of the test {test}; finish or stop that first",
                    glove=glove.name,
                    test=other.test.id,
                ),
            )


def _unknown(test_id: str) -> Problem:
    return Problem(
        404,
        "Unknown test",
        message(
            "accuracy_test.unknown_test",
            'there is no accuracy test "{test_id}"; /tests lists those there are',
            test_id=test_id,
        ),
    )
