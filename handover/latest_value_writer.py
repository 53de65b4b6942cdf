"""Writes to the broker in the background: of each key only the latest value is written.

State that is overwritten by newer state (a Device, an Alert) does not need every intermediate value. The
caller never waits. One worker writes one value after another. While the broker is unavailable, values wait,
and a newer value of the same key replaces the waiting one; so the number of keys bounds the memory in use.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Self

from handover.broker import BrokerError, BrokerUnavailable
from handover.retry import Backoff
from handover.telemetry import get_logger

log = get_logger(__name__)

Write = Callable[[], Awaitable[object]]


class LatestValueWriter:
    """Performs the latest write of each key; an asynchronous context manager, or use `run`.

    `on_rejected` is called with the key of a write that the broker refused, or whose value was invalid.
    """

    def __init__(self, *, on_rejected: Callable[[str], None] | None = None) -> None:
        self._on_rejected = on_rejected
        self._waiting: dict[str, Write] = {}
        self._has_waiting = asyncio.Event()
        self._worker: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._worker = asyncio.create_task(self.run())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._worker is not None:
            self._worker.cancel()
            with suppress(asyncio.CancelledError):
                await self._worker

    def put(self, key: str, write: Write) -> None:
        """Write soon; a write of the same `key` that still waits is replaced."""
        self._waiting[key] = write
        self._has_waiting.set()

    async def run(self) -> None:
        """Write until cancelled."""
        while True:
            await self._has_waiting.wait()
            while self._waiting:
                key = next(iter(self._waiting))
                await self._write_until_accepted(key, self._waiting.pop(key))
            self._has_waiting.clear()

    async def _write_until_accepted(self, key: str, write: Write) -> None:
        backoff = Backoff()
        while True:
            try:
                await write()
            except BrokerUnavailable as error:
                log.warning("broker unavailable, write waits", key=key, error=str(error))
                await backoff.wait()
                write = self._waiting.pop(key, write)
            except (BrokerError, ValueError) as error:
                log.error("write rejected", key=key, error=str(error))  # noqa: TRY400 - it says everything
                if self._on_rejected is not None:
                    self._on_rejected(key)
                return
            else:
                return
