"""Goals of actions: waiting for a result and the cancel signal, shared by the adapters."""

import asyncio
from collections.abc import Mapping
from typing import Any, TypeVar

from handover.messages import number_text
from handover_ros.errors import CallTimeout, ClosedUnanswered, ServerLost, ServiceUnavailable
from handover_ros.graph.qos import MAX_REQUESTS_IN_FLIGHT

Result = TypeVar("Result")
MAX_RESULT_CHARS = 500


async def result_within(pending: "asyncio.Future[Result]", action: str, timeout_s: float | None) -> Result:
    """Wait for the result of a goal; a timeout does not cancel `pending`, which may be awaited again.

    Raises:
        CallTimeout: the goal did not end in time.
        ClosedUnanswered: `pending` was cancelled, because the action was closed.
    """
    try:
        return await asyncio.wait_for(asyncio.shield(pending), timeout_s)
    except asyncio.CancelledError:
        if pending.cancelled():  # by the adapter, not by the caller
            raise ClosedUnanswered(f"{action} was closed before the goal ended") from None
        raise
    except TimeoutError:
        raise CallTimeout(
            f"{action}: the goal did not end within {number_text(timeout_s or 0.0)} s"
        ) from None


def result_text(result: Mapping[str, Any]) -> str:
    """Return what the result of a goal says, as text: its texts, numbers and flags that have a value."""
    said = (
        f"{name} {value}" for name, value in result.items() if isinstance(value, str | int | float) and value
    )
    return ", ".join(said)[:MAX_RESULT_CHARS]


def unanswered(service: str, timeout_s: float) -> CallTimeout:
    """Return the error for a request that was sent and not answered in time."""
    return CallTimeout(f"{service} did not answer within {number_text(timeout_s)} s")


def too_busy(service: str) -> ServiceUnavailable:
    """Return the error for a request that was not sent, because too many wait for their responses."""
    return ServiceUnavailable(
        f"{service} has not answered {MAX_REQUESTS_IN_FLIGHT} earlier requests, so this one was not sent"
    )


def goal_forgotten(action: str) -> ServerLost:
    """Return the error for a goal that its server does not know any more."""
    return ServerLost(f"{action}: its server does not know the goal any more; it was started again")


class CancelSignal:
    """The part of `port.ServedGoal` that concerns cancelling."""

    def __init__(self) -> None:
        self._cancel_requested = asyncio.Event()

    @property
    def cancel_requested(self) -> bool:
        """Return whether the client has requested the cancellation."""
        return self._cancel_requested.is_set()

    async def wait_cancel_requested(self) -> None:
        """Wait until the client requests the cancellation."""
        await self._cancel_requested.wait()

    def request_cancel(self) -> None:
        """Record the request of the client."""
        self._cancel_requested.set()
