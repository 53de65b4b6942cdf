"""Orchestrator: moves processes on. One writer takes what was heard, what is due and what people ask.

What has gathered while the last step was being written goes into the next one together, so that a disk
that commits 200 times a second can still move many more processes.
"""

import asyncio
import secrets
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any, Self, TypeVar

import orjson
from prometheus_client import Counter, Histogram
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from datamodels.entities import Task, TaskStatus
from handover.broker import BrokerClient
from handover.database import connect
from handover.errors import HandoverError, Problem
from handover.messages import message, text_of
from handover.task_life import FINISHED
from handover.telemetry import get_logger
from services.task_orchestrator import metrics
from services.task_orchestrator.entities import final_attributes
from services.task_orchestrator.expressions import is_variable_name
from services.task_orchestrator.floor import Floor
from services.task_orchestrator.library import Deployment, Library, plan_of, read_runnable
from services.task_orchestrator.outbox import Outbox
from services.task_orchestrator.process import Process, entity_of
from services.task_orchestrator.records import Message, ProcessRecord, Saying, Step
from services.task_orchestrator.settings import OrchestratorSettings
from services.task_orchestrator.store import EndedProcess, EndedTask, Store

log = get_logger(__name__)

BATCH = 200
STRIKE_OFF_AFTER_S = 0.1
TIDY_UP_EVERY_S = 3600.0
FORGET_AT_ONCE = 100
DELETED_AT_ONCE = 50
"""Entities deleted in one request, so that the broker answers others in between."""

STEP_SECONDS = Histogram(
    "handover_orchestrator_step_seconds",
    "From taking in what moves processes to its being on disk",
    buckets=(0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 2),
)
NEWS = Counter("handover_orchestrator_news_total", "News of Tasks heard", ["outcome"])

T = TypeVar("T")
Clock = Callable[[], datetime]


@dataclass(frozen=True, slots=True)
class _Work:
    """Something to do within a step; whoever waits for `done` gets its result once it is on disk."""

    act: Callable[[Step], Any]
    done: asyncio.Future[Any]
    process: str | None = None
    """A process that must be at hand for it, even if it is over."""


def utc_now() -> datetime:
    """Return the time."""
    return datetime.now(UTC)


