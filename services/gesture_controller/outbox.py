"""The outbox: what the broker is to be told, the newest of each kind.

Nobody waits for it: writes go out one after another, and while the broker is away they are kept, each
replaced by a newer one of the same kind.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Self

from handover.broker import BrokerError, BrokerUnavailable
from handover.telemetry import get_logger
from services.gesture_controller import metrics

log = get_logger(__name__)

FIRST_RETRY_S, LAST_RETRY_S = 0.1, 2.0

Write = Callable[[], Awaitable[object]]


class Outbox:
    """Writes to the broker in the background; an asynchronous context manager."""

    def __init__(self) -> None:
        self._waiting: dict[str, Write] = {}
        self._something_waits = asyncio.Event()
        self._worker: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._worker = asyncio.create_task(self._work())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._worker is not None:
            self._worker.cancel()
            with suppress(asyncio.CancelledError):
                await self._worker

    def put(self, kind: str, write: Write) -> None:
        """Have `write` done soon; one of the same `kind` that still waits is replaced."""
        self._waiting[kind] = write
        self._something_waits.set()

    async def _work(self) -> None:
        while True:
            await self._something_waits.wait()
            while self._waiting:
                kind = next(iter(self._waiting))
                await self._insist(kind, self._waiting.pop(kind))
            self._something_waits.clear()

    async def _insist(self, kind: str, write: Write) -> None:
        retry_s = FIRST_RETRY_S
        while True:
            try:
                await write()
            except BrokerUnavailable as error:
                log.warning("broker away, write waits", what=kind, error=str(error))
                await asyncio.sleep(retry_s)
                retry_s = min(2 * retry_s, LAST_RETRY_S)
                write = self._waiting.pop(kind, write)
            except (BrokerError, ValueError):
                metrics.UNTOLD.inc()
                log.exception("broker refused a write", what=kind)
                return
            else:
                return
