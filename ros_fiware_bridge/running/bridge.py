"""The bridge: every rule of a mapping at work, between one ROS graph and one broker."""

import asyncio
import hashlib
from collections.abc import Coroutine, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from functools import partial
from typing import Any, Self

from handover.broker import BrokerClient, BrokerUnavailable
from handover.errors import HandoverError, Problem
from handover.messages import message
from handover.notifications import NotificationReceiver
from handover.settings import Settings
from handover.telemetry import get_logger
from ros_fiware_bridge.errors import GraphError
from ros_fiware_bridge.graph.port import RosGraph
from ros_fiware_bridge.metrics import SILENT
from ros_fiware_bridge.rules import plan as planning
from ros_fiware_bridge.rules.definitions import WrongRule
from ros_fiware_bridge.rules.outbox import Letter
from ros_fiware_bridge.rules.outward import AlertNews
from ros_fiware_bridge.rules.plan import Plan, PlannedOutward
from ros_fiware_bridge.running.alert_desk import AlertDesk
from ros_fiware_bridge.running.asking import Asking, ChangeAsking, TaskAsking
from ros_fiware_bridge.running.fleet import Fleet
from ros_fiware_bridge.running.incoming import Incoming
from ros_fiware_bridge.running.listener import Listeners
from ros_fiware_bridge.running.losses import Losses
from ros_fiware_bridge.running.mailroom import Mailroom
from ros_fiware_bridge.running.memory import Memory
from ros_fiware_bridge.running.offering import Offering
from ros_fiware_bridge.running.outgoing import Outgoing
from ros_fiware_bridge.running.parameters import Parameters
from ros_fiware_bridge.running.tally import Tally

log = get_logger(__name__)

LOOK_EVERY_S = 1.0
SILENT_AFTER_S = 5.0


LASTING_LOOKS = 3
"""A mismatch with a peer that is seen in so many looks in a row is no matter of discovery."""


def _problem_key(text: str) -> str:
    return f"graph {hashlib.sha256(text.encode()).hexdigest()[:12]}"


