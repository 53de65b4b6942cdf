"""Requests to the ROS graph: a Task or a changed attribute calls a service or sends a goal to an action.

A request that was sent and not answered has an unknown outcome: its Task fails with that reason, and an Alert
says so, unless the rule permits to send it `again`. A goal that is given up is cancelled by the graph.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from handover.broker import BrokerClient
from handover.errors import HandoverError
from handover.job import Job, RequestedAction, TaskCancelled, TaskFailed
from handover.messages import message, text_of
from handover.performer import Performer
from handover.runtime.retry import Backoff
from handover.settings import Settings
from handover.tasks.outcomes import outcome_unknown
from handover.telemetry import get_logger
from handover_ros.errors import CallTimeout, GraphError, OutcomeUnknown
from handover_ros.graph.goals import result_text
from handover_ros.graph.port import Goal, GoalResult, GoalStatus, Message, RosGraph
from handover_ros.mapping import paths
from handover_ros.mapping.model import ActionGoal, Change, ServiceCall
from handover_ros.mapping.values import RESOURCE
from handover_ros.rules.attributes import MadeAttribute
from handover_ros.rules.change_tracker import scope_of
from handover_ros.rules.entity_extractor import MESSAGE_ERRORS
from handover_ros.rules.message_builder import Scope
from handover_ros.rules.outbox import Update
from handover_ros.rules.plan import PlannedRequest
from handover_ros.running.listener import Listener
from handover_ros.running.rule_stats import RuleStats

log = get_logger(__name__)

OnFeedback = Callable[[Mapping[str, Any]], None]
MAX_QUEUED = 16
CANCEL_TIMEOUT_S = 5.0
STOP_TIMEOUT_S = 10.0
"""A goal over its time limit ends so soon after its cancellation; otherwise its outcome is unknown."""
CANCEL_RETRY_S = 1.0


class RequestFailed(HandoverError):
    """A service or an action reported failure; `outputs` are its outputs."""

    def __init__(self, why: str, outputs: Mapping[str, Any]) -> None:
        super().__init__(why)
        self.outputs = outputs


@dataclass
class RosRequest:
    """A rule that calls a service or sends a goal; see `execute`."""

    planned: PlannedRequest
    stats: RuleStats
    graph: RosGraph

    async def execute(self, scope: Scope, on_feedback: OnFeedback, job: Job | None = None) -> dict[str, Any]:
        """Return the outputs.

        Raises `RequestFailed`, `TaskCancelled`, `OutcomeUnknown`, or another `HandoverError` if nothing was
        done.
        """
        clock = asyncio.get_running_loop().time
        self.stats.count_received(clock())
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
        except MESSAGE_ERRORS as error:
            self.stats.record_error(str(error), clock())
            raise error if isinstance(error, HandoverError) else HandoverError(str(error)) from error
        self.stats.count_forwarded(clock(), outputs)
        return outputs

    async def _goal(
        self, rule: ActionGoal, request: Message, on_feedback: OnFeedback, job: Job | None
    ) -> dict[str, Any]:
        client = await self.graph.action_client(rule.action, rule.type)
        try:
            sending = client.send_goal(
                request,
                on_feedback=lambda feedback: self._feed_back(feedback, on_feedback),
                timeout_s=rule.timeout_s,
            )
            goal = await _unless_cancelled(job, sending, rule.action)
            canceller = asyncio.create_task(_cancel_with_task(job, goal)) if job is not None else None
            try:
                ended = await goal.result(rule.result_timeout_s)
            except asyncio.CancelledError:
                with suppress(HandoverError, TimeoutError):  # the bridge stops, and so must the goal
                    await goal.cancel(1.0)
                raise
            except CallTimeout as late:
                ended = await self._stopped(goal, late)
            finally:
                if canceller is not None:
                    canceller.cancel()
            outputs = self._outputs(ended.result, rule, ended.status)
            if ended.status is GoalStatus.CANCELED:
                raise TaskCancelled("cancelled")
            return outputs
        finally:
            await client.close()  # which cancels a goal that has not ended

    async def _stopped(self, goal: Goal, late: CallTimeout) -> GoalResult:
        """Cancel a goal over its time limit; return its end if it succeeded meanwhile.

        Raises `RequestFailed` for one that has stopped, `OutcomeUnknown` for one that has not.
        """
        try:
            await goal.cancel(CANCEL_TIMEOUT_S)
            ended = await goal.result(STOP_TIMEOUT_S)
        except GraphError as error:
            raise OutcomeUnknown(f"{late}, was cancelled, and has not stopped: {error}") from error
        if ended.status is GoalStatus.SUCCEEDED:
            return ended
        raise RequestFailed(str(late), self._values(self.planned.outputs, ended.result))

    def _outputs(
        self, answer: Message, rule: ServiceCall | ActionGoal, status: GoalStatus | None
    ) -> dict[str, Any]:
        outputs = self._values(self.planned.outputs, answer)
        message = str(paths.getter(rule.message)(answer)) if rule.message is not None else result_text(answer)
        what = rule.service if isinstance(rule, ServiceCall) else rule.action
        if status is GoalStatus.CANCELED:
            return outputs
        if status not in {None, GoalStatus.SUCCEEDED}:
            raise RequestFailed(f"{what} gave up{_reason(message)}", outputs)
        if rule.success is not None and paths.getter(rule.success)(answer) is not True:
            raise RequestFailed(f"{what} did not succeed{_reason(message)}", outputs)
        return outputs

    def _feed_back(self, feedback: Message, on_feedback: OnFeedback) -> None:
        if values := self._values(self.planned.feedback, feedback):
            on_feedback(values)

    def _values(self, attributes: tuple[MadeAttribute, ...], answer: Message) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for attribute in attributes:
            try:
                values[attribute.name] = attribute.make(answer)
            except MESSAGE_ERRORS as error:
                self.stats.record_error(f"{attribute.name}: {error}", asyncio.get_running_loop().time())
        return values


async def _cancelled(job: Job) -> None:
    """Wait until the Task is cancelled."""
    while job.requested_action is not RequestedAction.CANCEL:
        await job.changed(since=job.requested_action)


async def _unless_cancelled(job: Job | None, sending: Coroutine[Any, Any, Goal], action: str) -> Goal:
    """Wait until a goal is accepted; after the cancellation of its Task no longer than a moment."""
    if job is None:
        return await sending
    accepted, cancelled = asyncio.create_task(sending), asyncio.create_task(_cancelled(job))
    try:
        await asyncio.wait([accepted, cancelled], return_when=asyncio.FIRST_COMPLETED)
        if not accepted.done():
            await asyncio.wait([accepted], timeout=CANCEL_TIMEOUT_S)
        if accepted.done():
            return accepted.result()
        raise OutcomeUnknown(f"{action}: the Task was cancelled before the server answered")
    finally:
        cancelled.cancel()
        accepted.cancel()
        await asyncio.wait([accepted])


async def _cancel_with_task(job: Job, goal: Goal) -> None:
    """Cancel the goal when the Task is cancelled; repeat the request until the goal has ended."""
    await _cancelled(job)
    backoff = Backoff(CANCEL_RETRY_S, CANCEL_RETRY_S)
    while True:
        try:
            if await goal.cancel(CANCEL_TIMEOUT_S):
                return
        except HandoverError as error:
            log.warning("cancelling a goal failed, retrying", task=job.task.id, error=str(error))
        await backoff.wait()


def _reason(message: str) -> str:
    return f": {message}" if message else ""


class RosTaskPerformer(Performer):
    """Performs the Tasks that a rule maps to a service or an action.

    `on_outcome` is called with a rule and the reason of an unknown outcome, or None for a known one.
    """

    def __init__(
        self,
        name: str,
        settings: Settings,
        broker: BrokerClient,
        *,
        notify_url: str,
        on_outcome: Callable[[str, str | None], None],
    ) -> None:
        super().__init__(name, settings, broker, notify_url=notify_url)
        self._on_outcome = on_outcome
        self._requests: dict[tuple[str, str], RosRequest] = {}

    def add(self, request: RosRequest) -> None:
        """Perform the Tasks of one more rule."""
        planned = request.planned
        assert planned.resource is not None and planned.rule.task is not None  # noqa: S101, PT018 - a Task's rule
        self._requests[planned.resource, planned.rule.task] = request

    async def may_repeat(self, job: Job) -> bool:  # noqa: ARG002
        """Return True: `perform` sends again only what the rule permits, and says what was interrupted."""
        return True

    async def perform(self, job: Job) -> Mapping[str, Any]:
        """Perform the Task by its rule; return the outputs."""
        request = self._request_for(job)
        rule = request.planned.rule
        if job.resumed and not rule.again:
            raise self._unknown(job, request, _interrupted(rule))

        def on_feedback(feedback: Mapping[str, Any]) -> None:
            others = {name: value for name, value in feedback.items() if name != "progress"}
            job.report_progress(_fraction(feedback.get("progress")), **others)

        await job.checkpoint()
        values = {**job.parameters, "taskId": job.task.id, "id": job.task.id.rsplit(":", 1)[-1]}
        try:
            if request.planned.reads_resource:
                values[RESOURCE] = scope_of(await self.broker.retrieve(job.resource), 0.0).values
            await job.checkpoint()  # nothing is sent without the lease
            outputs = await request.execute(Scope(values), on_feedback, job)
        except RequestFailed as failure:
            self._on_outcome(request.planned.name, None)
            raise TaskFailed(text_of(failure), **failure.outputs) from failure
        except TaskCancelled:
            self._on_outcome(request.planned.name, None)
            raise
        except OutcomeUnknown as error:
            if rule.again:
                raise TaskFailed(text_of(error)) from error
            raise self._unknown(job, request, text_of(error)) from error
        except HandoverError as error:
            raise TaskFailed(text_of(error)) from error
        self._on_outcome(request.planned.name, None)
        return outputs

    def _unknown(self, job: Job, request: RosRequest, why: str) -> TaskFailed:
        self._on_outcome(request.planned.name, f"{job.task.id}: {why}")
        return TaskFailed(outcome_unknown(why))

    def _request_for(self, job: Job) -> RosRequest:
        """Return the request of the Task's operation; raise `TaskFailed` without an enabled rule."""
        named = job.parameters.get("operation")
        operation = str(named) if named is not None else job.task.is_defined_by.object.rsplit(":", 1)[-1]
        request = self._requests.get((job.resource, operation))
        if request is None:
            tasks = ", ".join(task for resource, task in self._requests if resource == job.resource)
            raise TaskFailed.translated(
                "ros.no_rule_for_operation",
                'the ROS bridge has no rule for "{operation}" of {resource}; it has rules for {known}',
                operation=operation,
                resource=job.resource,
                known=tasks,
            )
        if not request.stats.enabled:
            raise TaskFailed.translated(
                "ros.rule_disabled",
                'the rule "{rule}" of the ROS bridge is switched off',
                rule=request.stats.name,
            )
        return request


