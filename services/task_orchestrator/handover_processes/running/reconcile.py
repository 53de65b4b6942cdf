"""Reconciliation of the Tasks with the broker, and the clock of timers and deadlines.

Notifications are hints. So the broker is queried for the open Tasks at start, after a lost connection, and
every `reconcile_s`. Many open Tasks are only counted by the broker, and compared if their number is
not the expected one, or at the latest every `MAX_UNCOMPARED_S`. So the end of a Task whose notification was
lost is found within `reconcile_s`, any other change within `MAX_UNCOMPARED_S`. A broker that does not count
is asked for all of them every `reconcile_s`.
"""

import asyncio
from typing import Any

from fastapi import Request

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.broker.cells import OtherCells
from handover.broker.resync import Resync
from handover.errors import HandoverError, Problem
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.retry import MAX_DELAY_S, Backoff
from handover.subscriptions.notifications import NotificationReceiver
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.tasks.task_life import UNFINISHED_QUERY
from handover.telemetry import get_logger
from handover_processes.allocation.agents import TYPES, WATCHED, read_agents
from handover_processes.definitions.own_definitions import write_definitions
from handover_processes.running.orchestrator import Orchestrator
from handover_processes.steps.unfinished_count import UnfinishedCount

log = get_logger(__name__)

MAX_QUERIED_TASKS = 40
MAX_READ_TASKS = 400
"""Up to this number, every open Task is read; beyond it, only those whose listed status has changed."""
MAX_UNCOMPARED_S = 60.0
"""The time between two comparisons of many Tasks while their number is the expected one."""
MAX_TIMER_WAIT_S = 60.0
"""The system clock may be changed, so a longer wait is not exact."""


