"""The rules from ROS to NGSI-LD of a bridge: forwarders, results of updates, and checks.

A check runs every second. It finds topics of patterns, types that the mapping leaves out, publishers with
another quality of service, lost messages and silent topics. The graph has no notifications for these.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Protocol

from handover_ros.errors import GraphError
from handover_ros.graph.port import RosGraph
from handover_ros.metrics import TOPIC_SILENT
from handover_ros.rules import plan as planning
from handover_ros.rules.message_schema import InvalidRule
from handover_ros.rules.outbox import Update
from handover_ros.rules.plan import Plan, PlannedRosToNgsild
from handover_ros.running.rule_stats import RuleStats
from handover_ros.running.topic_forwarder import PatternForwarder, TopicForwarder

SILENT_AFTER_S = 5.0


class RaiseAlert(Protocol):
    """Raises or clears the Alert `key`."""

    def __call__(self, key: str, description: str, *, active: bool) -> None:
        """Raise the Alert, or clear it unless it is `active`."""


class TopicRules:
    """The rules in `ros_to_ngsild`; `make` creates a forwarder, `restart` restarts a rule."""

    def __init__(
        self,
        plan: Plan,
        graph: RosGraph,
        stats: Mapping[str, RuleStats],
        *,
        make: Callable[[PlannedRosToNgsild], TopicForwarder],
        restart: Callable[[str], Awaitable[None]],
        alert: RaiseAlert,
    ) -> None:
        self._plan = plan
        self._graph = graph
        self._stats = stats
        self._make = make
        self._restart = restart
        self._alert = alert
        self._clock = asyncio.get_running_loop().time
        self._forwarders: dict[str, TopicForwarder] = {}
        self._pattern_forwarders: dict[str, PatternForwarder] = {}
        self._active: set[str] = set()
        """The rules, or rules and topics, that have had a publisher."""
        self._silent_since_s: dict[str, float] = {}

    def create(self) -> None:
        """Create the forwarders of all rules in the plan."""
        for planned in self._plan.ros_to_ngsild:
            if planned.pattern is not None:
                forwarder = PatternForwarder(planned, self._plan, self._graph, self._make)
                self._pattern_forwarders[planned.name] = forwarder
            else:
                self._forwarders[planned.name] = self._make(planned)

    def get(self, name: str) -> TopicForwarder | PatternForwarder | None:
        """Return the forwarder of a rule, if it is one of these rules."""
        return self._forwarders.get(name) or self._pattern_forwarders.get(name)

    def forwarders_of(self, name: str) -> Sequence[TopicForwarder]:
        """Return the forwarders of a rule, one for each of its topics."""
        if (pattern := self._pattern_forwarders.get(name)) is not None:
            return list(pattern.members.values())
        return [self._forwarders[name]] if name in self._forwarders else []

    def details(self, name: str) -> dict[str, Any] | None:
        """Return the source, the target and the peers of a rule; None if it is not one of these rules."""
        forwarder = self.get(name)
        if forwarder is None:
            return None
        rule = forwarder.planned.rule
        read = [reader.subscription for reader in self.forwarders_of(name) if reader.subscription is not None]
        extractor = forwarder.planned.extractor
        details: dict[str, Any] = {
            "from": rule.topic,
            "to": str(rule.entity.id.with_settings(self._plan.settings)) if rule.entity else "Alert",
            "type": extractor.type_name if extractor is not None else None,
            "qos": str(read[0].qos if read else forwarder.planned.qos),
            "publishers": sum(subscription.publishers() for subscription in read),
            "unreadable": sum(subscription.refused for subscription in read),
            "lastUnreadable": next(
                (subscription.last_error for subscription in read if subscription.last_error), None
            ),
        }
        if isinstance(forwarder, PatternForwarder):
            details["topics"] = sorted(forwarder.members)
        return details

    # Results of updates

    def accepted(self, update: Update) -> None:
        """Count an update that the broker has accepted, if it comes from one of these rules."""
        forwarders = self.forwarders_of(update.rule)
        if update.shown is not None and forwarders:
            forwarders[0].accepted(update)  # all forwarders share the statistics of the rule

    def dropped(self, rule: str, number: int, cause: str) -> None:
        """Count updates that newer ones have replaced."""
        if any(forwarder.planned.rule.buffer.keep > 1 for forwarder in self.forwarders_of(rule)):
            self._stats[rule].count_dropped(cause, number)
        else:
            self._stats[rule].count_conflated(number)

    def refused(self, update: Update, why: str) -> None:
        """Count an update that the broker has refused."""
        self._stats[update.rule].record_error(f"{update.entity_id}: {why}", self._clock())
        self._stats[update.rule].count_dropped("refused")
        for forwarder in self.forwarders_of(update.rule):
            forwarder.refused(update)

    # Checks

    async def check(self) -> None:
        """Check the topics of all enabled rules once."""
        for name, pattern in self._pattern_forwarders.items():
            if not self._stats[name].enabled:
                continue
            try:
                await pattern.add_topics()
            except GraphError as error:
                self._stats[name].record_error(str(error), self._clock())
            # A copy, since the rule may be disabled during the check.
            for topic, member in tuple(pattern.members.items()):
                await self._check_topic(name, f"{name} {topic}", member)
        for name, forwarder in self._forwarders.items():
            if self._stats[name].enabled:
                await self._check_topic(name, name, forwarder)

    async def _check_topic(self, name: str, key: str, forwarder: TopicForwarder) -> None:
        forwarder.count_reader_losses()
        if forwarder.planned.match:
            try:
                await forwarder.match()
            except GraphError as error:
                self._stats[name].record_error(str(error), self._clock())
        if forwarder.extractor is None:
            await self._find_type(name, forwarder)
        elif forwarder.subscription is not None and forwarder.subscription.publishers() > 0:
            self._active.add(key)
            self._clear_silence(key)
        elif key in self._active:
            self._report_silence(key, forwarder)

    async def _find_type(self, name: str, forwarder: TopicForwarder) -> None:
        topic = forwarder.planned.rule.topic
        type_names = next((info.type_names for info in self._graph.topics() if info.name == topic), ())
        if not type_names:
            return
        errors: list[str] = []

        def report(where: tuple[str, ...], why: InvalidRule) -> None:
            errors.append(f"{'.'.join(where)}: {why}")

        if len(type_names) > 1:
            errors.append(f"{topic} has the types {' and '.join(type_names)}; set one of them (type: …)")
        else:
            try:
                made = planning.compile_rule(self._plan, forwarder.planned.rule, type_names[0], report)
            except (GraphError, InvalidRule) as error:
                errors.append(str(error))
            else:
                if not errors:
                    forwarder.set_type(made)
                    await self._restart(name)
        for why in errors:
            self._stats[name].record_error(why, self._clock())
        self._alert(f"type {name}", "; ".join(errors), active=bool(errors))

    def _report_silence(self, key: str, forwarder: TopicForwarder) -> None:
        now_s = self._clock()
        if now_s - self._silent_since_s.setdefault(key, now_s) >= SILENT_AFTER_S:
            TOPIC_SILENT.labels(key).set(1)
            topic = forwarder.planned.rule.topic
            words = f"no node publishes {topic} any more; start its node, or switch the rule off"
            self._alert(f"silent {key}", words, active=True)

    def _clear_silence(self, key: str) -> None:
        if self._silent_since_s.pop(key, None) is not None:
            TOPIC_SILENT.labels(key).set(0)
            self._alert(f"silent {key}", "", active=False)

    async def stop(self, name: str) -> None:
        """Stop the forwarder of a rule and clear the Alerts of its silent topics."""
        forwarder = self.get(name)
        if forwarder is None:
            return
        topics = list(forwarder.members) if isinstance(forwarder, PatternForwarder) else []
        await forwarder.stop()
        for key in (name, *(f"{name} {topic}" for topic in topics)):
            self._clear_silence(key)
