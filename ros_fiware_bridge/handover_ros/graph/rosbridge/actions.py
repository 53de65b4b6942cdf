"""Actions over a rosbridge server (of ROS 2; the protocol of ROS 1 has none).

The protocol reports the end and the feedback of a goal, but not that it was accepted. A goal counts as
accepted unless it is refused at once. The ids of goals are those of the connection: a goal that outlives it
cannot be cancelled, and its server is known by the name of its node only.
"""

import asyncio
import secrets
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from handover.runtime.retry import Backoff
from handover_ros.errors import (
    BadMessage,
    GoalRefused,
    GraphClosed,
    GraphError,
    OutcomeUnknown,
    PublishBlocked,
    ServerLost,
    ServiceUnavailable,
)
from handover_ros.graph.action_server import BaseActionServer
from handover_ros.graph.goals import CancelSignal, result_within
from handover_ros.graph.port import ActionHandler, GoalResult, GoalStatus, Message
from handover_ros.graph.rosbridge.connection import Connection, Operation
from handover_ros.graph.rosbridge.json_codec import JsonCodec
from handover_ros.graph.rosbridge.view import RosapiView
from handover_ros.graph.waiting import until

REFUSED_WITHIN_S = 0.3
SERVER_LOST_AFTER_S = 10.0
"""A server counts as lost when rosapi, which is polled, has not listed it for so long."""
CHECK_S = 1.0
CANCEL_RETRY_S, MAX_CANCEL_RETRY_S = 0.5, 5.0
CANCELLED_WITHIN_S = 60.0
"""A cancelled goal without feedback ends within this time; otherwise its server has forgotten it."""


class RosbridgeGoal:
    """A goal that was sent; see `port.Goal`."""

    def __init__(
        self, client: "RosbridgeActionClient", goal_id: bytes, ended: "asyncio.Future[Operation]"
    ) -> None:
        self.goal_id = goal_id
        self.has_feedback = asyncio.Event()
        self.active_s = 0.0
        """When its last feedback came, or when it was cancelled for the first time."""
        self._client = client
        self._ended = ended
        self._servers = client.servers()
        self._is_cancelled = False
        self._watching: asyncio.Task[Operation] | None = None

    @property
    def status(self) -> GoalStatus:
        """Return the state of the goal, as far as the server reports it."""
        if self._ended.done() and not self._ended.cancelled() and self._ended.exception() is None:
            return _status(self._ended.result())
        return GoalStatus.EXECUTING if self.has_feedback.is_set() else GoalStatus.ACCEPTED

    async def result(self, timeout_s: float | None = None) -> GoalResult:
        if self._watching is None or (self._watching.done() and not self._ended.done()):
            self._watching = asyncio.get_running_loop().create_task(self._watch())
        return self._client.made(await result_within(self._watching, self._client.name, timeout_s))

    async def _watch(self) -> Operation:
        """Wait for the end while the server is there, and while a cancelled goal is not forgotten."""
        clock, name = asyncio.get_running_loop().time, self._client.name
        seen_s = clock()
        while True:
            done, _ = await asyncio.wait([self._ended], timeout=CHECK_S)
            if done:
                return self._ended.result()
            if not self._servers or set(self._servers) & set(self._client.servers()):
                seen_s = clock()
            if clock() - seen_s > SERVER_LOST_AFTER_S:
                raise ServerLost(f"the server of {name} went away before the goal ended")
            if self._is_cancelled and clock() - self.active_s > CANCELLED_WITHIN_S:
                raise ServerLost(f"{name}: the goal was cancelled and did not end")

    async def cancel(self, timeout_s: float = 5.0) -> bool:  # noqa: ARG002 - the port has it
        """Request the cancellation; the result shows whether it succeeded. False once the goal has ended."""
        if self._ended.done():
            return False
        if not self._is_cancelled:
            self._is_cancelled = True
            self.active_s = asyncio.get_running_loop().time()
        self._client.cancel(self.goal_id)
        return True

    def forget(self) -> None:
        """Cancel waiting for the result."""
        if self._watching is not None:
            self._watching.cancel()

    async def give_up(self) -> None:
        """Cancel the goal until it has ended, or the connection with it."""
        backoff = Backoff(CANCEL_RETRY_S, MAX_CANCEL_RETRY_S)
        while not self._ended.done():
            with suppress(PublishBlocked, GraphClosed):
                self._client.cancel(self.goal_id)
            await asyncio.wait([self._ended], timeout=backoff.next_delay_s())

    def refused(self) -> str | None:
        """Return the reason of the refusal; None if the goal was not refused."""
        if self._ended.done() and self._ended.exception() is None:
            ended = self._ended.result()
            return str(ended.get("values"))[:300] if ended.get("result") is False else None
        return None


