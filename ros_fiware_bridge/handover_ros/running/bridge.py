"""The bridge: runs every rule of a mapping between one ROS graph and one broker."""

import asyncio
import hashlib
from collections.abc import Sequence
from contextlib import AsyncExitStack, suppress
from functools import partial
from typing import Any, Self, cast

from handover.alerts.catalogue import ROS_PROBLEM
from handover.broker import BrokerClient, BrokerUnavailable
from handover.errors import HandoverError, Problem
from handover.runtime.background_tasks import BackgroundTasks
from handover.service_addresses import ROS_BRIDGE
from handover.settings import Settings
from handover.subscriptions.notifications import NotificationReceiver
from handover.telemetry import get_logger
from handover_ros.errors import GraphError
from handover_ros.graph.port import RosGraph
from handover_ros.metrics import CHECKS
from handover_ros.rules.entity_extractor import AlertState
from handover_ros.rules.plan import Plan, PlannedRosToNgsild
from handover_ros.running.alert_publisher import AlertPublisher
from handover_ros.running.broker_writer import BrokerWriter
from handover_ros.running.disabled_rules import DisabledRules
from handover_ros.running.entity_forwarder import EntityForwarder
from handover_ros.running.listener import Listeners
from handover_ros.running.parameters import Parameters
from handover_ros.running.ros_requests import ChangeTrigger, RosRequest, RosTaskPerformer
from handover_ros.running.rule_stats import DropReporter, RuleStats
from handover_ros.running.rule_view import RuleView
from handover_ros.running.served_services import ServedService
from handover_ros.running.topic_forwarder import PatternForwarder, TopicForwarder
from handover_ros.running.topic_rules import TopicRules

log = get_logger(__name__)

CHECK_INTERVAL_S = 1.0
MIN_LASTING_CHECKS = 3
"""A mismatch with a peer is reported after so many checks in a row: discovery takes a while."""


def _problem_key(text: str) -> str:
    return f"graph {hashlib.sha256(text.encode()).hexdigest()[:12]}"


