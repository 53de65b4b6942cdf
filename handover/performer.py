"""A performer: the component that acts for a Device or a Person and takes the Tasks that involve it.

    class Lamp(Performer):
        async def perform(self, job: Job) -> dict[str, Any]:
            await self.glow(job.parameters["seconds"])
            return {"lit": True}

It learns of Tasks by subscription and by asking: at start, after a broken link, and every few seconds. One
job at a time is done for each resource, in the order in which they came. After a crash a Task that was
begun is performed again; one whose end was recorded (`finished_tasks`) never is: that end is reported again.
"""

import asyncio
from abc import ABC, abstractmethod
from collections import OrderedDict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Self
from urllib.parse import urlsplit

from fastapi import FastAPI, Request, Response
from prometheus_client import Counter, Histogram

from datamodels.entities import Task, TaskStatus
from datamodels.times import iso
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.finished_tasks import End, FinishedTasks
from handover.job import Job, TaskCancelled, TaskFailed, TaskGone, Wants
from handover.messages import with_code
from handover.notifications import NotificationReceiver
from handover.rounds import FIRST_RETRY_S, LAST_RETRY_S, Rounds
from handover.settings import Settings
from handover.task_life import FINISHED
from handover.telemetry import get_logger, working_on

__all__ = ["Job", "Performer", "TaskCancelled", "TaskFailed", "TaskGone", "Wants"]

log = get_logger(__name__)

UNFINISHED = ",".join(f'"{status}"' for status in TaskStatus if status not in FINISHED)
REMEMBERED = 10_000
"""Tasks whose end is remembered, so that a late notification does not open them again."""

OUTCOMES = Counter("handover_tasks_total", "Tasks performed", ["performer", "outcome"])
SECONDS = Histogram(
    "handover_task_seconds",
    "From taking a Task up to its end",
    ["performer"],
    buckets=(0.1, 0.5, 1, 2, 5, 10, 30, 60, 300, 1800),
)
UNREADABLE = Counter("handover_unreadable_tasks_total", "Task entities that do not fit the data model")


@dataclass
class _Desk:
    """What lies on a resource's desk: the job in hand and those that wait."""

    waiting: deque[Job] = field(default_factory=deque)
    something_waits: asyncio.Event = field(default_factory=asyncio.Event)
    clerk: asyncio.Task[None] | None = None


