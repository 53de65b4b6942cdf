"""Serves goals: a task executes each accepted goal; its result is kept for a while."""

import asyncio
import time
from collections.abc import Callable
from typing import Any, Protocol

from handover_ros.errors import BadMessage, GraphError
from handover_ros.graph.action_server import BaseActionServer
from handover_ros.graph.goals import CancelSignal
from handover_ros.graph.port import ActionHandler, GoalStatus, Message, Publisher, Served, ServiceHandler
from handover_ros.graph.qos import DEFAULT, LATCHED, Qos
from handover_ros.types.type_store import TypeStore
from handover_ros.types.wrappers import CANCEL_GOAL, GOAL_STATUS_ARRAY

_RESULT_TTL_S = 900.0
_MAX_KEPT_GOALS = 1000
_ANY = bytes(16)
_AGREED, _REFUSED, _UNKNOWN, _OVER = 0, 1, 2, 3  # the constants of action_msgs/srv/CancelGoal


class ActionServerTransport(Protocol):
    """Creates the services and topics of an action; see `CycloneGraph`."""

    store: TypeStore

    def server(self, service: str, base: str, handler: ServiceHandler) -> Served:
        """Serve a service."""

    async def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> Publisher:
        """Publish on a topic."""


class CycloneServedGoal(CancelSignal):
    """A goal that is being executed; see `port.ServedGoal`."""

    def __init__(self, server: "CycloneActionServer", goal_id: bytes, request: Message) -> None:
        super().__init__()
        self.goal_id = goal_id
        self.request = request
        self.status = GoalStatus.ACCEPTED
        self.accepted_ns = time.time_ns()
        self.ended_s: float | None = None
        self.result: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        self.task: asyncio.Task[None] | None = None
        self._server = server

    @property
    def info(self) -> Message:
        """The goal as `action_msgs/msg/GoalInfo`."""
        sec, nanosec = divmod(self.accepted_ns, 10**9)
        return {"goal_id": {"uuid": self.goal_id}, "stamp": {"sec": sec, "nanosec": nanosec}}

    def cancel(self) -> None:
        """Record the request of the client."""
        self.status = GoalStatus.CANCELING
        self.request_cancel()

    def feedback(self, feedback: Message) -> None:
        self._server.send_feedback(self, feedback)


class CycloneActionServer(BaseActionServer):
    """A served action; see `port.Served`."""

    def __init__(
        self,
        transport: ActionServerTransport,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None,
        closed: Callable[[Any], None],
    ) -> None:
        super().__init__(action, type_name, handler, store=transport.store, accept=accept, closed=closed)
        self._transport = transport
        self._goals: dict[bytes, CycloneServedGoal] = {}
        self._parts: list[Served | Publisher] = []

    async def open(self) -> None:
        """Create the services and topics of the action."""
        base = f"{self.name}/_action"
        transport = self._transport
        self._feedback = await transport.publisher(
            f"{base}/feedback", f"{self.type_name}_FeedbackMessage", DEFAULT
        )
        self._status = await transport.publisher(f"{base}/status", GOAL_STATUS_ARRAY, LATCHED)
        self._parts = [
            self._feedback,
            self._status,
            transport.server(f"{base}/cancel_goal", CANCEL_GOAL, self._on_cancel),
            transport.server(f"{base}/get_result", f"{self.type_name}_GetResult", self._on_get_result),
            transport.server(f"{base}/send_goal", f"{self.type_name}_SendGoal", self._on_send_goal),
        ]

    async def _on_send_goal(self, request: Message) -> Message:
        self.calls += 1
        goal_id, wanted = request["goal_id"]["uuid"], request["goal"]
        self._forget_old()
        if goal_id in self._goals or len(self._goals) >= _MAX_KEPT_GOALS or not self._accepts(wanted):
            return {"accepted": False}
        goal = CycloneServedGoal(self, goal_id, wanted)
        self._goals[goal_id] = goal
        goal.task = asyncio.get_running_loop().create_task(self._work(goal))
        return {"accepted": True, "stamp": goal.info["stamp"]}

    async def _work(self, goal: CycloneServedGoal) -> None:
        goal.status = GoalStatus.EXECUTING
        self._publish_status()
        try:
            goal.status, result = await self._outcome(goal)
        except asyncio.CancelledError:  # the action was closed
            goal.status, result = GoalStatus.ABORTED, {}
        goal.ended_s = time.monotonic()
        if not goal.result.done():
            goal.result.set_result(result)
        self._publish_status()

    async def _on_get_result(self, request: Message) -> Message:
        goal = self._goals.get(request["goal_id"]["uuid"])
        if goal is None:
            return {"status": int(GoalStatus.UNKNOWN)}
        result = await asyncio.shield(goal.result)
        return {"status": int(goal.status), "result": result}

    async def _on_cancel(self, request: Message) -> Message:
        goal_id = request["goal_info"]["goal_id"]["uuid"]
        stamp = request["goal_info"]["stamp"]
        until_ns = stamp["sec"] * 10**9 + stamp["nanosec"]
        meant = [
            goal
            for goal in self._goals.values()
            if goal.goal_id == goal_id
            or (until_ns and goal.accepted_ns <= until_ns)
            or (goal_id == _ANY and not until_ns)
        ]
        going = [goal for goal in meant if not goal.status.is_over]
        for goal in going:
            goal.cancel()
        if going:
            self._publish_status()
            code = _AGREED
        elif meant:
            code = _OVER
        else:
            code = _UNKNOWN if goal_id != _ANY else _REFUSED
        return {"return_code": code, "goals_canceling": [goal.info for goal in going]}

    def send_feedback(self, goal: CycloneServedGoal, feedback: Message) -> None:
        """Publish the feedback of a goal.

        Raises:
            BadMessage: it does not match the definition.
        """
        self._feedback.publish({"goal_id": {"uuid": goal.goal_id}, "feedback": feedback})

    def _publish_status(self) -> None:
        listed = [{"goal_info": goal.info, "status": int(goal.status)} for goal in self._goals.values()]
        try:
            self._status.publish({"status_list": listed})
        except (GraphError, BadMessage) as error:
            self._fault(error)

    def _forget_old(self) -> None:
        now_s = time.monotonic()
        for goal_id, goal in list(self._goals.items()):
            full = len(self._goals) >= _MAX_KEPT_GOALS
            if goal.ended_s is not None and (full or now_s - goal.ended_s > _RESULT_TTL_S):
                del self._goals[goal_id]

    async def close(self) -> None:
        """Stop serving; active goals are aborted."""
        going = [goal.task for goal in self._goals.values() if goal.task is not None and not goal.task.done()]
        for task in going:
            task.cancel()
        await asyncio.gather(*going, return_exceptions=True)
        # Clients that wait for a result receive it before the service closes.
        await asyncio.sleep(0)
        for part in self._parts:
            await part.close()
        self._goals.clear()
        self._closed(self)
