"""The part of a served action that the adapters share: what is counted, and how a goal ends."""

from collections.abc import Callable
from typing import Any

import structlog

from handover_ros.errors import BadMessage
from handover_ros.graph.port import ActionHandler, GoalEnded, GoalStatus, Message, ServedGoal
from handover_ros.types.type_store import TypeStore

log = structlog.get_logger(__name__)


class BaseActionServer:
    """The base of the adapters' action servers; see `port.Served`."""

    def __init__(
        self,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        store: TypeStore,
        accept: Callable[[Message], bool] | None,
        closed: Callable[[Any], None],
    ) -> None:
        self.name = action
        self.type_name = type_name
        self.calls = 0
        self.failed = 0
        self.last_error: str | None = None
        self._handler = handler
        self._store = store
        self._accept = accept
        self._closed = closed

    def _accepts(self, request: Message) -> bool:
        try:
            return self._accept is None or self._accept(request)
        except Exception as error:  # noqa: BLE001 - one goal must not end the action
            self._fault(error)
            return False

    async def _outcome(self, goal: ServedGoal) -> tuple[GoalStatus, Message]:
        """Let the handler execute a goal; return its final status, and a result that matches the definition.

        A goal is CANCELED only if its client has requested that: ROS has no such transition otherwise.
        """
        status = GoalStatus.SUCCEEDED
        try:
            try:
                result = await self._handler(goal)
            except GoalEnded as ended:
                status, result = ended.status, ended.result
                if not status.is_over or (status is GoalStatus.CANCELED and not goal.cancel_requested):
                    status = GoalStatus.ABORTED
            self._check(result)
        except Exception as error:  # noqa: BLE001 - one goal must not end the action
            self._fault(error)
            return GoalStatus.ABORTED, {}
        return status, result

    def _check(self, result: Message) -> None:
        """Raise `BadMessage` if the adapter cannot send the result."""
        self._store.check(f"{self.type_name}_Result", result)

    def _fault(self, error: Exception) -> None:
        self.failed += 1
        self.last_error = f"{type(error).__name__}: {error}"
        # An error of ours has a traceback; what a message lacks is said by the text.
        log.error(
            "executing a goal failed",
            action=self.name,
            error=self.last_error,
            exc_info=None if isinstance(error, BadMessage) else error,
        )
