"""Orchestrator: applies received changes, due timers and requests of people to processes.

One writer task applies them. All that arrive while one transaction is written form the next step, so a disk
that commits 200 times a second does not limit the orchestrator to 200 changes.
"""

import asyncio
import secrets
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any, Self, TypeVar

import orjson
from prometheus_client import Counter, Histogram
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from datamodels.entities import Task, TaskStatus
from handover.background_tasks import BackgroundTasks
from handover.broker import BrokerClient
from handover.database import LockLost, connect
from handover.errors import HandoverError, Problem
from handover.messages import message, text_of
from handover.task_life import FINISHED
from handover.telemetry import get_logger
from services.task_orchestrator import metrics
from services.task_orchestrator.active_processes import ActiveProcesses
from services.task_orchestrator.allocation.agents import Agents
from services.task_orchestrator.allocation.allocator import Allocator
from services.task_orchestrator.allocation.mapping import MappingEntry, MappingTable
from services.task_orchestrator.correlation import EventStart
from services.task_orchestrator.definition_registry import DefinitionRegistry, Deployed, Deployment
from services.task_orchestrator.entities import final_attributes
from services.task_orchestrator.entity_delivery import EntityDelivery
from services.task_orchestrator.entity_matching import SeenEntities
from services.task_orchestrator.event_delivery import EventDelivery
from services.task_orchestrator.execution.graph import Plan
from services.task_orchestrator.languages.native import is_variable_name
from services.task_orchestrator.model import Definition
from services.task_orchestrator.notation.faults import as_json
from services.task_orchestrator.notation.file import read_bpmn
from services.task_orchestrator.outbox import Outbox
from services.task_orchestrator.process import Process, entity_of
from services.task_orchestrator.records import (
    Act,
    ActKind,
    DefinitionRecord,
    Message,
    MessageKind,
    MessageOutcome,
    ProcessRecord,
    StartTimer,
    Step,
)
from services.task_orchestrator.settings import OrchestratorSettings
from services.task_orchestrator.start_timers import next_timer, start_timers
from services.task_orchestrator.store import EndedProcess, EndedTask, Store

log = get_logger(__name__)

MAX_STEP_CHANGES = 200
MAX_ALLOCATION_ROUNDS = 20
"""Rounds of the search for performers in one step; the next round is in the next step."""
DELETE_DELIVERED_AFTER_S = 0.1
DELETE_EXPIRED_EVERY_S = 3600.0
MAX_DELETED_PROCESSES = 100
RETRY_TICK_AFTER_S = 60.0
"""Pause before the timers of a process are processed again that could not be."""
MAX_DELETED_ENTITIES = 50
"""Entities deleted in one request, so that the broker serves other requests in between."""

STEP_DURATION = Histogram(
    "handover_orchestrator_step_duration_seconds",
    "Time to apply a step and to write it to the database",
    buckets=(0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 2),
)
RECEIVED = Counter(
    "handover_orchestrator_task_changes_total", "Changes of Tasks that were received, by result", ["result"]
)

T = TypeVar("T")
Clock = Callable[[], datetime]


@dataclass(frozen=True, slots=True)
class _PendingChange:
    """A change to apply in a step; `done` gets its result once it is in the database."""

    act: Callable[[Step], Any]
    done: asyncio.Future[Any]
    process: str | None = None
    """A process that must be loaded for it, even if it is over."""


def utc_now() -> datetime:
    """Return the present time."""
    return datetime.now(UTC)


