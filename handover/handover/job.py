"""A job: one Task while its performer executes it.

Clients request a pause, a continuation or a cancellation. The performer reads `requested_action` (or waits
for `changed`), stops its work in a safe state and calls `checkpoint`. The job writes the status of the Task
to the broker.

A job acts under the lease of its Device. While that is not held, the job is paused; it is dropped without a
report if another process has it, or had it meanwhile.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from enum import Enum
from typing import Any

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.errors import HandoverError, TranslatedError
from handover.messages import message, with_code
from handover.runtime.retry import retry
from handover.tasks.device_lease import DeviceLease, LeaseState
from handover.tasks.finished_tasks import FinishedTasks
from handover.tasks.outcomes import outcome_unknown
from handover.tasks.task_life import FINISHED, is_legal, is_news
from handover.telemetry import get_logger
from handover_datamodels.entities import RequestedStatus, Task, TaskStatus
from handover_datamodels.numbers import not_finite_place
from handover_datamodels.times import iso

log = get_logger(__name__)

PROGRESS_EVERY_S = 0.5
LEASE_POLL_S = 0.5
DEFAULT_PRIORITY = 50
LEASE_ENDED = "the lease of the device has ended"
_NEVER = datetime.max.replace(tzinfo=UTC)


class RequestedAction(Enum):
    """What clients request of a performer at the moment."""

    RUN = "run"
    PAUSE = "pause"
    CANCEL = "cancel"


class TaskCancelled(HandoverError):
    """The Task was cancelled; let the exception propagate once the work has stopped."""


class TaskGone(TaskCancelled):
    """The Task was deleted from the broker or finished by another client: there is nothing to report."""


class TaskFailed(TranslatedError):
    """The Task cannot be done; `reason` and `outputs` become parts of its outputParameters."""

    def __init__(self, reason: str, **outputs: Any) -> None:
        super().__init__(reason)
        self.reason = reason
        self.outputs = outputs


class Job:
    """A Task that is executed for `resource`; `requested_action` may change at any time."""

    def __init__(
        self,
        task: Task,
        resource: str,
        broker: BrokerClient,
        records: FinishedTasks,
        lease: DeviceLease | None = None,
    ) -> None:
        self.task = task
        self.resource = resource
        self.requested_action = RequestedAction.RUN
        self.paused = False
        self.resumed = task.status.value is not TaskStatus.PENDING
        """True when an earlier run of the performer had started the Task."""
        self.begun_here = False
        """True when an earlier run of this performer, with the same data directory, had begun the work."""
        self._broker = broker
        self._records = records
        self._lease = lease
        self._number: int | None = None
        self.is_taken = False
        """Whether another process has the Device, or had it meanwhile."""
        self.on_taken: Callable[[], object] = lambda: None
        """Called then; it ends the work."""
        self._requested: RequestedStatus | None = None
        self._requested_at: datetime | None = None
        self._earlier_request: tuple[RequestedStatus, datetime | None] | None = None
        """A request that was read once and is older than the present one by its time."""
        self._holds: dict[str, None] = {}
        self._gone = False
        self._action_changed = asyncio.Event()
        self._outputs: dict[str, Any] = {}
        self._progress_writer: asyncio.Task[None] | None = None
        self._progress_at = float("-inf")
        self._observe_request(task)

    @property
    def order(self) -> tuple[bool, int, datetime]:
        """Return the order of this job among those that wait for the same resource."""
        priority, due = self.task.priority, self.task.due_date
        return (
            not self.resumed,
            -(DEFAULT_PRIORITY if priority is None else priority.value),
            _NEVER if due is None else due.value,
        )

    @property
    def parameters(self) -> dict[str, Any]:
        """Return the workParameters; empty when the Task has none."""
        work_parameters = self.task.work_parameters
        return (
            dict(work_parameters.value)
            if work_parameters is not None and isinstance(work_parameters.value, Mapping)
            else {}
        )

    def may_act(self) -> bool:
        """Return whether this process holds the Device; ask before every setpoint or goal. Cheap."""
        return self._lease is None or self._lease.authority().is_valid()

    def may_continue(self) -> bool:
        """Return whether a motion may continue: no pause is requested, and the lease does not end soon.

        Cheap and thread-safe, for control loops.
        """
        is_free = self._lease is None or self._lease.may_begin()
        return is_free and self.requested_action is RequestedAction.RUN

    @property
    def is_gone(self) -> bool:
        """Return whether another client finished or deleted the Task, or another process has its Device."""
        return self._gone

    async def until_held(self) -> None:
        """Wait for the lease if the work has ended without it; raise `TaskGone` if another process has it."""
        while not self._gone and not self.may_act():
            with suppress(TimeoutError):  # the lease of a cancelled job changes no action
                await asyncio.wait_for(self._action_changed.wait(), LEASE_POLL_S)
        if self._gone:
            raise TaskGone(f"{self.task.id} was ended by another client, or another process has its Device")

    def watch_lease(self) -> Callable[[], None]:
        """Pause while the lease is not held, from now until the returned function is called."""
        lease = self._lease
        if lease is None:
            return lambda: None
        self._number = lease.number
        lease.watchers.append(self._observe_lease)
        self._observe_lease()
        return lambda: lease.watchers.remove(self._observe_lease)

    def _observe_lease(self) -> None:
        lease = self._lease
        if lease is None or self._gone:
            return
        state = lease.state()
        # One more is our own next grant; further ones were those of other processes.
        was_taken = None not in {self._number, lease.number} and (lease.number or 0) > (self._number or 0) + 1
        if state is LeaseState.TAKEN or was_taken:
            log.warning("task dropped: another process holds the device", task=self.task.id, by=lease.holder)
            self.is_taken = True
            self.abandon()
            self.on_taken()
        elif state is LeaseState.HELD:
            self._number = lease.number
            if LEASE_ENDED in self._holds:
                self.resume(LEASE_ENDED)
        elif LEASE_ENDED not in self._holds:
            self.pause(LEASE_ENDED)

    async def changed(self, since: RequestedAction = RequestedAction.RUN) -> RequestedAction:
        """Wait until `requested_action` differs from `since`, the action the caller knows, and return it.

        It returns at once if a request came before the call, so none is missed.
        """
        while self.requested_action is since:
            await self._action_changed.wait()
        return self.requested_action

    def pause(self, reason: str) -> None:
        """Pause for a reason of the performer; `requested_action` is PAUSE until `resume`."""
        self._holds[reason] = None
        self._decide()

    def resume(self, reason: str) -> None:
        """Remove the pause for `reason`; the work continues when no other reason or request pauses it."""
        self._holds.pop(reason, None)
        self._decide()

    async def checkpoint(self) -> None:
        """Return at once, or report `paused` and wait until the work may continue.

        Call it while the work is stopped. Raises `TaskCancelled` when the Task was cancelled.
        """
        self._observe_lease()
        if self.requested_action is RequestedAction.PAUSE:
            await self._move(TaskStatus.PAUSED, reason=self._pause_reason())
            self.paused = True
            try:
                while self.requested_action is RequestedAction.PAUSE:
                    await self._action_changed.wait()
                if self.requested_action is RequestedAction.RUN:
                    await self._move(TaskStatus.IN_PROGRESS)
            finally:
                self.paused = False
        if self._gone:
            raise TaskGone(f"{self.task.id} was finished or deleted by another client")
        if self.requested_action is RequestedAction.CANCEL:
            raise TaskCancelled("cancelled")

    async def once(self, name: str, act: Callable[[], Awaitable[Mapping[str, Any]]]) -> dict[str, Any]:
        """Do `act` at most once for this Task, also after a crash, and return its result (plain JSON).

        A later run of the Task gets the recorded result. Raises `TaskFailed` with an unknown outcome if an
        earlier run began the act and recorded no result.
        """
        if not self.may_act():
            await self.checkpoint()
        earlier = await self._records.begin_act(self.task.id, name)
        if earlier is None:
            result = dict(await act())
            await self._records.end_act(self.task.id, name, result)
            return result
        if earlier.result is None:
            raise TaskFailed(
                outcome_unknown(
                    message(
                        "task.act_interrupted",
                        'its performer stopped during "{act}"; look whether that was done, '
                        "then retry or skip it",
                        act=name,
                    )
                )
            )
        return dict(earlier.result)

    def report_progress(self, fraction: float, **outputs: Any) -> None:
        """Report the progress, from 0 to 1, with other outputParameters that are known.

        At most two reports a second are written, in the background; the latest value wins.
        """
        self._outputs = {**self._outputs, **outputs, "progress": round(min(max(fraction, 0.0), 1.0), 3)}
        idle = self._progress_writer is None or self._progress_writer.done()
        if idle and time.monotonic() - self._progress_at >= PROGRESS_EVERY_S:
            self._progress_at = time.monotonic()
            self._progress_writer = asyncio.create_task(self._write_progress(dict(self._outputs)))

    def is_known(self, seen: Task) -> bool:
        """Return whether a Task has nothing new for this job, as in a notification of our own write."""
        request = seen.requested_status
        same_request = request is None or (request.value, request.observed_at) == (
            self._requested,
            self._requested_at,
        )
        return seen.status.value is self.task.status.value and same_request

    def observe(self, seen: Task) -> None:
        """Process the Task as the broker has it; an older state is ignored."""
        if seen.status.value in FINISHED and is_news(self.task, seen):
            self._gone = True
        self._observe_request(seen)

    def refresh(self, now: Task) -> None:
        """Replace the Task by its present state in the broker, before the work starts."""
        self.observe(now)
        self.task = now
        self.resumed = now.status.value is not TaskStatus.PENDING
        if now.status.value in FINISHED:
            self.abandon()

    def abandon(self) -> None:
        """Cancel the work: the Task is no longer in the broker."""
        self._gone = True
        self._decide()

    async def accept(self) -> None:
        """Write `assigned`, then `inProgress`, unless the Task already has that status.

        Raises `TaskCancelled` when the Task was cancelled, also while the status was written.
        """
        if self.task.status.value is TaskStatus.PENDING:
            await self._move(TaskStatus.ASSIGNED)
        await self.checkpoint()
        if self.task.status.value is not TaskStatus.IN_PROGRESS:
            await self._move(TaskStatus.IN_PROGRESS)
            await self.checkpoint()

    async def finish(self, status: TaskStatus, outputs: Mapping[str, Any]) -> None:
        """Write the final status with the outputParameters; repeated until the broker accepts it."""
        if self._progress_writer is not None:
            await self._progress_writer
        if self.task.status.value is TaskStatus.PAUSED and status is TaskStatus.COMPLETED:
            await self._move(TaskStatus.IN_PROGRESS)
        await self._move(status, outputs=outputs)

    async def _move(
        self, status: TaskStatus, *, reason: str | None = None, outputs: Mapping[str, Any] | None = None
    ) -> None:
        if self._gone:
            raise TaskGone(f"{self.task.id} was finished or deleted by another client")
        if self.task.status.value is status:
            return
        if not is_legal(self.task.status.value, status):
            raise HandoverError(f"a Task that is {self.task.status.value} cannot become {status}")
        at = datetime.now(UTC)
        written: dict[str, Any] = {"type": "Property", "value": status.value, "observedAt": iso(at)}
        if reason:
            written["reason"] = {"type": "Property", "value": reason}
        attributes = {"status": written}
        if outputs is not None:
            attributes["outputParameters"] = _output_property(outputs, at)
        await self._write_until_accepted(attributes)
        moved = self.task.status.model_copy(update={"value": status, "observed_at": at})
        self.task = self.task.model_copy(update={"status": moved})
        log.info("task moved", task=self.task.id, status=status.value, resource=self.resource, reason=reason)

    async def _write_until_accepted(self, attributes: Mapping[str, Any]) -> None:
        try:
            await retry(
                lambda: self._broker.append(self.task.id, attributes),
                on=BrokerUnavailable,
                on_failure=lambda error: log.warning(
                    "broker unavailable, task report waits", task=self.task.id, error=str(error)
                ),
            )
        except NotFound:
            self.abandon()
            raise TaskGone(f"{self.task.id} is no longer in the broker") from None

    async def _write_progress(self, outputs: Mapping[str, Any]) -> None:
        """Write the progress; after a failure the next report or the final status repeats it."""
        try:
            await self._broker.append(
                self.task.id,
                {"outputParameters": _output_property(finite_outputs(outputs), datetime.now(UTC))},
            )
        except (BrokerError, TypeError) as error:
            log.info("progress not written", task=self.task.id, error=str(error))

    def _observe_request(self, seen: Task) -> None:
        request = seen.requested_status
        if request is not None:
            at = request.observed_at
            is_later = self._requested_at is None or at is None or at >= self._requested_at
            # Clocks are set back: what lowers counts at once, and the rest when it is read a second time.
            is_lowering = request.value is not RequestedStatus.IN_PROGRESS
            if is_later or is_lowering or self._earlier_request == (request.value, at):
                self._requested, self._requested_at = request.value, at
                self._earlier_request = None
            else:
                self._earlier_request = request.value, at
        self._decide()

    def _decide(self) -> None:
        before = self.requested_action
        if self._gone or self._requested is RequestedStatus.CANCELLED:
            self.requested_action = RequestedAction.CANCEL
        elif self._holds or self._requested is RequestedStatus.PAUSED:
            self.requested_action = RequestedAction.PAUSE
        else:
            self.requested_action = RequestedAction.RUN
        if self.requested_action is not before:
            self._action_changed.set()
            self._action_changed = asyncio.Event()

    def _pause_reason(self) -> str:
        return ", ".join(self._holds) or "requested"


def finite_outputs(outputs: Mapping[str, Any]) -> dict[str, Any]:
    """Return the outputParameters without those that have a NaN or infinite number, which JSON has not.

    `reason` names them, unless it says why the Task failed.
    """
    places = {
        name: place for name, value in outputs.items() if (place := not_finite_place(value)) is not None
    }
    if not places:
        return dict(outputs)
    shown = ", ".join(f"{name}.{place}" if place else name for name, place in places.items())
    reason = message(
        "task.result_not_finite",
        "{places}: NaN or infinite, and JSON has no such number, so it is left out of the result; correct "
        "the program of the performer",
        places=shown,
    )
    finite = {name: value for name, value in outputs.items() if name not in places}
    return finite if "reason" in finite else {**finite, **with_code("reason", reason)}


def _output_property(outputs: Mapping[str, Any], at: datetime) -> dict[str, Any]:
    return {"type": "Property", "value": dict(outputs), "observedAt": iso(at)}
