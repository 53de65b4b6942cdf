"""Sends goals: an action consists of three services and two topics."""

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any, Protocol

from handover_ros.errors import GoalRefused, OutcomeUnknown
from handover_ros.graph.cyclone.service_client import CycloneClient
from handover_ros.graph.goals import goal_forgotten, result_within
from handover_ros.graph.own_goals import OwnGoals
from handover_ros.graph.port import GoalResult, GoalStatus, Message, Received, Subscription
from handover_ros.graph.qos import DEFAULT, LATCHED, Qos
from handover_ros.types.wrappers import CANCEL_GOAL, GOAL_STATUS_ARRAY

OnFeedback = Callable[[Message], None]


class ActionClientTransport(Protocol):
    """Creates the services and topics of an action; see `CycloneGraph`."""

    goals: OwnGoals

    def client(self, service: str, base: str) -> CycloneClient:
        """Return the client of a service."""

    async def subscribe(
        self, topic: str, type_name: str, on_message: Callable[[Received], None], qos: Qos = DEFAULT
    ) -> Subscription:
        """Subscribe to a topic."""


class CycloneGoal:
    """An accepted goal; see `port.Goal`."""

    def __init__(self, client: "CycloneActionClient", goal_id: bytes) -> None:
        self.goal_id = goal_id
        self.server: bytes | None = None
        """The participant that accepted the goal."""
        self._client = client
        self._status = GoalStatus.ACCEPTED
        self._result: asyncio.Task[GoalResult] | None = None

    @property
    def status(self) -> GoalStatus:
        return self._status

    def set_status(self, status: GoalStatus) -> None:
        """Set the reported state; the state of an ended goal is final."""
        if not self._status.is_over:
            self._status = status

    async def result(self, timeout_s: float | None = None) -> GoalResult:
        if self._result is None or (self._result.done() and self._result.exception() is not None):
            self._result = asyncio.get_running_loop().create_task(self._client.ask_result(self))
        return await result_within(self._result, self._client.name, timeout_s)

    async def cancel(self, timeout_s: float = 5.0) -> bool:
        """Request the cancellation."""
        return await self._client.cancel(self, timeout_s)

    def forget(self) -> None:
        """Cancel waiting for the result."""
        if self._result is not None:
            self._result.cancel()


class CycloneActionClient:
    """An action that goals are sent to; see `port.ActionClient`."""

    def __init__(
        self, transport: ActionClientTransport, action: str, type_name: str, closed: Callable[[Any], None]
    ) -> None:
        self.name = action
        self.type_name = type_name
        self._transport = transport
        self._closed = closed
        base = f"{action}/_action"
        self._send = transport.client(f"{base}/send_goal", f"{type_name}_SendGoal")
        self._get_result = transport.client(f"{base}/get_result", f"{type_name}_GetResult")
        self._cancel = transport.client(f"{base}/cancel_goal", CANCEL_GOAL)
        self._goals: dict[bytes, tuple[CycloneGoal, OnFeedback | None]] = {}
        self._subscriptions: list[Subscription] = []

    async def open(self) -> None:
        """Subscribe to the feedback and the states of goals."""
        base = f"{self.name}/_action"
        await self._transport.goals.watch(self.name)
        self._subscriptions = [
            await self._transport.subscribe(
                f"{base}/feedback", f"{self.type_name}_FeedbackMessage", self._on_feedback, DEFAULT
            ),
            await self._transport.subscribe(f"{base}/status", GOAL_STATUS_ARRAY, self._on_status, LATCHED),
        ]

    def _on_feedback(self, received: Received) -> None:
        message = received.message
        _, on_feedback = self._goals.get(message["goal_id"]["uuid"], (None, None))
        if on_feedback is not None:
            on_feedback(message["feedback"])

    def _on_status(self, received: Received) -> None:
        for goal_status in received.message["status_list"]:
            goal, _ = self._goals.get(goal_status["goal_info"]["goal_id"]["uuid"], (None, None))
            if goal is not None:
                with contextlib.suppress(ValueError):
                    goal.set_status(GoalStatus(goal_status["status"]))

    async def available(self, timeout_s: float) -> bool:
        """Wait until a server is available."""
        return await self._send.available(timeout_s)

    async def send_goal(
        self, goal: Message, *, on_feedback: OnFeedback | None = None, timeout_s: float = 5.0
    ) -> CycloneGoal:
        own = self._transport.goals
        goal_id = own.new_id()
        sent = CycloneGoal(self, goal_id)
        # Registered before it is sent: feedback may arrive before the response.
        self._goals[goal_id] = (sent, on_feedback)
        try:
            answer = await self._send.ask({"goal_id": {"uuid": goal_id}, "goal": goal}, timeout_s)
        except BaseException as error:
            self._goals.pop(goal_id, None)
            if isinstance(error, OutcomeUnknown | asyncio.CancelledError):
                own.give_up(self.name, goal_id)
            else:
                own.end(goal_id)
            raise
        if not answer.message["accepted"]:
            del self._goals[goal_id]
            own.end(goal_id)
            raise GoalRefused(f"{self.name}: the server did not accept the goal")
        sent.server = answer.server
        return sent

    async def ask_result(self, goal: CycloneGoal) -> GoalResult:
        """Wait for the result of a goal while its own server is there."""
        answer = await self._get_result.call({"goal_id": {"uuid": goal.goal_id}}, None, goal.server)
        try:
            status = GoalStatus(answer["status"])
        except ValueError:
            status = GoalStatus.UNKNOWN
        if not status.is_over:
            raise goal_forgotten(self.name)
        goal.set_status(status)
        self._goals.pop(goal.goal_id, None)
        self._transport.goals.end(goal.goal_id)
        return GoalResult(status, answer["result"])

    async def cancel(self, goal: CycloneGoal, timeout_s: float) -> bool:
        """Request the cancellation of a goal."""
        request = {"goal_info": {"goal_id": {"uuid": goal.goal_id}}}
        answer = await self._cancel.call(request, timeout_s, goal.server)
        agreed = any(goal_info["goal_id"]["uuid"] == goal.goal_id for goal_info in answer["goals_canceling"])
        if agreed:
            goal.set_status(GoalStatus.CANCELING)
        return agreed

    async def close(self) -> None:
        for subscription in self._subscriptions:
            await subscription.close()
        for goal, _ in self._goals.values():
            goal.forget()
            self._transport.goals.give_up(self.name, goal.goal_id)
        self._goals.clear()
        self._closed(self)
