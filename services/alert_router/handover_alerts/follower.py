"""The follower: learns of Alerts from the broker, of any component but those of other
cells, and takes the steps that are due.

A notification of the subscription is a hint to read all Alerts at once; they are read every few seconds
besides. Taking a step stores it with its messages in one transaction (`Store.take`). An Alert that is deleted
has returned to normal.
"""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Final

import orjson

from handover.broker import BrokerClient, BrokerError, NotFound
from handover.broker.cells import OtherCells
from handover.broker.resync import Resync
from handover.service_addresses import ALERT_ROUTER
from handover.subscriptions.notifications import NotificationReceiver
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.telemetry import get_logger
from handover_alerts import metrics
from handover_alerts.model.configuration import Route
from handover_alerts.model.occurrence import CLEARED, RAISED, AlertView, DueStep, Occurrence, due_steps
from handover_alerts.settings import RouterSettings
from handover_alerts.storage.store import Message, Store
from handover_datamodels.entities import Alert, AlertState, DataModelError, Severity
from handover_datamodels.times import iso

log = get_logger(__name__)

SUBSCRIPTION: Final = ALERT_ROUTER
STEP_INTERVAL_S: Final = 1.0
RETENTION_INTERVAL_S: Final = 3600.0
MAX_PLACES: Final = 10_000

Key = tuple[str, int]
"""The id of an Alert, and when it was issued in microseconds."""


class Follower:
    """Follows all Alerts but those of other cells; run `run`, `take_steps` and `keep_retention` as tasks."""

    def __init__(
        self,
        settings: RouterSettings,
        broker: BrokerClient,
        store: Store,
        routes: Callable[[], Mapping[str, Route]],
        on_message: Callable[[], None],
    ) -> None:
        self.receiver = NotificationReceiver(SUBSCRIPTION, settings, broker)
        self._subscriptions = OwnSubscriptions(SUBSCRIPTION, settings, broker)
        self.resync = Resync(self._reconcile, settings.reconcile_s)
        self._settings = settings
        self._broker = broker
        self._store = store
        self._routes = routes
        self._on_message = on_message
        self._occurrences: dict[Key, Occurrence] = {}
        self._taken: dict[Key, dict[str, datetime]] = {}
        self._places: dict[str, str] = {}
        self._cells = OtherCells(settings, broker)
        self._is_subscribed = False
        self._taking = asyncio.Lock()

    async def load(self) -> None:
        """Read which steps were taken by an earlier run, or by another replica."""
        self._occurrences.clear()
        self._is_subscribed = False
        self._taken = await asyncio.to_thread(self._store.steps)

    async def run(self) -> None:
        """Follow until cancelled."""
        await self.resync.run()

    async def take_steps(self) -> None:
        """Take the steps that become due as time passes, until cancelled."""
        while True:
            await self._take_due()
            await asyncio.sleep(STEP_INTERVAL_S)

    async def keep_retention(self) -> None:
        """Delete old entries of the log until cancelled."""
        while True:
            keep_s = self._settings.alert_retention_days * 86_400
            before_us = int((datetime.now(UTC).timestamp() - keep_s) * 1e6)
            await asyncio.to_thread(self._store.delete_old, before_us, list(self._occurrences))
            await asyncio.sleep(RETENTION_INTERVAL_S)

    async def _reconcile(self) -> bool:
        try:
            await self._cells.read()
            await self._subscriptions.keep(self._subscription())
            self._is_subscribed = True
            entities = await self._broker.query(type="Alert")
            alerts = {}
            for entity in entities:
                if self._cells.has(entity.get("id")):
                    continue
                view = await self._view(entity)
                if view is not None:
                    alerts[view.id, int(view.issued.timestamp() * 1e6)] = view
        except BrokerError as error:
            log.warning("alerts not read", error=str(error))
            self._is_subscribed = False
            return False
        self._merge(alerts)
        await self._take_due()
        return True

    def _merge(self, alerts: Mapping[Key, AlertView]) -> None:
        for key, view in alerts.items():
            present = self._occurrences.get(key)
            if present is not None:
                present.alert = view
            elif view.is_active or key in self._taken:
                self._occurrences[key] = Occurrence(view, self._taken.pop(key, {}))
        for key, occurrence in self._occurrences.items():
            if key not in alerts:
                occurrence.alert = _returned(occurrence.alert)
        metrics.ACTIVE.set(len(self._occurrences))

    async def _take_due(self) -> None:
        async with self._taking:
            now = datetime.now(UTC)
            for key, occurrence in list(self._occurrences.items()):
                for due in list(due_steps(occurrence, self._routes(), now)):
                    messages = [_message(occurrence.alert, due, channel, now) for channel in due.channels]
                    now_us = int(now.timestamp() * 1e6)
                    await asyncio.to_thread(self._store.take, *key, due.key, now_us, messages)
                    occurrence.taken[due.key] = now
                    self._on_message()
                if not occurrence.alert.is_active:
                    self._occurrences.pop(key, None)

    async def _view(self, entity: Mapping[str, Any]) -> AlertView | None:
        try:
            alert = Alert.from_ngsild(entity)
        except DataModelError as error:
            log.warning("alert not understood", alert=str(entity.get("id"))[:200], error=str(error)[:300])
            return None
        source = str(alert.alert_source.object)
        state = AlertState.NEW
        if alert.alert_state is not None:
            state = alert.alert_state.value
        elif alert.human_verified is not None and alert.human_verified.value:
            state = AlertState.ACKNOWLEDGED
        is_active = alert.valid_to is None and state is not AlertState.RETURNED_TO_NORMAL
        return AlertView(
            id=alert.id,
            category=str(alert.category.value),
            sub_category="" if alert.sub_category is None else str(alert.sub_category.value),
            severity=alert.severity.value if alert.severity is not None else Severity.MEDIUM,
            source=source,
            place=await self._place_of(source) if is_active else "",
            description="" if alert.description is None else str(alert.description.value),
            state=state,
            issued=alert.date_issued.value,
            is_active=is_active,
        )

    async def _place_of(self, source: str) -> str:
        """Return the Location of the source of an Alert; empty if there is none."""
        if source not in self._places:
            try:
                entity = await self._broker.retrieve(source) if source else {}
            except NotFound:
                entity = {}
            place = entity.get("isLocatedAt", {})
            if len(self._places) >= MAX_PLACES:
                self._places.clear()
            self._places[source] = str(place.get("object", "")) if isinstance(place, Mapping) else ""
        return self._places[source]

    def _subscription(self) -> dict[str, Any]:
        return {
            "id": self._settings.entity_id("Subscription", SUBSCRIPTION),
            "type": "Subscription",
            "entities": self._cells.selectors("Alert"),
            "notification": {
                "format": "normalized",
                "endpoint": self.receiver.endpoint(f"{self._settings.alert_router}/notifications"),
            },
        }


