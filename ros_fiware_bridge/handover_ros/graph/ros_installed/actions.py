"""Actions over an installed ROS."""

import asyncio
import concurrent.futures
import time
from collections.abc import Callable
from typing import Any

from handover_ros.errors import BadMessage, GoalRefused, OutcomeUnknown, ServerLost, ServiceUnavailable
from handover_ros.graph.action_server import BaseActionServer
from handover_ros.graph.goals import CancelSignal, goal_forgotten, result_within, unanswered
from handover_ros.graph.own_goals import UNKNOWN_GOAL, OwnGoals
from handover_ros.graph.port import ActionHandler, GoalResult, GoalStatus, Message
from handover_ros.graph.ros_installed.own_node import (
    DISCOVERY_DELAY_S,
    OwnRosNode,
    as_future,
    call,
    interface,
)
from handover_ros.graph.waiting import until

_SERVER_LOST_AFTER_S = 2.0
_CANCEL_TIMEOUT_S = 1.0


class RosGoal:
    """An accepted goal; see `port.Goal`."""

    def __init__(self, client: "RosActionClient", handle: Any, goal_id: bytes) -> None:
        self.goal_id = goal_id
        self._client = client
        self._handle = handle
        self._ended: asyncio.Task[GoalResult] | None = None
        self.servers = client.servers()
        """The servers that were there when one accepted the goal."""
        self.is_forgotten = asyncio.Event()
        """Set when a server has answered that it does not know the goal."""

    @property
    def status(self) -> GoalStatus:
        if self._ended is not None and self._ended.done() and self._ended.exception() is None:
            return self._ended.result().status
        return GoalStatus(self._handle.status)

    async def result(self, timeout_s: float | None = None) -> GoalResult:
        if self._ended is None or (self._ended.done() and self._ended.exception() is not None):
            self._ended = asyncio.get_running_loop().create_task(self._client.ask_result(self, self._handle))
        return await result_within(self._ended, self._client.name, timeout_s)

    async def cancel(self, timeout_s: float = 5.0) -> bool:
        """Request the cancellation."""
        answer = await self._client.within(self._handle.cancel_goal_async(), timeout_s)
        if answer.return_code == UNKNOWN_GOAL:
            self.is_forgotten.set()
        return any(bytes(goal_info.goal_id.uuid) == self.goal_id for goal_info in answer.goals_canceling)

    def forget(self) -> None:
        """Cancel waiting for the result."""
        if self._ended is not None:
            self._ended.cancel()


