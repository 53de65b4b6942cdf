"""The goals that a bridge has sent: one that nobody waits for is cancelled.

A server may accept a goal after its sender gave up, and a goal outlives a bridge that was killed. So the ids
of all goals of one bridge begin with the same bytes, which a file keeps with the actions, and the states that
the servers of these actions publish are followed. A goal that has our bytes and that nobody waits for is
cancelled as soon as a server shows it, and again until it has ended.
"""

import asyncio
import secrets
from collections.abc import Iterable
from pathlib import Path
from typing import Final, Protocol

import orjson
import structlog

from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover.runtime.retry import Backoff
from handover_ros.errors import GraphError
from handover_ros.graph.port import GoalStatus, Message, OnMessage, Received, Subscription
from handover_ros.graph.qos import LATCHED, Qos
from handover_ros.types.wrappers import CANCEL_GOAL, GOAL_STATUS_ARRAY

log = structlog.get_logger(__name__)

PREFIX_BYTES: Final = 8
CANCEL_TIMEOUT_S: Final = 5.0
RETRY_S, MAX_RETRY_S = 0.2, 5.0
UNLISTED_ATTEMPTS: Final = 3
"""How often a goal is cancelled that no server has shown: it may wait unread at its server."""
UNKNOWN_GOAL: Final = 2
"""The constant of `action_msgs/srv/CancelGoal`."""


class StatusGraph(Protocol):
    """The part of `port.RosGraph` that follows the states of goals, and cancels them."""

    async def subscribe(
        self, topic: str, type_name: str, on_message: OnMessage, qos: Qos = ...
    ) -> Subscription:
        """Subscribe to a topic."""

    async def call(self, service: str, type_name: str, request: Message, timeout_s: float = ...) -> Message:
        """Call a service."""


class OwnGoals:
    """The goals of one bridge; `file` keeps what recognizes them after a restart. Call `open` first."""

    def __init__(self, file: Path | None = None) -> None:
        self.graph: StatusGraph | None = None
        """The graph that follows the states; set before `open`."""
        self._file = file
        self._prefix = secrets.token_bytes(PREFIX_BYTES)
        self._actions: set[str] = set()
        self._awaited: set[bytes] = set()
        self._states: dict[bytes, GoalStatus] = {}
        """The goals of ours that nobody waits for, as last published, until they have ended."""
        self._cancelling: dict[bytes, asyncio.Task[None]] = {}
        self._subscriptions: dict[str, Subscription] = {}

    async def open(self) -> None:
        """Follow the actions of earlier runs. Raises `UsageError` if the file is damaged."""
        if self._file is None:
            return
        try:
            kept = orjson.loads(await asyncio.to_thread(self._file.read_bytes))
            prefix = int(kept["prefix"], 16).to_bytes(PREFIX_BYTES, "big")
            actions = [str(name) for name in kept["actions"]]
        except FileNotFoundError:
            return
        except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
            raise UsageError(
                f"the record of the sent goals of the ROS bridge, {self._file}, cannot be read ({error}); "
                "look whether the robots are at rest, then delete the file"
            ) from None
        self._prefix = prefix
        self._actions = set(actions)
        for action in actions:
            await self._follow(action)

    async def watch(self, action: str) -> None:
        """Follow the goals of an action from now on, also after a restart. Raises `GraphError`."""
        if action not in self._actions:
            self._actions.add(action)
            await self._keep()
        await self._follow(action)

    def new_id(self) -> bytes:
        """Return the id of a goal that its sender waits for until `end` or `give_up`."""
        goal_id = self._prefix + secrets.token_bytes(16 - PREFIX_BYTES)
        self._awaited.add(goal_id)
        return goal_id

    def end(self, goal_id: bytes) -> None:
        """Forget a goal that has ended, or that was not accepted."""
        self._awaited.discard(goal_id)

    def give_up(self, action: str, goal_id: bytes) -> None:
        """Cancel a goal that may still be executed: now, and whenever a server shows it."""
        if goal_id in self._awaited:
            self._awaited.discard(goal_id)
            log.warning("goal given up; it is cancelled", action=action, goal=goal_id.hex())
            self._start_cancelling(action, goal_id)

    async def close(self) -> None:
        """Stop following. What was given up is cancelled after the next start."""
        for task in self._cancelling.values():
            task.cancel()
        await asyncio.gather(*self._cancelling.values(), return_exceptions=True)
        for subscription in self._subscriptions.values():
            await subscription.close()
        self._subscriptions.clear()

    async def _keep(self) -> None:
        if self._file is not None:
            content = orjson.dumps({"prefix": self._prefix.hex(), "actions": sorted(self._actions)})
            try:
                await asyncio.to_thread(replace_durably, self._file, content)
            except OSError as error:
                raise GraphError(
                    f"{self._file} cannot be written ({error.strerror}), so no goal is sent: after a restart "
                    "the bridge could not stop it; free disk space"
                ) from error

    async def _follow(self, action: str) -> None:
        if action in self._subscriptions or self.graph is None:
            return

        def on_status(received: Received) -> None:
            self._on_status(action, received.message["status_list"])

        self._subscriptions[action] = await self.graph.subscribe(
            f"{action}/_action/status", GOAL_STATUS_ARRAY, on_status, LATCHED
        )

    def _on_status(self, action: str, listed: Iterable[Message]) -> None:
        for goal in listed:
            goal_id, status = bytes(goal["goal_info"]["goal_id"]["uuid"]), goal["status"]
            if not goal_id.startswith(self._prefix) or goal_id in self._awaited:
                continue
            if status >= GoalStatus.SUCCEEDED:
                self._states.pop(goal_id, None)
                continue
            if goal_id not in self._states:
                log.warning("a goal that nobody waits for is active", action=action, goal=goal_id.hex())
            self._states[goal_id] = GoalStatus(status)
            self._start_cancelling(action, goal_id)

    def _start_cancelling(self, action: str, goal_id: bytes) -> None:
        if goal_id not in self._cancelling:
            task = asyncio.get_running_loop().create_task(self._cancel(action, goal_id))
            self._cancelling[goal_id] = task
            task.add_done_callback(lambda _: self._cancelling.pop(goal_id, None))

    async def _cancel(self, action: str, goal_id: bytes) -> None:
        backoff, attempts = Backoff(RETRY_S, MAX_RETRY_S), 0
        request = {"goal_info": {"goal_id": {"uuid": goal_id}}}
        while goal_id in self._states or attempts < UNLISTED_ATTEMPTS:
            attempts += 1
            try:
                assert self.graph is not None  # noqa: S101 - set before `open`
                answer = await self.graph.call(
                    f"{action}/_action/cancel_goal", CANCEL_GOAL, request, CANCEL_TIMEOUT_S
                )
            except GraphError as error:
                log.warning("cancelling a goal that was given up failed", action=action, error=str(error))
            else:
                if answer["return_code"] == UNKNOWN_GOAL:
                    self._states.pop(goal_id, None)  # its server was started again
            await backoff.wait()