def _interrupted(rule: ServiceCall | ActionGoal) -> str:
    if isinstance(rule, ActionGoal):
        return message(
            "ros.goal_interrupted",
            "the ROS bridge stopped while {action} was active; such a goal is not sent again",
            action=rule.action,
        )
    return message(
        "ros.call_interrupted",
        "the ROS bridge stopped while it called {service}; such a call is not sent again",
        service=rule.service,
    )


def _fraction(progress: Any) -> float:
    return float(progress) if isinstance(progress, int | float) else 0.0


class ChangeTrigger:
    """Sends a request whenever an attribute changes: one at a time; a full queue drops the oldest.

    `on_result` is called with the reason of a failed request, and with None after one that succeeded.
    """

    def __init__(
        self, request: RosRequest, put: Callable[[Update], None], on_result: Callable[[str | None], None]
    ) -> None:
        change = request.planned.rule.when
        assert change is not None  # noqa: S101 - a rule of changes
        assert request.planned.selector is not None  # noqa: S101
        self.request = request
        self._change: Change = change
        self._put = put
        self._on_result = on_result
        self._queue: deque[Scope] = deque()
        self._has_pending = asyncio.Event()
        self.listener = Listener(
            request.planned.name,
            request.planned.selector,
            {change.attribute},
            self._take,
            at_start=False,
            on_error=lambda why: request.stats.record_error(why, asyncio.get_running_loop().time()),
        )

    async def run(self) -> None:
        """Send the queued requests until cancelled."""
        while True:
            while not self._queue:
                self._has_pending.clear()
                await self._has_pending.wait()
            scope = self._queue.popleft()
            try:
                outputs = await self.request.execute(scope, partial(self._write, scope))
            except RequestFailed as failure:
                outputs = dict(failure.outputs)
                self._on_result(f"{scope.values['entityId']}: {failure}")
            except (HandoverError, TaskCancelled) as error:
                log.info("call for a changed attribute failed", rule=self.request.stats.name, why=str(error))
                self._on_result(f"{scope.values['entityId']}: {error}")
                continue
            else:
                self._on_result(None)
            self._write(scope, outputs)

    def _take(self, _: Mapping[str, Any], scope: Scope) -> None:
        has_condition = "equals" in self._change.model_fields_set
        if has_condition and scope.values.get(self._change.attribute) != self._change.equals:
            return
        if len(self._queue) >= MAX_QUEUED:
            self._queue.popleft()
            self.request.stats.count_dropped("queue_full")
        self._queue.append(scope)
        self._has_pending.set()

    def _write(self, scope: Scope, outputs: Mapping[str, Any]) -> None:
        planned = self.request.planned
        planned_of = {attribute.name: attribute for attribute in (*planned.outputs, *planned.feedback)}
        attributes = {
            name: planned_of[name].written(value, None)
            for name, value in outputs.items()
            if name in planned_of
        }
        if attributes:
            entity_id, kind = str(scope.values["entityId"]), str(scope.values["type"])
            self._put(Update(self.request.stats.name, entity_id, kind, attributes, create=False))
