"""Goals of actions: waiting for a result and the cancel signal, shared by the adapters."""

import asyncio
from typing import TypeVar

from ros_fiware_bridge.errors import CallTimeout, GraphClosed

Result = TypeVar("Result")


async def result_within(pending: "asyncio.Future[Result]", action: str, timeout_s: float | None) -> Result:
    """Wait for the result of a goal; a timeout does not cancel `pending`, which may be awaited again.

    Raises:
        CallTimeout: the goal did not end in time.
        GraphClosed: `pending` was cancelled, because the action was closed.
    """
    try:
        return await asyncio.wait_for(asyncio.shield(pending), timeout_s)
    except asyncio.CancelledError:
        if pending.cancelled():  # by the adapter, not by the caller
            raise GraphClosed(f"{action} was closed before the goal ended") from None
        raise
    except TimeoutError:
        raise CallTimeout(f"{action}: the goal did not end within {timeout_s} s") from None


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
