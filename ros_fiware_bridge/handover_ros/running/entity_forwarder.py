"""Forwards entities of the broker to a topic, by one rule."""

import asyncio
from collections.abc import Mapping
from contextlib import AsyncExitStack
from typing import Any

from handover.errors import HandoverError
from handover.runtime.background_tasks import BackgroundTasks
from handover.telemetry import get_logger
from handover_ros.graph.port import Publisher, RosGraph
from handover_ros.rules.message_builder import Incomplete, Scope
from handover_ros.rules.plan import PlannedNgsildToRos
from handover_ros.rules.update_filter import UpdateFilter
from handover_ros.running.listener import Listener
from handover_ros.running.rule_stats import RuleStats

log = get_logger(__name__)

MAX_TOPICS = 64
MATCH_TIMEOUT_S = 2.0


class EntityForwarder:
    """Publishes the changes that its `listener` passes on, between `start` and `stop`."""

    def __init__(
        self, planned: PlannedNgsildToRos, stats: RuleStats, graph: RosGraph, settings: Mapping[str, str]
    ) -> None:
        self.planned = planned
        self.stats = stats
        self.publishers: dict[str, Publisher] = {}
        self._graph = graph
        self._topic = planned.rule.topic.with_settings(settings)
        self._clock = asyncio.get_running_loop().time
        self._filter = UpdateFilter(every_s=planned.rule.every_ms / 1000)
        self._held: dict[str, Scope] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._tasks = BackgroundTasks(f"rule {planned.name}")
        self._running = AsyncExitStack()
        self.listener = Listener(
            planned.name,
            planned.selector,
            planned.rule.attributes,
            self._take,
            at_start=planned.at_start,
            trust_notifications=planned.rule.every_value,
            on_error=lambda why: stats.record_error(why, self._clock()),
        )

    async def start(self) -> None:
        """Create the publisher, if the topic does not depend on the entity. Raises `GraphError`."""
        self.listener.enabled = True
        await self._running.enter_async_context(self._tasks)
        if self._topic.constant is not None:
            await self._publisher(self._topic.constant)

    async def stop(self) -> None:
        """Close all publishers."""
        self.listener.enabled = False
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        self._held.clear()
        await self._running.aclose()
        publishers, self.publishers = self.publishers, {}
        for publisher in publishers.values():
            await publisher.close()

    def _take(self, _: Mapping[str, Any], scope: Scope) -> None:
        now_s = self._clock()
        self.stats.count_received(now_s)
        entity_id = str(scope.values["entityId"])
        if (wait_s := self._filter.wait_s(entity_id, now_s)) > 0:
            self._held[entity_id] = scope
            if entity_id not in self._timers:
                loop = asyncio.get_running_loop()
                self._timers[entity_id] = loop.call_later(wait_s, self._due, entity_id)
            return
        self._forward(entity_id, scope, now_s)

    def _due(self, entity_id: str) -> None:
        del self._timers[entity_id]
        self._forward(entity_id, self._held.pop(entity_id), self._clock())

    def _forward(self, entity_id: str, scope: Scope, now_s: float) -> None:
        self._filter.record(entity_id, {}, now_s)
        try:
            message = self.planned.builder.message(scope)
            topic = self._topic.filler(lambda path: lambda _: _name_part(str(scope.values[str(path)])))(None)
        except Incomplete as error:
            log.debug("entity not complete yet", rule=self.stats.name, entity=entity_id, reason=str(error))
        except (HandoverError, ValueError, TypeError, ArithmeticError, LookupError) as error:
            self.stats.record_error(f"{entity_id}: {error}", now_s)
        else:
            if (publisher := self.publishers.get(topic)) is not None:
                self._publish(publisher, message)
                return
            self._tasks.start(self._publish_on_new, topic, message)

    async def _publish_on_new(self, topic: str, message: dict[str, Any]) -> None:
        try:
            publisher = await self._publisher(topic)
            await publisher.matched(MATCH_TIMEOUT_S)  # existing subscribers need a moment to discover it
            self._publish(publisher, message)
        except HandoverError as error:
            self.stats.record_error(f"{topic}: {error}", self._clock())

    def _publish(self, publisher: Publisher, message: dict[str, Any]) -> None:
        try:
            publisher.publish(message)
        except HandoverError as error:
            self.stats.record_error(f"{publisher.topic}: {error}", self._clock())
        else:
            self.stats.count_forwarded(self._clock(), message)

    async def _publisher(self, topic: str) -> Publisher:
        if topic not in self.publishers:
            if len(self.publishers) >= MAX_TOPICS:
                raise HandoverError(
                    f"a rule uses at most {MAX_TOPICS} topics; select fewer entities, or one topic"
                )
            rule = self.planned
            self.publishers[topic] = await self._graph.publisher(topic, rule.rule.type, rule.qos)
        return self.publishers[topic]


def _name_part(text: str) -> str:
    """Return `text` as a valid part of a topic name."""
    plain = "".join(char if char.isascii() and char.isalnum() else "_" for char in text)
    return f"_{plain}" if plain[:1].isdigit() else plain
