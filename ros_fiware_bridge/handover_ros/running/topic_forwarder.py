"""Forwards a topic to entities of the broker, by one rule.

A message that arrives before its entity may be written again is held, and a newer one replaces it. So the
newest value always reaches the broker, at most one interval late.
"""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Protocol

from handover.telemetry import get_logger
from handover_ros.errors import GraphError
from handover_ros.graph.port import Received, RosGraph, Subscription
from handover_ros.graph.qos import Qos
from handover_ros.graph.simulated_time import clock_publishers
from handover_ros.rules import origin
from handover_ros.rules.entity_extractor import AlertState, EntityExtractor, EntityState
from handover_ros.rules.outbox import Update
from handover_ros.rules.plan import Plan, PlannedRosToNgsild
from handover_ros.rules.update_filter import UpdateFilter
from handover_ros.running.rule_stats import RuleStats

log = get_logger(__name__)

CLOCK_CHECK_S = 1.0
"""How often it is looked whether the graph runs on simulated time."""


class EchoFilter(Protocol):
    """Detects values that other clients have written into the broker."""

    watched: frozenset[str]
    """The attributes that rules of the other direction read; they are marked and compared."""

    def is_echo(self, entity_id: str, attribute: str, value: Any) -> bool:
        """Return whether this value is what another client has just written."""

    def wrote(self, entity_id: str, attribute: str) -> None:
        """Record that the value of the graph is being written."""