class Reconciler:
    """Keeps the orchestrator consistent with the broker; an asynchronous context manager."""

    def __init__(self, orchestrator: Orchestrator, broker: BrokerClient) -> None:
        self._orchestrator = orchestrator
        self._broker = broker
        self._settings = orchestrator.settings
        self._receiver = NotificationReceiver("task-orchestrator", self._settings, broker)
        self._subscriptions = OwnSubscriptions("task-orchestrator", self._settings, broker)
        self._resync = Resync(self._try_reconcile, self._settings.reconcile_s)
        self._agents_resync = Resync(self._try_read_agents, self._settings.reconcile_s)
        self._cells = OtherCells(self._settings, broker)
        self._is_subscribed = self._registered = self._was_unavailable = False
        self._gone: set[str] = set()
        """Tasks that were missing at the last comparison: a started one stays so until somebody decides."""
        self._definitions_missing = asyncio.Event()
        self._unfinished = UnfinishedCount(broker, "Task", MAX_UNCOMPARED_S)
        self._tasks = BackgroundTasks("reconciler")

    async def __aenter__(self) -> "Reconciler":
        self._receiver.require_key()
        await self._tasks.__aenter__()
        self._tasks.start(self._resync.run)
        self._tasks.start(self._agents_resync.run)
        self._tasks.start(self._run_timers)
        self._tasks.start(self._write_other_definitions)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()

    async def probe(self) -> None:
        """Raise `Problem` 503 while the subscription to Tasks is missing."""
        if not self._is_subscribed:
            await self._orchestrator.cell.require()
            raise Problem(503, "Not subscribed", "the broker has not accepted the subscription yet")

    async def reconcile(self) -> None:
        """Query the broker once for the open Tasks and apply their state."""
        await self._orchestrator.writer.recover()
        await self._orchestrator.cell.require()
        await self._subscriptions.keep(self._subscription())
        await self._subscriptions.keep(self._agents_subscription())
        self._is_subscribed = True
        if not self._registered:
            await self._register()
        awaited = self._orchestrator.broker_changes.awaited()
        if len(awaited) > MAX_READ_TASKS:
            if await self._unfinished.is_as_expected(len(awaited)):
                return
            awaited = await self._select_changed(awaited)
        for start in range(0, len(awaited), MAX_QUERIED_TASKS):
            ids = awaited[start : start + MAX_QUERIED_TASKS]
            entities = await self._broker.query(type="Task", id=ids)
            await self._orchestrator.broker_changes.receive(entities)
            gone = set(ids).difference(str(entity.get("id")) for entity in entities)
            if gone - self._gone:
                log.warning("tasks missing in the broker", tasks=sorted(gone - self._gone))
                self._registered = False
            self._gone = self._gone.difference(ids) | gone
            if gone:
                await self._orchestrator.broker_changes.missing(gone)

    async def _select_changed(self, awaited: list[str]) -> list[str]:
        """Return those of the Tasks `awaited` that the broker does not list, or lists with another status."""
        unfinished = await self._broker.query(type="Task", q=UNFINISHED_QUERY, attrs="status")
        unchanged = {str(entity["id"]) for entity in unfinished}
        self._unfinished.note(len(unchanged.difference(awaited)))
        unchanged.difference_update(self._orchestrator.broker_changes.changed_ids(unfinished))
        return [task_id for task_id in awaited if task_id not in unchanged]

    async def receive_notification(self, request: Request) -> None:
        """Read the changed Tasks of a notification from the broker and apply them.

        Raises `Problem` if the notification is refused, or if the changes cannot be stored.
        """
        received = await self._receiver.receive(request)
        tasks = [entity for entity in received if entity.get("type") not in TYPES]
        if len(tasks) < len(received):
            self._agents_resync.request()
        changed = self._orchestrator.broker_changes.changed_ids(tasks)
        if not changed:  # a poll may have been faster; the answer says that the change is stored
            await self._orchestrator.broker_changes.wait_until_written()
            return
        try:
            entities = await self._receiver.read("Task", changed)
        except BrokerError as error:
            log.warning("changed tasks not read", error=str(error))
            self._unfinished.forget()
            self._resync.request()
            return
        await self._orchestrator.broker_changes.receive(entities)

    async def _register(self) -> None:
        """Create the definitions in the broker, which may have lost them.

        Those of running processes are written before their Tasks are compared, the others afterwards.
        """
        await self._write_definitions(are_running=True)
        self._registered = True
        self._definitions_missing.set()

    async def _write_other_definitions(self) -> None:
        backoff = Backoff()
        while True:
            await self._definitions_missing.wait()
            self._definitions_missing.clear()
            try:
                await self._write_definitions(are_running=False)
                backoff.reset()
            except BrokerError as error:
                log.warning("definitions not written to the broker", error=str(error))
                await asyncio.sleep(backoff.next_delay_s())
                self._definitions_missing.set()

    async def _write_definitions(self, *, are_running: bool) -> None:
        state = self._orchestrator.state
        registry = state.registry
        running = {process.record.definition for process in state.active_processes.processes.values()}
        for record in registry.latest():
            if (record.name in running) is not are_running:
                continue
            try:
                await registry.prepare(record)
                await write_definitions(self._broker, registry.entities(record))
            except BrokerUnavailable:
                raise
            except HandoverError as error:
                log.warning("definition not written to the broker", definition=record.name, error=str(error))

    async def _try_reconcile(self) -> bool:
        try:
            await self.reconcile()
        except BrokerError as error:
            log.warning("tasks not reconciled", error=str(error))
            self._was_unavailable, self._registered, self._is_subscribed = True, False, False
            self._unfinished.forget()
            return False
        except Problem as problem:
            log.warning("state of tasks not stored", error=str(problem))
            self._unfinished.forget()
            return False
        if self._was_unavailable:
            self._orchestrator.outbox.retry_now()
            self._was_unavailable = False
        return True

    def request_agents(self) -> None:
        """Read the agents without delay: what they depend on has changed."""
        self._agents_resync.request()

    async def read_agents(self) -> None:
        """Read the Devices and Persons of the broker, who perform Tasks, without those of other cells."""
        await self._cells.read()
        copies = [entity for type_ in TYPES for entity in await self._broker.query(type=type_)]
        entities = [entity for entity in copies if not self._cells.has(entity.get("id"))]
        state = self._orchestrator.state
        needs_acceptance = self._settings.resources_need_acceptance
        effective = state.offers.effective(entities, needs_acceptance=needs_acceptance)
        await self._orchestrator.broker_changes.set_agents(read_agents(effective))

    async def _try_read_agents(self) -> bool:
        try:
            await self.read_agents()
        except BrokerError as error:
            log.warning("agents not read", error=str(error))
            return False
        except Problem as problem:
            log.warning("performers of waiting activities not stored", error=str(problem))
            return False
        return True

    async def _run_timers(self) -> None:
        orchestrator = self._orchestrator
        while True:
            orchestrator.state.due_changed.clear()
            due = orchestrator.timers.next_due()
            wait_s: float | None = None
            if due is not None:
                wait_s = min(max((due - orchestrator.clock()).total_seconds(), 0.0), MAX_TIMER_WAIT_S)
            try:
                async with asyncio.timeout(wait_s):
                    await orchestrator.state.due_changed.wait()
            except TimeoutError:
                await self._tick()

    async def _tick(self) -> None:
        try:
            await self._orchestrator.timers.tick()
        except Problem as problem:
            log.warning("due timers not processed yet", error=str(problem))
            await asyncio.sleep(MAX_DELAY_S)

    def _agents_subscription(self) -> dict[str, Any]:
        return {
            **self._subscription(),
            "id": self._settings.entity_id("Subscription", "task-orchestrator-agents"),
            "description": "agents for the orchestrator",
            "entities": self._cells.selectors(*TYPES),
            "watchedAttributes": list(WATCHED),
        }

    def _subscription(self) -> dict[str, Any]:
        return {
            "id": self._settings.entity_id("Subscription", "task-orchestrator"),
            "type": "Subscription",
            "description": "Tasks for the orchestrator",
            "entities": self._cells.selectors("Task"),
            "watchedAttributes": ["status"],
            "notification": {
                "format": "normalized",
                "endpoint": self._receiver.endpoint(f"{self._settings.orchestrator}/notifications"),
            },
        }
