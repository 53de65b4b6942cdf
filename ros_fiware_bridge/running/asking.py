"""Asking: a Task, or an attribute that changes, calls a service or sends a goal to an action of the graph."""

import asyncio
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from handover.broker import BrokerClient
from handover.errors import HandoverError
from handover.job import Job, RequestedAction, TaskCancelled, TaskFailed
from handover.messages import message, text_of
from handover.performer import Performer
from handover.settings import Settings
from handover.telemetry import get_logger
from ros_fiware_bridge.graph.port import Goal, GoalStatus, Message, RosGraph
from ros_fiware_bridge.mapping import paths
from ros_fiware_bridge.mapping.model import ActionGoal, Change, ServiceCall
from ros_fiware_bridge.rules.attributes import MadeAttribute
from ros_fiware_bridge.rules.inward import Scope
from ros_fiware_bridge.rules.outbox import Letter
from ros_fiware_bridge.rules.outward import SURVIVED
from ros_fiware_bridge.rules.plan import PlannedAsk
from ros_fiware_bridge.running.listener import Listener
from ros_fiware_bridge.running.tally import Tally

log = get_logger(__name__)

OnFeedback = Callable[[Mapping[str, Any]], None]
MOST_WAITING = 16
CANCEL_WITHIN_S = 5.0


class NoSuccess(HandoverError):
    """A service or an action has answered, and the answer is no; `outputs` are what it told all the same."""

    def __init__(self, why: str, outputs: Mapping[str, Any]) -> None:
        super().__init__(why)
        self.outputs = outputs


@dataclass
class Asking:
    """A rule that asks the graph for something."""

    planned: PlannedAsk
    tally: Tally
    graph: RosGraph

    async def ask(self, scope: Scope, on_feedback: OnFeedback, job: Job | None = None) -> dict[str, Any]:
        """Ask, and return the outputs. Raises `NoSuccess`, `TaskCancelled`, or another `HandoverError`."""
        clock = asyncio.get_running_loop().time
        self.tally.hear(clock())
        try:
            request = self.planned.request.message(scope)
            rule = self.planned.rule
            if isinstance(rule, ServiceCall):
                answer = await self.graph.call(rule.service, rule.type, request, rule.timeout_s)
                outputs = self._outputs(answer, rule, None)
            else:
                outputs = await self._goal(rule, request, on_feedback, job)
        except TaskCancelled:
            raise
        except SURVIVED as error:
            self.tally.fault(str(error), clock())
            raise error if isinstance(error, HandoverError) else HandoverError(str(error)) from error
        self.tally.tell(clock(), outputs)
        return outputs

    async def _goal(
        self, rule: ActionGoal, request: Message, on_feedback: OnFeedback, job: Job | None
    ) -> dict[str, Any]:
        client = await self.graph.action_client(rule.action, rule.type)
        try:
            goal = await client.send_goal(
                request, on_feedback=lambda told: self._feed_back(told, on_feedback), timeout_s=rule.timeout_s
            )
            result = asyncio.ensure_future(goal.result(rule.result_timeout_s))
            steering = asyncio.create_task(_cancelled_by(job, goal)) if job is not None else None
            try:
                ended = await result
            except asyncio.CancelledError:
                with suppress(HandoverError, TimeoutError):  # the bridge ends; so does what it began
                    await goal.cancel(1.0)
                raise
            except HandoverError:  # the Task fails, so the robot must not go on with it
                with suppress(HandoverError, TimeoutError):
                    await goal.cancel(CANCEL_WITHIN_S)
                raise
            finally:
                if steering is not None:
                    steering.cancel()
                result.cancel()
            outputs = self._outputs(ended.result, rule, ended.status)
            if ended.status is GoalStatus.CANCELED:
                raise TaskCancelled("cancelled")
            return outputs
        finally:
            await client.close()

    def _outputs(
        self, answer: Message, rule: ServiceCall | ActionGoal, status: GoalStatus | None
    ) -> dict[str, Any]:
        outputs = self._made(self.planned.outputs, answer)
        message = str(paths.getter(rule.message)(answer)) if rule.message is not None else ""
        what = rule.service if isinstance(rule, ServiceCall) else rule.action
        if status is GoalStatus.CANCELED:
            return outputs
        if status not in {None, GoalStatus.SUCCEEDED}:
            raise NoSuccess(f"{what} gave up{_because(message)}", outputs)
        if rule.success is not None and paths.getter(rule.success)(answer) is not True:
            raise NoSuccess(f"{what} did not succeed{_because(message)}", outputs)
        return outputs

    def _feed_back(self, told: Message, on_feedback: OnFeedback) -> None:
        if made := self._made(self.planned.feedback, told):
            on_feedback(made)

    def _made(self, attributes: tuple[MadeAttribute, ...], answer: Message) -> dict[str, Any]:
        made: dict[str, Any] = {}
        for attribute in attributes:
            try:
                made[attribute.name] = attribute.make(answer)
            except SURVIVED as error:
                self.tally.fault(f"{attribute.name}: {error}", asyncio.get_running_loop().time())
        return made


async def _cancelled_by(job: Job, goal: Goal) -> None:
    """Cancel the goal once the Task is not wanted any more; asked again until the goal has ended."""
    while job.requested_action is not RequestedAction.CANCEL:
        await job.changed()
    while True:
        try:
            if await goal.cancel(CANCEL_WITHIN_S):
                return
        except HandoverError as error:
            log.warning("a goal could not be cancelled yet", task=job.task.id, error=str(error))
        await asyncio.sleep(1.0)


