"""Broker entities: keeps handlers up to date with the Tasks, Processes, Alerts and Devices in the broker.

Those of other cells are left out. Changes arrive through a subscription. Since notifications may be late,
repeated or lost, the broker is also queried at start, after a broken connection, and every few seconds. This
needs standard NGSI-LD only.
"""

import asyncio
import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from fastapi import FastAPI, Request, Response

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.broker.cells import OtherCells
from handover.broker.resync import Resync
from handover.service_addresses import BROKER, WEBUI
from handover.subscriptions.notifications import REQUIRES_NOTIFICATION_KEY, NotificationReceiver
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.telemetry import get_logger
from handover_web.settings import WebuiSettings
from handover_web.sources.services import ServiceMonitor
from handover_web.sources.source import Source

log = get_logger(__name__)

QUERY_BATCH_SIZE: Final = 40
NOTIFICATION_PATH: Final = "/notifications"
REPLICA_SUBSCRIPTION_S: Final = 3600.0
YIELD_INTERVAL: Final = 50
"""Entities handled before the event loop runs other tasks."""


class EntityHandler(ABC):
    """Handles the entities of one type; the filter `active_q` selects those that may still change."""

    ngsi_type: str
    active_q: str | None = None

    @abstractmethod
    def update(self, entity: Mapping[str, Any]) -> None:
        """Handle the current state of an entity (normalized)."""

    @abstractmethod
    def active_ids(self) -> Collection[str]:
        """Return the ids of the known entities that may still change."""

    @abstractmethod
    def remove(self, entity_id: str) -> None:
        """Handle the deletion of an entity."""


class BrokerEntities(Source):
    """Calls each handler for its entities."""

    def __init__(
        self,
        settings: WebuiSettings,
        broker: BrokerClient,
        handlers: Sequence[EntityHandler],
        services: ServiceMonitor,
    ) -> None:
        self._settings = settings
        self._broker = broker
        self._handlers = {handler.ngsi_type: handler for handler in handlers}
        self._services = services
        self._receiver = NotificationReceiver(WEBUI, settings, broker)
        self._subscriptions = OwnSubscriptions(WEBUI, settings, broker)
        self._cells = OtherCells(settings, broker)
        self._is_subscribed = self._is_unreachable = False
        self._renew_s = 0.0
        self._subscription: dict[str, Any] = {}
        self._notified: set[str] = set()
        self._resync = Resync(self._reconcile_round, settings.reconcile_s)

    def mount(self, app: FastAPI) -> None:
        """Add the route for notifications."""

        @app.post(
            NOTIFICATION_PATH,
            status_code=204,
            include_in_schema=False,
            dependencies=[REQUIRES_NOTIFICATION_KEY],
        )
        async def notify(request: Request) -> Response:
            received = await self._receiver.receive(request)  # display only: no action depends on it
            for number, entity in enumerate(received, 1):
                self._notified.add(str(entity.get("id")))
                self._update(entity)
                self._services.record_message(BROKER, _summary(entity))
                if number % YIELD_INTERVAL == 0:
                    await asyncio.sleep(0)
            return Response(status_code=204)

    def require_key(self) -> None:
        """Raise `UsageError` if the key that authenticates notifications cannot be stored."""
        self._receiver.require_key()

    def query_now(self) -> None:
        """Query the broker now."""
        self._resync.request()

    async def run(self) -> None:
        """Subscribe, and query the broker periodically."""
        await self._resync.run()

    async def _reconcile_round(self) -> bool:
        try:
            await self._reconcile()
        except BrokerError as error:
            if self._is_subscribed or not self._is_unreachable:
                log.warning("entity query failed", error=str(error))
            self._is_subscribed, self._is_unreachable = False, True
            self._services.check_now()
            return False
        return True

    async def _reconcile(self) -> None:
        if not self._is_subscribed or time.monotonic() >= self._renew_s:
            self._subscription = self._new_subscription()
            await self._subscriptions.keep(self._subscription)
            self._is_subscribed, self._is_unreachable = True, False
            self._renew_s = time.monotonic() + REPLICA_SUBSCRIPTION_S / 2
            self._services.check_now()
        else:
            await self._subscriptions.keep(self._subscription)
        await self._cells.read()
        for handler in self._handlers.values():
            try:
                await self._query(handler)
            except BrokerUnavailable:
                raise
            except BrokerError as error:  # one rejected query must not hide the others
                log.warning("entity query rejected", entity_type=handler.ngsi_type, error=str(error))

    async def _query(self, handler: EntityHandler) -> None:
        self._notified.clear()
        for entity_id in [active_id for active_id in handler.active_ids() if self._cells.has(active_id)]:
            handler.remove(entity_id)
        before = set(handler.active_ids())
        entities = await self._broker.query(type=handler.ngsi_type, q=handler.active_q)
        await self._update_all(entities)
        missing = sorted(before.difference(str(entity["id"]) for entity in entities))
        for start in range(0, len(missing), QUERY_BATCH_SIZE):
            ids = missing[start : start + QUERY_BATCH_SIZE]
            changed = await self._broker.query(type=handler.ngsi_type, id=ids)
            await self._update_all(changed)
            for lost in set(ids).difference(str(entity["id"]) for entity in changed):
                if lost not in self._notified:
                    handler.remove(lost)

    async def _update_all(self, entities: Sequence[Mapping[str, Any]]) -> None:
        """Handle query results, except entities that were notified in the meantime."""
        for number, entity in enumerate(entities, 1):
            if str(entity.get("id")) not in self._notified:
                self._update(entity)
            if number % YIELD_INTERVAL == 0:
                await asyncio.sleep(0)

    def _update(self, entity: Mapping[str, Any]) -> None:
        handler = self._handlers.get(_type_of(entity))
        if handler is None or self._cells.has(entity.get("id")):
            return
        try:
            handler.update(entity)
        except ValueError as error:
            log.warning("invalid entity", entity=entity.get("id"), error=str(error))

    def _new_subscription(self) -> dict[str, Any]:
        """Return the subscription; that of a replica expires, since its name may not return."""
        instance = self._settings.instance
        expiry = datetime.now(UTC) + timedelta(seconds=REPLICA_SUBSCRIPTION_S)
        return {
            "id": self._settings.entity_id("Subscription", f"webui-{instance}" if instance else "webui"),
            **({"expiresAt": expiry.strftime("%Y-%m-%dT%H:%M:%SZ")} if instance else {}),
            "type": "Subscription",
            "description": "Entities shown by the web UI",
            "entities": [{"type": name} for name in self._handlers],
            "notification": {
                "format": "normalized",
                "endpoint": self._receiver.endpoint(f"{self._settings.webui}{NOTIFICATION_PATH}"),
            },
        }


def _type_of(entity: Mapping[str, Any]) -> str:
    types = entity.get("type")
    return str(types[0] if isinstance(types, list) and types else types)


def _summary(entity: Mapping[str, Any]) -> str:
    name = str(entity.get("id", "")).rsplit(":", 1)[-1]
    for attribute_name in ("status", "deviceState", "severity"):
        attribute = entity.get(attribute_name)
        if isinstance(attribute, Mapping) and "value" in attribute:
            return f"{_type_of(entity)} {name}: {attribute['value']}"
    return f"{_type_of(entity)} {name}"