class Orchestrator:
    """All processes of this factory; an asynchronous context manager while it changes."""

    def __init__(
        self, settings: OrchestratorSettings, broker: BrokerClient, *, clock: Clock = utc_now
    ) -> None:
        self.settings = settings
        self.broker = broker
        self.clock = clock
        self.store = Store(connect(settings.database("orchestrator")))
        self.registry = DefinitionRegistry(settings)
        self.outbox = Outbox(settings, broker, self._on_rejected)
        self._changes: asyncio.Queue[_PendingChange] = asyncio.Queue()
        self._next_seq = 1
        self._start_timers: dict[str, tuple[StartTimer, ...]] = {}
        self._disk = ThreadPoolExecutor(1, "orchestrator-disk")
        self.allocator = Allocator(settings)
        self.active_processes = ActiveProcesses(
            settings, self.registry, self.store, self.on_disk, self.allocator
        )
        self.events = EventDelivery(
            self.active_processes.processes, self._start_by_event, settings.message_ttl_s
        )
        self.entities = EntityDelivery(
            settings, self.active_processes.processes, self.events, self._start_by_event
        )
        self.active_processes.on_loaded = self.events.add_process
        self._tasks = BackgroundTasks("orchestrator")
        self.due_changed = asyncio.Event()
        self.on_unowned: Callable[[], None] = lambda: None
        """Called when the broker shows an unfinished Task that no running process waits for."""
        self.on_entity_waits: Callable[[], None] = lambda: None
        """Called when there may be new filters of entities, or new waits for a condition about them."""

    async def __aenter__(self) -> Self:
        await self.on_disk(self.store.migrate)
        self.registry.add(await self.on_disk(self.store.definitions))
        table: MappingTable | None = await self.on_disk(self.store.mapping)
        if table is not None:
            self.allocator.mapping = table
        for record in self.registry.latest():
            await self.registry.prepare(record)
            with suppress(HandoverError):  # such a version cannot be started
                self._add_events(self.registry.plan_of(record).definition)
        await self.active_processes.load_unfinished()
        self._start_timers = await self.on_disk(self.store.start_timers)
        self.events.stored = {each.id: each for each in await self.on_disk(self.store.stored_messages)}
        self.entities.seen = SeenEntities(await self.on_disk(self.store.entities_seen))
        metrics.register_open_tasks(self.active_processes.open_tasks, self.clock)
        pending = await self.on_disk(self.store.outbox)
        self._next_seq = max((message.seq for message in pending), default=0) + 1
        await self._tasks.__aenter__()
        for task in (self._write_steps, self._delete_delivered, self._delete_expired):
            self._tasks.start(task)
        await self.outbox.__aenter__()
        self.outbox.send(pending)
        log.info("orchestrator started", processes=len(self.active_processes.processes), pending=len(pending))
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()
        await self.outbox.__aexit__()
        await self.on_disk(self.store.close)
        self._disk.shutdown()

    async def on_disk(self, action: Callable[..., T], *arguments: Any) -> T:
        """Run a blocking `action` of the store in its thread."""
        return await asyncio.get_running_loop().run_in_executor(self._disk, action, *arguments)

    # Requests of people

    async def deploy(self, xml: bytes, *, only_if_never_seen: bool = False) -> Deployed:
        """Deploy the processes of a BPMN file; raise `BadBpmn` if one cannot be executed.

        A process whose file equals its latest version, or with `only_if_never_seen` any version, stays as it
        is.
        """
        file = await asyncio.to_thread(read_bpmn, xml)

        def act(step: Step) -> Deployed:
            found = []
            for definition in file.definitions:
                record, created = self.registry.next_version(
                    definition, step.definitions, self.clock(), only_if_never_seen=only_if_never_seen
                )
                if created:
                    self.registry.keep(Plan(definition, record.version))
                    step.definitions.append(record)
                    step.start_timers[record.name] = start_timers(definition, self.clock())
                    entities = self.registry.entities(record)
                    step.enqueue(f"definition {record.name}", MessageKind.UPSERT, entities[0]["id"], entities)
                found.append(Deployment(record.name, record.version, created))
            return Deployed(tuple(found), file.warnings)

        return await self._do(act)

    async def check_deployment(self, xml: bytes) -> dict[str, Any]:
        """Return the result that a deployment would have; raise `BadBpmn` if the file cannot be executed."""
        file = await asyncio.to_thread(read_bpmn, xml)
        found = []
        for definition in file.definitions:
            record, created = self.registry.next_version(
                definition, (), self.clock(), only_if_never_seen=False
            )
            found.append(
                {"name": record.name, "version": record.version, "title": record.title, "created": created}
            )
        allocation = [line for each in file.definitions for line in self.allocator.report(each)]
        warnings = as_json(file.warnings)
        return {**found[0], "definitions": found, "warnings": warnings, "allocation": allocation}

    async def set_mapping(
        self,
        entries: Sequence[MappingEntry],
        *,
        by: str | None,
        why: str | None = None,
        version: int | None = None,
    ) -> MappingTable:
        """Replace the mapping, for Tasks that are posted from now on.

        Raises `Problem` 409 if `version` is given and is not the present one.
        """

        def act(step: Step) -> MappingTable:
            present = step.mappings[-1] if step.mappings else self.allocator.mapping
            if version not in {None, present.version}:
                raise Problem(
                    409,
                    "Mapping has changed",
                    message(
                        "allocation.mapping_changed",
                        "the mapping has the version {present}, not {version}; read it and change it again",
                        present=present.version,
                        version=version,
                    ),
                )
            table = MappingTable(present.version + 1, tuple(entries), by, why, self.clock())
            step.mappings.append(table)
            return table

        return await self._do(act)

    async def start(
        self,
        definition: str,
        parameters: Mapping[str, Any],
        *,
        version: int | None = None,
        key: str | None = None,
    ) -> tuple[str, bool]:
        """Start a process; return its id, and False if `key` had started it before.

        Raises `Problem` 404 for an unknown definition, 422 for parameters that do not fit it.
        """
        if key is not None and (known := await self.on_disk(self.store.by_key, key)) is not None:
            return known.id, False
        check_variables(parameters)
        with suppress(Problem):  # a process that `key` started meanwhile is returned, whatever its definition
            await self.registry.prepare(self.registry.record(definition, version))

        def act(step: Step) -> tuple[str, bool]:
            earlier = self._started_with(key)
            if earlier is not None:
                return earlier.record.id, False
            deployed = self.registry.record(definition, version)
            variables = self.registry.plan_of(deployed).definition.arguments(parameters)
            return self._start(step, deployed, variables, key=key), True

        return await self._do(act)

    def _start(
        self,
        step: Step,
        deployed: DefinitionRecord,
        variables: Mapping[str, Any],
        *,
        key: str | None = None,
        partner: str | None = None,
        at: str | None = None,
        results: Mapping[str, Any] | None = None,
    ) -> str:
        """Start a process in a step and return its id; raise `Problem` if that is impossible."""
        now = self.clock()
        record = ProcessRecord(
            id=f"{deployed.name}-{secrets.token_hex(6)}",
            definition=deployed.name,
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
            partner=partner,
        )
        plan = self.registry.plan_of(deployed)
        process = Process.start(
            self.settings,
            plan,
            record,
            step,
            now,
            library=self.registry,
            allocator=self.allocator,
            at=at,
            results=results,
        )
        self.active_processes.processes[record.id] = process
        return record.id

    def _start_by_event(
        self,
        step: Step,
        start: EventStart,
        variables: Mapping[str, Any],
        *,
        partner: str | None,
        key: str | None = None,
    ) -> str:
        deployed = self.registry.record(start.definition)
        definition = self.registry.plan_of(deployed).definition
        given = {name: value for name, value in variables.items() if name in definition.parameters}
        return self._start(
            step,
            deployed,
            definition.arguments(given),
            key=key,
            partner=partner,
            at=start.event,
            results=variables,
        )

    async def publish(
        self,
        name: str,
        *,
        key: Any = None,
        process: str | None = None,
        variables: Mapping[str, Any],
        ttl: timedelta | None = None,
    ) -> tuple[MessageOutcome, str | None]:
        """Bring a message to the process that waits for it, or start one; otherwise keep it for `ttl`.

        Returns what became of it, and the process. Raises `Problem` 409 if several processes wait for it.
        """

        def act(step: Step) -> tuple[MessageOutcome, str | None]:
            now = self.clock()
            record = self.events.record(name, key, variables, now, ttl=ttl)
            return self.events.publish(step, record, now, process=process)

        return await self._do(act)

    async def broadcast(self, name: str, variables: Mapping[str, Any]) -> list[str]:
        """Bring a signal to everyone who waits for it; return the processes that got it or were started."""
        return await self._do(lambda step: self.events.broadcast(step, name, variables, self.clock()))

    async def cancel(self, process_id: str, by: str | None = None) -> None:
        """Cancel a process; raise `Problem` 404 if there is none, 409 if it has ended."""
        await self._do_with(process_id, lambda process, step: process.cancel(by, step, self.clock()))

    async def retry(self, process_id: str, task_id: str, by: str) -> None:
        """Post a failed Task again that its process waits for.

        Raises `Problem` 404 if there is no such process or Task, 409 if it cannot be retried.
        """

        def act(process: Process, step: Step) -> None:
            token, now = process.incident_of(task_id), self.clock()
            process.mend(Act(now, ActKind.RETRY, by, task_id), token, step, now)

        await self._do_with(process_id, act)

    async def mend(
        self,
        process_id: str,
        kind: ActKind,
        token: str | None,
        *,
        by: str | None,
        why: str | None,
        to: str | None = None,
        values: Mapping[str, Any] | None = None,
    ) -> None:
        """Do what a person has decided about a token of a process, or about its variables.

        Raises `Problem` 404 if there is no such process or token, 409 if the act is impossible.
        """

        def act(process: Process, step: Step) -> None:
            now = self.clock()
            decided = Act(now, kind, by, to=to, why=why, values=dict(values) if values else None)
            process.mend(decided, token, step, now)

        await self._do_with(process_id, act)

    async def pause(self, process_id: str, kind: ActKind, *, by: str | None, why: str | None) -> None:
        """Pause or resume a process; raise `Problem` 404 if there is none, 409 if it has ended."""
        await self._do_with(process_id, lambda process, step: self._pause(process, kind, by, why, step))

    async def pause_all(
        self, kind: ActKind, *, by: str | None, why: str | None, definition: str | None = None
    ) -> list[str]:
        """Pause or resume all running processes, or those of a definition; return their ids."""

        def pausing(process: Process) -> Callable[[Step], None]:
            return lambda step: self._pause(process, kind, by, why, step)

        wanted = {
            process.record.id: pausing(process)
            for process in self.active_processes.processes.values()
            if process.run is not None and definition in (None, process.record.definition)
        }
        return list(await self._do_each(wanted))

    def _pause(self, process: Process, kind: ActKind, by: str | None, why: str | None, step: Step) -> None:
        now = self.clock()
        act = Act(now, kind, by, why=why)
        if kind is ActKind.PAUSE:
            process.pause(act, step, now)
        else:
            process.resume_work(act, step, now)

    def _started_with(self, key: str | None) -> Process | None:
        if key is None:
            return None
        begun = self.active_processes.processes.values()
        return next((process for process in begun if process.record.key == key), None)

    async def set_agents(self, agents: Agents) -> None:
        """Take the agents of the broker, and try again to find performers for waiting activities."""

        def act(_: Step) -> None:
            self.allocator.agents = agents
            self.allocator.has_changed = True

        if agents != self.allocator.agents or self.allocator.waiting():
            await self._do(act)

    # Received changes and due timers

    async def receive(self, entities: Iterable[Mapping[str, Any]]) -> int:
        """Apply Tasks as the broker has them; return how many had changed. Foreign Tasks are ignored."""
        by_process: dict[str, list[Task]] = {}
        for task in self.changed_tasks(entities):
            owner = self.active_processes.owner(task.id)
            if owner is not None:
                by_process.setdefault(owner.record.id, []).append(task)

        def applying(tasks: list[Task]) -> Callable[[Step], int]:
            return lambda step: self._apply(tasks, step)

        answers = await self._do_each({name: applying(tasks) for name, tasks in by_process.items()})
        return sum(answers.values())

    def changed_tasks(self, entities: Iterable[Mapping[str, Any]]) -> list[Task]:
        """Return the Tasks of the orchestrator among `entities` that have changed."""
        tasks = []
        for entity in self._select_changed(entities):
            try:
                task = Task.from_ngsild(entity)
            except ValueError as error:
                RECEIVED.labels("unreadable").inc()
                log.warning("task does not match the data model", task=entity.get("id"), error=str(error))
                continue
            owner = self.active_processes.owner(task.id)
            if owner is not None and owner.is_news(task):
                tasks.append(task)
            else:
                RECEIVED.labels("known").inc()
        return tasks

    def changed_ids(self, entities: Iterable[Mapping[str, Any]]) -> list[str]:
        """Return the ids of the Tasks of the orchestrator among `entities` with another status than known.

        Only `id` and `status` are looked at.
        """
        return [str(entity["id"]) for entity in self._select_changed(entities)]

    def _select_changed(self, entities: Iterable[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
        for entity in entities:
            task_id = str(entity.get("id"))
            owner = self.active_processes.owner(task_id)
            if owner is None:
                RECEIVED.labels("foreign").inc()
                if not _is_finished(entity):
                    self.on_unowned()  # an ended Task of the orchestrator may have reappeared
                continue
            known = owner.tasks.get(task_id)  # none while the step that ends it is written
            if known is None or _status(entity) == known.status.value:
                RECEIVED.labels("known").inc()
            else:
                yield entity

    async def change(self, act: Callable[[Step], T]) -> T:
        """Apply `act` in the next step and return its result once the step is in the database."""
        return await self._do(act)

    async def recover(self) -> None:
        """Load the processes again whose changes an unavailable database did not store."""
        if self.active_processes.stale:
            await self._do(lambda _: None)

    async def missing(self, task_ids: Iterable[str]) -> None:
        """Handle that the broker does not have these Tasks of the orchestrator."""

        def handling(task_id: str) -> Callable[[Step], None]:
            def act(step: Step) -> None:
                owner = self.active_processes.owner(task_id)
                if owner is not None:
                    owner.missing(task_id, step, self.clock())

            return act

        await self._do_each({task_id: handling(task_id) for task_id in task_ids})

    async def tick(self) -> None:
        """Process the timers that are due."""

        now = self.clock()

        def ticking(process: Process) -> Callable[[Step], None]:
            return lambda step: process.tick(step, now)

        def act(step: Step) -> None:
            self.events.expire(step, now)
            self._start_by_timers(step, now)

        await self._do(act)
        due = {process.record.id: process for process in self.active_processes.due(now)}
        answers = await self._do_each({name: ticking(process) for name, process in due.items()})
        for process_id in due.keys() - answers.keys():
            self.active_processes.postpone(process_id, now + timedelta(seconds=RETRY_TICK_AFTER_S))

    def next_due(self) -> datetime | None:
        """Return when the next timer is due, or a stored message expires."""
        starts = (timer.due for timers in self._start_timers.values() for timer in timers)
        moments = (self.active_processes.next_due(), self.events.next_expiry(), *starts)
        return min((moment for moment in moments if moment is not None), default=None)

    def _start_by_timers(self, step: Step, now: datetime) -> None:
        """Start the processes whose timer start events are due."""
        for definition, timers in self._start_timers.items():
            if all(timer.due > now for timer in timers):
                continue
            kept = []
            for timer in timers:
                if timer.due > now:
                    kept.append(timer)
                    continue
                try:
                    self._start_by_event(step, EventStart(definition, timer.event), {}, partner=None)
                except Problem as problem:
                    log.warning("timer starts no process", definition=definition, error=str(problem))
                following = next_timer(timer, now)
                kept += [] if following is None else [following]
            step.start_timers[definition] = tuple(kept)

    def awaited(self) -> list[str]:
        """Return the ids of the open Tasks that the broker must have.

        Tasks of a step that is not written yet are none of them.
        """
        return [
            task_id for task_id in self.active_processes.task_ids() if not self.outbox.is_pending(task_id)
        ]

    # Deletion of ended entities from the broker

    async def archive(self, ended: Iterable[EndedProcess]) -> list[str]:
        """Mark processes as archived and delete their entities from the broker; return their ids.

        One transaction marks them and puts the deletions into the outbox. A process that was retried
        meanwhile is skipped.
        """

        def act(step: Step) -> list[str]:
            now = self.clock()
            archived = []
            for each in ended:
                record = each.process
                if record.id not in self.active_processes.processes:
                    step.archived.append(replace(record, archived_at=now, revision=record.revision + 1))
                    self._enqueue_delete(step, record.id, (*each.tasks, self._urn(record.id)))
                    archived.append(record.id)
            return archived

        return await self._do(act)

    async def delete_archived(self, entities: Mapping[str, Iterable[str]]) -> None:
        """Delete entities of archived processes, by process, that have reappeared in the broker."""

        def act(step: Step) -> None:
            for process_id, ids in entities.items():
                if process_id not in self.active_processes.processes:
                    self._enqueue_delete(step, process_id, tuple(ids))

        await self._do(act)

    async def restate(self, tasks: Iterable[EndedTask], processes: Iterable[EndedProcess]) -> int:
        """Report the end of Tasks and processes again that the broker shows as unfinished.

        Archived ones are deleted instead. Returns how many messages that takes.
        """

        def act(step: Step) -> int:
            now, before = self.clock(), len(step.messages)
            for each in tasks:
                task = each.task
                if self.active_processes.owner(task.id) is not None or self.outbox.is_pending(task.id):
                    continue
                if each.archived:
                    self._enqueue_delete(step, task.process, (task.id,))
                else:
                    step.enqueue(task.process, MessageKind.APPEND, task.id, final_attributes(task))
            for ended in processes:
                record, urn = ended.process, self._urn(ended.process.id)
                if record.id in self.active_processes.processes or self.outbox.is_pending(urn):
                    continue
                if record.archived_at is not None:
                    self._enqueue_delete(step, record.id, (urn,))
                else:
                    entity = entity_of(self.settings, record, ended.tasks, now)
                    step.enqueue(record.id, MessageKind.UPSERT, urn, [entity])
            return len(step.messages) - before

        return await self._do(act)

    def _enqueue_delete(self, step: Step, process_id: str, ids: Sequence[str]) -> None:
        for start in range(0, len(ids), MAX_DELETED_ENTITIES):
            some = list(ids[start : start + MAX_DELETED_ENTITIES])
            step.enqueue(process_id, MessageKind.DELETE, self._urn(process_id), some)

    def _urn(self, process_id: str) -> str:
        return self.settings.entity_id("Process", process_id)

    def _apply(self, tasks: Iterable[Task], step: Step) -> int:
        now = self.clock()
        applied = 0
        for task in tasks:
            owner = self.active_processes.owner(task.id)
            if owner is not None and owner.receive(task, step, now):
                applied += 1
                RECEIVED.labels("applied").inc()
                log.info("task moved", task=task.id, status=task.status.value.value, process=owner.record.id)
        return applied

    async def _on_rejected(self, message: Message, reason: str) -> None:
        owner = self.active_processes.owner(message.subject)
        if message.kind is MessageKind.CREATE and owner is not None:
            await self._do(lambda step: owner.reject(message.subject, reason, step, self.clock()))

    # Writing of steps

    async def _do(self, act: Callable[[Step], T], *, process: str | None = None) -> T:
        done: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self._changes.put_nowait(_PendingChange(act, done, process))
        return await done

    async def _do_each(self, acts: Mapping[str, Callable[[Step], T]]) -> dict[str, T]:
        """Apply changes that are independent: one that fails prevents no other; return the answers.

        Raises `Problem` if all fail, as when the database is unavailable.
        """
        answers = await asyncio.gather(*(self._do(act) for act in acts.values()), return_exceptions=True)
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

    async def _do_with(self, process_id: str, act: Callable[[Process, Step], T]) -> T:
        """Change a process that may be over; raise `Problem` 404 if there is none."""
        if not await self.on_disk(self.store.processes, [process_id]):
            raise Problem(
                404,
                "No such process",
                message("process.unknown", 'there is no process "{process_id}"', process_id=process_id),
            )

        def with_it(step: Step) -> T:
            process = self.active_processes.processes.get(process_id)
            if process is None:
                reason = f"this release cannot read {process_id}; the log says why"
                raise Problem(409, "Process cannot be resumed", reason)
            return act(process, step)

        return await self._do(with_it, process=process_id)

    async def _write_steps(self) -> None:
        while True:
            changes = [await self._changes.get()]
            while len(changes) < MAX_STEP_CHANGES and not self._changes.empty():
                changes.append(self._changes.get_nowait())
            with STEP_DURATION.time():
                await self._write_batch(changes)

    async def _write_batch(self, changes: list[_PendingChange]) -> None:
        step = Step(self._next_seq)
        answers: list[tuple[_PendingChange, Any]] = []
        fetched = {change.process for change in changes if change.process is not None}
        try:
            await self.active_processes.refresh()
            await self.active_processes.fetch(fetched)
            for change in changes:
                try:
                    answers.append((change, change.act(step)))
                    self._allocate_waiting(step)
                    self.events.settle(step, self.clock())
                except Problem as problem:
                    _answer(change, problem)
            step.delivered = self.outbox.take_delivered()
            if step:
                await self.on_disk(self.store.write, step)
        except Exception as error:  # noqa: BLE001 - logged, and answered, by _write_individually
            self.outbox.restore_delivered(step.delivered)
            self.active_processes.mark_stale(step.touched)
            with suppress(SQLAlchemyError):  # the database is unavailable: the next step tries again
                await self.active_processes.refresh()
            self.active_processes.release(fetched)
            await self._write_individually([change for change in changes if not change.done.done()], error)
            return
        self._next_seq = step.next_seq
        self._add_definitions(step.definitions)
        for table in step.mappings:
            self.allocator.mapping = table
        self.active_processes.apply(step)
        self.events.apply(step)
        self.entities.seen.apply(step.entities_seen)
        if step.definitions or self.events.entity_index.new_conditions:
            self.on_entity_waits()
        self._start_timers |= step.start_timers
        self.active_processes.release(fetched)
        self.due_changed.set()
        self.outbox.send(step.messages)
        for change, answer in answers:
            _answer(change, answer)

    def _allocate_waiting(self, step: Step) -> None:
        """Try again to find performers for waiting activities, if agents or their Tasks have changed."""
        for _ in range(MAX_ALLOCATION_ROUNDS):
            if not self.allocator.has_changed:
                return
            self.allocator.has_changed = False
            for process_id in self.allocator.waiting():
                process = self.active_processes.processes.get(process_id)
                if process is not None:
                    process.allocate(step, self.clock())

    def _add_definitions(self, definitions: Sequence[DefinitionRecord]) -> None:
        self.registry.add(definitions)
        for record in definitions:
            self._add_events(self.registry.plan_of(record).definition)

    def _add_events(self, definition: Definition) -> None:
        self.events.add_definition(definition)
        self.entities.add_definition(definition)

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
        reason = str(error.orig if isinstance(error, DBAPIError) else error)
        log.error("step not written", error=reason, exc_info=None if expected else error)
        for change in changes:
            _answer(
                change,
                Problem(
                    503,
                    "Not written",
                    message(
                        "process.not_written",
                        "nothing was changed: {reason}; correct that and send the request again",
                        reason=reason,
                    ),
                ),
            )

    async def _delete_delivered(self) -> None:
        """Delete delivered messages from the database if no other step does so."""
        while True:
            await self.outbox.has_delivered.wait()
            await asyncio.sleep(DELETE_DELIVERED_AFTER_S)
            try:
                await self._do(lambda _: None)
            except Problem as problem:
                log.warning("delivered messages not deleted yet", error=str(problem))

    async def _delete_expired(self) -> None:
        """Delete processes from the database after `keep_days`."""
        while self.settings.keep_days:
            ended_before = self.clock() - timedelta(days=self.settings.keep_days)
            try:
                while await self.on_disk(self._delete_ended, ended_before) == MAX_DELETED_PROCESSES:
                    log.info("old processes deleted", at_least=MAX_DELETED_PROCESSES)
            except SQLAlchemyError as error:
                log.warning("old processes not deleted yet", error=str(error))
            await asyncio.sleep(DELETE_EXPIRED_EVERY_S)

    def _delete_ended(self, ended_before: datetime) -> int:
        """Delete old processes; with archiving only those whose entities were deleted from the broker."""
        archived_only = self.settings.retention_h > 0
        return self.store.delete_ended(ended_before, MAX_DELETED_PROCESSES, archived_only=archived_only)


def check_variables(variables: Mapping[str, Any]) -> None:
    """Raise `Problem` 422 for names or values that process variables cannot have."""
    for name in variables:
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
        orjson.dumps(variables)
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


def _is_finished(entity: Mapping[str, Any]) -> bool:
    return _status(entity) in FINISHED


def _status(entity: Mapping[str, Any]) -> str | None:
    status = entity.get("status")
    value = status.get("value") if isinstance(status, Mapping) else None
    return value if isinstance(value, str) else None


def _answer(change: _PendingChange, answer: Any) -> None:
    if change.done.done():
        return
    if isinstance(answer, Problem):
        change.done.set_exception(answer)
    else:
        change.done.set_result(answer)
