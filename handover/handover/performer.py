"""A performer: the component that executes the Tasks of Devices and Persons.

    class Lamp(Performer):
        async def perform(self, job: Job) -> dict[str, Any]:
            await self.glow(job.parameters["seconds"])
            return {"lit": True}

How it works:

1. It learns of Tasks by a subscription and by querying the broker: at start, after a lost connection, and
   every few seconds (`Resync`).
2. Each resource has a `ResourceQueue` with one worker, so a resource executes one Task at a time: first one
   that was started before a crash, then by priority, due date and arrival.
3. It executes Tasks of a Device only while it holds its lease (`device_lease`); of several performers of
   one Device the others stand by. `perform` calls `job.may_act` before every command that moves something,
   and stops at `job.checkpoint` when the lease ends.
4. A Task that was started is never executed again: after a crash, or when another process has taken the
   Device over, it fails with an unknown outcome, so that a person decides. A performer whose acts may be
   repeated, or that knows what was done, overrides `may_repeat`. Within such a Task, `Job.once` does what
   must not be repeated: a Task that a crash has interrupted within it fails with an unknown outcome.
5. The end of a Task is recorded (`finished_tasks`) before it is reported, and reported again at each
   reconciliation until the broker has it, also after a crash. A recorded `completed` is never replaced: work
   that was done is not reported as failed.
"""

import asyncio
from abc import ABC, abstractmethod
from collections import OrderedDict, deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Self
from urllib.parse import urlsplit

from fastapi import FastAPI, Request, Response
from prometheus_client import Counter, Histogram

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.broker.cells import OtherCells
from handover.broker.resync import Resync
from handover.job import Job, RequestedAction, TaskCancelled, TaskFailed, TaskGone, finite_outputs
from handover.messages import message, with_code
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.retry import retry
from handover.settings import Settings
from handover.subscriptions.notifications import REQUIRES_NOTIFICATION_KEY, NotificationReceiver
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.subscriptions.record import SubscriptionRecord
from handover.tasks.device_lease import DeviceLeases
from handover.tasks.finished_tasks import End, FinishedTasks
from handover.tasks.outcomes import outcome_unknown
from handover.tasks.task_life import FINISHED, STARTED, UNFINISHED_QUERY
from handover.telemetry import get_logger, working_on
from handover_datamodels.entities import Task, TaskStatus
from handover_datamodels.times import iso

__all__ = ["Job", "Performer", "RequestedAction", "TaskCancelled", "TaskFailed", "TaskGone"]

log = get_logger(__name__)

MAX_SELECTED = 20
"""Resources in a query."""
MAX_ANNOUNCED = 200
"""Resources in a request that announces the performer of each."""
MAX_SELECTION_ATTEMPTS = 5
REFUSED_CONTENT = frozenset({400, 413, 422})
"""The answers of a broker that refuses the outputs themselves; any other may be different later."""
PERFORM = "perform"
"""The act that is recorded for each Task before `perform` is called."""
MAX_REMEMBERED = 10_000
"""Ended Tasks that are remembered, so that a late notification does not start them again."""

OUTCOMES = Counter("handover_tasks_total", "Tasks performed", ["performer", "outcome"])
DURATION = Histogram(
    "handover_task_duration_seconds",
    "Time from the start of a Task to its end",
    ["performer"],
    buckets=(0.1, 0.5, 1, 2, 5, 10, 30, 60, 300, 1800),
)
UNREADABLE = Counter("handover_unreadable_tasks_total", "Task entities that do not match the data model")


@dataclass
class ResourceQueue:
    """The jobs that wait for one resource, and the worker that executes them."""

    waiting: deque[Job] = field(default_factory=deque)
    has_waiting: asyncio.Event = field(default_factory=asyncio.Event)
    worker: asyncio.Task[None] | None = None

    def take(self) -> Job:
        """Remove and return the job to execute next."""
        job = min(self.waiting, key=lambda waiting_job: waiting_job.order)
        self.waiting.remove(job)
        return job


