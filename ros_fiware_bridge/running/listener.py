"""A listener: learns of entities in the broker, by subscription and by asking, and passes on what is news.

Its subscription has a deterministic id, so making it twice makes one; it is deleted when the bridge ends in
good order. Every few seconds the broker is asked for the state itself, since notifications may be lost.
"""

import re
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any

from fastapi import Request

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.errors import Problem
from handover.messages import message
from handover.notifications import NotificationReceiver, ids_of
from handover.resync import Resync
from handover.settings import Settings
from handover.telemetry import get_logger
from ros_fiware_bridge.mapping.model import EntitySelector
from ros_fiware_bridge.rules.inward import Scope
from ros_fiware_bridge.rules.latest import Latest, scope_of

log = get_logger(__name__)

Effect = Callable[[Mapping[str, Any], Scope], None]
"""What is done with an entity (normalized) that is news."""


class Listener:
    """Listens for `attributes` of the entities that `selector` chooses, and has `effect` done with news.

    What the broker holds at the start is only news with `at_start`.
    """

    def __init__(
        self,
        name: str,
        selector: EntitySelector,
        attributes: Iterable[str],
        effect: Effect,
        *,
        at_start: bool,
        complain: Callable[[str], None],
    ) -> None:
        self.name = name
        self.selector = selector
        self.attributes = tuple(attributes)
        self.latest = Latest(self.attributes)
        self.enabled = True
        self.complain = complain
        """Told why the broker does not let us listen."""
        self._effect = effect
        self._at_start = at_start
        self._began = False

    def subscription(self, subscription_id: str, endpoint: Mapping[str, Any]) -> dict[str, Any]:
        """Return its subscription as the broker takes it."""
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

    async def ask(self, broker: BrokerClient) -> None:
        """Ask the broker for the state itself. Raises `BrokerError`."""
        chosen = self.selector
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
            self.take(entity, only_notice=first and not self._at_start)

    async def read(self, notified: Iterable[Mapping[str, Any]], receiver: NotificationReceiver) -> None:
        """Read from the broker what a notification is about, and pass on what is news. Raises `BrokerError`.

        What is passed on may move a robot, so the content of the notification is not used.
        """
        ids = ids_of([entity for entity in notified if self._is_chosen(entity)])
        for entity in await receiver.read(self.selector.type, ids, q=self.selector.q):
            self.take(entity)

    def take(self, entity: Mapping[str, Any], *, only_notice: bool = False) -> None:
        """Take notice of an entity; what is news is passed on unless it is `only_notice`d."""
        if not self._is_chosen(entity):
            return
        if self.latest.take(entity, time.monotonic()) and self.enabled and not only_notice:
            self._effect(entity, scope_of(entity, time.time()))

    def _is_chosen(self, entity: Mapping[str, Any]) -> bool:
        """Say whether this is an entity that the rule is about, whoever tells of it."""
        entity_id, types, chosen = entity.get("id"), entity.get("type"), self.selector
        if not isinstance(entity_id, str) or chosen.type not in (
            types if isinstance(types, list) else [types]
        ):
            return False
        if chosen.id is not None:
            return entity_id == chosen.id
        return chosen.id_pattern is None or re.search(chosen.id_pattern, entity_id) is not None


class Listeners:
    """All listeners of a bridge, with their subscriptions."""

    def __init__(
        self,
        settings: Settings,
        broker: BrokerClient,
        receiver: NotificationReceiver,
        notify_url: str,
        prefix: str = "ros-bridge-rule-",
    ) -> None:
        self.watched: frozenset[str] = frozenset()
        self.subscribed = False
        self._settings = settings
        self._broker = broker
        self._receiver = receiver
        self._notify_url = notify_url
        self._prefix = prefix
        self._listeners: dict[str, Listener] = {}
        self._resync = Resync(self._go, settings.reconcile_s)

    def add(self, listener: Listener) -> None:
        """Have one more listen, from the next round on."""
        self._listeners[listener.name] = listener
        self.watched |= frozenset(listener.attributes)

    def named(self, name: str) -> Listener | None:
        """Return the listener of the rule `name`."""
        return self._listeners.get(name)

    def is_echo(self, entity_id: str, attribute: str, value: Any) -> bool:
        """Say whether this value is what somebody else wrote just now."""
        now_s = time.monotonic()
        return any(one.latest.is_echo(entity_id, attribute, value, now_s) for one in self._listeners.values())

    def wrote(self, entity_id: str, attribute: str) -> None:
        """Take notice that a value of the graph is being written."""
        for listener in self._listeners.values():
            listener.latest.wrote(entity_id, attribute)

    async def take_notification(self, rule: str, request: Request) -> None:
        """Have the rule `rule` act on what the broker says of the entities that a notification names.

        Raises `Problem` if there is no such rule, or if the notification is refused.
        """
        notified = await self._receiver.receive(request)
        listener = self._listeners.get(rule)
        if listener is None:
            raise Problem(
                404,
                "No such rule",
                message("ros.no_such_listening_rule", 'no rule "{rule}" listens to the broker', rule=rule),
            )
        try:
            await listener.read(notified, self._receiver)
        except BrokerError as error:
            log.warning("cannot read entities that have changed", rule=rule, error=str(error))
            self._resync.request()

    async def keep(self) -> None:
        """Go rounds until cancelled: subscriptions are what they should be, and nothing has been missed."""
        await self._resync.run()

    def wish(self) -> None:
        """Wish for a round now."""
        self._resync.request()

    async def unsubscribe(self) -> None:
        """Delete the subscriptions, as far as the broker lets us."""
        for name in self._listeners:
            with suppress(BrokerError):
                await self._broker.delete_subscription(self._id(name))
        self.subscribed = False

    async def _go(self) -> bool:
        try:
            there = {str(one.get("id")) for one in await self._broker.subscriptions()}
            await self._clear_away(there)
            for name, listener in self._listeners.items():
                if listener.enabled:
                    await self._listen(self._id(name), listener, there)
        except BrokerError as error:
            log.info("the broker cannot be asked", error=str(error))
            self.subscribed = False
            return False
        self.subscribed = True
        return True

    async def _clear_away(self, there: set[str]) -> None:
        """Delete the subscriptions of rules that are off, or that an earlier mapping left behind."""
        wanted = {self._id(name) for name, one in self._listeners.items() if one.enabled}
        for subscription_id in {one for one in there if one.startswith(self._id(""))} - wanted:
            with suppress(NotFound):
                await self._broker.delete_subscription(subscription_id)

    async def _listen(self, subscription_id: str, listener: Listener, there: set[str]) -> None:
        """Make the subscription if it lacks, and ask for what it may have missed."""
        try:
            if subscription_id not in there or not self.subscribed:
                endpoint = self._receiver.endpoint(f"{self._notify_url}/{listener.name}")
                await self._broker.ensure_subscription(listener.subscription(subscription_id, endpoint))
            await listener.ask(self._broker)
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            listener.complain(f"the broker does not let us listen: {error}")

    def _id(self, name: str) -> str:
        return self._settings.entity_id("Subscription", f"{self._prefix}{name}")


def _short(kind: Any) -> str:
    """Return the name of a type, which some brokers tell as a URI."""
    return re.split(r"[/#]", str(kind))[-1]
