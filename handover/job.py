"""A job: one Task in the hands of its performer.

The performer asks `wants` (or waits for `changed`) to learn that somebody wishes it to pause, go on or
stop, comes to rest in its own way, and says so with `checkpoint`. The job keeps the Task in the broker true.
"""

import asyncio
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from enum import Enum
from typing import Any

from datamodels.entities import RequestedStatus, Task, TaskStatus
from datamodels.times import iso
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.errors import HandoverError
from handover.rounds import FIRST_RETRY_S, LAST_RETRY_S
from handover.task_life import FINISHED, is_legal, is_news
from handover.telemetry import get_logger

log = get_logger(__name__)

PROGRESS_EVERY_S = 0.5


class Wants(Enum):
    """What is wished of a performer at this moment."""

    GO = "go"
    PAUSE = "pause"
    CANCEL = "cancel"


class TaskCancelled(HandoverError):
    """The Task is not wanted any more; let it pass once the work has come to rest."""


class TaskGone(TaskCancelled):
    """The Task is no longer in the broker, or somebody else has finished it: nothing is left to report."""


class TaskFailed(HandoverError):
    """The Task cannot be done; `reason` is told to whoever asked, `outputs` join the outputParameters."""

    def __init__(self, reason: str, **outputs: Any) -> None:
        super().__init__(reason)
        self.reason = reason
        self.outputs = outputs