class Performer(ABC):
    """Executes the Tasks of resources; an asynchronous context manager while it is active.

    `name` identifies it to other components; the broker sends notifications to `notify_url` (see `mount`).
    `holder` is its identity for leases where replicas share one that a database guards; by default that of
    its data directory. Its subscription is added to `subscription_record`.
    """

    def __init__(
        self,
        name: str,
        settings: Settings,
        broker: BrokerClient,
        *,
        notify_url: str,
        holder: str | None = None,
        subscription_record: SubscriptionRecord | None = None,
    ) -> None:
        self.name = name
        self.settings = settings
        self.broker = broker
        self.notify_url = notify_url
        self._receiver = NotificationReceiver(name, settings, broker)
        self._cells = OtherCells(settings, broker)
        self._subscriptions = OwnSubscriptions(name, settings, broker, subscription_record)
        self._queues: dict[str, ResourceQueue] = {}
        self._jobs: dict[str, Job] = {}
        self._ended: OrderedDict[str, None] = OrderedDict()
        self._finished = FinishedTasks(settings, name)
        self._unreported: dict[str, End] = {}
        """The ends that the broker has not accepted yet."""
        self._holder = holder
        self.leases = DeviceLeases(
            settings,
            name,
            None if broker.credentials is None else broker.credentials.headers,
            on_held=lambda _: self._resync.request(),
        )
        self._announced: set[str] = set()
        self._subscribed = False
        self._selects_own = False
        self._selection_attempts = 0
        self._resync = Resync(self._try_reconcile, settings.reconcile_s)
        self._active = False
        self._tasks = BackgroundTasks(name, on_failure=lambda _: self._resync.request())

    @abstractmethod
    async def perform(self, job: Job) -> Mapping[str, Any] | None:
        """Execute the Task and return its outputParameters.

        Raise `TaskFailed` when it cannot be done. Call `job.checkpoint()` where the work can pause, and
        `job.may_act()` before every command that moves something.
        """

    async def may_repeat(self, job: Job) -> bool:  # noqa: ARG002 - for those that override it
        """Return whether `perform` may be called for a Task that was started before, here or elsewhere.

        `job.begun_here` says whether that was this performer with this data directory. By default no Task is
        executed twice.
        """
        return False

    async def act_for(self, resource: str) -> None:
        """Execute Tasks that involve `resource` (the URN of a Device or Person) from now on."""
        if resource not in self._queues:
            self._queues[resource] = ResourceQueue()
            self.leases.of(resource)
            if self._active:
                self._start_worker(resource)
        self._resync.request()

    def stop_acting_for(self, resource: str) -> bool:
        """Accept no more Tasks for `resource`; return False without a change while it has a job."""
        queue = self._queues.get(resource)
        if queue is None:
            return True
        if queue.waiting or any(job.resource == resource for job in self._jobs.values()):
            return False
        if queue.worker is not None:
            queue.worker.cancel()
        del self._queues[resource]
        self.leases.drop(resource)
        self._announced.discard(resource)
        return True

    def resources(self) -> Iterable[str]:
        """Return the resources this performer acts for."""
        return tuple(self._queues)

    def jobs(self) -> Iterable[Job]:
        """Return the running and the waiting jobs."""
        return tuple(self._jobs.values())

    def mount(self, app: FastAPI) -> None:
        """Add the route for notifications at the path of `notify_url`."""

        @app.post(
            urlsplit(self.notify_url).path,
            status_code=204,
            tags=["notifications"],
            dependencies=[REQUIRES_NOTIFICATION_KEY],
        )
        async def notify(request: Request) -> Response:
            """Read the Tasks of a notification from the broker."""
            await self._read(await self._receiver.receive(request))
            return Response(status_code=204)

    async def __aenter__(self) -> Self:
        self._receiver.require_key()
        await self._finished.open()
        identity, was_leased = await self._finished.identity()
        self.leases.open(
            self._holder or identity, was_leased=was_leased, keep_mark=self._finished.mark_leased
        )
        self._active = True
        await self._tasks.__aenter__()
        for resource in self._queues:
            self._start_worker(resource)
        self._tasks.start(self._resync.run)
        self._tasks.start_restarting(self.leases.run)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._active = False
        await self._tasks.__aexit__()
        await self.leases.release()
        await self._finished.close()

    async def probe(self) -> None:
        """Raise an error while the subscription to Tasks is missing, or all Devices are held by others."""
        if not self._subscribed:
            raise BrokerUnavailable(
                503, "Not subscribed", "the broker has not accepted the subscription to Tasks yet"
            )
        if (reason := self.leases.standby()) is not None:
            raise ConnectionError(reason)

    # Discovery of Tasks

    async def _try_reconcile(self) -> bool:
        try:
            await self._reconcile()
        except BrokerError as error:
            log.warning("tasks not reconciled", performer=self.name, error=str(error))
            self._subscribed = False
            self._announced.clear()
            return False
        return True

    async def _reconcile(self) -> None:
        await self._cells.read()
        await self._subscriptions.keep(self._subscription())
        self._subscribed = True
        await self._announce(
            [
                queue
                for queue in self._queues
                if queue not in self._announced and self.leases.of(queue).is_held()
            ]
        )
        task_ids = set(self._jobs)
        unfinished = await self._unfinished()
        for entity in unfinished:
            self._process(entity)
        for missing in task_ids.difference(entity["id"] for entity in unfinished):
            await self._update(missing)

    async def _unfinished(self) -> list[dict[str, Any]]:
        """Return the unfinished Tasks, of all performers until the broker has shown that it can select ours.

        Brokers differ in how they compare members of a list with `q`. So the selection is used once it has
        returned all Tasks of ours that a query without it returns.
        """
        resources = self._queues
        own = self._selection() if 0 < len(resources) <= MAX_SELECTED else None
        if own is not None and self._selects_own:
            return await self.broker.query(type=Task.ngsi_type(), q=own)
        unfinished = await self.broker.query(type=Task.ngsi_type(), q=UNFINISHED_QUERY)
        expected = {str(entity["id"]) for entity in unfinished if self._involves(entity, resources)}
        if own is not None and expected and self._selection_attempts < MAX_SELECTION_ATTEMPTS:
            self._selection_attempts += 1
            try:
                selected = await self.broker.query(type=Task.ngsi_type(), q=own)
            except BrokerUnavailable:
                raise
            except BrokerError as error:
                log.info("the broker cannot select tasks by resource", error=str(error))
            else:
                self._selects_own = expected <= {str(entity["id"]) for entity in selected}
        return unfinished

    def _selection(self) -> str:
        """Return the `q` of the unfinished Tasks that involve a resource of this performer."""
        involved = "|".join(f'involves[object]=="{resource}"' for resource in self._queues)
        return f"{UNFINISHED_QUERY};({involved})"

    @staticmethod
    def _involves(entity: Mapping[str, Any], resources: Collection[str]) -> bool:
        task = _as_task(entity)
        return task is not None and any(link.object in resources for link in task.involves or ())

    async def _announce(self, resources: Sequence[str]) -> None:
        performer = {"type": "Property", "value": self.name}
        for start in range(0, len(resources), MAX_ANNOUNCED):
            batch = resources[start : start + MAX_ANNOUNCED]
            await self.broker.upsert(
                [{"id": resource, "type": _type_in(resource), "performer": performer} for resource in batch]
            )
            self._announced.update(resource for resource in batch if resource in self._queues)

    async def _update(self, task_id: str) -> None:
        job = self._jobs.get(task_id)
        if job is None:
            return
        try:
            job.observe(await self.broker.get(task_id, Task))
        except NotFound:
            job.abandon()

    async def _read(self, notified: Iterable[Mapping[str, Any]]) -> None:
        """Read the relevant Tasks of a notification from the broker."""
        relevant = [
            task.id for task in map(_as_task, notified) if task is not None and self._is_relevant(task)
        ]
        try:
            entities = await self._receiver.read(Task.ngsi_type(), relevant)
        except BrokerError as error:
            log.warning("changed tasks not read", performer=self.name, error=str(error))
            self._resync.request()
            return
        for entity in entities:
            self._process(entity)

    def _is_relevant(self, task: Task) -> bool:
        """Return whether a Task may be for this performer and has changed."""
        job = self._jobs.get(task.id)
        return not job.is_known(task) if job is not None else self._is_acceptable(task)

    def _is_acceptable(self, task: Task) -> bool:
        """Return whether a Task without a job may be for this performer."""
        is_open = task.id not in self._ended and task.status.value not in FINISHED
        return is_open and any(link.object in self._queues for link in task.involves or ())

    def _process(self, entity: Mapping[str, Any]) -> None:
        """Process a Task as the broker has it."""
        task = _as_task(entity)
        if task is None:
            return
        job = self._jobs.get(task.id)
        if job is not None:
            job.observe(task)
            self._end_if_cancelled(job)
        elif self._is_acceptable(task):
            self._tasks.start(self._accept, task)

    async def _accept(self, task: Task) -> None:
        resource = await self._resource_for(task)
        end = self._unreported.get(task.id)
        if end is None and resource is not None:
            end = await self._finished.find(task.id)
        if resource is None or resource not in self._queues:
            return
        if task.id in self._jobs or task.id in self._ended:
            return
        lease = self.leases.of(resource)
        if end is not None:
            if lease.is_held():  # else when it is: the lease wakes the reconciliation
                await self._report_again(task, end)
            return
        job = Job(task, resource, self.broker, self._finished, lease)
        self._jobs[task.id] = job
        log.debug("task accepted", task=task.id, resource=resource)
        queue = self._queues[resource]
        if job.resumed:
            queue.waiting.appendleft(job)
        else:
            queue.waiting.append(job)
        queue.has_waiting.set()

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
            log.warning("end of a finished task not reported again", task=task.id, error=str(error))
            return  # the next reconciliation finds it unfinished
        self._unreported.pop(task.id, None)
        log.warning("end of a finished task reported again", task=task.id, status=end.status.value)
        OUTCOMES.labels(self.name, "reported_again").inc()

    async def _resource_for(self, task: Task) -> str | None:
        """Return the resource for which this performer executes the Task.

        The performer of a Task is that of the first involved resource that has a performer.
        """
        for link in task.involves or ():
            if link.object in self._queues:
                return link.object
            try:
                entity = await self.broker.retrieve(link.object)
            except NotFound:
                continue
            except BrokerError:
                self._resync.request()
                return None
            if "performer" in entity:
                return None
        return None

    # Execution of Tasks

    def _start_worker(self, resource: str) -> None:
        queue = self._queues[resource]
        queue.worker = self._tasks.start(self._work_on_queue, queue)

    async def _work_on_queue(self, queue: ResourceQueue) -> None:
        while True:
            while not queue.waiting:
                queue.has_waiting.clear()
                await queue.has_waiting.wait()
            lease = self.leases.of(queue.waiting[0].resource)
            if not lease.may_begin():
                await lease.wait_until_held()
                continue
            job = queue.take()
            try:
                await self._work_on(job)
            except Exception:
                # The next reconciliation reports its end again, or begins it if it has none.
                log.exception("end of a job not reported", task=job.task.id)
                OUTCOMES.labels(self.name, "unreported").inc()
                self._jobs.pop(job.task.id, None)

    async def _work_on(self, job: Job) -> None:
        with working_on(task=job.task.id, resource=job.resource), DURATION.labels(self.name).time():
            stop_watching = job.watch_lease()
            try:
                outcome = await self._execute(job)
            except TaskGone as gone:
                outcome = "gone"
                log.info("task dropped", reason=str(gone))
            finally:
                stop_watching()
            OUTCOMES.labels(self.name, outcome).inc()
        self._jobs.pop(job.task.id, None)
        if outcome != "gone":
            self._remember(job)

    async def _execute(self, job: Job) -> str:
        await self._refresh(job)
        try:
            await self._begin(job)
            outputs = dict(await self._work(job) or {})
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
            log.exception("task failed")
            reason = f"{self.name} failed: {type(error).__name__}: {error}"
            await self._finish(job, TaskStatus.FAILED, {"reason": reason})
            return "failed"
        try:
            await self._finish(job, TaskStatus.COMPLETED, outputs)
        except TypeError as error:  # the outputs are no plain JSON
            await self._finish(job, TaskStatus.FAILED, {"reason": _not_reportable(error)})
            return "failed"
        except BrokerError as error:
            if error.status not in REFUSED_CONTENT:
                raise
            await self._finish(job, TaskStatus.COMPLETED, {"reason": _not_reportable(error)})
        return "completed"

    async def _work(self, job: Job) -> Mapping[str, Any] | None:
        """Call `perform`, and cancel it if another process takes the Device over. Raises `TaskGone` then."""
        work = asyncio.ensure_future(self.perform(job))
        job.on_taken = work.cancel
        try:
            return await work
        except asyncio.CancelledError:
            if not job.is_taken:
                raise
            raise TaskGone(f"another process has the Device of {job.task.id}") from None

    async def _begin(self, job: Job) -> None:
        """Accept the Task and record that its work begins; raise `TaskFailed` if it may have begun before."""
        was_started = job.task.status.value in STARTED
        earlier = await self._finished.act(job.task.id, PERFORM)
        job.begun_here = earlier is not None or (was_started and self._finished.is_upgraded)
        if (was_started or job.begun_here) and not await self.may_repeat(job):
            raise TaskFailed(
                outcome_unknown(
                    message(
                        "task.performer_stopped",
                        "its performer stopped after it had begun; look what was done, then retry or skip it",
                    )
                )
            )
        await job.accept()
        try:
            await self._finished.begin_act(job.task.id, PERFORM)
        except OSError as error:
            raise TaskFailed.translated(
                "task.begin_not_recorded",
                "the begin of the work cannot be recorded: {error}; free disk space",
                error=str(error),
            ) from error

    async def _finish(self, job: Job, status: TaskStatus, outputs: Mapping[str, Any]) -> None:
        """Record the end of the job, then report it: after a crash in between it is not executed again."""
        finite = finite_outputs(outputs)
        if finite.keys() != outputs.keys():
            log.warning("result has numbers that are not finite", task=job.task.id, reason=finite["reason"])
        self._unreported[job.task.id] = end = End(status, finite)
        try:
            await self._finished.record(job.task.id, end)
        except (OSError, TypeError) as error:
            log.warning("end of a task not recorded", task=job.task.id, error=str(error))
        try:
            await job.until_held()
            await job.finish(status, finite)
        except TaskGone:
            self._unreported.pop(job.task.id, None)
            raise
        self._unreported.pop(job.task.id, None)

    async def _refresh(self, job: Job) -> None:
        """Read the Task again before the work starts: the notification may have been old."""
        try:
            now = await retry(lambda: self.broker.get(job.task.id, Task), on=BrokerUnavailable)
        except NotFound:
            raise TaskGone(f"{job.task.id} is no longer in the broker") from None
        job.refresh(now)

    def _end_if_cancelled(self, job: Job) -> None:
        """End a waiting job at once when it is cancelled."""
        queue = self._queues[job.resource]
        is_waiting = job in queue.waiting
        if is_waiting and job.is_gone:
            queue.waiting.remove(job)
            self._jobs.pop(job.task.id, None)
        elif is_waiting and job.requested_action is RequestedAction.CANCEL and job.may_act():
            queue.waiting.remove(job)
            self._tasks.start(self._work_on, job)

    def _remember(self, job: Job) -> None:
        self._ended[job.task.id] = None
        while len(self._ended) > MAX_REMEMBERED:
            self._ended.popitem(last=False)

    @property
    def subscription_id(self) -> str:
        """The id of the subscription to Tasks."""
        return self.settings.entity_id("Subscription", f"{self.name}-tasks")

    def _subscription(self) -> dict[str, Any]:
        return {
            "id": self.subscription_id,
            "type": "Subscription",
            "description": f"Tasks for {self.name}",
            "entities": self._cells.selectors(Task.ngsi_type(), acts_for=self._queues),
            "watchedAttributes": ["status", "requestedStatus"],
            "notification": {
                "format": "normalized",
                "endpoint": self._receiver.endpoint(self.notify_url),
            },
        }


def _type_in(resource: str) -> str:
    return resource.split(":")[2] if resource.count(":") >= 3 else "Device"


def _not_reportable(error: Exception) -> str:
    return f"the result could not be reported: {error}"


def _as_task(entity: Mapping[str, Any]) -> Task | None:
    """Return `entity` as a Task; log, count and return None if it does not match the data model."""
    try:
        return Task.from_ngsild(entity)
    except ValueError as error:
        UNREADABLE.inc()
        log.warning("task does not match the data model", task=entity.get("id"), error=str(error))
        return None
