"""Orchestrator: moves processes on. One writer takes what was heard, what is due and what people ask.

What has gathered while the last step was being written goes into the next one together, so that a disk
that commits 200 times a second can still move many more processes.
"""

import asyncio
import secrets
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Self, TypeVar

import orjson
from prometheus_client import Counter, Histogram
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from datamodels.entities import Task, TaskStatus
from handover.broker import BrokerClient
from handover.database import connect
from handover.errors import HandoverError, Problem
from handover.telemetry import get_logger
from services.task_orchestrator.expressions import is_variable_name
from services.task_orchestrator.library import Deployment, Library, read_runnable
from services.task_orchestrator.outbox import Outbox
from services.task_orchestrator.process import Process
from services.task_orchestrator.records import Message, ProcessRecord, Saying, Step
from services.task_orchestrator.settings import OrchestratorSettings
from services.task_orchestrator.store import Store

log = get_logger(__name__)

BATCH = 200
STRIKE_OFF_AFTER_S = 0.1

STEP_SECONDS = Histogram(
    "handover_orchestrator_step_seconds",
    "From taking in what moves processes to its being on disk",
    buckets=(0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 2),
)
NEWS = Counter("handover_orchestrator_news_total", "News of Tasks heard", ["outcome"])
ENDED = Counter("handover_orchestrator_processes_total", "Processes that have ended", ["status"])

T = TypeVar("T")
Clock = Callable[[], datetime]