def _returned(alert: AlertView) -> AlertView:
    return replace(alert, is_active=False, state=AlertState.RETURNED_TO_NORMAL)


def _message(alert: AlertView, due: DueStep, channel: str, now: datetime) -> Message:
    route = due.key.removesuffix(f":{due.step}")
    subject, text = described(alert, due.step)
    return Message(
        alert.id,
        route,
        due.step,
        channel,
        subject,
        body_of(alert, due.step, text),
        int(now.timestamp() * 1e6),
    )


def described(alert: AlertView, step: str) -> tuple[str, str]:
    """Return the subject and the text of a message."""
    kind = alert.sub_category or alert.category
    source = alert.source.rpartition(":")[2]
    what = {RAISED: "", CLEARED: "Returned to normal: "}.get(step, "Not acknowledged: ")
    subject = f"{what}[{alert.severity.value}] {kind}: {source}"
    lines = [
        f"{what}{alert.description or kind}",
        "",
        f"Severity: {alert.severity.value}",
        f"Category: {alert.category}{f' / {alert.sub_category}' if alert.sub_category else ''}",
        f"Source: {alert.source}",
        *([f"Place: {alert.place}"] if alert.place else []),
        f"Since: {iso(alert.issued)}",
        f"Alert: {alert.id}",
    ]
    return subject, "\n".join(lines)


def body_of(alert: AlertView, step: str, text: str) -> str:
    """Return what is stored of a message: its text, and the Alert for programs."""
    document = {
        "step": step,
        "text": text,
        "id": alert.id,
        "category": alert.category,
        "subCategory": alert.sub_category,
        "severity": alert.severity.value,
        "alertSource": alert.source,
        "place": alert.place,
        "description": alert.description,
        "alertState": alert.state.value,
        "dateIssued": iso(alert.issued),
    }
    return orjson.dumps(document).decode()
