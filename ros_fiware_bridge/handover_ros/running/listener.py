"""Listeners: receive entities of the broker by subscription and by polling, and pass on changes.

Each subscription has a deterministic id, so creating it twice has no effect; the bridge deletes it on an
orderly shutdown. The broker is also polled every few seconds, since notifications may be lost.
"""

import re
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any

from fastapi import Request

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.broker.resync import Resync
from handover.errors import Problem
from handover.service_addresses import ROS_BRIDGE
from handover.settings import Settings
from handover.subscriptions.notifications import NotificationReceiver, ids_of
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.telemetry import get_logger
from handover_ros.mapping.model import EntitySelector
from handover_ros.rules.change_tracker import ChangeTracker, scope_of
from handover_ros.rules.message_builder import Scope

log = get_logger(__name__)

Effect = Callable[[Mapping[str, Any], Scope], None]
"""Called with a changed entity (normalized)."""


class Listener:
    """Watches `attributes` of the entities that `selector` selects, and calls `effect` for each change.

    The state that the broker holds at the start counts as a change only with `at_start`. A notification names
    the entities to read; with `trust_notifications` its content is passed on instead. Reading costs a query,
    and of values that change faster than queries are answered only the newest is seen.

    States are passed on in the order in which the broker had them: a polled state never follows a newer one,
    and with `trust_notifications` never precedes values whose notifications are on their way.
    """

    def __init__(
        self,
        name: str,
        selector: EntitySelector,
        attributes: Iterable[str],
        effect: Effect,
        *,
        at_start: bool,
        trust_notifications: bool = False,
        on_error: Callable[[str], None],
    ) -> None:
        self.name = name
        self.selector = selector
        self.attributes = tuple(attributes)
        self.tracker = ChangeTracker(self.attributes)
        self.enabled = True
        self.on_error = on_error
        """Called with the reason why the broker refuses the subscription or the query."""
        self._effect = effect
        self._at_start = at_start
        self._trust_notifications = trust_notifications
        self._began = False

    def subscription(self, subscription_id: str, endpoint: Mapping[str, Any]) -> dict[str, Any]:
        """Return the subscription as NGSI-LD."""
        chosen = self.selector
        entity = {"type": chosen.type, "id": chosen.id, "idPattern": chosen.id_pattern}
        return {
            "id": subscription_id,
            "type": "Subscription",
            "description": f"ROS bridge, rule {self.name}",
            "entities": [{key: value for key, value in entity.items() if value is not None}],
            "watchedAttributes": list(self.attributes),
            **({"q": chosen.q} if chosen.q else {}),
            "notification": {
                "format": "normalized",
                "endpoint": endpoint,
            },
        }

    async def poll(self, broker: BrokerClient) -> None:
        """Poll the broker. Raises `BrokerError`."""
        began_s, chosen = time.monotonic(), self.selector
        if chosen.id is not None and chosen.q is None:
            entities = []
            with suppress(NotFound):
                entities = [await broker.retrieve(chosen.id)]
        else:
            entities = await broker.query(
                type=chosen.type, id=chosen.id, id_pattern=chosen.id_pattern, q=chosen.q
            )
        first, self._began = not self._began, True
        for entity in entities:
            if not self._is_chosen(entity) or self.tracker.was_taken_since(str(entity["id"]), began_s):
                continue
            if self._trust_notifications and not first:
                if not self.tracker.is_missed(entity, time.monotonic()):
                    continue
                log.warning("notification missed", rule=self.name, entity=entity["id"])
            self.take(entity, baseline=first and not self._at_start)

    async def read(self, notified: Iterable[Mapping[str, Any]], receiver: NotificationReceiver) -> None:
        """Retrieve the entities of a notification and pass on changes. Raises `BrokerError`.

        The content of the notification itself is used only with `every_value`, since a change may move a
        robot.
        """
        if self._trust_notifications:
            for entity in notified:
                self.take(entity)
            return
        ids = ids_of([entity for entity in notified if self._is_chosen(entity)])
        for entity in await receiver.read(self.selector.type, ids, q=self.selector.q):
            self.take(entity)

    def take(self, entity: Mapping[str, Any], *, baseline: bool = False) -> None:
        """Record the state of an entity; a change is passed on unless the state is a `baseline`."""
        if not self._is_chosen(entity):
            return
        if self.tracker.take(entity, time.monotonic()) and self.enabled and not baseline:
            self._effect(entity, scope_of(entity, time.time()))

    def _is_chosen(self, entity: Mapping[str, Any]) -> bool:
        """Return whether the rule selects this entity; notifications may hold others."""
        entity_id, types, chosen = entity.get("id"), entity.get("type"), self.selector
        if not isinstance(entity_id, str) or chosen.type not in (
            types if isinstance(types, list) else [types]
        ):
            return False
        if chosen.id is not None:
            return entity_id == chosen.id
        return chosen.id_pattern is None or re.search(chosen.id_pattern, entity_id) is not None