class TopicForwarder:
    """Subscribes to a topic between `start` and `stop`; passes on updates and Alerts."""

    def __init__(
        self,
        planned: PlannedRosToNgsild,
        stats: RuleStats,
        graph: RosGraph,
        *,
        put: Callable[[Update], None],
        publish_alert: Callable[[str, AlertState], None],
        echoes: EchoFilter,
    ) -> None:
        self.planned = planned
        self.stats = stats
        self.subscription: Subscription | None = None
        self.extractor: EntityExtractor | None = planned.extractor
        self._graph = graph
        self._put = put
        self._publish_alert = publish_alert
        self._echoes = echoes
        self._clock = asyncio.get_running_loop().time
        self._held: dict[str, EntityState | Received] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._seen: set[str] = set()
        self._filter = self._new_filter()
        self._overwritten = 0
        self._unreadable = 0
        self._has_clock = self._is_simulated = False
        self._clock_known_until_s = float("-inf")

    async def start(self) -> None:
        """Subscribe to the topic; has no effect while its type is unknown. Raises `GraphError`."""
        if self.subscription is None and self.extractor is not None:
            await self._subscribe(self._reader_qos())

    async def match(self) -> None:
        """Subscribe again if the publishers have changed their quality of service. Raises `GraphError`."""
        if self.subscription is not None and (qos := self._reader_qos()) != self.subscription.qos:
            await self._unsubscribe()
            await self._subscribe(qos)

    def _reader_qos(self) -> Qos:
        topic = self.planned.rule.topic
        topic_info = next((candidate for candidate in self._graph.topics() if candidate.name == topic), None)
        return self.planned.reader_qos(
            publisher.qos for publisher in (topic_info.publishers if topic_info else ()) if not publisher.ours
        )

    async def _subscribe(self, qos: Qos) -> None:
        assert self.extractor is not None  # noqa: S101 - the type is known before anything subscribes
        topic = self.planned.rule.topic
        self.subscription = await self._graph.subscribe(
            topic, self.extractor.type_name, self._on_message, qos
        )

    async def _unsubscribe(self) -> None:
        self.count_reader_losses()
        self._overwritten = self._unreadable = 0
        if self.subscription is not None:
            subscription, self.subscription = self.subscription, None
            await subscription.close()

    async def stop(self) -> None:
        """Unsubscribe and discard held messages."""
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        self._held.clear()
        self._filter = self._new_filter()
        await self._unsubscribe()

    @property
    def keeps_versions(self) -> bool:
        """Whether the rule keeps every message, not only the newest."""
        rule = self.planned.rule
        return rule.buffer.keep > 1 and rule.every_ms == 0

    def count_reader_losses(self) -> None:
        """Count the messages that the subscription has lost since the last call."""
        if self.subscription is None:
            self._overwritten = self._unreadable = 0
            return
        overwritten, unreadable = self.subscription.dropped, self.subscription.refused
        if self.keeps_versions:
            self.stats.count_dropped("reader_overflow", overwritten - self._overwritten)
        else:
            self.stats.count_conflated(overwritten - self._overwritten)
        if unreadable > self._unreadable:
            self.stats.record_error(
                self.subscription.last_error or "a message could not be read", self._clock()
            )
            self.stats.count_dropped("unreadable", unreadable - self._unreadable)
        self._overwritten, self._unreadable = overwritten, unreadable

    def accepted(self, update: Update) -> None:
        """Count an update that the broker has accepted."""
        self.stats.count_forwarded(self._clock(), {"entity": update.entity_id, **(update.shown or {})})

    def refused(self, update: Update) -> None:
        """Forget the values of an update that the broker has refused."""
        self._filter.forget(update.entity_id)

    def _on_message(self, received: Received) -> None:
        if received.ours or self.extractor is None:
            return  # messages of the bridge itself come from the broker
        now_s = self._clock()
        self.stats.count_received(now_s)
        only = self._only_entity
        if only is not None and (wait_s := self._filter.wait_s(only, now_s)) > 0:
            self._hold(only, received, wait_s)  # only the last held message is decoded
            return
        self._process(received, now_s)

    @property
    def _only_entity(self) -> str | None:
        """Return the entity of every message, if it is known without decoding a message."""
        if self.extractor is None or not self.extractor.constant_entity or len(self._seen) != 1:
            return None
        return next(iter(self._seen))

    def _process(self, received: Received, now_s: float) -> None:
        assert self.extractor is not None  # noqa: S101 - the type is known before a message arrives
        try:
            message = received.excerpt(self.extractor.fields)
        except GraphError as error:
            self.stats.record_error(str(error), now_s)
            return
        extraction = self.extractor.extract(
            message, received.received_at_s, is_simulated=self._runs_on_simulated_time(now_s)
        )
        if extraction.is_simulated and not self._is_simulated:
            log.warning(
                "stamps of simulated time are replaced by the time of reception", rule=self.stats.name
            )
        self._is_simulated = extraction.is_simulated
        for reason in extraction.errors:
            self.stats.record_error(reason, now_s)
        for alert in extraction.alerts:
            self._publish_alert(self.stats.name, alert)
        for state in extraction.entities:
            self._forward(state, now_s)

    def _runs_on_simulated_time(self, now_s: float) -> bool:
        if now_s >= self._clock_known_until_s:
            self._clock_known_until_s = now_s + CLOCK_CHECK_S
            self._has_clock = bool(clock_publishers(self._graph))
        return self._has_clock

    def _forward(self, state: EntityState, now_s: float) -> None:
        if not self._may_write(state.entity_id, now_s):
            return
        if (wait_s := self._filter.wait_s(state.entity_id, now_s)) > 0:
            self._hold(state.entity_id, state, wait_s)
            return
        if not self._filter.is_change(state.entity_id, state.values, now_s):
            return
        self._filter.record(state.entity_id, state.values, now_s)
        attributes = self._without_echoes(state)
        if attributes:
            rule = self.planned.rule
            self._put(
                Update(
                    self.stats.name,
                    state.entity_id,
                    state.entity_type,
                    attributes,
                    rule.buffer.keep,
                    rule.create,
                    now_s,
                    state.values,
                )
            )

    def _may_write(self, entity_id: str, now_s: float) -> bool:
        if entity_id in self._seen:
            return True
        if len(self._seen) >= self.planned.rule.max_entities:
            self.stats.record_error(
                f"{entity_id} would be entity {len(self._seen) + 1} of this rule, more than "
                f"{self.planned.rule.max_entities} (max_entities); raise the limit, or map to fewer ids",
                now_s,
            )
            return False
        self._seen.add(entity_id)
        return True

    def _without_echoes(self, state: EntityState) -> Mapping[str, Any]:
        """Return the attributes that did not come from the broker, marked where they could be sent back."""
        echoes = self._echoes
        if echoes.watched.isdisjoint(state.attributes):
            return state.attributes
        attributes: dict[str, Any] = {}
        for name, attribute in state.attributes.items():
            if name not in echoes.watched:
                attributes[name] = attribute
            elif not echoes.is_echo(state.entity_id, name, state.values[name]):
                echoes.wrote(state.entity_id, name)
                attributes[name] = origin.marked(dict(attribute), self._graph.node_name)
        return attributes

    def _hold(self, entity_id: str, what: EntityState | Received, wait_s: float) -> None:
        self._held[entity_id] = what
        if entity_id not in self._timers:
            loop = asyncio.get_running_loop()
            self._timers[entity_id] = loop.call_later(wait_s, self._due, entity_id)

    def _due(self, entity_id: str) -> None:
        del self._timers[entity_id]
        held, now_s = self._held.pop(entity_id), self._clock()
        if (wait_s := self._filter.wait_s(entity_id, now_s)) > 0:
            self._hold(entity_id, held, wait_s)
        elif isinstance(held, EntityState):
            self._forward(held, now_s)
        else:
            self._process(held, now_s)

    def _new_filter(self) -> UpdateFilter:
        rule = self.planned.rule
        attributes = self.extractor.attributes if self.extractor is not None else ()
        dead_bands = {
            attribute.name: attribute.dead_band for attribute in attributes if attribute.dead_band is not None
        }
        for attribute in attributes:
            for part in attribute.parts:
                if part.dead_band is not None:
                    dead_bands[f"{attribute.name}.{part.name}"] = part.dead_band
        return UpdateFilter(
            every_s=rule.every_ms / 1000,
            on_change=rule.on_change,
            dead_bands=dead_bands,
            at_least_every_s=rule.at_least_every_s,
            max_entities=rule.max_entities,
        )

    def set_type(self, extractor: EntityExtractor) -> None:
        """Set the extractor for the topic's type, which the mapping leaves out."""
        self.extractor = extractor
        self.planned = replace(self.planned, extractor=extractor)
        self._filter = self._new_filter()


