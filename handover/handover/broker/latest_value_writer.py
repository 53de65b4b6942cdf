"""Writes to the broker in the background: of each key only the latest value is written.

State that is overwritten by newer state (a Device, an Alert) does not need every intermediate value. The
caller never waits. One worker writes one value after another, and a newer value of a key replaces the one
that waits; so the number of keys bounds the memory in use.

How failures are handled:

1. While no answer comes, all values wait, and each attempt is that of another key.
2. A key that the broker does not accept now (429, 503) waits alone, and the other keys are written meanwhile.
3. A key at which the broker fails (500) is tried `MAX_FAULTS` times; then it is rejected, as after a refusal.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Self

from handover.broker import (
    MAX_FAULTS,
    BrokerError,
    BrokerFault,
    BrokerUnavailable,
    BrokerUnreachable,
    fault_delay_s,
)
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger

log = get_logger(__name__)

Write = Callable[[], Awaitable[object]]
OnRejected = Callable[[str, BrokerError | ValueError], None]


@dataclass
class _Waiting:
    """The write of a key, and how it went so far."""

    write: Write
    backoff: Backoff = field(default_factory=Backoff)
    faults: int = 0


class LatestValueWriter:
    """Performs the latest write of each key; an asynchronous context manager, or use `run`.

    `on_rejected` is called with the key and the error of a write that the broker refused or failed at, or
    whose value was invalid.
    """

    def __init__(self, *, on_rejected: OnRejected | None = None) -> None:
        self._on_rejected = on_rejected
        self._ready: dict[str, _Waiting] = {}
        """In the order in which they are written."""
        self._later: dict[str, _Waiting] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._has_ready = asyncio.Event()
        self._outage = Backoff()
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
        waiting = self._ready.get(key) or self._later.get(key)
        if waiting is None:
            self._add(key, _Waiting(write))
        else:
            waiting.write = write

    async def run(self) -> None:
        """Write until cancelled."""
        try:
            while True:
                await self._has_ready.wait()
                while self._ready:
                    key = next(iter(self._ready))
                    await self._attempt(key, self._ready.pop(key))
                self._has_ready.clear()
        finally:
            for key in list(self._timers):
                self._resume(key)

    async def _attempt(self, key: str, waiting: _Waiting) -> None:
        try:
            await waiting.write()
        except BrokerUnreachable as error:
            log.warning("broker unavailable, writes wait", key=key, error=str(error))
            self._add(key, self._latest(key, waiting))  # after all others
            await self._outage.wait()
            return
        except BrokerFault as error:
            waiting.faults += 1
            if waiting.faults == MAX_FAULTS:
                self._reject(key, error)
            else:
                log.warning("the broker fails at a write, which is repeated", key=key, error=str(error))
                self._postpone(key, waiting, fault_delay_s(waiting.faults))
        except BrokerUnavailable as error:
            log.warning("the broker does not accept a write now, which waits", key=key, error=str(error))
            self._postpone(key, waiting, waiting.backoff.next_delay_s())
        except (BrokerError, ValueError) as error:
            self._reject(key, error)
        self._outage.reset()

    def _reject(self, key: str, error: BrokerError | ValueError) -> None:
        log.error("write rejected", key=key, error=str(error))
        if self._on_rejected is not None:
            self._on_rejected(key, error)

    def _postpone(self, key: str, waiting: _Waiting, delay_s: float) -> None:
        self._later[key] = self._latest(key, waiting)
        self._timers[key] = asyncio.get_running_loop().call_later(delay_s, self._resume, key)

    def _resume(self, key: str) -> None:
        self._timers.pop(key).cancel()
        self._add(key, self._later.pop(key))

    def _latest(self, key: str, waiting: _Waiting) -> _Waiting:
        """Take a newer write of the key, which came during the attempt."""
        newer = self._ready.pop(key, None)
        waiting.write = newer.write if newer else waiting.write
        return waiting

    def _add(self, key: str, waiting: _Waiting) -> None:
        self._ready[key] = waiting
        self._has_ready.set()
