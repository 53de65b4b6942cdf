"""Incoming: one rule from entities to a topic at work."""

import asyncio
from collections.abc import Mapping
from typing import Any

from handover.errors import HandoverError
from handover.telemetry import get_logger
from ros_fiware_bridge.graph.port import Publisher, RosGraph
from ros_fiware_bridge.rules.inward import Incomplete, Scope
from ros_fiware_bridge.rules.pace import Pace
from ros_fiware_bridge.rules.plan import PlannedInward
from ros_fiware_bridge.running.listener import Listener
from ros_fiware_bridge.running.tally import Tally

log = get_logger(__name__)

MOST_TOPICS = 64
MATCHED_WITHIN_S = 2.0


class Incoming:
    """A rule at work while it is `start`ed; what its `listener` passes on is published."""

    def __init__(
        self, planned: PlannedInward, tally: Tally, graph: RosGraph, settings: Mapping[str, str]
    ) -> None:
        self.planned = planned
        self.tally = tally
        self.publishers: dict[str, Publisher] = {}
        self._graph = graph
        self._topic = planned.rule.topic.with_settings(settings)
        self._clock = asyncio.get_running_loop().time
        self._pace = Pace(every_s=planned.rule.every_ms / 1000)
        self._held: dict[str, Scope] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._chores: set[asyncio.Task[None]] = set()
        self.listener = Listener(
            planned.name,
            planned.selector,
            planned.rule.attributes,
            self._take,
            at_start=planned.at_start,
            complain=lambda why: tally.fault(why, self._clock()),
        )

    async def start(self) -> None:
        """Be there for readers, where the topic does not depend on the entity. Raises `GraphError`."""
        self.listener.enabled = True
        if self._topic.constant is not None:
            await self._publisher(self._topic.constant)

    async def stop(self) -> None:
        """Say nothing any more."""
        self.listener.enabled = False
        for timer in self._timers.values():
            timer.cancel()
        for chore in self._chores:
            chore.cancel()
        self._timers.clear()
        self._held.clear()
        publishers, self.publishers = self.publishers, {}
        for publisher in publishers.values():
            await publisher.close()

    def _take(self, _: Mapping[str, Any], scope: Scope) -> None:
        now_s = self._clock()
        self.tally.hear(now_s)
        entity_id = str(scope.values["entityId"])
        if (wait_s := self._pace.waits_s(entity_id, now_s)) > 0:
            self._held[entity_id] = scope
            if entity_id not in self._timers:
                loop = asyncio.get_running_loop()
                self._timers[entity_id] = loop.call_later(wait_s, self._due, entity_id)
            return
        self._say(entity_id, scope, now_s)

    def _due(self, entity_id: str) -> None:
        del self._timers[entity_id]
        self._say(entity_id, self._held.pop(entity_id), self._clock())

    def _say(self, entity_id: str, scope: Scope, now_s: float) -> None:
        self._pace.told(entity_id, {}, now_s)
        try:
            message = self.planned.inward.message(scope)
            topic = self._topic.filler(lambda path: lambda _: _name_part(str(scope.values[str(path)])))(None)
        except Incomplete as error:
            log.debug("an entity is not complete yet", rule=self.tally.name, entity=entity_id, why=str(error))
        except (HandoverError, ValueError, TypeError, ArithmeticError, LookupError) as error:
            self.tally.fault(f"{entity_id}: {error}", now_s)
        else:
            if (publisher := self.publishers.get(topic)) is not None:
                self._publish(publisher, message)
                return
            chore = asyncio.get_running_loop().create_task(self._publish_anew(topic, message))
            self._chores.add(chore)
            chore.add_done_callback(self._chores.discard)

    async def _publish_anew(self, topic: str, message: dict[str, Any]) -> None:
        try:
            publisher = await self._publisher(topic)
            await publisher.matched(MATCHED_WITHIN_S)  # who is there may need a moment to find us
            self._publish(publisher, message)
        except HandoverError as error:
            self.tally.fault(f"{topic}: {error}", self._clock())

    def _publish(self, publisher: Publisher, message: dict[str, Any]) -> None:
        try:
            publisher.publish(message)
        except HandoverError as error:
            self.tally.fault(f"{publisher.topic}: {error}", self._clock())
        else:
            self.tally.tell(self._clock(), message)

    async def _publisher(self, topic: str) -> Publisher:
        if topic not in self.publishers:
            if len(self.publishers) >= MOST_TOPICS:
                raise HandoverError(
                    f"this would be topic {MOST_TOPICS + 1} of one rule; choose fewer entities, or one topic"
                )
            rule = self.planned
            self.publishers[topic] = await self._graph.publisher(topic, rule.rule.type, rule.qos)
        return self.publishers[topic]


def _name_part(text: str) -> str:
    """Return `text` as it may stand in the name of a topic."""
    plain = "".join(char if char.isascii() and char.isalnum() else "_" for char in text)
    return f"_{plain}" if plain[:1].isdigit() else plain