def _because(message: str) -> str:
    return f": {message}" if message else ""


class TaskAsking(Performer):
    """Performs the Tasks for which a rule asks the graph for something."""

    def __init__(self, name: str, settings: Settings, broker: BrokerClient, *, notify_url: str) -> None:
        super().__init__(name, settings, broker, notify_url=notify_url)
        self._askings: dict[tuple[str, str], Asking] = {}

    def add(self, asking: Asking) -> None:
        """Have one more kind of Task performed."""
        planned = asking.planned
        assert planned.resource is not None and planned.rule.task is not None  # noqa: S101, PT018 - a Task's rule
        self._askings[planned.resource, planned.rule.task] = asking

    async def perform(self, job: Job) -> Mapping[str, Any]:
        """Do what the Task asks, by the rule for it; return what was answered."""
        named = job.parameters.get("operation")
        operation = str(named) if named is not None else job.task.is_defined_by.object.rsplit(":", 1)[-1]
        asking = self._askings.get((job.resource, operation))
        if asking is None:
            known = ", ".join(task for resource, task in self._askings if resource == job.resource)
            raise TaskFailed(
                message(
                    "ros.no_rule_for_operation",
                    'no rule of the ROS bridge does "{operation}" for {resource}; they do {known}',
                    operation=operation,
                    resource=job.resource,
                    known=known,
                )
            )
        if not asking.tally.enabled:
            raise TaskFailed(
                message(
                    "ros.rule_disabled",
                    'the rule "{rule}" of the ROS bridge is switched off',
                    rule=asking.tally.name,
                )
            )
        rule = asking.planned.rule
        if job.resumed and isinstance(rule, ActionGoal) and not rule.again:
            raise TaskFailed(
                message(
                    "ros.goal_interrupted",
                    "the ROS bridge was ended while {action} worked on this; such a goal is not sent again",
                    action=rule.action,
                )
            )
        loop = asyncio.get_running_loop()
        chores: set[asyncio.Task[None]] = set()

        def on_feedback(told: Mapping[str, Any]) -> None:
            others = {name: value for name, value in told.items() if name != "progress"}
            chore = loop.create_task(job.progress(_fraction(told.get("progress")), **others))
            chores.add(chore)
            chore.add_done_callback(chores.discard)

        await job.checkpoint()
        scope = Scope({**job.parameters, "taskId": job.task.id, "id": job.task.id.rsplit(":", 1)[-1]})
        try:
            return await asking.ask(scope, on_feedback, job)
        except NoSuccess as no:
            raise TaskFailed(text_of(no), **no.outputs) from no
        except TaskCancelled:
            raise
        except HandoverError as error:
            raise TaskFailed(text_of(error)) from error


def _fraction(told: Any) -> float:
    return float(told) if isinstance(told, int | float) else 0.0


class ChangeAsking:
    """Asks the graph whenever an attribute changes: one after another, the oldest giving way to many.

    `failing` is called with why a call failed, and with None once one has succeeded.
    """

    def __init__(
        self, asking: Asking, put: Callable[[Letter], None], failing: Callable[[str | None], None]
    ) -> None:
        change = asking.planned.rule.when
        assert change is not None  # noqa: S101 - a rule of changes
        assert asking.planned.selector is not None  # noqa: S101
        self.asking = asking
        self._change: Change = change
        self._put = put
        self._failing = failing
        self._waiting: deque[Scope] = deque()
        self._something = asyncio.Event()
        self.listener = Listener(
            asking.planned.name,
            asking.planned.selector,
            {change.attribute},
            self._take,
            at_start=False,
            complain=lambda why: asking.tally.fault(why, asyncio.get_running_loop().time()),
        )

    async def keep(self) -> None:
        """Work through what waits until cancelled."""
        while True:
            while not self._waiting:
                self._something.clear()
                await self._something.wait()
            scope = self._waiting.popleft()
            try:
                outputs = await self.asking.ask(scope, lambda told, scope=scope: self._write(scope, told))  # type: ignore[misc]  # mypy does not see the default
            except NoSuccess as no:
                outputs = dict(no.outputs)
                self._failing(f"{scope.values['entityId']}: {no}")
            except (HandoverError, TaskCancelled) as error:
                log.info("call for a changed attribute failed", rule=self.asking.tally.name, why=str(error))
                self._failing(f"{scope.values['entityId']}: {error}")
                continue
            else:
                self._failing(None)
            self._write(scope, outputs)

    def _take(self, _: Mapping[str, Any], scope: Scope) -> None:
        wanted = "equals" in self._change.model_fields_set
        if wanted and scope.values.get(self._change.attribute) != self._change.equals:
            return
        if len(self._waiting) >= MOST_WAITING:
            self._waiting.popleft()
            self.asking.tally.lose("queue_full")
        self._waiting.append(scope)
        self._something.set()

    def _write(self, scope: Scope, outputs: Mapping[str, Any]) -> None:
        made = {one.name: one for one in (*self.asking.planned.outputs, *self.asking.planned.feedback)}
        attributes = {
            name: made[name].written(value, None) for name, value in outputs.items() if name in made
        }
        if attributes:
            entity_id, kind = str(scope.values["entityId"]), str(scope.values["type"])
            self._put(Letter(self.asking.tally.name, entity_id, kind, attributes, create=False))
