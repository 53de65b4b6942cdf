"""Actions by way of a rosbridge server (of ROS 2: that of ROS 1 has none in its protocol).

The protocol does not tell that a goal was accepted, only how it ended and what is felt on the way: a goal
counts as accepted unless it is refused at once.
"""

import asyncio
import secrets
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import structlog

from ros_fiware_bridge.errors import (
    BadMessage,
    CallTimeout,
    GoalRefused,
    GraphClosed,
    GraphError,
    PublishBlocked,
    ServiceUnavailable,
)
from ros_fiware_bridge.graph.port import ActionHandler, GoalEnded, GoalResult, GoalStatus, Message
from ros_fiware_bridge.graph.rosbridge.forms import Forms
from ros_fiware_bridge.graph.rosbridge.link import Link, Op
from ros_fiware_bridge.graph.rosbridge.view import RosapiView
from ros_fiware_bridge.graph.waiting import until

log = structlog.get_logger(__name__)

REFUSED_WITHIN_S = 0.3


class RosbridgeGoal:
    """A goal that was sent; see `port.Goal`."""

    def __init__(self, client: "RosbridgeActionClient", goal_id: bytes, ended: "asyncio.Future[Op]") -> None:
        self.goal_id = goal_id
        self.felt = asyncio.Event()
        self._client = client
        self._ended = ended

    @property
    def status(self) -> GoalStatus:
        """How it stands, as far as the server tells."""
        if self._ended.done() and not self._ended.cancelled() and self._ended.exception() is None:
            return _status(self._ended.result())
        return GoalStatus.EXECUTING if self.felt.is_set() else GoalStatus.ACCEPTED

    async def result(self, timeout_s: float | None = None) -> GoalResult:
        """Wait for its end."""
        try:
            ended = await asyncio.wait_for(asyncio.shield(self._ended), timeout_s)
        except asyncio.CancelledError:
            if self._ended.cancelled():
                raise GraphClosed(f"{self._client.name} was closed before the goal ended") from None
            raise
        except TimeoutError:
            raise CallTimeout(f"{self._client.name}: the goal did not end within {timeout_s} s") from None
        return self._client.made(ended)

    async def cancel(self, timeout_s: float = 5.0) -> bool:  # noqa: ARG002 - the port has it
        """Ask the server to cancel it; it does not answer that, the result tells. False once it has ended."""
        if self._ended.done():
            return False
        self._client.cancel(self.goal_id)
        return True

    def refused(self) -> str | None:
        """Return why it was refused, if it was."""
        if self._ended.done() and self._ended.exception() is None:
            ended = self._ended.result()
            return str(ended.get("values"))[:300] if ended.get("result") is False else None
        return None


class RosbridgeActionClient:
    """An action that goals are sent to; see `port.ActionClient`."""

    def __init__(
        self,
        link: Link,
        forms: Forms,
        view: RosapiView,
        action: str,
        type_name: str,
        *,
        closed: Callable[[Any], None],
    ) -> None:
        self.name = action
        self.type_name = type_name
        self._link = link
        self._forms = forms
        self._view = view
        self._closed = closed
        self._felt: dict[str, Callable[[Op], None]] = {}
        self._waiting: set[asyncio.Future[Op]] = set()
        self._open = True
        link.on("action_feedback", self._feedback)

    async def available(self, timeout_s: float) -> bool:
        """Wait until a server is there."""
        self._view.look_now()
        return await until(self._served, timeout_s)

    def _served(self) -> bool:
        return any(one.name == self.name and one.servers for one in self._view.actions())

    async def send_goal(
        self, goal: Message, *, on_feedback: Callable[[Message], None] | None = None, timeout_s: float = 5.0
    ) -> RosbridgeGoal:
        """Send a goal."""
        if not self._open:
            raise GraphClosed(f"{self.name} was closed; no goal can be sent to it")
        args, _ = self._forms.to_json(f"{self.type_name}_Goal", goal)
        goal_id = secrets.token_bytes(16)
        ended: asyncio.Future[Op] = asyncio.ensure_future(
            self._link.ask(
                None,
                op="send_action_goal",
                id=goal_id.hex(),
                action=self.name,
                action_type=self._forms.type_name(self.type_name),
                args=args,
                feedback=True,
            )
        )
        sent = RosbridgeGoal(self, goal_id, ended)
        self._waiting.add(ended)
        ended.add_done_callback(lambda _: self._forget(goal_id, ended))

        def felt(operation: Op) -> None:
            sent.felt.set()
            if on_feedback is not None:
                with suppress(BadMessage):
                    on_feedback(self._forms.message(f"{self.type_name}_Feedback", operation.get("values")))

        self._felt[goal_id.hex()] = felt
        ended.add_done_callback(lambda _: sent.felt.set())
        with suppress(TimeoutError):
            async with asyncio.timeout(min(REFUSED_WITHIN_S, timeout_s)):
                await sent.felt.wait()
        if ended.done() and (error := ended.exception()) is not None:
            raise error
        if (why := sent.refused()) is not None:
            raise _unwanted(self.name, why)
        return sent

    def cancel(self, goal_id: bytes) -> None:
        """Have the server cancel a goal."""
        self._link.send(op="cancel_action_goal", id=goal_id.hex(), action=self.name)

    def made(self, ended: Op) -> GoalResult:
        """Return how a goal ended. Raises `GoalRefused`, `ServiceUnavailable`, `BadMessage`."""
        if ended.get("result") is False:
            raise _unwanted(self.name, str(ended.get("values"))[:300])
        return GoalResult(
            _status(ended), self._forms.message(f"{self.type_name}_Result", ended.get("values") or {})
        )

    def _feedback(self, operation: Op) -> None:
        if (felt := self._felt.get(str(operation.get("id")))) is not None:
            felt(operation)

    def _forget(self, goal_id: bytes, ended: "asyncio.Future[Op]") -> None:
        self._felt.pop(goal_id.hex(), None)
        self._waiting.discard(ended)
        if not ended.cancelled():
            ended.exception()  # whoever waits for the result is told; nobody need wait

    async def close(self) -> None:
        """Let go of it."""
        if self._open:
            self._open = False
            self._link.off("action_feedback", self._feedback)
            for ended in list(self._waiting):
                ended.cancel()
            self._closed(self)