class Listeners:
    """All listeners of a bridge and their subscriptions."""

    def __init__(
        self,
        settings: Settings,
        broker: BrokerClient,
        receiver: NotificationReceiver,
        notify_url: str,
        *,
        prefix: str = "ros-bridge-rule-",
        service: str = ROS_BRIDGE,
    ) -> None:
        self.watched: frozenset[str] = frozenset()
        self.subscribed = False
        self._settings = settings
        self._broker = broker
        self._receiver = receiver
        self._subscriptions = OwnSubscriptions(service, settings, broker)
        self._notify_url = notify_url
        self._prefix = prefix
        self._listeners: dict[str, Listener] = {}
        self._resync = Resync(self._synchronize, settings.reconcile_s)

    def add(self, listener: Listener) -> None:
        """Add a listener; it takes effect with the next resync."""
        self._listeners[listener.name] = listener
        self.watched |= frozenset(listener.attributes)

    def named(self, name: str) -> Listener | None:
        """Return the listener of the rule `name`."""
        return self._listeners.get(name)

    def is_echo(self, entity_id: str, attribute: str, value: Any) -> bool:
        """Return whether this value is what another client has just written."""
        now_s = time.monotonic()
        return any(
            listener.tracker.is_echo(entity_id, attribute, value, now_s)
            for listener in self._listeners.values()
        )

    def wrote(self, entity_id: str, attribute: str) -> None:
        """Record that a value of the graph is being written."""
        for listener in self._listeners.values():
            listener.tracker.wrote(entity_id, attribute)

    async def take_notification(self, rule: str, request: Request) -> None:
        """Have `rule` process the current state of the entities in a notification.

        Raises `Problem` if there is no such rule, or the notification is refused.
        """
        notified = await self._receiver.receive(request)
        listener = self._listeners.get(rule)
        if listener is None:
            raise Problem.translated(
                404,
                "No such rule",
                "ros.no_such_listening_rule",
                'no rule "{rule}" reads entities of the broker',
                rule=rule,
            )
        try:
            await listener.read(notified, self._receiver)
        except BrokerError as error:
            log.warning("reading changed entities failed", rule=rule, error=str(error))
            self._resync.request()

    async def run(self) -> None:
        """Keep the subscriptions in place and poll the broker until cancelled."""
        await self._resync.run()

    def request_resync(self) -> None:
        """Request a resync now, without waiting for it."""
        self._resync.request()

    async def unsubscribe(self) -> None:
        """Delete the subscriptions, as far as the broker is available."""
        for name in self._listeners:
            with suppress(BrokerError):
                await self._broker.delete_subscription(self._id(name))
        self.subscribed = False

    async def _synchronize(self) -> bool:
        try:
            there = {
                str(subscription.get("id")): subscription
                for subscription in await self._broker.subscriptions()
            }
            await self._delete_unused(there)
            for name, listener in self._listeners.items():
                if listener.enabled:
                    await self._listen(self._id(name), listener, there)
        except BrokerError as error:
            log.info("resync with the broker failed", error=str(error))
            self.subscribed = False
            return False
        self.subscribed = True
        return True

    async def _delete_unused(self, there: Iterable[str]) -> None:
        """Delete the subscriptions of disabled rules and of earlier mappings."""
        wanted = {self._id(name) for name, listener in self._listeners.items() if listener.enabled}
        for subscription_id in {
            identifier for identifier in there if identifier.startswith(self._id(""))
        } - wanted:
            await self._subscriptions.drop(subscription_id)

    async def _listen(
        self, subscription_id: str, listener: Listener, there: Mapping[str, Mapping[str, Any]]
    ) -> None:
        """Create or restore the subscription, and poll for changes that were missed."""
        try:
            endpoint = self._receiver.endpoint(f"{self._notify_url}/{listener.name}")
            await self._subscriptions.keep(listener.subscription(subscription_id, endpoint), there)
            await listener.poll(self._broker)
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            listener.on_error(f"the broker refuses the subscription: {error}")

    def _id(self, name: str) -> str:
        return self._settings.entity_id("Subscription", f"{self._prefix}{name}")
