"""Archive: ended processes leave the broker after `retention_h`; their history stays in the database.

How it works:

1. A process can be archived when it ended long enough ago, all its Tasks have ended and the outbox holds
   nothing about it. How each Task ended is in the database by then, in the transaction that ended it.
2. One transaction marks the process (`archived_at`) and puts the deletion of its entities into its stream of
   the outbox. After a crash at any moment either nothing has happened, or the deletion is delivered; a second
   delivery finds nothing to delete. If a person retries a failed process, its new messages follow the
   deletion in the same stream.
3. The next processes wait until the broker has deleted these, so that it is not delayed and nothing piles up
   while it is away.
4. The database decides, not the broker. A broker that was restored from an old backup, or anybody with access
   to it, can bring ended Tasks back. They are compared with the database: what is archived is deleted again,
   anything else that has ended gets its recorded end again. Nothing is ever posted as pending again.
"""

import asyncio
from collections.abc import Mapping
from datetime import timedelta
from typing import Any

from prometheus_client import Counter
from sqlalchemy.exc import SQLAlchemyError

from handover.broker import BrokerClient, BrokerError
from handover.broker.resync import Resync
from handover.errors import Problem
from handover.runtime.background_tasks import BackgroundTasks
from handover.tasks.task_life import UNFINISHED_QUERY
from handover.telemetry import get_logger
from handover_processes.running.orchestrator import Orchestrator
from handover_processes.steps.unfinished_count import UnfinishedCount
from handover_processes.storage.store import EndedProcess, EndedTask

log = get_logger(__name__)

MAX_GROUP = 10
PAUSE_S = 0.5
"""Between two groups of processes: 20 a second at most."""
MAX_ARCHIVE_EVERY_S = 60.0
CHECK_EVERY_ROUNDS = 6
"""The unfinished Tasks of the broker are compared with the database once in so many `reconcile_s`."""
MAX_UNLISTED_S = 300.0
"""The time between two such comparisons while the broker counts as many as are expected."""
CHECK_ALL_EVERY_S = 3600.0
MIN_CHECK_PAUSE_S = 0.5

ARCHIVED = Counter("handover_orchestrator_processes_archived_total", "Processes deleted from the broker")
REAPPEARED = Counter(
    "handover_orchestrator_reappeared_total",
    "Ended Tasks and Processes that the broker showed again, by what was done",
    ["done"],
)