class RosbridgeActionClient:
    """An action that goals are sent to; see `port.ActionClient`."""

    def __init__(
        self,
        connection: Connection,
        codec: JsonCodec,
        view: RosapiView,
        action: str,
        type_name: str,
        *,
        closed: Callable[[Any], None],
    ) -> None:
        self.name = action
        self.type_name = type_name
        self._connection = connection
        self._codec = codec
        self._view = view
        self._closed = closed
        self._on_feedback: dict[str, Callable[[Operation], None]] = {}
        self._goals: dict[bytes, RosbridgeGoal] = {}
        self._given_up: set[asyncio.Task[None]] = set()
        self._open = True
        connection.on("action_feedback", self._feedback)

    async def available(self, timeout_s: float) -> bool:
        """Wait until a server is available."""
        self._view.poll_soon()
        return await until(self._served, timeout_s)

    def _served(self) -> bool:
        return bool(self.servers())

    def servers(self) -> tuple[str | None, ...]:
        """Return the nodes that serve the action; none without rosapi."""
        return next((action.servers for action in self._view.actions() if action.name == self.name), ())

    async def send_goal(
        self, goal: Message, *, on_feedback: Callable[[Message], None] | None = None, timeout_s: float = 5.0
    ) -> RosbridgeGoal:
        if not self._open:
            raise GraphClosed(f"{self.name} was closed; no goal can be sent to it")
        args, _ = self._codec.to_json(f"{self.type_name}_Goal", goal)
        goal_id = secrets.token_bytes(16)
        ended: asyncio.Future[Operation] = asyncio.ensure_future(
            self._connection.request(
                None,
                op="send_action_goal",
                id=goal_id.hex(),
                action=self.name,
                action_type=self._codec.type_name(self.type_name),
                args=args,
                feedback=True,
            )
        )
        sent = RosbridgeGoal(self, goal_id, ended)
        self._goals[goal_id] = sent
        ended.add_done_callback(lambda _: self._forget(goal_id, ended))

        def receive_feedback(operation: Operation) -> None:
            sent.has_feedback.set()
            sent.active_s = asyncio.get_running_loop().time()
            if on_feedback is not None:
                with suppress(BadMessage):
                    on_feedback(self._codec.message(f"{self.type_name}_Feedback", operation.get("values")))

        self._on_feedback[goal_id.hex()] = receive_feedback
        ended.add_done_callback(lambda _: sent.has_feedback.set())
        try:
            with suppress(TimeoutError):
                async with asyncio.timeout(min(REFUSED_WITHIN_S, timeout_s)):
                    await sent.has_feedback.wait()
        except asyncio.CancelledError:
            self._give_up(sent)
            raise
        if ended.done() and (error := ended.exception()) is not None:
            raise error
        if (why := sent.refused()) is not None:
            raise _refusal(self.name, why)
        return sent

    def cancel(self, goal_id: bytes) -> None:
        """Request the cancellation of a goal."""
        self._connection.send(op="cancel_action_goal", id=goal_id.hex(), action=self.name)

    def made(self, ended: Operation) -> GoalResult:
        """Return the result of a goal. Raises `GoalRefused`, `OutcomeUnknown`."""
        if ended.get("result") is False:
            refusal = _refusal(self.name, str(ended.get("values"))[:300])
            raise refusal if isinstance(refusal, GoalRefused) else OutcomeUnknown(str(refusal))
        try:
            result = self._codec.message(f"{self.type_name}_Result", ended.get("values") or {})
        except BadMessage as error:
            raise OutcomeUnknown(f"{self.name} ended, and its result cannot be read: {error}") from error
        return GoalResult(_status(ended), result)

    def _feedback(self, operation: Operation) -> None:
        if (receive := self._on_feedback.get(str(operation.get("id")))) is not None:
            receive(operation)

    def _forget(self, goal_id: bytes, ended: "asyncio.Future[Operation]") -> None:
        self._on_feedback.pop(goal_id.hex(), None)
        self._goals.pop(goal_id, None)
        if not ended.cancelled():
            ended.exception()  # retrieved here, since a caller may never wait for the result

    async def close(self) -> None:
        """Release the action; goals that have not ended are cancelled, and waiting for them fails."""
        if self._open:
            self._open = False
            self._connection.off("action_feedback", self._feedback)
            for goal in list(self._goals.values()):
                goal.forget()
                self._give_up(goal)
            self._closed(self)

    def _give_up(self, goal: RosbridgeGoal) -> None:
        task = asyncio.get_running_loop().create_task(goal.give_up())
        self._given_up.add(task)
        task.add_done_callback(self._given_up.discard)


