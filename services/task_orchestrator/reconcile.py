"""Reconcile: notifications are hints, so the broker is asked how our Tasks stand, again and again.

At start, after a broken link, and every few seconds with jitter. The clock that makes timers and deadlines
happen is kept here too.
"""

import asyncio
from typing import Any

from fastapi import Request

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.errors import HandoverError, Problem
from handover.notifications import NotificationReceiver
from handover.resync import Resync
from handover.retry import MAX_DELAY_S
from handover.telemetry import get_logger
from services.task_orchestrator.orchestrator import Orchestrator

log = get_logger(__name__)

ASKED_AT_ONCE = 40
LOOK_AGAIN_S = 60.0
"""The clock of the machine may be set: never trust a longer wait."""


class Reconciler:
    """Keeps what the orchestrator knows and what the broker holds the same."""

    def __init__(self, orchestrator: Orchestrator, broker: BrokerClient) -> None:
        self._orchestrator = orchestrator
        self._broker = broker
        self._settings = orchestrator.settings
        self._receiver = NotificationReceiver("task-orchestrator", self._settings, broker)
        self._resync = Resync(self._ask_well, self._settings.reconcile_s)
        self._introduced = self._away = False
        self._chores: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> "Reconciler":
        self._receiver.require_key()
        self._chores = [asyncio.create_task(self._resync.run()), asyncio.create_task(self._keep_time())]
        return self

    async def __aexit__(self, *_: object) -> None:
        for chore in self._chores:
            chore.cancel()
        await asyncio.gather(*self._chores, return_exceptions=True)

    async def probe(self) -> None:
        """Return when news of Tasks would reach us; raise if the subscription is not in place."""
        if not self._introduced:
            raise Problem(503, "Not subscribed", "the broker has not taken the subscription yet")

    async def ask(self) -> None:
        """Ask the broker once how our unfinished Tasks stand, and take in what it says."""
        await self._orchestrator.recover()
        if not self._introduced:
            await self._introduce()
        awaited = self._orchestrator.awaited()
        for start in range(0, len(awaited), ASKED_AT_ONCE):
            asked = awaited[start : start + ASKED_AT_ONCE]
            entities = await self._broker.query(type="Task", id=asked)
            await self._orchestrator.hear(entities)
            gone = set(asked).difference(str(entity.get("id")) for entity in entities)
            if gone:
                log.warning("the broker does not have tasks of ours", tasks=sorted(gone))
                self._introduced = False
                await self._orchestrator.missing(gone)

    async def take_notification(self, request: Request) -> None:
        """Read the Tasks that a notification says have changed from the broker, and take in what that says.

        Raises `Problem` if the notification is refused, or if what the broker says cannot be written.
        """
        news = self._orchestrator.news_in(await self._receiver.receive(request))
        try:
            entities = await self._receiver.read("Task", [task.id for task in news])
        except BrokerError as error:
            log.warning("cannot read tasks that have changed", error=str(error))
            self._resync.request()
            return
        await self._orchestrator.hear(entities)

    async def _introduce(self) -> None:
        """Make sure that the broker notifies us and knows our definitions: it may have lost them."""
        await self._broker.ensure_subscription(self._subscription())
        library = self._orchestrator.library
        for record in library.latest():
            try:
                await self._broker.upsert(library.entities(record))
            except BrokerUnavailable:
                raise
            except HandoverError as error:
                log.warning("a definition cannot be told", definition=record.name, error=str(error))
        self._introduced = True

    async def _ask_well(self) -> bool:
        try:
            await self.ask()
        except BrokerError as error:
            log.warning("cannot ask the broker", error=str(error))
            self._away, self._introduced = True, False
            return False
        except Problem as problem:
            log.warning("what the broker said could not be taken in", error=str(problem))
            return False
        if self._away:
            self._orchestrator.outbox.broker_is_back()
            self._away = False
        return True

    async def _keep_time(self) -> None:
        orchestrator = self._orchestrator
        while True:
            orchestrator.due_changed.clear()
            due = orchestrator.next_due()
            wait_s = None if due is None else (due - orchestrator.clock()).total_seconds()
            try:
                async with asyncio.timeout(None if wait_s is None else min(max(wait_s, 0.0), LOOK_AGAIN_S)):
                    await orchestrator.due_changed.wait()
            except TimeoutError:
                await self._tick()

    async def _tick(self) -> None:
        try:
            await self._orchestrator.tick()
        except Problem as problem:
            log.warning("what is due could not be done yet", error=str(problem))
            await asyncio.sleep(MAX_DELAY_S)

    def _subscription(self) -> dict[str, Any]:
        return {
            "id": self._settings.entity_id("Subscription", "task-orchestrator"),
            "type": "Subscription",
            "description": "Tasks for the orchestrator",
            "entities": [{"type": "Task"}],
            "watchedAttributes": ["status"],
            "notification": {
                "format": "normalized",
                "endpoint": self._receiver.endpoint(f"{self._settings.own_url}/notifications"),
            },
        }
