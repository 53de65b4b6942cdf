"""Entities: Tasks, Processes, Alerts and Devices as the broker has them.

Learnt by a subscription of the screen's own, and by asking: at start, after a broken link, and every few
seconds, since notifications may be late, doubled or lost. Nothing here needs more than NGSI-LD.
"""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

from fastapi import FastAPI, Request, Response

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.notifications import NotificationReceiver
from handover.resync import Resync
from handover.telemetry import get_logger
from webui.settings import BROKER, WebuiSettings
from webui.sources.services import Services
from webui.sources.source import Source

log = get_logger(__name__)

ASKED_AT_ONCE: Final = 40
NOTIFIED_AT: Final = "/notifications"
TAKEN_AT_ONCE: Final = 50
"""Entities taken before others get a turn of the event loop."""


class Kind(ABC):
    """What is made of the entities of one type; `open_q` selects those that may yet change."""

    ngsi_type: str
    open_q: str | None = None

    @abstractmethod
    def take(self, entity: Mapping[str, Any]) -> None:
        """Take an entity (normalized) as it is now."""

    @abstractmethod
    def still_open(self) -> Collection[str]:
        """Return the ids of those known that may still change."""

    @abstractmethod
    def gone(self, entity_id: str) -> None:
        """Take note that there is no such entity any more."""


class Entities(Source):
    """Keeps each kind informed of its entities."""

    def __init__(
        self, settings: WebuiSettings, broker: BrokerClient, kinds: Sequence[Kind], services: Services
    ) -> None:
        self._settings = settings
        self._broker = broker
        self._kinds = {kind.ngsi_type: kind for kind in kinds}
        self._services = services
        self._receiver = NotificationReceiver("webui", settings, broker)
        self._subscribed = self._away = False
        self._overtaken: set[str] = set()
        self._resync = Resync(self._ask, settings.reconcile_s)

    def mount(self, app: FastAPI) -> None:
        """Add the route that the broker notifies."""

        @app.post(NOTIFIED_AT, status_code=204, include_in_schema=False)
        async def notify(request: Request) -> Response:
            received = await self._receiver.receive(request)  # shown as it is: nothing acts on it
            for number, entity in enumerate(received, 1):
                self._overtaken.add(str(entity.get("id")))
                self._take(entity)
                self._services.heard(BROKER, _in_words(entity))
                if number % TAKEN_AT_ONCE == 0:
                    await asyncio.sleep(0)
            return Response(status_code=204)

    def require_key(self) -> None:
        """Return if notifications can be told from forged ones; raise `UsageError` if no key can be kept."""
        self._receiver.require_key()

    def ask_again(self) -> None:
        """Ask the broker now."""
        self._resync.request()

    async def follow(self) -> None:
        """Subscribe, and ask again and again."""
        await self._resync.run()

    async def _ask(self) -> bool:
        try:
            await self._reconcile()
        except BrokerError as error:
            if self._subscribed or not self._away:
                log.warning("cannot ask the broker for entities", error=str(error))
            self._subscribed, self._away = False, True
            self._services.look_now()
            return False
        return True

    async def _reconcile(self) -> None:
        if not self._subscribed:
            await self._broker.ensure_subscription(self._subscription())
            self._subscribed, self._away = True, False
            self._services.look_now()
        for kind in self._kinds.values():
            try:
                await self._ask_for(kind)
            except BrokerUnavailable:
                raise
            except BrokerError as error:  # one question that this broker refuses must not hide the rest
                log.warning("the broker refuses a question", about=kind.ngsi_type, error=str(error))

    async def _ask_for(self, kind: Kind) -> None:
        self._overtaken.clear()
        before = set(kind.still_open())
        found = await self._broker.query(type=kind.ngsi_type, q=kind.open_q)
        await self._take_fresh(found)
        missing = sorted(before.difference(str(entity["id"]) for entity in found))
        for start in range(0, len(missing), ASKED_AT_ONCE):
            asked = missing[start : start + ASKED_AT_ONCE]
            changed = await self._broker.query(type=kind.ngsi_type, id=asked)
            await self._take_fresh(changed)
            for lost in set(asked).difference(str(entity["id"]) for entity in changed):
                if lost not in self._overtaken:
                    kind.gone(lost)

    async def _take_fresh(self, entities: Sequence[Mapping[str, Any]]) -> None:
        """Take what was asked for, but not what a notification has overtaken meanwhile."""
        for number, entity in enumerate(entities, 1):
            if str(entity.get("id")) not in self._overtaken:
                self._take(entity)
            if number % TAKEN_AT_ONCE == 0:
                await asyncio.sleep(0)

    def _take(self, entity: Mapping[str, Any]) -> None:
        kind = self._kinds.get(_type_of(entity))
        if kind is None:
            return
        try:
            kind.take(entity)
        except ValueError as error:
            log.warning("entity does not fit its data model", entity=entity.get("id"), error=str(error))

    def _subscription(self) -> dict[str, Any]:
        return {
            "id": self._settings.entity_id("Subscription", "webui"),
            "type": "Subscription",
            "description": "What the screen shows",
            "entities": [{"type": name} for name in self._kinds],
            "notification": {
                "format": "normalized",
                "endpoint": self._receiver.endpoint(f"{self._settings.own_url}{NOTIFIED_AT}"),
            },
        }


def _type_of(entity: Mapping[str, Any]) -> str:
    given = entity.get("type")
    return str(given[0] if isinstance(given, list) and given else given)


def _in_words(entity: Mapping[str, Any]) -> str:
    short = str(entity.get("id", "")).rsplit(":", 1)[-1]
    for name in ("status", "deviceState", "severity"):
        attribute = entity.get(name)
        if isinstance(attribute, Mapping) and "value" in attribute:
            return f"{_type_of(entity)} {short}: {attribute['value']}"
    return f"{_type_of(entity)} {short}"