class RosActionClient:
    """An action that goals are sent to; see `port.ActionClient`."""

    def __init__(
        self,
        node: OwnRosNode,
        action: str,
        type_name: str,
        *,
        own: OwnGoals,
        closed: Callable[[Any], None],
    ) -> None:
        from rclpy.action import ActionClient  # noqa: PLC0415 - is only there where ROS is

        self.name = action
        self.type_name = type_name
        self._node = node
        self._own = own
        self._closed = closed
        self._loop = asyncio.get_running_loop()
        self._interface = interface(type_name, node.store)
        self._client = ActionClient(node.node, self._interface, action, callback_group=node.group)
        self._goals: dict[bytes, RosGoal] = {}
        self._open = True
        self._settled = False

    async def available(self, timeout_s: float) -> bool:
        """Wait until a server is available."""
        return await until(self._client.server_is_ready, timeout_s)

    def servers(self) -> frozenset[bytes]:
        """Return the present servers, by the ids of their publishers of states."""
        publishers = self._node.node.get_publishers_info_by_topic(f"{self.name}/_action/status")
        return frozenset(bytes(publisher.endpoint_gid) for publisher in publishers)

    async def within(self, pending: Any, timeout_s: float) -> Any:
        """Wait for a future of rclpy.

        Raises:
            CallTimeout: it does not complete in time.
        """
        try:
            return await asyncio.wait_for(as_future(pending, self._loop), timeout_s)
        except TimeoutError:
            raise unanswered(self.name, timeout_s) from None

    async def send_goal(
        self,
        goal: Message,
        *,
        on_feedback: Callable[[Message], None] | None = None,
        timeout_s: float = 5.0,
    ) -> RosGoal:
        from unique_identifier_msgs.msg import UUID  # noqa: PLC0415 - is only there where ROS is

        sent = self._node.to_ros(self._interface.Goal, f"{self.type_name}_Goal", goal)
        start_s = self._loop.time()
        if not await self.available(timeout_s):
            raise ServiceUnavailable(
                f"no node serves {self.name} ({self.type_name}); start its node, or check the name and the "
                "number of the domain (ROS_DOMAIN_ID)"
            )

        if not self._settled:
            await asyncio.sleep(min(DISCOVERY_DELAY_S, timeout_s / 2))
            self._settled = True

        def receive_feedback(feedback: Any) -> None:
            if on_feedback is not None:
                message = self._node.from_ros(f"{self.type_name}_Feedback", feedback.feedback)
                call(self._loop, on_feedback, message)

        goal_id = self._own.new_id()
        try:
            pending = self._client.send_goal_async(sent, receive_feedback, UUID(uuid=list(goal_id)))
            # The seconds of the caller, in the text as well; discovery has used some of them.
            async with asyncio.timeout_at(start_s + timeout_s):
                handle = await as_future(pending, self._loop)
        except TimeoutError:
            self._own.give_up(self.name, goal_id)
            raise unanswered(self.name, timeout_s) from None
        except BaseException:
            self._own.give_up(self.name, goal_id)
            raise
        if not handle.accepted:
            self._own.end(goal_id)
            raise GoalRefused(f"{self.name}: the server did not accept the goal")
        accepted = RosGoal(self, handle, goal_id)
        self._goals[goal_id] = accepted
        return accepted

    async def ask_result(self, goal: RosGoal, handle: Any) -> GoalResult:
        """Wait for the result of a goal while its server is there.

        rclpy does not report which of several servers accepted a goal. So when one of them goes away, or one
        does not know the goal, the others are asked again: a server that does not know it says so at once.
        """
        answers = {as_future(handle.get_result_async(), self._loop)}
        servers = goal.servers
        forgotten = asyncio.ensure_future(goal.is_forgotten.wait())
        try:
            while True:
                done, _ = await asyncio.wait(
                    {*answers, forgotten},
                    timeout=_SERVER_LOST_AFTER_S,
                    return_when=asyncio.FIRST_COMPLETED,
                )
                if ended := done - {forgotten}:
                    return self._result(goal, ended.pop().result())
                if done:
                    raise goal_forgotten(self.name)
                left = servers & self.servers()
                if servers and not await until(
                    lambda: bool(goal.servers & self.servers()), _SERVER_LOST_AFTER_S
                ):
                    raise ServerLost(f"the server of {self.name} went away before the goal ended")
                if left and left != servers:
                    servers = left
                    answers.add(as_future(handle.get_result_async(), self._loop))
        finally:
            forgotten.cancel()
            for answer in answers:
                answer.cancel()

    def _result(self, goal: RosGoal, ended: Any) -> GoalResult:
        status = GoalStatus(ended.status)
        if not status.is_over:
            raise goal_forgotten(self.name)
        try:
            result = self._node.from_ros(f"{self.type_name}_Result", ended.result)
        except BadMessage as error:
            raise OutcomeUnknown(f"{self.name} ended, and its result cannot be read: {error}") from error
        self._goals.pop(goal.goal_id, None)
        self._own.end(goal.goal_id)
        return GoalResult(status, result)

    async def close(self) -> None:
        if self._open:
            self._open = False
            for goal in self._goals.values():
                goal.forget()
                self._own.give_up(self.name, goal.goal_id)
            self._client.destroy()
            self._closed(self)


