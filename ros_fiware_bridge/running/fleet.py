"""A fleet: a rule whose topic has places, such as `/{robot}/odom`, at work on every topic that fits."""

from collections.abc import Callable

from ros_fiware_bridge.graph.port import RosGraph
from ros_fiware_bridge.rules.plan import Plan, PlannedOutward
from ros_fiware_bridge.running.outgoing import Outgoing


class Fleet:
    """One `Outgoing` for each topic that fits, made by `make` when somebody publishes on it."""

    def __init__(
        self, planned: PlannedOutward, plan: Plan, graph: RosGraph, make: Callable[[PlannedOutward], Outgoing]
    ) -> None:
        self.planned = planned
        self.members: dict[str, Outgoing] = {}
        self._plan = plan
        self._graph = graph
        self._make = make

    async def start(self) -> None:
        """Read every topic that fits. Raises `GraphError`."""
        await self.look()

    async def look(self) -> None:
        """Read the topics that fit and are not read yet. Raises `GraphError`."""
        pattern = self.planned.pattern
        for topic in self._graph.topics():
            found = pattern.fullmatch(topic.name) if pattern is not None else None
            full = len(self.members) >= self.planned.rule.most_entities
            if (
                found is None
                or full
                or topic.name in self.members
                or all(one.ours for one in topic.publishers)
            ):
                continue
            member = self._make(self.planned.at(self._plan, topic.name, found.groupdict()))
            self.members[topic.name] = member
            await member.start()

    async def stop(self) -> None:
        """Stop reading."""
        members, self.members = self.members, {}
        for member in members.values():
            await member.stop()
