"""The subscriptions of a service: created, checked at each reconciliation, and restored.

Notifications are hints, so a lost subscription loses nothing; a changed one sends the notifications, and the
key of the service, elsewhere. With accounts the broker lets a service alone change what it has created. An
admin may delete it, and without accounts everybody may change it. So a service compares its subscription with
the state after its own last write: by `modifiedAt`, which changes also with what the broker does not show, or
by the content if a broker has no such member. What others have changed is written again, with an Alert; the
Alert returns to normal once the subscription was found unchanged.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import orjson

from handover.alerts import clear_alert, raise_alert
from handover.alerts.catalogue import SUBSCRIPTION_CHANGED
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NgsiLd, NotFound
from handover.settings import Settings
from handover.subscriptions.record import SubscriptionRecord
from handover.telemetry import get_logger

log = get_logger(__name__)

_COMPARED: Final = (
    *("entities", "watchedAttributes", "q", "geoQ", "scopeQ", "csf", "isActive", "expiresAt", "throttling"),
    *("timeInterval", "notificationTrigger", "notification"),
)
_COMPARED_OF_NOTIFICATION: Final = ("endpoint", "format", "attributes", "pick", "omit", "join", "joinLevel")
"""Members that are compared if the broker has no `modifiedAt`; counts change by themselves."""


@dataclass(slots=True)
class _Written:
    """A subscription as it was written, and the mark of its state in the broker."""

    subscription: NgsiLd
    mark: str | None
    has_alert: bool = False


class OwnSubscriptions:
    """The subscriptions of the service `name` in `broker`; what it writes is added to `record`."""

    def __init__(
        self, name: str, settings: Settings, broker: BrokerClient, record: SubscriptionRecord | None = None
    ) -> None:
        self._name = name
        self._settings = settings
        self._broker = broker
        self._record = record
        self._written: dict[str, _Written] = {}

    async def keep(self, subscription: NgsiLd, listed: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        """Create a subscription, update it if the service has changed it, restore it if others have.

        `listed` are all present subscriptions by their ids, if they were read. Raises `BrokerError`.
        """
        subscription_id = str(subscription["id"])
        written = self._written.get(subscription_id)
        if written is None or written.subscription != subscription:
            await self._write(subscription, has_alert=written is not None and written.has_alert)
            return
        try:
            mark = await self._mark(subscription_id, listed)
        except BrokerUnavailable:
            del self._written[subscription_id]  # it may come back without its subscriptions
            raise
        if mark == written.mark:
            if written.has_alert:
                await clear_alert(self._broker, self._settings, key=self._key(subscription_id))
                written.has_alert = False
            return
        log.warning("subscription restored", subscription=subscription_id, was_deleted=mark is None)
        await self._write(subscription, has_alert=True)
        await self._raise_alert(subscription_id)

    async def drop(self, subscription_id: str) -> None:
        """Delete a subscription, if there is one. Raises `BrokerError`."""
        self._written.pop(subscription_id, None)
        with suppress(NotFound):
            await self._broker.delete_subscription(subscription_id)
        if self._record is not None:
            self._record.remove(subscription_id)

    async def _write(self, subscription: NgsiLd, *, has_alert: bool) -> None:
        subscription_id = str(subscription["id"])
        self._written.pop(subscription_id, None)
        if self._record is not None:
            self._record.add(subscription)
        await self._broker.ensure_subscription(subscription)
        mark = await self._mark(subscription_id)
        self._written[subscription_id] = _Written(subscription, mark, has_alert)

    async def _mark(
        self, subscription_id: str, listed: Mapping[str, Mapping[str, Any]] | None = None
    ) -> str | None:
        """Return what changes with each change of a subscription; None if it does not exist."""
        try:
            document: Mapping[str, Any] | None = (
                await self._broker.subscription(subscription_id)
                if listed is None
                else listed.get(subscription_id)
            )
        except NotFound:
            document = None
        if document is None:
            return None
        modified = document.get("modifiedAt")
        if isinstance(modified, str):
            return modified
        return orjson.dumps(_compared(document), option=orjson.OPT_SORT_KEYS).decode()

    async def _raise_alert(self, subscription_id: str) -> None:
        try:
            await raise_alert(
                self._broker,
                self._settings,
                SUBSCRIPTION_CHANGED,
                key=self._key(subscription_id),
                source=self._settings.entity_id("Device", self._name),
                description=SUBSCRIPTION_CHANGED.describe(
                    "service.subscription_changed",
                    subscription=subscription_id,
                    service=self._name,
                ),
            )
        except BrokerError as error:
            log.warning("alert not written", subscription=subscription_id, error=str(error))

    @staticmethod
    def _key(subscription_id: str) -> str:
        return f"changed {subscription_id.rpartition(':')[2]}"


def _compared(document: Mapping[str, Any]) -> dict[str, Any]:
    shown = {name: document[name] for name in _COMPARED if name in document}
    notification = shown.get("notification")
    if isinstance(notification, Mapping):
        shown["notification"] = {
            name: notification[name] for name in _COMPARED_OF_NOTIFICATION if name in notification
        }
    return shown
