"""Active processes: the processes in memory, the owners of their Tasks, and the next due timers.

The database is authoritative. After a failed transaction the affected processes are loaded from it again.
"""

from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from datetime import datetime
from typing import Any

from prometheus_client import Counter

from handover.errors import HandoverError
from handover.telemetry import get_logger
from handover_bpmn.timing.due_queue import DueQueue
from handover_processes.allocation.allocator import Allocator
from handover_processes.definitions.definition_registry import DefinitionRegistry
from handover_processes.metrics import HandoverTimer
from handover_processes.process.process import Process
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskRecord
from handover_processes.settings import OrchestratorSettings
from handover_processes.storage.store import Store

log = get_logger(__name__)

ENDED = Counter("handover_orchestrator_processes_total", "Processes that have ended", ["status"])

OnDisk = Callable[..., Awaitable[Any]]
"""Runs a blocking action of the store in the one thread that may."""


class ActiveProcesses:
    """All processes that have not ended, or that have Tasks that have not ended."""

    def __init__(
        self,
        settings: OrchestratorSettings,
        registry: DefinitionRegistry,
        store: Store,
        on_disk: OnDisk,
        allocator: Allocator,
    ) -> None:
        self._allocator = allocator
        self._settings = settings
        self._registry = registry
        self._store = store
        self._on_disk = on_disk
        self.processes: dict[str, Process] = {}
        self._owners: dict[str, str] = {}
        self._by_key: dict[str, str] = {}
        self._dues = DueQueue[str]()
        self._stale: set[str] = set()
        self._handover_timer = HandoverTimer()
        self.on_loaded: Callable[[Process], None] = lambda _: None
        """Called with each process that was loaded from the database."""

    @property
    def stale(self) -> bool:
        """Return whether some processes differ from the database."""
        return bool(self._stale)

    def owner(self, task_id: str) -> Process | None:
        """Return the process of a Task that has not ended."""
        return self.processes.get(self._owners.get(task_id, ""))

    def task_ids(self) -> tuple[str, ...]:
        """Return the ids of the Tasks that have not ended, as the database has them."""
        return tuple(self._owners)

    def open_tasks(self) -> Iterator[TaskRecord]:
        """Yield the Tasks that have not ended."""
        for process in self.processes.values():
            yield from process.tasks.values()

    def due(self, now: datetime) -> list[Process]:
        """Return the processes with a timer that is due."""
        return [self.processes[process_id] for process_id in self._dues.due(now)]

    def postpone(self, process_id: str, until: datetime) -> None:
        """Regard the timers of a process as due at `until`, since they could not be processed."""
        if process_id in self._dues:
            self._dues.set(process_id, until)

    def next_due(self) -> datetime | None:
        """Return when the next timer is due."""
        return self._dues.next_due()

    def add(self, process: Process) -> None:
        """Add a process that was started or loaded."""
        self.processes[process.record.id] = process
        if process.record.key is not None:
            self._by_key[process.record.key] = process.record.id

    def with_key(self, key: str) -> Process | None:
        """Return the process that was started with a key."""
        return self.processes.get(self._by_key.get(key, ""))

    def mark_stale(self, process_ids: Iterable[str]) -> None:
        """Mark processes to be loaded again by `refresh`: a step with them was not written."""
        self._stale.update(process_ids)

    async def load_unfinished(self) -> None:
        """Load all unfinished processes."""
        records = await self._on_disk(self._store.unfinished)
        tasks = await self._on_disk(self._store.unfinished_tasks)
        ids = await self._on_disk(self._store.task_ids, [record.id for record in records])
        for record in records:
            await self._resume(record, tasks.get(record.id, ()), ids[record.id])

    async def refresh(self) -> None:
        """Load the stale processes from the database."""
        if not self._stale:
            return
        records = await self._on_disk(self._store.processes, sorted(self._stale))
        for process_id in self._stale:
            self._remove(process_id)
        for record in records:
            await self._load(record)
        self._stale.clear()

    async def fetch(self, process_ids: Iterable[str]) -> None:
        """Load these processes, even if they are over; `release` removes those again."""
        wanted = [process_id for process_id in process_ids if process_id not in self.processes]
        for record in await self._on_disk(self._store.processes, wanted) if wanted else ():
            await self._load(record, include_over=True)

    def release(self, process_ids: Iterable[str]) -> None:
        """Remove those of these processes that are over."""
        for process_id in process_ids:
            process = self.processes.get(process_id)
            if process is not None and process.over:
                self._remove(process_id)

    def apply(self, step: Step) -> None:
        """Update owners and timers after a step was written, and remove processes that are over."""
        for task in step.tasks.values():
            self._owners[task.id] = task.process
            if task.finished:
                del self._owners[task.id]
        for record in step.processes.values():
            process = self.processes[record.id]
            if record.id in step.ended:
                ENDED.labels(record.status.value).inc()
                log.info("process ended", process=record.id, status=record.status.value, reason=record.reason)
            self._set_due(process)
        self.release(step.processes)
        self._handover_timer.observe(step)

    async def _load(self, record: ProcessRecord, *, include_over: bool = False) -> None:
        tasks = await self._on_disk(self._store.tasks, record.id)
        await self._resume(record, tasks, None, include_over=include_over)

    async def _resume(
        self,
        record: ProcessRecord,
        tasks: Sequence[TaskRecord],
        all_tasks: Sequence[str] | None,
        *,
        include_over: bool = False,
    ) -> None:
        try:
            definition = self._registry.record(record.definition, record.version)
            await self._registry.prepare(definition)
            plan = self._registry.plan_of(definition)
            process = Process.resume(
                self._settings,
                plan,
                record,
                tasks,
                self._registry,
                allocator=self._allocator,
                all_tasks=all_tasks,
            )
        except HandoverError as error:
            log.critical("process not resumed", process=record.id, error=str(error))
            return
        except Exception:  # one damaged process must not stop the others
            log.exception("process not resumed", process=record.id)
            return
        if include_over or not process.over:
            self.add(process)
            self._owners.update(dict.fromkeys(process.tasks, record.id))
            self._set_due(process)
            self.on_loaded(process)

    def _set_due(self, process: Process) -> None:
        self._dues.set(process.record.id, process.next_due())

    def _remove(self, process_id: str) -> None:
        self._dues.set(process_id, None)
        process = self.processes.pop(process_id, None)
        if process is not None:
            self._by_key.pop(process.record.key or "", None)
            process.release()
        for task_id in process.tasks if process is not None else ():
            self._owners.pop(task_id, None)
