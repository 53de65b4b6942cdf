"""The bridge: every rule of a mapping at work, between one ROS graph and one broker."""

import asyncio
import secrets
from collections.abc import Coroutine, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from typing import Any, Self

from handover.broker import BrokerClient, BrokerUnavailable
from handover.errors import HandoverError, Problem
from handover.settings import Settings
from handover.telemetry import get_logger
from ros_fiware_bridge.errors import GraphError
from ros_fiware_bridge.graph.port import RosGraph
from ros_fiware_bridge.metrics import SILENT
from ros_fiware_bridge.rules import plan as planning
from ros_fiware_bridge.rules.definitions import WrongRule
from ros_fiware_bridge.rules.outbox import Letter
from ros_fiware_bridge.rules.outward import AlertNews
from ros_fiware_bridge.rules.plan import Plan
from ros_fiware_bridge.running.alert_desk import AlertDesk
from ros_fiware_bridge.running.asking import Asking, ChangeAsking, TaskAsking
from ros_fiware_bridge.running.incoming import Incoming
from ros_fiware_bridge.running.listener import Listeners
from ros_fiware_bridge.running.mailroom import Mailroom
from ros_fiware_bridge.running.memory import Memory
from ros_fiware_bridge.running.offering import Offering
from ros_fiware_bridge.running.outgoing import Outgoing
from ros_fiware_bridge.running.tally import Tally

log = get_logger(__name__)

LOOK_EVERY_S = 1.0
SILENT_AFTER_S = 5.0


