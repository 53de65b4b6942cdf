"""Floor: the processes that are under way, whose Tasks are whose, and what is due next.

It is what the database says, held in memory. What could not be written is taken anew from there.
"""

from collections.abc import Awaitable, Callable, Iterable, Iterator
from datetime import datetime
from typing import Any

from prometheus_client import Counter

from handover.errors import HandoverError
from handover.telemetry import get_logger
from services.task_orchestrator.library import Library
from services.task_orchestrator.metrics import Relay
from services.task_orchestrator.process import Process
from services.task_orchestrator.records import ProcessRecord, Step, TaskRecord
from services.task_orchestrator.settings import OrchestratorSettings
from services.task_orchestrator.store import Store

log = get_logger(__name__)

ENDED = Counter("handover_orchestrator_processes_total", "Processes that have ended", ["status"])

OnDisk = Callable[..., Awaitable[Any]]
"""Runs a blocking action of the store in the one thread that may."""


class Floor:
    """All processes on which anything can still happen."""

    def __init__(
        self, settings: OrchestratorSettings, library: Library, store: Store, on_disk: OnDisk
    ) -> None:
        self._settings = settings
        self._library = library
        self._store = store
        self._on_disk = on_disk
        self.processes: dict[str, Process] = {}
        self._owners: dict[str, str] = {}
        self._dues: dict[str, datetime] = {}
        self._stale: set[str] = set()
        self._relay = Relay()

    @property
    def stale(self) -> bool:
        """Say whether some processes are not as the database has them."""
        return bool(self._stale)

    def owner(self, task_id: str) -> Process | None:
        """Return the process that a Task which has not ended belongs to."""
        return self.processes.get(self._owners.get(task_id, ""))

    def open_tasks(self) -> Iterator[TaskRecord]:
        """Yield the Tasks that have not ended."""
        for process in self.processes.values():
            yield from process.tasks.values()

    def due(self, now: datetime) -> list[Process]:
        """Return the processes for which something is due."""
        return [self.processes[process_id] for process_id, due in self._dues.items() if due <= now]

    def next_due(self) -> datetime | None:
        """Return when something is due next."""
        return min(self._dues.values(), default=None)

    def mistrust(self, process_ids: Iterable[str]) -> None:
        """Take these processes for wrong until `refresh`: a step with them was not written."""
        self._stale.update(process_ids)

    async def fill(self) -> None:
        """Take up everything that is under way."""
        for record in await self._on_disk(self._store.unfinished):
            await self._load(record)

    async def refresh(self) -> None:
        """Take the mistrusted processes anew from the database."""
        if not self._stale:
            return
        records = await self._on_disk(self._store.processes, sorted(self._stale))
        for process_id in self._stale:
            self._forget(process_id)
        for record in records:
            await self._load(record)
        self._stale.clear()

    async def fetch(self, process_ids: Iterable[str]) -> None:
        """Take up these processes, even if they are over; `clear` puts those away again."""
        wanted = [process_id for process_id in process_ids if process_id not in self.processes]
        for record in await self._on_disk(self._store.processes, wanted) if wanted else ():
            await self._load(record, even_if_over=True)

    def clear(self, process_ids: Iterable[str]) -> None:
        """Let go of those of these processes that are over."""
        for process_id in process_ids:
            process = self.processes.get(process_id)
            if process is not None and process.over:
                self._forget(process_id)

    def settle(self, step: Step) -> None:
        """After a step: know who owns its Tasks and what is due, and let go of what is over."""
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
        self.clear(step.processes)
        self._relay.follow(step)

    async def _load(self, record: ProcessRecord, *, even_if_over: bool = False) -> None:
        tasks = await self._on_disk(self._store.tasks, record.id)
        try:
            definition = self._library.record(record.definition, record.version)
            await self._library.prepare(definition)
            plan = self._library.plan(definition)
            process = Process.resume(self._settings, plan, record, tasks)
        except HandoverError as error:
            log.critical("a process cannot be resumed", process=record.id, error=str(error))
            return
        if even_if_over or not process.over:
            self.processes[record.id] = process
            self._owners.update(dict.fromkeys(process.tasks, record.id))
            self._set_due(process)

    def _set_due(self, process: Process) -> None:
        self._dues.pop(process.record.id, None)
        for timer in process.timers()[:1]:
            self._dues[process.record.id] = timer.due

    def _forget(self, process_id: str) -> None:
        self._dues.pop(process_id, None)
        process = self.processes.pop(process_id, None)
        for task_id in process.tasks if process is not None else ():
            self._owners.pop(task_id, None)
