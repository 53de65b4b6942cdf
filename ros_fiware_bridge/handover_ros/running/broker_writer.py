"""Writes updates to the broker in bulk requests, and retries while the broker is unavailable.

A request is sent at once if none was sent within the last `batch_s`. Each entity has at most one request in
flight. Updates that the broker refuses are reported to their rule; others wait in the outbox.
"""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Self

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger
from handover_ros.metrics import BROKER_UNAVAILABLE, PENDING_UPDATES
from handover_ros.rules.outbox import Batch, Outbox, Update

log = get_logger(__name__)

MAX_REQUESTS_IN_FLIGHT = 4
SHUTDOWN_TIMEOUT_S = 1.0

OnAccepted = Callable[[Update], None]
OnRefused = Callable[[Update, str], None]
OnDropped = Callable[[str, int, str], None]
"""Called with the rule, the number and the cause, `broker_away` or `broker_slow`."""


class BrokerWriter:
    """Writes queued updates, while it is entered as an asynchronous context manager.

    `on_accepted` is called with updates that the broker has accepted, `on_refused` with those that it
    refuses, `on_dropped` with the number of updates that newer ones have replaced.
    """

    def __init__(
        self,
        broker: BrokerClient,
        batch_s: float,
        *,
        on_accepted: OnAccepted,
        on_refused: OnRefused,
        on_dropped: OnDropped,
    ) -> None:
        self.outbox = Outbox()
        self.away_since_s: float | None = None
        self._broker = broker
        self._batch_s = batch_s
        self._on_accepted = on_accepted
        self._on_refused = on_refused
        self._on_dropped = on_dropped
        self._has_pending = asyncio.Event()
        self._emptied = asyncio.Event()
        self._requests_in_flight = 0
        self._backoff = Backoff()
        self._tasks = BackgroundTasks("broker writer")

    async def __aenter__(self) -> Self:
        await self._tasks.__aenter__()
        self._tasks.start(self._work)
        return self

    async def __aexit__(self, *_: object) -> None:
        """Wait for pending updates for at most `SHUTDOWN_TIMEOUT_S`, then stop."""
        if self.away_since_s is None and (len(self.outbox) or self._requests_in_flight):
            self._emptied.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(SHUTDOWN_TIMEOUT_S):
                    await self._emptied.wait()
        await self._tasks.__aexit__()
        if left := len(self.outbox):
            log.warning("updates lost at shutdown", updates=left)

    def put(self, update: Update) -> None:
        """Queue an update; a newer update of the same rule and entity may replace it."""
        self._count_dropped(update.rule, self.outbox.put(update))
        self._has_pending.set()

    async def _work(self) -> None:
        clock = asyncio.get_running_loop().time
        sent_at_s = float("-inf")
        while True:
            await self._has_pending.wait()
            if (wait_s := sent_at_s + self._batch_s - clock()) > 0:
                await asyncio.sleep(wait_s)
            self._has_pending.clear()
            limit = 1 if self.away_since_s is not None else MAX_REQUESTS_IN_FLIGHT
            if self._requests_in_flight < limit and (batches := self.outbox.take()):
                sent_at_s = clock()
                self._requests_in_flight += 1
                self._tasks.start(self._send, batches).add_done_callback(self._request_done)
                self._has_pending.set()  # there may be more than one request can carry
            PENDING_UPDATES.set(len(self.outbox))

    def _request_done(self, _: asyncio.Task[None]) -> None:
        self._requests_in_flight -= 1
        if len(self.outbox):
            self._has_pending.set()
        elif not self._requests_in_flight:
            self._emptied.set()

    async def _send(self, batches: Sequence[Batch]) -> None:
        upserted = [batch for batch in batches if batch.create]
        if upserted:
            await self._deliver(upserted)
        for batch in batches:
            if not batch.create:
                await self._deliver([batch])

    async def _deliver(self, batches: list[Batch]) -> None:
        try:
            await self._write(batches)
        except BrokerUnavailable as error:
            await self._wait_for_broker(batches, error)
        except BrokerError:
            await self._deliver_one_by_one(batches)
        except BaseException:
            self._requeue(batches)
            raise
        else:
            for batch in batches:
                self._count_accepted(batch)
            self.outbox.acknowledge(batches)
            self._broker_answered()

    async def _deliver_one_by_one(self, batches: Sequence[Batch]) -> None:
        """Write one version at a time, so that one refused update does not hold up the others."""
        for index, batch in enumerate(batches):
            try:
                for version in batch.split():
                    try:
                        await self._write([version])
                    except BrokerUnavailable:
                        raise
                    except BrokerError as error:
                        for update in version.updates:
                            self._on_refused(update, str(error))
                    else:
                        self._count_accepted(version)
            except BrokerUnavailable as error:
                await self._wait_for_broker(batches[index:], error)
                return
            except BaseException:
                self._requeue(batches[index:])
                raise
            self.outbox.acknowledge([batch])
            self._broker_answered()

    def _count_accepted(self, batch: Batch) -> None:
        for version in batch.versions:
            for update in version:
                self._on_accepted(update)

    async def _write(self, batches: Sequence[Batch]) -> None:
        if batches[0].create:
            await self._broker.upsert([entity for batch in batches for entity in batch.entities()])
            return
        for entity in batches[0].entities():
            attributes = {name: value for name, value in entity.items() if name not in {"id", "type"}}
            await self._broker.append(batches[0].entity_id, attributes)

    async def _wait_for_broker(self, batches: Sequence[Batch], error: BrokerUnavailable) -> None:
        if self.away_since_s is None:
            log.warning("broker unavailable, updates wait", error=str(error), pending=len(self.outbox))
            self.away_since_s = asyncio.get_running_loop().time()
            BROKER_UNAVAILABLE.set(1)
        try:
            await self._backoff.wait()
        finally:
            self._requeue(batches)

    def _requeue(self, batches: Sequence[Batch]) -> None:
        for rule, number in self.outbox.requeue(batches).items():
            self._count_dropped(rule, number)

    def _count_dropped(self, rule: str, number: int) -> None:
        if number:
            self._on_dropped(rule, number, "broker_slow" if self.away_since_s is None else "broker_away")

    def _broker_answered(self) -> None:
        if self.away_since_s is not None:
            log.info("broker available again", pending=len(self.outbox))
            self.away_since_s = None
            BROKER_UNAVAILABLE.set(0)
        self._backoff.reset()
