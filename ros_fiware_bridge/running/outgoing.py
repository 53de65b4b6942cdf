"""Outgoing: one rule from a topic to entities at work.

A message that comes before its entity may be written again is held, and gives way to a newer one; so the
last word is always told, at most one interval late.
"""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Protocol

from ros_fiware_bridge.errors import GraphError
from ros_fiware_bridge.graph.port import Received, RosGraph, Subscription
from ros_fiware_bridge.graph.qos import Qos
from ros_fiware_bridge.rules import origin
from ros_fiware_bridge.rules.outbox import Letter
from ros_fiware_bridge.rules.outward import AlertNews, Outward, Update
from ros_fiware_bridge.rules.pace import Pace
from ros_fiware_bridge.rules.plan import PlannedOutward
from ros_fiware_bridge.running.tally import Tally


class Echoes(Protocol):
    """Whoever knows what others have written into the broker."""

    watched: frozenset[str]
    """The attributes that are listened to, which are marked and compared."""

    def is_echo(self, entity_id: str, attribute: str, value: Any) -> bool:
        """Say whether this value is what somebody else wrote just now."""

    def wrote(self, entity_id: str, attribute: str) -> None:
        """Take notice that the value of the graph is being written."""


class Outgoing:
    """A rule at work while it is `start`ed; letters go to `put`, news of Alerts to `announce`."""

    def __init__(
        self,
        planned: PlannedOutward,
        tally: Tally,
        graph: RosGraph,
        *,
        put: Callable[[Letter], None],
        announce: Callable[[str, AlertNews], None],
        echoes: Echoes,
    ) -> None:
        self.planned = planned
        self.tally = tally
        self.subscription: Subscription | None = None
        self.outward: Outward | None = planned.outward
        self._graph = graph
        self._put = put
        self._announce = announce
        self._echoes = echoes
        self._clock = asyncio.get_running_loop().time
        self._held: dict[str, Update | Received] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._seen: set[str] = set()
        self._pace = self._new_pace()
        self._overtaken = 0
        self._unread = 0

    async def start(self) -> None:
        """Listen to the topic; does nothing while nobody has told its type. Raises `GraphError`."""
        if self.subscription is None and self.outward is not None:
            await self._subscribe(self._reader_qos())

    async def match(self) -> None:
        """Subscribe again where the publishers offer another quality of service than before."""
        if self.subscription is not None and (qos := self._reader_qos()) != self.subscription.qos:
            await self._unsubscribe()
            await self._subscribe(qos)

    def _reader_qos(self) -> Qos:
        topic = self.planned.rule.topic
        found = next((one for one in self._graph.topics() if one.name == topic), None)
        return self.planned.reader_qos(one.qos for one in (found.publishers if found else ()) if not one.ours)

    async def _subscribe(self, qos: Qos) -> None:
        assert self.outward is not None  # noqa: S101 - nobody subscribes before the type is known
        topic = self.planned.rule.topic
        self.subscription = await self._graph.subscribe(topic, self.outward.type_name, self._heard, qos)

    async def _unsubscribe(self) -> None:
        self.count_losses()
        self._overtaken = self._unread = 0
        if self.subscription is not None:
            subscription, self.subscription = self.subscription, None
            await subscription.close()

    async def stop(self) -> None:
        """Stop listening; what is held is let go."""
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        self._held.clear()
        self._pace = self._new_pace()
        await self._unsubscribe()

    @property
    def keeps_versions(self) -> bool:
        """Whether the rule wants every message written, not only the newest."""
        rule = self.planned.rule
        return rule.buffer.keep > 1 and rule.every_ms == 0

    def count_losses(self) -> None:
        """Count what the subscription has lost since the last time."""
        if self.subscription is None:
            self._overtaken = self._unread = 0
            return
        overtaken, unread = self.subscription.dropped, self.subscription.refused
        if self.keeps_versions:
            self.tally.lose("reader_overflow", overtaken - self._overtaken)
        else:
            self.tally.conflate(overtaken - self._overtaken)
        if unread > self._unread:
            self.tally.fault(self.subscription.last_error or "a message could not be read", self._clock())
            self.tally.lose("unreadable", unread - self._unread)
        self._overtaken, self._unread = overtaken, unread

    def taken(self, letter: Letter) -> None:
        """Count a letter that the broker has taken."""
        self.tally.tell(self._clock(), {"entity": letter.entity_id, **(letter.shown or {})})

    def refused(self, letter: Letter) -> None:
        """Take notice that the broker did not take a letter: what it said is not known there."""
        self._pace.forget(letter.entity_id)

    def _heard(self, received: Received) -> None:
        if received.ours or self.outward is None:
            return  # what the bridge says itself came from the broker
        now_s = self._clock()
        self.tally.hear(now_s)
        only = self._only_entity
        if only is not None and (wait_s := self._pace.waits_s(only, now_s)) > 0:
            self._hold(only, received, wait_s)  # it is not even decoded unless it is the last
            return
        self._take(received, now_s)

    @property
    def _only_entity(self) -> str | None:
        """Return the entity that every message is about, if that needs no look at the message."""
        if self.outward is None or not self.outward.constant_entity or len(self._seen) != 1:
            return None
        return next(iter(self._seen))

    def _take(self, received: Received, now_s: float) -> None:
        assert self.outward is not None  # noqa: S101 - nothing is heard before its type is known
        try:
            message = received.excerpt(self.outward.fields)
        except GraphError as error:
            self.tally.fault(str(error), now_s)
            return
        harvest = self.outward.harvest(message, received.received_at_s)
        for fault in harvest.faults:
            self.tally.fault(fault, now_s)
        for alert in harvest.alerts:
            self._announce(self.tally.name, alert)
        for update in harvest.updates:
            self._offer(update, now_s)

    def _offer(self, update: Update, now_s: float) -> None:
        if not self._is_known(update.entity_id, now_s):
            return
        if (wait_s := self._pace.waits_s(update.entity_id, now_s)) > 0:
            self._hold(update.entity_id, update, wait_s)
            return
        if not self._pace.is_news(update.entity_id, update.values, now_s):
            return
        self._pace.told(update.entity_id, update.values, now_s)
        attributes = self._not_from_there(update)
        if attributes:
            rule = self.planned.rule
            self._put(
                Letter(
                    self.tally.name,
                    update.entity_id,
                    update.entity_type,
                    attributes,
                    rule.buffer.keep,
                    rule.create,
                    now_s,
                    update.values,
                )
            )

    def _is_known(self, entity_id: str, now_s: float) -> bool:
        if entity_id in self._seen:
            return True
        if len(self._seen) >= self.planned.rule.most_entities:
            self.tally.fault(
                f"{entity_id} would be entity {len(self._seen) + 1} of this rule, more than "
                f"{self.planned.rule.most_entities} (most_entities); raise that, or make ids otherwise",
                now_s,
            )
            return False
        self._seen.add(entity_id)
        return True

    def _not_from_there(self, update: Update) -> Mapping[str, Any]:
        """Return what of `update` did not come from the broker, marked where it could be sent back."""
        echoes = self._echoes
        if echoes.watched.isdisjoint(update.attributes):
            return update.attributes
        attributes: dict[str, Any] = {}
        for name, attribute in update.attributes.items():
            if name not in echoes.watched:
                attributes[name] = attribute
            elif not echoes.is_echo(update.entity_id, name, update.values[name]):
                echoes.wrote(update.entity_id, name)
                attributes[name] = origin.marked(dict(attribute), self._graph.node_name)
        return attributes

    def _hold(self, entity_id: str, what: Update | Received, wait_s: float) -> None:
        self._held[entity_id] = what
        if entity_id not in self._timers:
            loop = asyncio.get_running_loop()
            self._timers[entity_id] = loop.call_later(wait_s, self._due, entity_id)

    def _due(self, entity_id: str) -> None:
        del self._timers[entity_id]
        held, now_s = self._held.pop(entity_id), self._clock()
        if (wait_s := self._pace.waits_s(entity_id, now_s)) > 0:
            self._hold(entity_id, held, wait_s)
        elif isinstance(held, Update):
            self._offer(held, now_s)
        else:
            self._take(held, now_s)

    def _new_pace(self) -> Pace:
        rule = self.planned.rule
        made = self.outward.attributes if self.outward is not None else ()
        return Pace(
            every_s=rule.every_ms / 1000,
            on_change=rule.on_change,
            dead_bands={one.name: one.dead_band for one in made if one.dead_band is not None},
            at_least_every_s=rule.at_least_every_s,
            most_entities=rule.most_entities,
        )

    def know(self, outward: Outward) -> None:
        """Take notice of the topic's type, which the mapping did not say."""
        self.outward = outward
        self.planned = replace(self.planned, outward=outward)
        self._pace = self._new_pace()