class RosbridgeServedGoal(CancelSignal):
    """A goal that is being executed; see `port.ServedGoal`."""

    def __init__(self, server: "RosbridgeActionServer", goal_id: str, request: Message) -> None:
        super().__init__()
        self.goal_id = goal_id.encode()[:16].ljust(16, b"\0")
        self.request = request
        self._server = server
        self._id = goal_id

    def feedback(self, feedback: Message) -> None:
        self._server.send_feedback(self._id, feedback)


class RosbridgeActionServer(BaseActionServer):
    """A served action; see `port.Served`."""

    def __init__(
        self,
        connection: Connection,
        codec: JsonCodec,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None,
        closed: Callable[[Any], None],
    ) -> None:
        super().__init__(action, type_name, handler, store=codec.store, accept=accept, closed=closed)
        self._connection = connection
        self._codec = codec
        self._goals: dict[str, RosbridgeServedGoal] = {}
        self._working: set[asyncio.Task[None]] = set()
        self._open = True
        connection.on("send_action_goal", self._asked)
        connection.on("cancel_action_goal", self._cancel)
        connection.on_opening(self._advertise)
        self._advertise()

    def _advertise(self) -> None:
        self._connection.send(
            op="advertise_action", action=self.name, type=self._codec.type_name(self.type_name)
        )

    def send_feedback(self, goal_id: str, feedback: Message) -> None:
        """Send feedback of a goal."""
        values, _ = self._codec.to_json(f"{self.type_name}_Feedback", feedback)
        with suppress(PublishBlocked):  # the next feedback, or the result, replaces it
            self._connection.send(op="action_feedback", id=goal_id, action=self.name, values=values)

    def _asked(self, operation: Operation) -> None:
        if operation.get("action") == self.name:
            work = asyncio.create_task(self._work(str(operation.get("id")), operation))
            self._working.add(work)
            work.add_done_callback(self._working.discard)

    def _cancel(self, operation: Operation) -> None:
        if (goal := self._goals.get(str(operation.get("id")))) is not None:
            goal.request_cancel()

    async def _work(self, goal_id: str, operation: Operation) -> None:
        self.calls += 1
        status = GoalStatus.ABORTED  # the protocol cannot reject a goal
        result: Message = {}
        try:
            request = self._codec.message(f"{self.type_name}_Goal", operation.get("args") or {})
        except BadMessage as error:
            self._fault(error)
        else:
            if self._accepts(request):
                self._goals[goal_id] = goal = RosbridgeServedGoal(self, goal_id, request)
                try:
                    status, result = await self._outcome(goal)
                finally:
                    self._goals.pop(goal_id, None)
        values, _ = self._codec.to_json(f"{self.type_name}_Result", result)
        try:
            self._connection.send(
                op="action_result",
                id=goal_id,
                action=self.name,
                values=values,
                status=int(status),
                result=True,
            )
        except PublishBlocked as error:
            self.last_error = str(error)

    def _check(self, result: Message) -> None:
        self._codec.to_json(f"{self.type_name}_Result", result)

    async def close(self) -> None:
        if self._open:
            self._open = False
            self._connection.off("send_action_goal", self._asked)
            self._connection.off("cancel_action_goal", self._cancel)
            self._connection.off_opening(self._advertise)
            for work in list(self._working):
                work.cancel()
            if self._connection.is_open:
                self._connection.send(op="unadvertise_action", action=self.name)
            self._closed(self)


def _status(ended: Operation) -> GoalStatus:
    status = ended.get("status")
    return GoalStatus(status) if isinstance(status, int) and status in set(GoalStatus) else GoalStatus.UNKNOWN


def _refusal(action: str, why: str) -> GraphError:
    if "reject" in why.lower():
        return GoalRefused(f"{action}: the server did not accept the goal ({why})")
    return ServiceUnavailable(
        f"{action}: the goal could not be executed; the rosbridge server reports: {why}"
    )