class Job:
    """A Task that is being performed for `resource`; `wants` changes while the work goes on."""

    def __init__(self, task: Task, resource: str, broker: BrokerClient) -> None:
        self.task = task
        self.resource = resource
        self.wants = Wants.GO
        self.paused = False
        self.resumed = task.status.value is not TaskStatus.PENDING
        """True when the Task had been begun before this process took it up, by an earlier run."""
        self._broker = broker
        self._requested: RequestedStatus | None = None
        self._requested_at: datetime | None = None
        self._holds: dict[str, None] = {}
        self._gone = False
        self._news = asyncio.Event()
        self._outputs: dict[str, Any] = {}
        self._progress_writer: asyncio.Task[None] | None = None
        self._progress_at = float("-inf")
        self._observe_request(task)

    @property
    def parameters(self) -> dict[str, Any]:
        """Return the workParameters; empty when the Task has none."""
        given = self.task.work_parameters
        return dict(given.value) if given is not None and isinstance(given.value, Mapping) else {}

    async def changed(self, since: Wants | None = None) -> Wants:
        """Wait until `wants` is another than `since` (than now, if not given), and return it."""
        before = self.wants if since is None else since
        while self.wants is before:
            await self._news.wait()
        return self.wants

    def pause(self, reason: str) -> None:
        """Hold the work for a reason of the performer's own; `wants` becomes PAUSE until `resume`."""
        self._holds[reason] = None
        self._decide()

    def resume(self, reason: str) -> None:
        """Take back the hold for `reason`; the work goes on when no other reason and no request hold it."""
        self._holds.pop(reason, None)
        self._decide()

    async def checkpoint(self) -> None:
        """Go on at once, or report `paused` and wait until the work may go on.

        Call it when the work has come to rest. Raises `TaskCancelled` when the Task is not wanted any more.
        """
        if self.wants is Wants.PAUSE:
            await self._move(TaskStatus.PAUSED, reason=self._pause_reason())
            self.paused = True
            try:
                while self.wants is Wants.PAUSE:
                    await self._news.wait()
                if self.wants is Wants.GO:
                    await self._move(TaskStatus.IN_PROGRESS)
            finally:
                self.paused = False
        if self._gone:
            raise TaskGone(f"{self.task.id} was finished or deleted by somebody else")
        if self.wants is Wants.CANCEL:
            raise TaskCancelled("cancelled")

    async def progress(self, fraction: float, **outputs: Any) -> None:
        """Say how far the work is, from 0 to 1, with any other outputParameters known so far.

        Returns at once: at most two a second are written, the newest wins, and none delays the work.
        """
        self._outputs = {**self._outputs, **outputs, "progress": round(min(max(fraction, 0.0), 1.0), 3)}
        idle = self._progress_writer is None or self._progress_writer.done()
        if idle and time.monotonic() - self._progress_at >= PROGRESS_EVERY_S:
            self._progress_at = time.monotonic()
            self._progress_writer = asyncio.create_task(self._write_progress(dict(self._outputs)))

    def knows(self, seen: Task) -> bool:
        """Say whether a Task says nothing that this job does not know: our own write comes back so."""
        request = seen.requested_status
        same_request = request is None or (request.value, request.observed_at) == (
            self._requested,
            self._requested_at,
        )
        return seen.status.value is self.task.status.value and same_request

    def observe(self, seen: Task) -> None:
        """Take notice of the Task as the broker has it; older news is ignored."""
        if seen.status.value in FINISHED and is_news(self.task, seen):
            self._gone = True
        self._observe_request(seen)

    def see_anew(self, now: Task) -> None:
        """Take the Task as the broker has it at this moment, before anything is done for it."""
        self.observe(now)
        self.task = now
        self.resumed = now.status.value is not TaskStatus.PENDING
        if now.status.value in FINISHED:
            self.abandon()

    def abandon(self) -> None:
        """Take notice that the Task is no longer in the broker."""
        self._gone = True
        self._decide()

    async def accept(self) -> None:
        """Write `assigned`, then `inProgress`, as far as the Task has not come yet."""
        if self.task.status.value is TaskStatus.PENDING:
            await self._move(TaskStatus.ASSIGNED)
        await self.checkpoint()
        if self.task.status.value is not TaskStatus.IN_PROGRESS:
            await self._move(TaskStatus.IN_PROGRESS)

    async def finish(self, status: TaskStatus, outputs: Mapping[str, Any]) -> None:
        """Write the end of the Task with its outputParameters; repeated until the broker has it."""
        if self._progress_writer is not None:
            await self._progress_writer
        if self.task.status.value is TaskStatus.PAUSED and status is TaskStatus.COMPLETED:
            await self._move(TaskStatus.IN_PROGRESS)
        await self._move(status, outputs=outputs)

    async def _move(
        self, status: TaskStatus, *, reason: str | None = None, outputs: Mapping[str, Any] | None = None
    ) -> None:
        if self._gone:
            raise TaskGone(f"{self.task.id} was finished or deleted by somebody else")
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
        await self._insist(attributes)
        moved = self.task.status.model_copy(update={"value": status, "observed_at": at})
        self.task = self.task.model_copy(update={"status": moved})
        log.info("task moved", task=self.task.id, status=status.value, resource=self.resource, reason=reason)

    async def _insist(self, attributes: Mapping[str, Any]) -> None:
        """Write until the broker has it: what was decided must not depend on the link of this moment."""
        retry_s = FIRST_RETRY_S
        while True:
            try:
                await self._broker.append(self.task.id, attributes)
            except BrokerUnavailable as error:
                log.warning("broker away, task report waits", task=self.task.id, error=str(error))
                await asyncio.sleep(retry_s)
                retry_s = min(2 * retry_s, LAST_RETRY_S)
            except NotFound:
                self.abandon()
                raise TaskGone(f"{self.task.id} is no longer in the broker") from None
            else:
                return

    async def _write_progress(self, outputs: Mapping[str, Any]) -> None:
        """Write how far the work is; if it fails, the next one, or the end, says it again."""
        try:
            await self._broker.append(
                self.task.id, {"outputParameters": _output_property(outputs, datetime.now(UTC))}
            )
        except (BrokerError, TypeError) as error:
            log.info("progress could not be written", task=self.task.id, error=str(error))

    def _observe_request(self, seen: Task) -> None:
        request = seen.requested_status
        if request is not None:
            at = request.observed_at
            if self._requested_at is None or at is None or at >= self._requested_at:
                self._requested, self._requested_at = request.value, at
        self._decide()

    def _decide(self) -> None:
        before = self.wants
        if self._gone or self._requested is RequestedStatus.CANCELLED:
            self.wants = Wants.CANCEL
        elif self._holds or self._requested is RequestedStatus.PAUSED:
            self.wants = Wants.PAUSE
        else:
            self.wants = Wants.GO
        if self.wants is not before:
            self._news.set()
            self._news = asyncio.Event()

    def _pause_reason(self) -> str:
        return ", ".join(self._holds) or "requested"


def _output_property(outputs: Mapping[str, Any], at: datetime) -> dict[str, Any]:
    return {"type": "Property", "value": dict(outputs), "observedAt": iso(at)}