class RosServedGoal(CancelSignal):
    """A goal that is being executed; see `port.ServedGoal`."""

    def __init__(self, server: "RosActionServer", handle: Any, request: Message) -> None:
        super().__init__()
        self.goal_id = bytes(handle.goal_id.uuid)
        self.request = request
        self._server = server
        self._handle = handle
        if handle.is_cancel_requested:
            self.request_cancel()

    def feedback(self, feedback: Message) -> None:
        self._server.send_feedback(self._handle, feedback)


class RosActionServer(BaseActionServer):
    """A served action; see `port.Served`."""

    def __init__(
        self,
        node: OwnRosNode,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None,
        closed: Callable[[Any], None],
    ) -> None:
        from rclpy.action import ActionServer, CancelResponse, GoalResponse  # noqa: PLC0415 - where ROS is

        super().__init__(action, type_name, handler, store=node.store, accept=accept, closed=closed)
        self._node = node
        self._loop = asyncio.get_running_loop()
        self._interface = interface(type_name, node.store)
        self._goal_response, self._cancel_response = GoalResponse, CancelResponse
        self._goals: dict[bytes, RosServedGoal] = {}
        self._working: set[concurrent.futures.Future[tuple[GoalStatus, Message]]] = set()
        self._open = True
        self._server = ActionServer(
            node.node,
            self._interface,
            action,
            self._execute,
            callback_group=node.group,
            goal_callback=self._wanted,
            cancel_callback=self._cancelled,
        )

    def _wanted(self, goal: Any) -> Any:
        self.calls += 1
        accepted = self._accepts(self._node.from_ros(f"{self.type_name}_Goal", goal))
        return self._goal_response.ACCEPT if accepted else self._goal_response.REJECT

    def _cancelled(self, handle: Any) -> Any:
        goal = self._goals.get(bytes(handle.goal_id.uuid))
        if goal is not None:
            call(self._loop, goal.request_cancel)
        return self._cancel_response.ACCEPT

    def _execute(self, handle: Any) -> Any:
        """Execute one goal; in a thread of the executor, which waits for the loop."""
        work = asyncio.run_coroutine_threadsafe(self._work(handle), self._loop)
        self._working.add(work)
        try:
            status, result = work.result()
        except concurrent.futures.CancelledError:
            status, result = GoalStatus.ABORTED, {}
        finally:
            self._working.discard(work)
        if status is GoalStatus.CANCELED and self._canceling(handle):
            handle.canceled()
        elif status is GoalStatus.SUCCEEDED:
            handle.succeed()
        else:
            handle.abort()
        return self._node.to_ros(self._interface.Result, f"{self.type_name}_Result", result)

    @staticmethod
    def _canceling(handle: Any) -> bool:
        """Wait until rclpy has recorded the cancel request that our handler has seen; False without one."""
        end_s = time.monotonic() + _CANCEL_TIMEOUT_S
        while not handle.is_cancel_requested:
            if time.monotonic() > end_s:
                return False
            time.sleep(0.005)
        return True

    async def _work(self, handle: Any) -> tuple[GoalStatus, Message]:
        request = self._node.from_ros(f"{self.type_name}_Goal", handle.request)
        goal = RosServedGoal(self, handle, request)
        self._goals[goal.goal_id] = goal
        try:
            return await self._outcome(goal)
        finally:
            self._goals.pop(goal.goal_id, None)

    def send_feedback(self, handle: Any, feedback: Message) -> None:
        """Publish the feedback of a goal.

        Raises:
            BadMessage: it does not match the definition.
        """
        made = self._interface.Feedback
        handle.publish_feedback(self._node.to_ros(made, f"{self.type_name}_Feedback", feedback))

    async def close(self) -> None:
        """Stop serving; active goals are aborted."""
        if self._open:
            self._open = False
            for work in list(self._working):
                work.cancel()
            await asyncio.to_thread(concurrent.futures.wait, list(self._working), 2.0)
            self._server.destroy()
            self._closed(self)