class Archiver:
    """Keeps the broker free of what has ended; an asynchronous context manager."""

    def __init__(self, orchestrator: Orchestrator, broker: BrokerClient) -> None:
        self._orchestrator = orchestrator
        self._broker = broker
        self._settings = orchestrator.settings
        self._retention = timedelta(hours=self._settings.retention_h)
        self._checks = Resync(self._try_check, CHECK_EVERY_ROUNDS * self._settings.reconcile_s)
        self._unfinished_tasks = UnfinishedCount(broker, "Task", MAX_UNLISTED_S)
        self._unfinished_processes = UnfinishedCount(broker, "Process", MAX_UNLISTED_S)
        self._check_all_at = 0.0
        self._tasks = BackgroundTasks("archiver")

    async def __aenter__(self) -> "Archiver":
        self._orchestrator.broker_changes.on_unowned = self._checks.request
        await self._tasks.__aenter__()
        self._tasks.start(self._checks.run)
        if self._retention:
            self._tasks.start(self._archive_forever)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()

    async def archive(self) -> int:
        """Archive some of the processes that ended long enough ago.

        Returns how many, once the broker has deleted their entities.
        """
        orchestrator = self._orchestrator
        ended_before = orchestrator.clock() - self._retention
        ended = await orchestrator.on_disk(orchestrator.store.to_archive, ended_before, MAX_GROUP)
        if not ended:
            return 0
        archived = await orchestrator.archiving.archive(ended)
        ARCHIVED.inc(len(archived))
        log.info("processes archived", processes=archived)
        urns = [self._settings.entity_id("Process", process) for process in archived]
        while any(orchestrator.outbox.is_pending(urn) for urn in urns):  # noqa: ASYNC110 - paces the deletion
            await asyncio.sleep(PAUSE_S)
        return len(archived)

    async def check_unfinished(self) -> int:
        """Report the end of what the broker shows as unfinished though it has ended; return how many were."""
        orchestrator = self._orchestrator
        ended_tasks = await self._ended_tasks()
        ended_processes = await self._ended_processes()
        if not ended_tasks and not ended_processes:
            return 0
        count = await orchestrator.archiving.restate(ended_tasks, ended_processes)
        if count:
            REAPPEARED.labels("restated").inc(count)
            log.warning(
                "the broker shows as unfinished what has ended; its recorded end is reported again",
                tasks=sorted(task.task.id for task in ended_tasks),
                processes=sorted(process.process.id for process in ended_processes),
            )
        return count

    async def _ended_tasks(self) -> list[EndedTask]:
        """Return the ended Tasks that the broker shows as unfinished."""
        orchestrator, active = self._orchestrator, self._orchestrator.state.active_processes
        if await self._unfinished_tasks.is_as_expected(len(active.task_ids())):
            return []
        shown = await self._broker.query(type="Task", q=UNFINISHED_QUERY, attrs="status")
        unowned = [task for task in (str(entity["id"]) for entity in shown) if active.owner(task) is None]
        ended: list[EndedTask] = await orchestrator.on_disk(orchestrator.store.ended_tasks, unowned)
        self._unfinished_tasks.note(len(unowned) - len(ended))
        return ended

    async def _ended_processes(self) -> list[EndedProcess]:
        """Return the ended processes that the broker shows as unfinished."""
        orchestrator, active = self._orchestrator, self._orchestrator.state.active_processes.processes
        running = sum(process.run is not None for process in active.values())
        if await self._unfinished_processes.is_as_expected(running):
            return []
        shown = await self._broker.query(type="Process", q=UNFINISHED_QUERY, attrs="status")
        unknown = [process for process in map(self._process, shown) if process not in active]
        ended: list[EndedProcess] = await orchestrator.on_disk(orchestrator.store.ended_processes, unknown)
        self._unfinished_processes.note(len(unknown) - len(ended))
        return ended

    async def check_all(self) -> int:
        """Delete entities of archived processes that the broker shows all the same; return how many."""
        orchestrator = self._orchestrator
        tasks = [str(entity["id"]) for entity in await self._broker.query(type="Task", attrs="status")]
        processes = {
            self._process(entity): str(entity["id"])
            for entity in await self._broker.query(type="Process", attrs="status")
        }
        archived = await orchestrator.on_disk(orchestrator.store.archived, tasks, list(processes))
        wrong: dict[str, list[str]] = {}
        for stored_id, process in archived.items():
            if not orchestrator.outbox.is_pending(self._settings.entity_id("Process", process)):
                wrong.setdefault(process, []).append(processes.get(stored_id, stored_id))
        count = sum(len(ids) for ids in wrong.values())
        if count:
            REAPPEARED.labels("deleted").inc(count)
            log.warning("archived entities are in the broker again and are deleted", count=count)
            some = list(wrong.items())
            for start in range(0, len(some), MAX_GROUP):
                await orchestrator.archiving.delete_archived(dict(some[start : start + MAX_GROUP]))
                await asyncio.sleep(PAUSE_S)
        return count

    def _process(self, entity: Mapping[str, Any]) -> str:
        """Return the id of the process that an entity stands for, without what makes it a URN."""
        return str(entity["id"]).removeprefix(self._settings.entity_id("Process", ""))

    async def _archive_forever(self) -> None:
        every_s = min(self._retention.total_seconds() / 4, MAX_ARCHIVE_EVERY_S)
        while True:
            count = 0
            try:
                count = await self.archive()
            except (Problem, SQLAlchemyError) as error:
                log.warning("processes could not be archived yet", error=str(error))
            await asyncio.sleep(PAUSE_S if count else max(every_s, PAUSE_S))

    async def _try_check(self) -> bool:
        clock = asyncio.get_running_loop().time
        try:
            wrong = await self.check_unfinished()
            if self._retention and (wrong or clock() >= self._check_all_at):
                await self.check_all()
                self._check_all_at = clock() + CHECK_ALL_EVERY_S
        except BrokerError as error:
            log.info("the broker cannot be compared with the database yet", error=str(error))
            self._unfinished_tasks.forget()
            self._unfinished_processes.forget()
            self._check_all_at = 0.0  # it may come back with other entities
            return False
        except (Problem, SQLAlchemyError) as error:
            log.warning("the broker could not be compared with the database", error=str(error))
            return False
        await asyncio.sleep(MIN_CHECK_PAUSE_S)  # however many notifications ask for a check
        return True