class PatternForwarder:
    """One `TopicForwarder` for each matching topic that has a publisher, made by `make`."""

    def __init__(
        self,
        planned: PlannedRosToNgsild,
        plan: Plan,
        graph: RosGraph,
        make: Callable[[PlannedRosToNgsild], TopicForwarder],
    ) -> None:
        self.planned = planned
        self.members: dict[str, TopicForwarder] = {}
        self._plan = plan
        self._graph = graph
        self._make = make

    async def start(self) -> None:
        """Subscribe to every matching topic. Raises `GraphError`."""
        await self.add_topics()

    async def add_topics(self) -> None:
        """Subscribe to matching topics that are new. Raises `GraphError`."""
        pattern = self.planned.pattern
        for topic in self._graph.topics():
            match = pattern.fullmatch(topic.name) if pattern is not None else None
            full = len(self.members) >= self.planned.rule.max_entities
            if (
                match is None
                or full
                or topic.name in self.members
                or all(publisher.ours for publisher in topic.publishers)
            ):
                continue
            member = self._make(self.planned.for_topic(self._plan, topic.name, match.groupdict()))
            self.members[topic.name] = member
            await member.start()

    async def stop(self) -> None:
        """Unsubscribe from all topics."""
        members, self.members = self.members, {}
        for member in members.values():
            await member.stop()