class Performer(ABC):
    """Takes Tasks for resources and performs them; an asynchronous context manager while it is on duty.

    `name` is how it is known to others; `notify_url` is where the broker can reach it (see `mount`).
    """

    def __init__(self, name: str, settings: Settings, broker: BrokerClient, *, notify_url: str) -> None:
        self.name = name
        self.settings = settings
        self.broker = broker
        self.notify_url = notify_url
        self._receiver = NotificationReceiver(name, settings, broker)
        self._desks: dict[str, _Desk] = {}
        self._jobs: dict[str, Job] = {}
        self._ended: OrderedDict[str, None] = OrderedDict()
        self._finished = FinishedTasks(settings, name)
        self._announced: set[str] = set()
        self._subscribed = False
        self._rounds = Rounds(self._ask, settings.reconcile_s)
        self._on_duty = False
        self._chores: set[asyncio.Task[None]] = set()

    @abstractmethod
    async def perform(self, job: Job) -> Mapping[str, Any] | None:
        """Do what the Task asks; return its outputParameters.

        Raise `TaskFailed` when it cannot be done. Call `job.checkpoint()` where the work can rest.
        """

    async def act_for(self, resource: str) -> None:
        """Take Tasks that involve `resource` (the URN of a Device or Person) from now on."""
        if resource not in self._desks:
            self._desks[resource] = _Desk()
            if self._on_duty:
                self._seat_clerk(resource)
        self._rounds.wish()

    def stop_acting_for(self, resource: str) -> bool:
        """Take no more Tasks for `resource`; return False, and nothing changes, while a Task is in hand."""
        desk = self._desks.get(resource)
        if desk is None:
            return True
        if desk.waiting or any(job.resource == resource for job in self._jobs.values()):
            return False
        if desk.clerk is not None:
            desk.clerk.cancel()
        del self._desks[resource]
        self._announced.discard(resource)
        return True

    def resources(self) -> Iterable[str]:
        """Return the resources this performer acts for."""
        return tuple(self._desks)

    def jobs(self) -> Iterable[Job]:
        """Return the jobs in hand and waiting."""
        return tuple(self._jobs.values())

    def mount(self, app: FastAPI) -> None:
        """Add the route that the broker notifies; its path is that of `notify_url`."""

        @app.post(urlsplit(self.notify_url).path, status_code=204, tags=["notifications"])
        async def notify(request: Request) -> Response:
            """Read the Tasks that a notification says have changed from the broker."""
            await self._read(await self._receiver.receive(request))
            return Response(status_code=204)

    async def __aenter__(self) -> Self:
        self._receiver.require_key()
        await self._finished.open()
        self._on_duty = True
        for resource in self._desks:
            self._seat_clerk(resource)
        self._do(self._rounds.keep())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._on_duty = False
        for chore in list(self._chores):
            chore.cancel()
        await asyncio.gather(*self._chores, return_exceptions=True)
        await self._finished.close()

    async def probe(self) -> None:
        """Return when Tasks would reach this performer; raise if its subscription is not in place."""
        if not self._subscribed:
            raise BrokerUnavailable(503, "Not subscribed", "the broker has not taken the subscription yet")

    # How Tasks are learnt of

    async def _ask(self) -> bool:
        try:
            await self._reconcile()
        except BrokerError as error:
            log.warning("cannot ask the broker for tasks", performer=self.name, error=str(error))
            self._subscribed = False
            self._announced.clear()
            return False
        return True

    async def _reconcile(self) -> None:
        if not self._subscribed:
            await self.broker.ensure_subscription(self._subscription())
            self._subscribed = True
        for resource in set(self._desks) - self._announced:
            await self._announce(resource)
        at_hand = set(self._jobs)
        unfinished = await self.broker.query(type=Task.ngsi_type(), q=f"status=={UNFINISHED}")
        for entity in unfinished:
            self._take_notice(entity)
        for missing in at_hand.difference(entity["id"] for entity in unfinished):
            await self._look_at(missing)

    async def _announce(self, resource: str) -> None:
        kind = resource.split(":")[2] if resource.count(":") >= 3 else "Device"
        performer = {"type": "Property", "value": self.name}
        await self.broker.upsert([{"id": resource, "type": kind, "performer": performer}])
        self._announced.add(resource)

    async def _look_at(self, task_id: str) -> None:
        job = self._jobs.get(task_id)
        if job is None:
            return
        try:
            job.observe(await self.broker.get(task_id, Task))
        except NotFound:
            job.abandon()

    async def _read(self, notified: Iterable[Mapping[str, Any]]) -> None:
        """Read from the broker those of our Tasks that a notification names."""
        concerned = [
            task.id for task in map(_readable, notified) if task is not None and self._concerns(task)
        ]
        try:
            entities = await self._receiver.read(Task.ngsi_type(), concerned)
        except BrokerError as error:
            log.warning("cannot read tasks that have changed", performer=self.name, error=str(error))
            self._rounds.wish()
            return
        for entity in entities:
            self._take_notice(entity)

    def _concerns(self, task: Task) -> bool:
        """Say whether a Task is worth reading: it is for us, and says what we do not know yet."""
        job = self._jobs.get(task.id)
        if job is not None:
            return not job.knows(task)
        return self._is_for_us(task)

    def _is_for_us(self, task: Task) -> bool:
        """Say whether a Task that we do not have may be ours to perform."""
        open_to_us = task.id not in self._ended and task.status.value not in FINISHED
        return open_to_us and any(link.object in self._desks for link in task.involves or ())

    def _take_notice(self, entity: Mapping[str, Any]) -> None:
        """Take notice of a Task as the broker has it."""
        task = _readable(entity)
        if task is None:
            return
        job = self._jobs.get(task.id)
        if job is not None:
            job.observe(task)
            self._drop_if_unwanted(job)
        elif self._is_for_us(task):
            self._do(self._take_up(task))

    async def _take_up(self, task: Task) -> None:
        resource = await self._resource_for(task)
        end = await self._finished.find(task.id) if resource is not None else None
        if resource is None or resource not in self._desks or task.id in self._jobs or task.id in self._ended:
            return
        if end is not None:
            await self._report_again(task, end)
            return
        job = Job(task, resource, self.broker)
        self._jobs[task.id] = job
        log.debug("task taken up", task=task.id, resource=resource)
        desk = self._desks[resource]
        if job.resumed:
            desk.waiting.appendleft(job)
        else:
            desk.waiting.append(job)
        desk.something_waits.set()

    async def _report_again(self, task: Task, end: End) -> None:
        """Report the recorded end of a Task that the broker shows as unfinished."""
        now = iso(datetime.now(UTC))
        try:
            if (await self.broker.get(task.id, Task)).status.value in FINISHED:
                return  # an old notification
            await self.broker.append(
                task.id,
                {
                    "status": {"type": "Property", "value": end.status.value, "observedAt": now},
                    "outputParameters": {"type": "Property", "value": dict(end.outputs), "observedAt": now},
                },
            )
        except NotFound:
            return
        except BrokerError as error:
            log.warning("a finished task could not be reported again", task=task.id, error=str(error))
            return  # the next round finds it unfinished
        log.warning("a finished task was reported again", task=task.id, status=end.status.value)
        OUTCOMES.labels(self.name, "reported again").inc()

    async def _resource_for(self, task: Task) -> str | None:
        """Return the resource this performer does the Task for: the first involved that has a performer."""
        for link in task.involves or ():
            if link.object in self._desks:
                return link.object
            try:
                entity = await self.broker.retrieve(link.object)
            except NotFound:
                continue
            except BrokerError:
                self._rounds.wish()
                return None
            if "performer" in entity:
                return None
        return None

    # How Tasks are performed

    def _seat_clerk(self, resource: str) -> None:
        desk = self._desks[resource]
        desk.clerk = self._do(self._work_through(desk))

    async def _work_through(self, desk: _Desk) -> None:
        while True:
            while not desk.waiting:
                desk.something_waits.clear()
                await desk.something_waits.wait()
            job = desk.waiting.popleft()
            try:
                await self._work_on(job)
            except Exception:
                log.exception("a job could not be reported", task=job.task.id)
                OUTCOMES.labels(self.name, "unreported").inc()
                self._jobs.pop(job.task.id, None)
                self._remember(job)  # to do it again and again would help nobody

    async def _work_on(self, job: Job) -> None:
        with working_on(task=job.task.id, resource=job.resource), SECONDS.labels(self.name).time():
            try:
                outcome = await self._begin_to_end(job)
            except TaskGone as gone:
                outcome = "gone"
                log.info("task dropped", reason=str(gone))
            OUTCOMES.labels(self.name, outcome).inc()
        self._jobs.pop(job.task.id, None)
        if outcome != "gone":
            self._remember(job)

    async def _begin_to_end(self, job: Job) -> str:
        await self._make_sure(job)
        try:
            await job.accept()
            outputs = dict(await self.perform(job) or {})
        except TaskGone:
            raise
        except TaskCancelled:
            await self._finish(job, TaskStatus.FAILED, {"reason": "cancelled"})
            return "cancelled"
        except TaskFailed as failure:
            outputs = {**failure.outputs, **with_code("reason", failure.reason)}
            await self._finish(job, TaskStatus.FAILED, outputs)
            return "failed"
        except Exception as error:
            log.exception("performing failed")
            reason = f"{self.name} failed: {type(error).__name__}: {error}"
            await self._finish(job, TaskStatus.FAILED, {"reason": reason})
            return "failed"
        try:
            await self._finish(job, TaskStatus.COMPLETED, outputs)
        except (BrokerError, TypeError) as error:  # the outputs themselves cannot be written
            await self._finish(
                job, TaskStatus.FAILED, {"reason": f"the result could not be reported: {error}"}
            )
            return "failed"
        return "completed"

    async def _finish(self, job: Job, status: TaskStatus, outputs: Mapping[str, Any]) -> None:
        """Record the end of the job, then report it: after a crash in between it is not performed again."""
        try:
            await self._finished.record(job.task.id, End(status, outputs))
        except (OSError, TypeError) as error:
            log.warning("the end of a task could not be recorded", task=job.task.id, error=str(error))
        await job.finish(status, outputs)

    async def _make_sure(self, job: Job) -> None:
        """Look at the Task as it is now: what brought it here may have been an old notification."""
        retry_s = FIRST_RETRY_S
        while True:
            try:
                now = await self.broker.get(job.task.id, Task)
            except BrokerUnavailable:
                await asyncio.sleep(retry_s)
                retry_s = min(2 * retry_s, LAST_RETRY_S)
            except NotFound:
                raise TaskGone(f"{job.task.id} is no longer in the broker") from None
            else:
                job.see_anew(now)
                return

    def _drop_if_unwanted(self, job: Job) -> None:
        """End a job that still waits on the desk when it is cancelled there, without waiting for its turn."""
        desk = self._desks[job.resource]
        if job.wants is Wants.CANCEL and job in desk.waiting:
            desk.waiting.remove(job)
            self._do(self._work_on(job))

    def _remember(self, job: Job) -> None:
        self._ended[job.task.id] = None
        while len(self._ended) > REMEMBERED:
            self._ended.popitem(last=False)

    def _do(self, work: Any) -> asyncio.Task[None]:
        chore: asyncio.Task[None] = asyncio.create_task(work)
        self._chores.add(chore)
        chore.add_done_callback(self._done)
        return chore

    def _done(self, chore: asyncio.Task[None]) -> None:
        self._chores.discard(chore)
        if not chore.cancelled() and (error := chore.exception()) is not None:
            log.error("a chore of the performer failed", performer=self.name, exc_info=error)
            self._rounds.wish()

    def _subscription(self) -> dict[str, Any]:
        return {
            "id": self.settings.entity_id("Subscription", f"{self.name}-tasks"),
            "type": "Subscription",
            "description": f"Tasks for {self.name}",
            "entities": [{"type": Task.ngsi_type()}],
            "watchedAttributes": ["status", "requestedStatus"],
            "notification": {
                "format": "normalized",
                "endpoint": self._receiver.endpoint(self.notify_url),
            },
        }


def _readable(entity: Mapping[str, Any]) -> Task | None:
    """Return `entity` as a Task; None, counted and logged, if it does not fit the data model."""
    try:
        return Task.from_ngsild(entity)
    except ValueError as error:
        UNREADABLE.inc()
        log.warning("task does not fit its data model", task=entity.get("id"), error=str(error))
        return None