@dataclass(frozen=True, slots=True)
class _Work:
    """Something to do within a step; whoever waits for `done` gets its result once it is on disk."""

    act: Callable[[Step], Any]
    done: asyncio.Future[Any]


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
        self.processes: dict[str, Process] = {}
        self._owners: dict[str, str] = {}
        self._work: asyncio.Queue[_Work] = asyncio.Queue()
        self._next_seq = 1
        self._stale: set[str] = set()
        self._dues: dict[str, datetime] = {}
        self._disk = ThreadPoolExecutor(1, "orchestrator-disk")
        self._chores: list[asyncio.Task[None]] = []
        self.due_changed = asyncio.Event()

    async def __aenter__(self) -> Self:
        await self.on_disk(self.store.migrate)
        self.library.add(await self.on_disk(self.store.definitions))
        for record in await self.on_disk(self.store.unfinished):
            await self._load(record)
        untold = await self.on_disk(self.store.outbox)
        self._next_seq = max((message.seq for message in untold), default=0) + 1
        self._chores = [asyncio.create_task(self._write_on()), asyncio.create_task(self._strike_off())]
        self.outbox.send(untold)
        log.info("orchestrator at work", processes=len(self.processes), untold=len(untold))
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
        definition = await asyncio.to_thread(read_runnable, xml)

        def act(step: Step) -> Deployment:
            record, created = self.library.next_version(
                definition, step.definitions, self.clock(), only_if_never_seen=only_if_never_seen
            )
            if created:
                step.definitions.append(record)
                entities = self.library.entities(record)
                step.say(f"definition {record.name}", Saying.UPSERT, entities[0]["id"], entities)
            return Deployment(record.name, record.version, created)

        return await self._do(act)

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
                raise Problem(422, "Bad parameter", f'"{name}" cannot be the name of a process variable')

        try:
            orjson.dumps(parameters)
        except TypeError as error:
            raise Problem(422, "Bad parameter", f"the parameters are no plain JSON: {error}") from None

        def act(step: Step) -> tuple[str, bool]:
            twin = next((p for p in self.processes.values() if key is not None and p.record.key == key), None)
            if twin is not None:
                return twin.record.id, False
            deployed = self.library.record(definition, version)
            plan, now = self.library.plan(deployed), self.clock()
            variables = plan.definition.arguments(parameters)
            record = ProcessRecord(
                id=f"{definition}-{secrets.token_hex(4)}",
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
            self.processes[record.id] = Process.begin(self.settings, plan, record, step, now)
            return record.id, True

        return await self._do(act)

    async def cancel(self, process_id: str) -> None:
        """Cancel a process; raise `Problem` 404 if there is none, 409 if it has ended."""
        if not await self.on_disk(lambda: self.store.processes(ids=[process_id])):
            raise Problem(404, "No such process", f'there is no process "{process_id}"')

        def act(step: Step) -> None:
            process = self.processes.get(process_id)
            if process is None:
                raise Problem(409, "Process has ended", f"{process_id} has ended already")
            process.cancel(step, self.clock())

        await self._do(act)

    # What is heard and what is due

    async def hear(self, entities: Iterable[Mapping[str, Any]]) -> int:
        """Take in Tasks as the broker has them; return how many were news. Others' Tasks are ignored."""
        tasks = []
        for entity in entities:
            owner = self._owner(str(entity.get("id")))
            if owner is None:
                NEWS.labels("not ours").inc()
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
        return await self._do(lambda step: self._take_in(tasks, step)) if tasks else 0

    async def recover(self) -> None:
        """Take up again what the database, when it was away, left undone."""
        if self._stale:
            await self._do(lambda _: None)

    async def missing(self, task_ids: Iterable[str]) -> None:
        """Take in that the broker does not have these Tasks of ours."""

        def act(step: Step) -> None:
            for task_id in task_ids:
                owner = self._owner(task_id)
                if owner is not None:
                    owner.missing(task_id, step, self.clock())

        await self._do(act)

    async def tick(self) -> None:
        """Let happen what is due."""

        def act(step: Step) -> None:
            now = self.clock()
            for process_id in [process_id for process_id, due in self._dues.items() if due <= now]:
                self.processes[process_id].tick(step, now)

        await self._do(act)

    def next_due(self) -> datetime | None:
        """Return when something is due next."""
        return min(self._dues.values(), default=None)

    def awaited(self) -> list[str]:
        """Return the ids of our Tasks that have not ended and that the broker must have by now."""
        return [
            task_id
            for process in self.processes.values()
            for task_id in process.tasks
            if not self.outbox.on_its_way(task_id)
        ]

    def _take_in(self, tasks: Iterable[Task], step: Step) -> int:
        now = self.clock()
        heard = 0
        for task in tasks:
            owner = self._owner(task.id)
            if owner is not None and owner.hear(task, step, now):
                heard += 1
                NEWS.labels("taken in").inc()
                log.info("task moved", task=task.id, status=task.status.value.value, process=owner.record.id)
        return heard

    async def _on_refused(self, message: Message, reason: str) -> None:
        owner = self._owner(message.subject)
        if message.saying is Saying.CREATE and owner is not None:
            await self._do(lambda step: owner.refused(message.subject, reason, step, self.clock()))

    def _owner(self, task_id: str) -> Process | None:
        return self.processes.get(self._owners.get(task_id, ""))

    # How it is written down

    async def _do(self, act: Callable[[Step], T]) -> T:
        done: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self._work.put_nowait(_Work(act, done))
        return await done

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
        try:
            await self._refresh()
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
            self._stale |= step.touched
            with suppress(SQLAlchemyError):  # the database is away: the next step tries again
                await self._refresh()
            await self._write_apart([work for work in works if not work.done.done()], error)
            return
        self._next_seq = step.next_seq
        self._settle(step)
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
                work, Problem(503, "Not written", f"nothing was changed: {reason}; mend that and ask again")
            )

    async def _refresh(self) -> None:
        """Take processes anew from the database after a step with them was not written."""
        if not self._stale:
            return
        records = await self.on_disk(lambda ids: self.store.processes(ids=ids), sorted(self._stale))
        for process_id in self._stale:
            self._forget(process_id)
        for record in records:
            await self._load(record)
        self._stale.clear()

    async def _load(self, record: ProcessRecord) -> None:
        tasks = await self.on_disk(self.store.tasks, record.id)
        try:
            plan = self.library.plan(self.library.record(record.definition, record.version))
            run = plan.resume(record.state) if record.state is not None else None
        except HandoverError as error:
            log.critical("a process cannot be resumed", process=record.id, error=str(error))
            return
        process = Process(self.settings, record, plan, run)
        process.tasks = {task.id: task for task in tasks if not task.finished}
        process.composed = [task.id for task in tasks]
        process.told = (record.status, len(tasks))
        if not process.over:
            self.processes[record.id] = process
            self._owners.update(dict.fromkeys(process.tasks, record.id))
            self._set_due(process)

    def _settle(self, step: Step) -> None:
        """After a step: know who owns its Tasks and what is due, and let go of what is over."""
        self.library.add(step.definitions)
        for task in step.tasks.values():
            self._owners[task.id] = task.process
            if task.finished:
                self._owners.pop(task.id, None)
        for record in step.processes.values():
            process = self.processes[record.id]
            if record.id in step.ended:
                ENDED.labels(record.status.value).inc()
                log.info("process ended", process=record.id, status=record.status.value, reason=record.reason)
            self._set_due(process)
            if process.over:
                self._forget(record.id)
        self.due_changed.set()

    def _set_due(self, process: Process) -> None:
        self._dues.pop(process.record.id, None)
        for timer in process.timers()[:1]:
            self._dues[process.record.id] = timer.due

    def _forget(self, process_id: str) -> None:
        self._dues.pop(process_id, None)
        process = self.processes.pop(process_id, None)
        for task_id in process.tasks if process is not None else ():
            self._owners.pop(task_id, None)

    async def _strike_off(self) -> None:
        """Delete delivered messages from the database when no step comes along that would do it."""
        while True:
            await self.outbox.something_delivered.wait()
            await asyncio.sleep(STRIKE_OFF_AFTER_S)
            try:
                await self._do(lambda _: None)
            except Problem as problem:
                log.warning("delivered messages could not be struck off yet", error=str(problem))


def _answer(work: _Work, answer: Any) -> None:
    if work.done.done():
        return
    if isinstance(answer, Problem):
        work.done.set_exception(answer)
    else:
        work.done.set_result(answer)