class Bridge:
    """Rules at work; an asynchronous context manager while they are.

    `url` is where the broker reaches the bridge; `name` tells several bridges of one factory apart.
    """

    def __init__(
        self,
        plan: Plan,
        graph: RosGraph,
        broker: BrokerClient,
        settings: Settings,
        *,
        url: str,
        name: str = "ros-bridge",
    ) -> None:
        self.plan = plan
        self.graph = graph
        self.name = name
        self.settings = settings
        self.broker = broker
        self.tallies = {rule: Tally(rule, section) for section, rule, _ in plan.document.mapping.rules()}
        self.mailroom = Mailroom(
            broker,
            plan.document.mapping.batch_ms / 1000,
            refused=self._refused,
            dropped=lambda rule, number: self.tallies[rule].drop(number),
        )
        self.key = secrets.token_urlsafe(18)
        """What the broker shows when it notifies: a robot must not move because anybody says so."""
        self.listeners = Listeners(settings, broker, f"{url}/notifications/{self.key}", f"{name}-rule-")
        self.tasks = TaskAsking(name, settings, broker, notify_url=f"{url}/notifications-of-tasks")
        self.alerts = AlertDesk(broker, settings)
        self._memory = Memory(settings.data_dir / f"{name}.json")
        self._outgoing: dict[str, Outgoing] = {}
        self._incoming: dict[str, Incoming] = {}
        self._changes: dict[str, ChangeAsking] = {}
        self._offerings: dict[str, Offering] = {}
        self._silent_since_s: dict[str, float] = {}
        self._chores: list[asyncio.Task[None]] = []
        self._on = AsyncExitStack()

    async def __aenter__(self) -> Self:
        await self._make_rules()
        for name in self._memory.load():
            if name in self.tallies:
                self.tallies[name].enabled = False
        await self._on.enter_async_context(self.mailroom)
        for name, tally in self.tallies.items():
            if tally.enabled:
                await self._start(name)
            elif (listener := self.listeners.named(name)) is not None:
                listener.enabled = False
        if any(True for _ in self.tasks.resources()):
            await self._on.enter_async_context(self.tasks)
        self._do(self.listeners.keep())
        self._do(self.alerts.keep())
        self._do(self._look_around())
        for change in self._changes.values():
            self._do(change.keep())
        return self

    async def __aexit__(self, *_: object) -> None:
        for chore in self._chores:
            chore.cancel()
        await asyncio.gather(*self._chores, return_exceptions=True)
        for name in self.tallies:
            with suppress(GraphError):
                await self._stop(name)
        await self._on.aclose()
        with suppress(TimeoutError):
            async with asyncio.timeout(1.0):
                await self.listeners.unsubscribe()

    async def probe(self) -> None:
        """Return when the broker knows where to tell us of changes; raise if it does not."""
        if not self.listeners.subscribed:
            raise BrokerUnavailable(503, "Not subscribed", "the broker has not taken the subscriptions yet")
        if any(True for _ in self.tasks.resources()):
            await self.tasks.probe()

    async def switch(self, name: str, *, on: bool) -> None:
        """Switch a rule on or off, for good. Raises `Problem`."""
        if name not in self.tallies:
            raise self._no_such_rule(name)
        off = {rule for rule, tally in self.tallies.items() if not tally.enabled}
        self._memory.save(off - {name} if on else off | {name})
        tally = self.tallies[name]
        if tally.enabled is not on:
            tally.enabled = on
            await (self._start if on else self._stop)(name)
            self.listeners.wish()

    def views(self) -> Sequence[Mapping[str, Any]]:
        """Return what there is to say of every rule."""
        return [self.view(name) for name in self.tallies]

    def view(self, name: str) -> Mapping[str, Any]:
        """Return what there is to say of a rule. Raises `Problem`."""
        if name not in self.tallies:
            raise self._no_such_rule(name)
        seen = dict(self.tallies[name].view(asyncio.get_running_loop().time()))
        seen |= self._particulars(name)
        return seen

    def _no_such_rule(self, name: str) -> Problem:
        known = ", ".join(self.tallies) or "none"
        return Problem(404, "No such rule", f'there is no rule "{name}"; there are {known}')

    def _particulars(self, name: str) -> dict[str, Any]:
        if (outgoing := self._outgoing.get(name)) is not None:
            subscription = outgoing.subscription
            rule = outgoing.planned.rule
            return {
                "from": rule.topic,
                "to": str(rule.entity.id.with_settings(self.plan.settings)) if rule.entity else "Alert",
                "type": outgoing.outward.type_name if outgoing.outward else None,
                "qos": str(outgoing.planned.qos),
                "publishers": subscription.publishers() if subscription else 0,
                "unread": subscription.refused if subscription else 0,
                "lastUnread": subscription.last_error if subscription else None,
                "overtaken": subscription.dropped if subscription else 0,
            }
        if (incoming := self._incoming.get(name)) is not None:
            chosen = incoming.planned.selector
            return {
                "from": chosen.id or f"{chosen.type} {chosen.id_pattern or chosen.q or ''}".strip(),
                "to": str(incoming.planned.rule.topic),
                "type": incoming.planned.rule.type,
                "qos": str(incoming.planned.qos),
                "subscribers": sum(one.subscribers() for one in incoming.publishers.values()),
            }
        asks = {planned.name: planned for planned in self.plan.asks}
        if (asked := asks.get(name)) is not None:
            what = getattr(asked.rule, "service", None) or getattr(asked.rule, "action", None)
            by = f"{asked.rule.task} of {asked.resource}" if asked.rule.task else "a change"
            return {"from": by, "to": what, "type": asked.rule.type}
        offering = self._offerings[name].planned.rule
        return {"from": offering.service, "to": f"Task {offering.task.definition}", "type": offering.type}

    # How rules are made, started and stopped

    async def _make_rules(self) -> None:
        plan, graph = self.plan, self.graph
        for inward in plan.inward:
            incoming = Incoming(inward, self.tallies[inward.name], graph, plan.settings)
            self._incoming[inward.name] = incoming
            self.listeners.add(incoming.listener)
        for planned in plan.asks:
            asking = Asking(planned, self.tallies[planned.name], graph)
            if planned.rule.when is not None:
                change = ChangeAsking(asking, self.mailroom.put)
                self._changes[planned.name] = change
                self.listeners.add(change.listener)
            else:
                self.tasks.add(asking)
                await self.tasks.act_for(planned.resource or "")
        for outward in plan.outward:
            self._outgoing[outward.name] = Outgoing(
                outward,
                self.tallies[outward.name],
                graph,
                put=self.mailroom.put,
                announce=self.alerts.announce,
                echoes=self.listeners,
            )
        for offer in plan.offers:
            self._offerings[offer.name] = Offering(
                offer, self.tallies[offer.name], graph, self.broker, settings=self.settings, plan=plan
            )

    async def _start(self, name: str) -> None:
        rule = self._outgoing.get(name) or self._incoming.get(name) or self._offerings.get(name)
        if (listener := self.listeners.named(name)) is not None:
            listener.enabled = True
        if rule is not None:
            try:
                await rule.start()
            except HandoverError as error:
                self.tallies[name].fault(str(error), asyncio.get_running_loop().time())

    async def _stop(self, name: str) -> None:
        rule = self._outgoing.get(name) or self._incoming.get(name) or self._offerings.get(name)
        if (listener := self.listeners.named(name)) is not None:
            listener.enabled = False
        if rule is not None:
            await rule.stop()
        self._is_heard(name)

    def _refused(self, letter: Letter, why: str) -> None:
        self.tallies[letter.rule].fault(f"{letter.entity_id}: {why}", asyncio.get_running_loop().time())
        if (outgoing := self._outgoing.get(letter.rule)) is not None:
            outgoing.refused(letter)

    # What is looked after

    async def _look_around(self) -> None:
        """Every second: topics whose type is not known yet, topics gone silent, a broker that was away."""
        clock = asyncio.get_running_loop().time
        heard: set[str] = set()
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            for name, outgoing in self._outgoing.items():
                if not self.tallies[name].enabled:
                    continue
                if outgoing.outward is None:
                    await self._learn_type(name, outgoing)
                elif outgoing.subscription is not None:
                    if outgoing.subscription.publishers() > 0:
                        heard.add(name)
                        self._is_heard(name)
                    elif name in heard:
                        self._is_silent(name, outgoing, clock())
            self._tell_of_losses()

    async def _learn_type(self, name: str, outgoing: Outgoing) -> None:
        types = {topic.name: topic.type_names for topic in self.graph.topics()}
        found = types.get(outgoing.planned.rule.topic, ())
        if len(found) != 1:
            return
        wrong: list[str] = []

        def say(where: tuple[str, ...], why: WrongRule) -> None:
            wrong.append(f"{'.'.join(where)}: {why}")

        try:
            made = planning.outward(self.plan, outgoing.planned.rule, found[0], say)
        except (GraphError, WrongRule) as error:
            wrong.append(str(error))
        else:
            if not wrong:
                outgoing.know(made)
                await self._start(name)
        for why in wrong:
            self.tallies[name].fault(why, asyncio.get_running_loop().time())

    def _is_silent(self, name: str, outgoing: Outgoing, now_s: float) -> None:
        since_s = self._silent_since_s.setdefault(name, now_s)
        if now_s - since_s >= SILENT_AFTER_S:
            SILENT.labels(name).set(1)
            topic = outgoing.planned.rule.topic
            words = f"nobody speaks on {topic} any more; start the node that does, or switch the rule off"
            self._alert(f"silent {name}", words, standing=True)

    def _is_heard(self, name: str) -> None:
        if self._silent_since_s.pop(name, None) is not None:
            SILENT.labels(name).set(0)
            self._alert(f"silent {name}", "", standing=False)

    def _tell_of_losses(self) -> None:
        lost = self.mailroom.lost_while_away
        if lost and self.mailroom.away_since_s is None:
            self.mailroom.lost_while_away = 0
            words = f"while the broker was away {lost} updates gave way to newer ones"
            self._alert("broker away", words, standing=True)

    def _alert(self, key: str, description: str, *, standing: bool) -> None:
        source = self.settings.entity_id("Device", self.name)
        news = AlertNews(key, source, standing, "ros", description, severity="medium")
        self.alerts.announce(self.name, news)

    def _do(self, work: Coroutine[Any, Any, None]) -> None:
        chore = asyncio.create_task(work)
        chore.add_done_callback(self._done)
        self._chores.append(chore)

    def _done(self, chore: asyncio.Task[None]) -> None:
        if not chore.cancelled() and (error := chore.exception()) is not None:
            log.error("a chore of the bridge failed", exc_info=error)