class Bridge:
    """Rules at work; an asynchronous context manager while they are.

    `url` is where the broker reaches the bridge; `name` tells several bridges of one factory apart; with
    `parameters` it serves those of its node, which the adapter does not.
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
        parameters: bool = True,
    ) -> None:
        self.plan = plan
        self.graph = graph
        self.name = name
        self.settings = settings
        self.broker = broker
        self._serves_parameters = parameters
        self.tallies = {rule: Tally(rule, section) for section, rule, _ in plan.document.mapping.rules()}
        self.mailroom = Mailroom(
            broker,
            plan.document.mapping.batch_ms / 1000,
            taken=self._taken,
            refused=self._refused,
            dropped=self._dropped,
        )
        self.losses = Losses(
            self.tallies.values(),
            lambda rule, key, words: self._alert(f"{key} {rule}", words, standing=True),
        )
        receiver = NotificationReceiver(name, settings, broker)
        self.listeners = Listeners(settings, broker, receiver, f"{url}/notifications", f"{name}-rule-")
        self.tasks = TaskAsking(name, settings, broker, notify_url=f"{url}/notifications-of-tasks")
        self.alerts = AlertDesk(broker, settings)
        self._memory = Memory(settings.data_dir / f"{name}.json")
        self._outgoing: dict[str, Outgoing] = {}
        self._fleets: dict[str, Fleet] = {}
        self._incoming: dict[str, Incoming] = {}
        self._changes: dict[str, ChangeAsking] = {}
        self._offerings: dict[str, Offering] = {}
        self._silent_since_s: dict[str, float] = {}
        self._problems: dict[str, int] = {}
        """In how many looks in a row each problem of the graph was seen."""
        self._chores: list[asyncio.Task[None]] = []
        self._on = AsyncExitStack()

    async def __aenter__(self) -> Self:
        await self._make_rules()
        for name in self._memory.load():
            if name in self.tallies:
                self.tallies[name].enabled = False
        await self._on.enter_async_context(self.mailroom)
        if self._serves_parameters:
            await self._on.enter_async_context(Parameters(self.graph, self._parameters))
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

    def _parameters(self) -> dict[str, bool | str]:
        rules = {f"rules.{name}.enabled": tally.enabled for name, tally in self.tallies.items()}
        return {"mapping": self.plan.document.file, **rules}

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
        return Problem(
            404,
            "No such rule",
            message(
                "ros.no_such_rule", 'there is no rule "{name}"; there are {known}', name=name, known=known
            ),
        )

    def _particulars(self, name: str) -> dict[str, Any]:
        if (fleet := self._fleets.get(name)) is not None:
            rule = fleet.planned.rule
            read = [one.subscription for one in fleet.members.values() if one.subscription is not None]
            return {
                "from": rule.topic,
                "to": str(rule.entity.id.with_settings(self.plan.settings)) if rule.entity else "Alert",
                "type": rule.type,
                "qos": str(read[0].qos if read else fleet.planned.qos),
                "topics": sorted(fleet.members),
                "publishers": sum(one.publishers() for one in read),
                "unread": sum(one.refused for one in read),
                "lastUnread": next((one.last_error for one in read if one.last_error), None),
            }
        if (outgoing := self._outgoing.get(name)) is not None:
            subscription = outgoing.subscription
            rule = outgoing.planned.rule
            return {
                "from": rule.topic,
                "to": str(rule.entity.id.with_settings(self.plan.settings)) if rule.entity else "Alert",
                "type": outgoing.outward.type_name if outgoing.outward else None,
                "qos": str(subscription.qos if subscription else outgoing.planned.qos),
                "publishers": subscription.publishers() if subscription else 0,
                "unread": subscription.refused if subscription else 0,
                "lastUnread": subscription.last_error if subscription else None,
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
                change = ChangeAsking(asking, self.mailroom.put, partial(self._call_fails, planned.name))
                self._changes[planned.name] = change
                self.listeners.add(change.listener)
            else:
                self.tasks.add(asking)
                await self.tasks.act_for(planned.resource or "")
        for outward in plan.outward:
            if outward.pattern is not None:
                self._fleets[outward.name] = Fleet(outward, plan, graph, self._made_outgoing)
            else:
                self._outgoing[outward.name] = self._made_outgoing(outward)
        for offer in plan.offers:
            self._offerings[offer.name] = Offering(
                offer, self.tallies[offer.name], graph, self.broker, settings=self.settings, plan=plan
            )

    def _made_outgoing(self, planned: PlannedOutward) -> Outgoing:
        return Outgoing(
            planned,
            self.tallies[planned.name],
            self.graph,
            put=self.mailroom.put,
            announce=self.alerts.announce,
            echoes=self.listeners,
        )

    def _outgoing_of(self, rule: str) -> Sequence[Outgoing]:
        """Return what is at work for a rule from ROS to NGSI-LD."""
        if (fleet := self._fleets.get(rule)) is not None:
            return list(fleet.members.values())
        return [self._outgoing[rule]] if rule in self._outgoing else []

    def _startable(self, name: str) -> "Outgoing | Fleet | Incoming | Offering | None":
        outgoing = self._outgoing.get(name) or self._fleets.get(name)
        return outgoing or self._incoming.get(name) or self._offerings.get(name)

    async def _start(self, name: str) -> None:
        rule = self._startable(name)
        if (listener := self.listeners.named(name)) is not None:
            listener.enabled = True
        if rule is not None:
            try:
                await rule.start()
            except HandoverError as error:
                self.tallies[name].fault(str(error), asyncio.get_running_loop().time())

    async def _stop(self, name: str) -> None:
        rule = self._startable(name)
        if (listener := self.listeners.named(name)) is not None:
            listener.enabled = False
        silent = [name, *(f"{name} {topic}" for topic in rule.members)] if isinstance(rule, Fleet) else [name]
        if rule is not None:
            await rule.stop()
        for key in silent:
            self._is_heard(key)

    def _taken(self, letter: Letter) -> None:
        if letter.shown is not None:
            for outgoing in self._outgoing_of(letter.rule)[:1]:  # any of them counts for the rule
                outgoing.taken(letter)

    def _dropped(self, rule: str, number: int, cause: str) -> None:
        if any(one.planned.rule.buffer.keep > 1 for one in self._outgoing_of(rule)):
            self.tallies[rule].lose(cause, number)
        else:
            self.tallies[rule].conflate(number)

    def _refused(self, letter: Letter, why: str) -> None:
        self.tallies[letter.rule].fault(f"{letter.entity_id}: {why}", asyncio.get_running_loop().time())
        self.tallies[letter.rule].lose("refused")
        for outgoing in self._outgoing_of(letter.rule):
            outgoing.refused(letter)

    # What is looked after

    async def _look_around(self) -> None:
        """Every second: topics whose type is not known yet, topics gone silent, a broker that was away."""
        clock = asyncio.get_running_loop().time
        heard: set[str] = set()
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            for name, fleet in self._fleets.items():
                if self.tallies[name].enabled:
                    await self._look_for_robots(name, fleet, heard)
            for name, outgoing in self._outgoing.items():
                if not self.tallies[name].enabled:
                    continue
                outgoing.count_losses()
                if outgoing.planned.match:
                    await self._match(name, outgoing)
                if outgoing.outward is None:
                    await self._learn_type(name, outgoing)
                elif outgoing.subscription is not None:
                    if outgoing.subscription.publishers() > 0:
                        heard.add(name)
                        self._is_heard(name)
                    elif name in heard:
                        self._is_silent(name, outgoing, clock())
            self.losses.look(clock())
            self._report_problems()

    async def _look_for_robots(self, name: str, fleet: Fleet, heard: set[str]) -> None:
        clock = asyncio.get_running_loop().time
        try:
            await fleet.look()
        except GraphError as error:
            self.tallies[name].fault(str(error), clock())
        for topic, member in tuple(fleet.members.items()):  # a rule may be switched on or off meanwhile
            key = f"{name} {topic}"
            member.count_losses()
            if member.planned.match:
                await self._match(name, member)
            if member.subscription is not None and member.subscription.publishers() > 0:
                heard.add(key)
                self._is_heard(key)
            elif key in heard:
                self._is_silent(key, member, clock())

    async def _match(self, name: str, outgoing: Outgoing) -> None:
        try:
            await outgoing.match()
        except GraphError as error:
            self.tallies[name].fault(str(error), asyncio.get_running_loop().time())

    async def _learn_type(self, name: str, outgoing: Outgoing) -> None:
        types = {topic.name: topic.type_names for topic in self.graph.topics()}
        topic = outgoing.planned.rule.topic
        found = types.get(topic, ())
        if not found:
            return
        wrong: list[str] = []
        if len(found) > 1:
            wrong.append(f"{topic} has the types {' and '.join(found)}; say which (type: …)")
            self._wrong_type(name, wrong)
            return

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
        self._wrong_type(name, wrong)

    def _wrong_type(self, name: str, wrong: Sequence[str]) -> None:
        for why in wrong:
            self.tallies[name].fault(why, asyncio.get_running_loop().time())
        self._alert(f"type {name}", "; ".join(wrong), standing=bool(wrong))

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

    def _call_fails(self, name: str, why: str | None) -> None:
        words = f'the rule "{name}" could not call the graph: {why}' if why is not None else ""
        self._alert(f"call {name}", words, standing=why is not None)

    def _report_problems(self) -> None:
        """Raise an Alert for each mismatch with a peer that lasts, and clear it when it is gone."""
        seen = {str(problem) for problem in self.graph.problems()}
        for gone in self._problems.keys() - seen:
            if self._problems.pop(gone) >= LASTING_LOOKS:
                self._alert(_problem_key(gone), "", standing=False)
        for text in seen:
            looks = self._problems[text] = self._problems.get(text, 0) + 1
            if looks == LASTING_LOOKS:
                self._alert(_problem_key(text), text, standing=True)

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
