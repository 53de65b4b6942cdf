"""Step writer: applies changes to processes and writes them to the database, group by group.

One task writes. All changes that arrive while one transaction is written form the next step, so a disk that
commits 200 times a second does not limit the orchestrator to 200 changes. If a step cannot be written, its
processes are loaded again and its changes are applied one by one, so that only the faulty one fails.

A pause or a cancellation acts also while the database cannot be written (`apply_lowering`): its messages are
sent to the broker at once, and the change is applied before any other one as soon as the database accepts it.
Until then no other change is written, so that nothing continues what a person has stopped.
"""

import asyncio
import signal
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any, Self, TypeVar

from prometheus_client import Histogram
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from handover.database import LockLost
from handover.database.outage import RETRY_AFTER_S, is_outage, outage_problem
from handover.errors import HandoverError, Problem
from handover.messages import message
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.retry import Backoff
from handover.security.audit_trail import AuditedRequest, current_request
from handover.telemetry import get_logger
from handover_processes.process.process import Process
from handover_processes.records.step import Step
from handover_processes.steps.outbox import Outbox
from handover_processes.steps.working_state import WorkingState

log = get_logger(__name__)

MAX_STEP_CHANGES = 200
DELETE_DELIVERED_AFTER_S = 0.1
DELETE_EXPIRED_EVERY_S = 3600.0
MAX_DELETED_PROCESSES = 100
DEFERRED_RETRY_S = 5.0
NOT_WRITTEN = "Not written"
"""The title of the problem of a change that the database did not accept."""

STEP_DURATION = Histogram(
    "handover_orchestrator_step_duration_seconds",
    "Time to apply a step and to write it to the database",
    buckets=(0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 2),
)

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _PendingChange:
    """A change to apply in a step; `done` gets its result once it is in the database."""

    act: Callable[[Step], Any]
    done: asyncio.Future[Any]
    process: str | None = None
    """A process that must be loaded for it, even if it is over."""
    request: AuditedRequest | None = None
    """The request that causes it, for the audit log."""
    is_lowering: bool = False
    """Whether it acts also if it cannot be written now."""