class Orchestrator:
    """All processes of this factory; an asynchronous context manager while it works."""

    def __init__(
        self, settings: OrchestratorSettings, broker: BrokerClient, *, clock: Clock = utc_now
    ) -> None:
        self.settings = settings
        self.broker = broker
        self.clock = clock
        self.store = Store(connect(settings.database("orchestrator")))
        self.library = Library(settings)
        self.outbox = Outbox(settings, broker, self._on_refused)
        self._work: asyncio.Queue[_Work] = asyncio.Queue()
        self._next_seq = 1
        self._disk = ThreadPoolExecutor(1, "orchestrator-disk")
        self.floor = Floor(settings, self.library, self.store, self.on_disk)
        self._chores: list[asyncio.Task[None]] = []
        self.due_changed = asyncio.Event()
        self.on_unowned: Callable[[], None] = lambda: None
        """Called when the broker shows an unfinished Task that no running process waits for."""

    async def __aenter__(self) -> Self:
        await self.on_disk(self.store.migrate)
        self.library.add(await self.on_disk(self.store.definitions))
        await self.floor.fill()
        metrics.show_open(self.floor.open_tasks, self.clock)
        untold = await self.on_disk(self.store.outbox)
        self._next_seq = max((message.seq for message in untold), default=0) + 1
        chores = (self._write_on(), self._strike_off(), self._tidy_up())
        self._chores = [asyncio.create_task(chore) for chore in chores]
        self.outbox.send(untold)
        log.info("orchestrator at work", processes=len(self.floor.processes), untold=len(untold))
        return self

    async def __aexit__(self, *_: object) -> None:
        for chore in self._chores:
            chore.cancel()
        await asyncio.gather(*self._chores, return_exceptions=True)
        await self.outbox.close()
        await self.on_disk(self.store.close)
        self._disk.shutdown()

    async def on_disk(self, action: Callable[..., T], *arguments: Any) -> T:
        """Run a blocking `action` of the store in the one thread that may."""
        return await asyncio.get_running_loop().run_in_executor(self._disk, action, *arguments)

    # What people ask

    async def deploy(self, xml: bytes, *, only_if_never_seen: bool = False) -> Deployment:
        """Deploy a BPMN file; raise `BadBpmn` if it cannot run.

        The file that is the latest version already changes nothing; nor, with `only_if_never_seen`, one that
        was a version at any time.
        """
        plan = await asyncio.to_thread(plan_of, xml)
        definition = plan.definition

        def act(step: Step) -> Deployment:
            record, created = self.library.next_version(
                definition, step.definitions, self.clock(), only_if_never_seen=only_if_never_seen
            )
            if created:
                self.library.keep(plan)
                step.definitions.append(record)
                entities = self.library.entities(record)
                step.say(f"definition {record.name}", Saying.UPSERT, entities[0]["id"], entities)
            return Deployment(record.name, record.version, created)

        return await self._do(act)

    async def try_out(self, xml: bytes) -> dict[str, Any]:
        """Say what deploying a BPMN file would lead to; raise `BadBpmn` if it cannot run."""
        definition = await asyncio.to_thread(read_runnable, xml)
        record, created = self.library.next_version(definition, (), self.clock(), only_if_never_seen=False)
        return {"name": record.name, "version": record.version, "title": record.title, "created": created}

    async def begin(
        self,
        definition: str,
        parameters: Mapping[str, Any],
        *,
        version: int | None = None,
        key: str | None = None,
    ) -> tuple[str, bool]:
        """Start a process and return its id; False with it when `key` had started it before.

        Raises `Problem` 404 for an unknown definition, 422 for parameters that do not fit it.
        """
        if key is not None and (known := await self.on_disk(self.store.by_key, key)) is not None:
            return known.id, False
        for name in parameters:
            if not is_variable_name(name):
                raise Problem(
                    422,
                    "Bad parameter",
                    message(
                        "process.bad_parameter_name",
                        '"{name}" cannot be the name of a process variable',
                        name=name,
                    ),
                )

        try:
            orjson.dumps(parameters)
        except TypeError as error:
            raise Problem(
                422,
                "Bad parameter",
                message(
                    "process.parameters_not_json",
                    "the parameters are no plain JSON: {error}",
                    error=text_of(error),
                ),
            ) from None

        with suppress(Problem):  # a twin that was begun meanwhile counts, whatever its definition
            await self.library.prepare(self.library.record(definition, version))

        def act(step: Step) -> tuple[str, bool]:
            twin = self._begun_with(key)
            if twin is not None:
                return twin.record.id, False
            deployed = self.library.record(definition, version)
            plan, now = self.library.plan(deployed), self.clock()
            variables = plan.definition.arguments(parameters)
            record = ProcessRecord(
                id=f"{definition}-{secrets.token_hex(6)}",
                definition=definition,
                version=deployed.version,
                key=key,
                status=TaskStatus.IN_PROGRESS,
                parameters=variables,
                variables=variables,
                waiting=(),
                reason=None,
                started_at=now,
                ended_at=None,
                revision=1,
                state=None,
            )
            self.floor.processes[record.id] = Process.begin(self.settings, plan, record, step, now)
            return record.id, True

        return await self._do(act)

    async def cancel(self, process_id: str, by: str | None = None) -> None:
        """Cancel a process; raise `Problem` 404 if there is none, 409 if it has ended."""
        await self._do_with(process_id, lambda process, step: process.cancel(by, step, self.clock()))

    async def retry(self, process_id: str, task_id: str, by: str) -> None:
        """Have the failed Task that has ended a process done anew, and let the process go on.

        Raises `Problem` 404 if there is no such process or Task, 409 if it cannot be retried.
        """
        await self._do_with(process_id, lambda process, step: process.retry(task_id, by, step, self.clock()))

    def _begun_with(self, key: str | None) -> Process | None:
        begun = self.floor.processes.values()
        return next((process for process in begun if key is not None and process.record.key == key), None)

    # What is heard and what is due

    async def hear(self, entities: Iterable[Mapping[str, Any]]) -> int:
        """Take in Tasks as the broker has them; return how many were news. Others' Tasks are ignored."""
        tasks = self.news_in(entities)
        return await self._do(lambda step: self._take_in(tasks, step)) if tasks else 0

    def news_in(self, entities: Iterable[Mapping[str, Any]]) -> list[Task]:
        """Return those of our Tasks among `entities` that say something we do not know."""
        tasks = []
        for entity in entities:
            owner = self.floor.owner(str(entity.get("id")))
            if owner is None:
                NEWS.labels("not ours").inc()
                if not _says_finished(entity):
                    self.on_unowned()  # a Task of ours that has ended may have come back
                continue
            try:
                task = Task.from_ngsild(entity)
            except ValueError as error:
                NEWS.labels("unreadable").inc()
                log.warning("task does not fit its data model", task=entity.get("id"), error=str(error))
                continue
            if owner.is_news(task):
                tasks.append(task)
            else:
                NEWS.labels("known").inc()
        return tasks

    async def recover(self) -> None:
        """Take up again what the database, when it was away, left undone."""
        if self.floor.stale:
            await self._do(lambda _: None)

    async def missing(self, task_ids: Iterable[str]) -> None:
        """Take in that the broker does not have these Tasks of ours."""

        def act(step: Step) -> None:
            for task_id in task_ids:
                owner = self.floor.owner(task_id)
                if owner is not None:
                    owner.missing(task_id, step, self.clock())

        await self._do(act)

    async def tick(self) -> None:
        """Let happen what is due."""

        def act(step: Step) -> None:
            now = self.clock()
            for process in self.floor.due(now):
                process.tick(step, now)

        await self._do(act)

    def next_due(self) -> datetime | None:
        """Return when something is due next."""
        return self.floor.next_due()

    def awaited(self) -> list[str]:
        """Return the ids of our Tasks that have not ended and that the broker must have by now."""
        return [
            task_id
            for process in self.floor.processes.values()
            for task_id in process.tasks
            if not self.outbox.on_its_way(task_id)
        ]

    # What leaves the broker, and what it shows though it has ended

    async def archive(self, ended: Iterable[EndedProcess]) -> list[str]:
        """Mark processes as archived and delete their entities from the broker; return which.

        One transaction marks them and puts the deletions into the outbox. A process that is being retried at
        this moment stays.
        """

        def act(step: Step) -> list[str]:
            now = self.clock()
            archived = []
            for each in ended:
                record = each.process
                if record.id not in self.floor.processes:
                    step.archived.append(replace(record, archived_at=now, revision=record.revision + 1))
                    self._say_delete(step, record.id, (*each.tasks, self._urn(record.id)))
                    archived.append(record.id)
            return archived

        return await self._do(act)

    async def delete_archived(self, entities: Mapping[str, Iterable[str]]) -> None:
        """Delete entities of archived processes again (by process), which the broker shows all the same."""

        def act(step: Step) -> None:
            for process_id, ids in entities.items():
                if process_id not in self.floor.processes:
                    self._say_delete(step, process_id, tuple(ids))

        await self._do(act)

    async def restate(self, tasks: Iterable[EndedTask], processes: Iterable[EndedProcess]) -> int:
        """Report again how Tasks and processes have ended that the broker shows as unfinished.

        What is archived is deleted again. Returns how many were reported.
        """

        def act(step: Step) -> int:
            now, before = self.clock(), len(step.messages)
            for each in tasks:
                task = each.task
                if self.floor.owner(task.id) is not None or self.outbox.on_its_way(task.id):
                    continue
                if each.archived:
                    self._say_delete(step, task.process, (task.id,))
                else:
                    step.say(task.process, Saying.APPEND, task.id, final_attributes(task))
            for ended in processes:
                record, urn = ended.process, self._urn(ended.process.id)
                if record.id in self.floor.processes or self.outbox.on_its_way(urn):
                    continue
                if record.archived_at is not None:
                    self._say_delete(step, record.id, (urn,))
                else:
                    entity = entity_of(self.settings, record, ended.tasks, now)
                    step.say(record.id, Saying.UPSERT, urn, [entity])
            return len(step.messages) - before

        return await self._do(act)

    def _say_delete(self, step: Step, process_id: str, ids: Sequence[str]) -> None:
        for start in range(0, len(ids), DELETED_AT_ONCE):
            some = list(ids[start : start + DELETED_AT_ONCE])
            step.say(process_id, Saying.DELETE, self._urn(process_id), some)

    def _urn(self, process_id: str) -> str:
        return self.settings.entity_id("Process", process_id)

    def _take_in(self, tasks: Iterable[Task], step: Step) -> int:
        now = self.clock()
        heard = 0
        for task in tasks:
            owner = self.floor.owner(task.id)
            if owner is not None and owner.hear(task, step, now):
                heard += 1
                NEWS.labels("taken in").inc()
                log.info("task moved", task=task.id, status=task.status.value.value, process=owner.record.id)
        return heard

    async def _on_refused(self, message: Message, reason: str) -> None:
        owner = self.floor.owner(message.subject)
        if message.saying is Saying.CREATE and owner is not None:
            await self._do(lambda step: owner.refused(message.subject, reason, step, self.clock()))

    # How it is written down

    async def _do(self, act: Callable[[Step], T], *, process: str | None = None) -> T:
        done: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self._work.put_nowait(_Work(act, done, process))
        return await done

    async def _do_with(self, process_id: str, act: Callable[[Process, Step], T]) -> T:
        """Do something with a process that may be over; raise `Problem` 404 if there is none."""
        if not await self.on_disk(self.store.processes, [process_id]):
            raise Problem(
                404,
                "No such process",
                message("process.unknown", 'there is no process "{process_id}"', process_id=process_id),
            )

        def with_it(step: Step) -> T:
            process = self.floor.processes.get(process_id)
            if process is None:
                reason = f"this release cannot read {process_id}; the log says why"
                raise Problem(409, "Process cannot be resumed", reason)
            return act(process, step)

        return await self._do(with_it, process=process_id)

    async def _write_on(self) -> None:
        while True:
            works = [await self._work.get()]
            while len(works) < BATCH and not self._work.empty():
                works.append(self._work.get_nowait())
            with STEP_SECONDS.time():
                await self._write_together(works)

    async def _write_together(self, works: list[_Work]) -> None:
        step = Step(self._next_seq)
        answers: list[tuple[_Work, Any]] = []
        fetched = {work.process for work in works if work.process is not None}
        try:
            await self.floor.refresh()
            await self.floor.fetch(fetched)
            for work in works:
                try:
                    answers.append((work, work.act(step)))
                except Problem as problem:
                    _answer(work, problem)
            step.delivered = self.outbox.take_delivered()
            if step:
                await self.on_disk(self.store.write, step)
        except Exception as error:  # noqa: BLE001 - logged, and answered, by _write_apart
            self.outbox.put_back(step.delivered)
            self.floor.mistrust(step.touched)
            with suppress(SQLAlchemyError):  # the database is away: the next step tries again
                await self.floor.refresh()
            self.floor.clear(fetched)
            await self._write_apart([work for work in works if not work.done.done()], error)
            return
        self._next_seq = step.next_seq
        self.library.add(step.definitions)
        self.floor.settle(step)
        self.floor.clear(fetched)
        self.due_changed.set()
        self.outbox.send(step.messages)
        for work, answer in answers:
            _answer(work, answer)

    async def _write_apart(self, works: list[_Work], error: Exception) -> None:
        """Something in a step went wrong: do its parts one by one, so that only the culprit suffers."""
        if len(works) > 1:
            for work in works:
                await self._write_together([work])
            return
        expected = isinstance(error, HandoverError | SQLAlchemyError)
        reason = str(error.orig if isinstance(error, DBAPIError) else error)
        log.error("a step could not be written", error=reason, exc_info=None if expected else error)
        for work in works:
            _answer(
                work,
                Problem(
                    503,
                    "Not written",
                    message(
                        "process.not_written",
                        "nothing was changed: {reason}; mend that and ask again",
                        reason=reason,
                    ),
                ),
            )

    async def _strike_off(self) -> None:
        """Delete delivered messages from the database when no step comes along that would do it."""
        while True:
            await self.outbox.something_delivered.wait()
            await asyncio.sleep(STRIKE_OFF_AFTER_S)
            try:
                await self._do(lambda _: None)
            except Problem as problem:
                log.warning("delivered messages could not be struck off yet", error=str(problem))

    async def _tidy_up(self) -> None:
        """Forget, now and then, the processes that ended longer ago than they are to be kept."""
        while self.settings.keep_days:
            ended_before = self.clock() - timedelta(days=self.settings.keep_days)
            try:
                while await self.on_disk(self._forget, ended_before) == FORGET_AT_ONCE:
                    log.info("processes of old forgotten", at_least=FORGET_AT_ONCE)
            except SQLAlchemyError as error:
                log.warning("processes of old could not be forgotten yet", error=str(error))
            await asyncio.sleep(TIDY_UP_EVERY_S)

    def _forget(self, ended_before: datetime) -> int:
        """Delete old processes from the database, but none whose entities have not left the broker."""
        archived_only = self.settings.retention_h > 0
        return self.store.forget(ended_before, FORGET_AT_ONCE, archived_only=archived_only)


def _says_finished(entity: Mapping[str, Any]) -> bool:
    status = entity.get("status")
    value = status.get("value") if isinstance(status, Mapping) else None
    return isinstance(value, str) and value in FINISHED


def _answer(work: _Work, answer: Any) -> None:
    if work.done.done():
        return
    if isinstance(answer, Problem):
        work.done.set_exception(answer)
    else:
        work.done.set_result(answer)