class RosbridgeServedGoal:
    """A goal that is being worked on; see `port.ServedGoal`."""

    def __init__(self, server: "RosbridgeActionServer", goal_id: str, request: Message) -> None:
        self.goal_id = goal_id.encode()[:16].ljust(16, b"\0")
        self.request = request
        self._server = server
        self._id = goal_id
        self.cancelling = asyncio.Event()

    def feedback(self, feedback: Message) -> None:
        """Tell how far it is."""
        self._server.tell(self._id, feedback)

    @property
    def cancel_requested(self) -> bool:
        """Whether the client asked to cancel."""
        return self.cancelling.is_set()

    async def wait_cancel_requested(self) -> None:
        """Wait until the client asks to cancel."""
        await self.cancelling.wait()


class RosbridgeActionServer:
    """An action that is offered; see `port.Served`."""

    def __init__(
        self,
        link: Link,
        forms: Forms,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None,
        closed: Callable[[Any], None],
    ) -> None:
        self.name = action
        self.type_name = type_name
        self.calls = 0
        self.failed = 0
        self.last_error: str | None = None
        self._link = link
        self._forms = forms
        self._handler = handler
        self._accept = accept
        self._closed = closed
        self._goals: dict[str, RosbridgeServedGoal] = {}
        self._working: set[asyncio.Task[None]] = set()
        self._open = True
        link.on("send_action_goal", self._asked)
        link.on("cancel_action_goal", self._cancel)
        link.on_opening(self._advertise)
        self._advertise()

    def _advertise(self) -> None:
        self._link.send(op="advertise_action", action=self.name, type=self._forms.type_name(self.type_name))

    def tell(self, goal_id: str, feedback: Message) -> None:
        """Send feedback of a goal."""
        values, _ = self._forms.to_json(f"{self.type_name}_Feedback", feedback)
        with suppress(PublishBlocked):  # the next one, or the result, says more
            self._link.send(op="action_feedback", id=goal_id, action=self.name, values=values)

    def _asked(self, operation: Op) -> None:
        if operation.get("action") == self.name:
            work = asyncio.create_task(self._work(str(operation.get("id")), operation))
            self._working.add(work)
            work.add_done_callback(self._working.discard)

    def _cancel(self, operation: Op) -> None:
        if (goal := self._goals.get(str(operation.get("id")))) is not None:
            goal.cancelling.set()

    async def _work(self, goal_id: str, operation: Op) -> None:
        self.calls += 1
        status, result = GoalStatus.SUCCEEDED, {}
        try:
            request = self._forms.message(f"{self.type_name}_Goal", operation.get("args") or {})
            if self._accept is not None and not self._accept(request):
                status = GoalStatus.ABORTED  # the protocol has no word for a goal that is not wanted
            else:
                self._goals[goal_id] = goal = RosbridgeServedGoal(self, goal_id, request)
                result = await self._handler(goal)
        except GoalEnded as ended:
            status, result = ended.status, ended.result
        except Exception as error:  # one goal must not end the server
            self.failed += 1
            self.last_error = f"{type(error).__name__}: {error}"
            log.exception("a goal of the ROS graph had a fault", action=self.name)
            status = GoalStatus.ABORTED
        finally:
            self._goals.pop(goal_id, None)
        values, _ = self._forms.to_json(f"{self.type_name}_Result", result)
        try:
            self._link.send(
                op="action_result",
                id=goal_id,
                action=self.name,
                values=values,
                status=int(status),
                result=True,
            )
        except PublishBlocked as error:
            self.last_error = str(error)

    async def close(self) -> None:
        """Stop serving."""
        if self._open:
            self._open = False
            self._link.off("send_action_goal", self._asked)
            self._link.off("cancel_action_goal", self._cancel)
            self._link.off_opening(self._advertise)
            for work in list(self._working):
                work.cancel()
            if self._link.is_open:
                self._link.send(op="unadvertise_action", action=self.name)
            self._closed(self)


def _status(ended: Op) -> GoalStatus:
    told = ended.get("status")
    return GoalStatus(told) if isinstance(told, int) and told in set(GoalStatus) else GoalStatus.UNKNOWN


def _unwanted(action: str, why: str) -> GraphError:
    if "reject" in why.lower():
        return GoalRefused(f"{action}: the server did not accept the goal ({why})")
    return ServiceUnavailable(f"{action}: the goal could not be worked on; the rosbridge server says: {why}")