class StepWriter:
    """Applies and writes changes; an asynchronous context manager while it does so."""

    def __init__(self, state: WorkingState, outbox: Outbox) -> None:
        self.outbox = outbox
        self._state = state
        self._changes: asyncio.Queue[_PendingChange] = asyncio.Queue()
        self._next_seq = 1
        self._deferred: list[_PendingChange] = []
        """Changes that have acted and are not written yet."""
        self._has_deferred = asyncio.Event()
        self._tasks = BackgroundTasks("step writer")

    async def __aenter__(self) -> Self:
        pending = await self._state.on_disk(self._state.store.outbox)
        self._next_seq = max((message.seq for message in pending), default=0) + 1
        await self._tasks.__aenter__()
        for task in (self._write_steps, self._delete_delivered, self._delete_expired, self._write_deferred):
            self._tasks.start(task)
        await self.outbox.__aenter__()
        self.outbox.send(pending)
        log.info("pending messages loaded", count=len(pending))
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()
        await self.outbox.__aexit__()

    async def apply(
        self, act: Callable[[Step], T], *, process: str | None = None, is_lowering: bool = False
    ) -> T:
        """Apply a change in the next step and return its result once the step is in the database.

        `process` is loaded for it, even if it is over. Raises `Problem` 503 if the step cannot be written,
        unless it is lowering: such a change only pauses or cancels, and is written later then.
        """
        done: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        change = _PendingChange(act, done, process, current_request(), is_lowering)
        self._changes.put_nowait(change)
        return await done

    async def apply_each(
        self, acts: Mapping[str, Callable[[Step], T]], *, is_lowering: bool = False
    ) -> dict[str, T]:
        """Apply changes that are independent: one that fails prevents no other; return the answers.

        Raises `Problem` if all fail, as when the database is unavailable.
        """
        applied = (self.apply(act, is_lowering=is_lowering) for act in acts.values())
        answers = await asyncio.gather(*applied, return_exceptions=True)
        done: dict[str, T] = {}
        failed: list[Problem] = []
        for name, answer in zip(acts, answers, strict=True):
            if isinstance(answer, Problem):
                log.error("change not applied", subject=name, error=str(answer))
                failed.append(answer)
            elif isinstance(answer, BaseException):
                raise answer
            else:
                done[name] = answer
        if failed and not done:
            raise failed[0]
        return done

    async def apply_to(
        self, process_id: str, act: Callable[[Process, Step], T], *, is_lowering: bool = False
    ) -> T:
        """Change a process that may be over; raise `Problem` 404 if there is none."""
        if process_id not in self._state.active_processes.processes:  # a pause must not wait for a database
            await self._state.require_process(process_id)
        return await self.apply(
            lambda step: act(self._state.find_process(process_id), step),
            process=process_id,
            is_lowering=is_lowering,
        )

    async def recover(self) -> None:
        """Load the processes again whose changes an unavailable database did not store."""
        if self._state.active_processes.stale:
            await self.apply(lambda _: None)

    async def _write_steps(self) -> None:
        while True:
            changes = [await self._changes.get()]
            while len(changes) < MAX_STEP_CHANGES and not self._changes.empty():
                changes.append(self._changes.get_nowait())
            with STEP_DURATION.time():
                if self._deferred:
                    changes = await self._write_deferred_first(changes)
                await self._write_batch(changes)

    async def _write_deferred_first(self, changes: list[_PendingChange]) -> list[_PendingChange]:
        """Write what has acted already, one by one; return the changes that may be written after it.

        Those are all of them, or while the database refuses only those that act all the same.
        """
        while self._deferred:
            earlier = self._deferred[0]
            done: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
            await self._write_batch([replace(earlier, done=done, is_lowering=False)])
            problem = done.exception()
            if isinstance(problem, Problem) and problem.title == NOT_WRITTEN:
                for change in changes:
                    if not change.is_lowering:
                        _answer(change, problem)
                return [change for change in changes if change.is_lowering]
            self._deferred.pop(0)  # written, or its process has ended meanwhile
            log.info("a pause or cancellation is written that was not before", problem=str(problem or ""))
        self._has_deferred.clear()
        return changes

    async def _write_deferred(self) -> None:
        """Try to write what has acted already, also while nobody requests a change."""
        backoff = Backoff(max_s=DEFERRED_RETRY_S)
        while True:
            await self._has_deferred.wait()
            await backoff.wait()
            with suppress(Problem):
                await self.apply(lambda _: None)
                backoff.reset()

    async def _write_batch(self, changes: list[_PendingChange]) -> None:
        state, active_processes = self._state, self._state.active_processes
        step = Step(self._next_seq)
        answers: list[tuple[_PendingChange, Any]] = []
        fetched = {change.process for change in changes if change.process is not None}
        try:
            await active_processes.refresh()
            await active_processes.fetch(fetched)
            for change in changes:
                step.signed_in = _signed_in(change.request)
                try:
                    answers.append((change, change.act(step)))
                    state.settle(step)
                    if (cause := change.request) is not None and cause.is_change and not cause.is_finished:
                        step.requests.append(cause)
                except Problem as problem:
                    _answer(change, problem)
            step.delivered = self.outbox.take_delivered()
            if step:
                await state.on_disk(state.store.write, step)
        except Exception as error:  # noqa: BLE001 - logged, and answered, by _write_individually
            self.outbox.restore_delivered(step.delivered)
            active_processes.mark_stale(step.touched)
            with suppress(SQLAlchemyError):  # the database is unavailable: the next step tries again
                await active_processes.refresh()
            active_processes.release(fetched)
            changes = [change for change in changes if not change.done.done()]
            is_refused = isinstance(error, SQLAlchemyError)
            if is_refused and len(changes) == 1 and changes[0].is_lowering and answers:
                self._defer(changes[0], step, answers[0][1], error)
            else:
                await self._write_individually(changes, error)
            return
        self._next_seq = step.next_seq
        state.apply(step)
        active_processes.release(fetched)
        self.outbox.send(step.messages)
        for change, answer in answers:
            _answer(change, answer)

    def _defer(self, change: _PendingChange, step: Step, answer: Any, error: Exception) -> None:
        """Send the messages of a change that only lowers, and keep it until it can be written."""
        log.error("a pause or cancellation acts and is not written yet", error=_reason_of(error))
        self._next_seq = step.next_seq  # a message that is stored later has another number
        self.outbox.send(step.messages)
        self._deferred.append(change)
        self._has_deferred.set()
        _answer(change, answer)

    async def _write_individually(self, changes: list[_PendingChange], error: Exception) -> None:
        """Apply the changes of a failed step one by one, so that only the faulty one fails."""
        if len(changes) > 1:
            for change in changes:
                await self._write_batch([change])
            return
        if isinstance(error, LockLost):
            log.critical("another orchestrator has taken over; this one ends", error=str(error))
            signal.raise_signal(signal.SIGTERM)
        expected = isinstance(error, HandoverError | SQLAlchemyError)
        reason = _reason_of(error)
        log.error("step not written", error=reason, exc_info=None if expected else error)
        problem = Problem(
            503,
            NOT_WRITTEN,
            message(
                "process.not_written",
                "nothing was changed: {reason}; correct that and send the request again",
                reason=reason,
            ),
            extra={"retryAfterS": RETRY_AFTER_S} if is_outage(error) else None,
        )
        if isinstance(error, DBAPIError) and error.connection_invalidated:
            problem = outage_problem(error) or problem  # the server may have carried out the commit
        for change in changes:
            _answer(change, problem)

    async def _delete_delivered(self) -> None:
        """Delete delivered messages from the database if no other step does so."""
        while True:
            await self.outbox.has_delivered.wait()
            await asyncio.sleep(DELETE_DELIVERED_AFTER_S)
            try:
                await self.apply(lambda _: None)
            except Problem as problem:
                log.warning("delivered messages not deleted yet", error=str(problem))

    async def _delete_expired(self) -> None:
        """Delete processes from the database after `keep_days`."""
        keep_days = self._state.settings.keep_days
        while keep_days:
            ended_before = self._state.clock() - timedelta(days=keep_days)
            try:
                while await self._state.on_disk(self._delete_ended, ended_before) == MAX_DELETED_PROCESSES:
                    log.info("old processes deleted", at_least=MAX_DELETED_PROCESSES)
                await self._state.on_disk(self._state.store.delete_statistics, ended_before)
            except SQLAlchemyError as error:
                log.warning("old processes not deleted yet", error=str(error))
            await asyncio.sleep(DELETE_EXPIRED_EVERY_S)

    def _delete_ended(self, ended_before: datetime) -> int:
        """Delete old processes; with archiving only those whose entities were deleted from the broker."""
        archived_only = self._state.settings.retention_h > 0
        return self._state.store.delete_ended(
            ended_before, MAX_DELETED_PROCESSES, archived_only=archived_only
        )


def _signed_in(request: AuditedRequest | None) -> str | None:
    caller = None if request is None else request.caller
    return None if caller is None else caller.own_name


def _reason_of(error: Exception) -> str:
    return str(error.orig if isinstance(error, DBAPIError) else error)


def _answer(change: _PendingChange, answer: Any) -> None:
    if change.done.done():
        return
    if isinstance(answer, Problem):
        change.done.set_exception(answer)
    else:
        change.done.set_result(answer)