class Bridge:
    """Runs the rules of a plan while it is entered as an asynchronous context manager.

    `url` is the address at which the broker reaches the bridge; `name` distinguishes the bridges of one
    factory. With `parameters` it serves the parameters of its node, where the adapter does not.
    """

    def __init__(
        self,
        plan: Plan,
        graph: RosGraph,
        broker: BrokerClient,
        settings: Settings,
        *,
        url: str,
        name: str = ROS_BRIDGE,
        parameters: bool = True,
    ) -> None:
        self.plan = plan
        self.graph = graph
        self.name = name
        self.settings = settings
        self.broker = broker
        self._serves_parameters = parameters
        self.stats = {rule: RuleStats(rule, section) for section, rule, _ in plan.document.mapping.rules()}
        self.topic_rules = TopicRules(
            plan, graph, self.stats, make=self._make_forwarder, restart=self._start, alert=self._alert
        )
        self.broker_writer = BrokerWriter(
            broker,
            plan.document.mapping.batch_ms / 1000,
            on_accepted=self.topic_rules.accepted,
            on_refused=self.topic_rules.refused,
            on_dropped=self.topic_rules.dropped,
        )
        self.drops = DropReporter(
            self.stats.values(),
            lambda rule, key, words: self._alert(f"{key} {rule}", words, active=True),
        )
        receiver = NotificationReceiver(name, settings, broker)
        self.listeners = Listeners(
            settings, broker, receiver, f"{url}/notifications", prefix=f"{name}-rule-", service=name
        )
        self.tasks = RosTaskPerformer(
            name,
            settings,
            broker,
            notify_url=f"{url}/notifications-of-tasks",
            on_outcome=self._report_outcome,
        )
        self.alerts = AlertPublisher(broker, settings)
        self._disabled_rules = DisabledRules(settings.data_dir / f"{name}.json")
        self._entity_forwarders: dict[str, EntityForwarder] = {}
        self._changes: dict[str, ChangeTrigger] = {}
        self._served: dict[str, ServedService] = {}
        self._problems: dict[str, int] = {}
        """The number of consecutive checks in which each problem of the graph was seen."""
        self._tasks = BackgroundTasks("ROS bridge")
        self._on = AsyncExitStack()

    async def __aenter__(self) -> Self:
        await self._make_rules()
        for name in self._disabled_rules.load():
            if name in self.stats:
                self.stats[name].enabled = False
        await self._on.enter_async_context(self.broker_writer)
        if self._serves_parameters:
            await self._on.enter_async_context(Parameters(self.graph, self._parameters))
        for name, stats in self.stats.items():
            if stats.enabled:
                await self._start(name)
            elif (listener := self.listeners.named(name)) is not None:
                listener.enabled = False
        if any(True for _ in self.tasks.resources()):
            await self._on.enter_async_context(self.tasks)
        await self._tasks.__aenter__()
        for loop in (self.listeners.run, self.alerts.run, self._supervise):
            self._tasks.start(loop)
        for change in self._changes.values():
            self._tasks.start(change.run)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()
        for name in self.stats:
            with suppress(GraphError):
                await self._stop(name)
        await self._on.aclose()
        with suppress(TimeoutError):
            async with asyncio.timeout(1.0):
                await self.listeners.unsubscribe()

    def _parameters(self) -> dict[str, bool | str]:
        rules = {f"rules.{name}.enabled": stats.enabled for name, stats in self.stats.items()}
        return {"mapping": self.plan.document.file, **rules}

    async def probe(self) -> None:
        """Return if the broker has the subscriptions of the bridge. Raises `BrokerUnavailable`."""
        if not self.listeners.subscribed:
            raise BrokerUnavailable(
                503, "Not subscribed", "the broker has not accepted the subscriptions yet"
            )
        if any(True for _ in self.tasks.resources()):
            await self.tasks.probe()

    async def switch(self, name: str, *, on: bool) -> None:
        """Switch a rule on or off; it stays so after a restart. Raises `Problem`."""
        if name not in self.stats:
            raise self._no_such_rule(name)
        off = {rule for rule, stats in self.stats.items() if not stats.enabled}
        self._disabled_rules.save(off - {name} if on else off | {name})
        stats = self.stats[name]
        if stats.enabled is not on:
            stats.enabled = on
            await (self._start if on else self._stop)(name)
            self.listeners.request_resync()

    def views(self) -> Sequence[RuleView]:
        """Return the view of every rule."""
        return [self.view(name) for name in self.stats]

    def view(self, name: str) -> RuleView:
        """Return the view of a rule: its statistics, source, target and peers. Raises `Problem`."""
        if name not in self.stats:
            raise self._no_such_rule(name)
        seen: dict[str, Any] = dict(self.stats[name].view(asyncio.get_running_loop().time()))
        seen |= self._details(name)
        return cast("RuleView", seen)

    def _no_such_rule(self, name: str) -> Problem:
        names = ", ".join(self.stats) or "none"
        return Problem.translated(
            404,
            "No such rule",
            "ros.no_such_rule",
            'there is no rule "{name}"; there are {known}',
            name=name,
            known=names,
        )

    def _details(self, name: str) -> dict[str, Any]:
        if (details := self.topic_rules.details(name)) is not None:
            return details
        if (entity_forwarder := self._entity_forwarders.get(name)) is not None:
            chosen = entity_forwarder.planned.selector
            return {
                "from": chosen.id or f"{chosen.type} {chosen.id_pattern or chosen.q or ''}".strip(),
                "to": str(entity_forwarder.planned.rule.topic),
                "type": entity_forwarder.planned.rule.type,
                "qos": str(entity_forwarder.planned.qos),
                "subscribers": sum(
                    publisher.subscribers() for publisher in entity_forwarder.publishers.values()
                ),
            }
        asks = {planned.name: planned for planned in self.plan.requests}
        if (asked := asks.get(name)) is not None:
            what = getattr(asked.rule, "service", None) or getattr(asked.rule, "action", None)
            by = f"{asked.rule.task} of {asked.resource}" if asked.rule.task else "a change"
            return {"from": by, "to": what, "type": asked.rule.type}
        served = self._served[name].planned.rule
        return {"from": served.service, "to": f"Task {served.task.definition}", "type": served.type}

    # How rules are made, started and stopped

    async def _make_rules(self) -> None:
        plan, graph = self.plan, self.graph
        for planned_entity_rule in plan.ngsild_to_ros:
            entity_forwarder = EntityForwarder(
                planned_entity_rule, self.stats[planned_entity_rule.name], graph, plan.settings
            )
            self._entity_forwarders[planned_entity_rule.name] = entity_forwarder
            self.listeners.add(entity_forwarder.listener)
        for planned in plan.requests:
            request = RosRequest(planned, self.stats[planned.name], graph)
            if planned.rule.when is not None:
                change = ChangeTrigger(
                    request, self.broker_writer.put, partial(self._report_call, planned.name)
                )
                self._changes[planned.name] = change
                self.listeners.add(change.listener)
            else:
                self.tasks.add(request)
                await self.tasks.act_for(planned.resource or "")
        self.topic_rules.create()
        for offer in plan.served_services:
            self._served[offer.name] = ServedService(
                offer, self.stats[offer.name], graph, self.broker, settings=self.settings, plan=plan
            )

    def _make_forwarder(self, planned: PlannedRosToNgsild) -> TopicForwarder:
        return TopicForwarder(
            planned,
            self.stats[planned.name],
            self.graph,
            put=self.broker_writer.put,
            publish_alert=self.alerts.publish,
            echoes=self.listeners,
        )

    def _startable(
        self, name: str
    ) -> "TopicForwarder | PatternForwarder | EntityForwarder | ServedService | None":
        return self.topic_rules.get(name) or self._entity_forwarders.get(name) or self._served.get(name)

    async def _start(self, name: str) -> None:
        rule = self._startable(name)
        if (listener := self.listeners.named(name)) is not None:
            listener.enabled = True
        if rule is not None:
            try:
                await rule.start()
            except HandoverError as error:
                self.stats[name].record_error(str(error), asyncio.get_running_loop().time())

    async def _stop(self, name: str) -> None:
        if (listener := self.listeners.named(name)) is not None:
            listener.enabled = False
        await self.topic_rules.stop(name)
        rule = self._entity_forwarders.get(name) or self._served.get(name)
        if rule is not None:
            await rule.stop()

    # Supervision

    async def _supervise(self) -> None:
        while True:
            await asyncio.sleep(CHECK_INTERVAL_S)
            await self.topic_rules.check()
            CHECKS.inc()
            self.drops.report(asyncio.get_running_loop().time())
            self._report_problems()

    def _report_call(self, name: str, why: str | None) -> None:
        words = f'the rule "{name}" could not call the graph: {why}' if why is not None else ""
        self._alert(f"call {name}", words, active=why is not None)

    def _report_outcome(self, name: str, why: str | None) -> None:
        """Raise an Alert for a Task with an unknown outcome; the next known one of the rule clears it."""
        words = (
            f'the outcome of a Task of the rule "{name}" is unknown: {why}; look at the robot, then retry or '
            "skip the Task"
        )
        self._alert(f"outcome {name}", words if why is not None else "", active=why is not None)

    def _report_problems(self) -> None:
        """Raise an Alert for each mismatch with a peer that lasts, and clear it afterwards."""
        seen = {str(problem) for problem in self.graph.problems()}
        for gone in self._problems.keys() - seen:
            if self._problems.pop(gone) >= MIN_LASTING_CHECKS:
                self._alert(_problem_key(gone), "", active=False)
        for text in seen:
            checks = self._problems[text] = self._problems.get(text, 0) + 1
            if checks == MIN_LASTING_CHECKS:
                self._alert(_problem_key(text), text, active=True)

    def _alert(self, key: str, description: str, *, active: bool) -> None:
        source = self.settings.entity_id("Device", self.name)
        severity = ROS_PROBLEM.severity.value
        state = AlertState(key, source, active, ROS_PROBLEM.category, description, severity=severity)
        self.alerts.publish(self.name, state)
