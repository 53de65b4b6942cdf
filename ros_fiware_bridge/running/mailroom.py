"""The mailroom: brings letters to the broker, in batches, and keeps trying while it is away.

A batch goes at once when none went within the last `batch_s`; of each entity at most one request is under
way. What the broker refuses is told to the rule it came from; what it cannot take now waits in the outbox.
"""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Self

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.retry import Backoff
from handover.telemetry import get_logger
from ros_fiware_bridge.metrics import BROKER_AWAY, WAITING
from ros_fiware_bridge.rules.outbox import Letter, Outbox, Parcel

log = get_logger(__name__)

MOST_BATCHES_UNDER_WAY = 4
GRACE_S = 1.0

Taken = Callable[[Letter], None]
Refused = Callable[[Letter, str], None]
Dropped = Callable[[str, int, str], None]
"""Called with the rule, the number and the cause, `broker_away` or `broker_slow`."""


class Mailroom:
    """Sends what is put into it; an asynchronous context manager while it works.

    `taken` is called with letters that the broker has, `refused` with those that it does not take, `dropped`
    with how many gave way to newer ones.
    """

    def __init__(
        self, broker: BrokerClient, batch_s: float, *, taken: Taken, refused: Refused, dropped: Dropped
    ) -> None:
        self.outbox = Outbox()
        self.away_since_s: float | None = None
        self._broker = broker
        self._batch_s = batch_s
        self._taken = taken
        self._refused = refused
        self._dropped = dropped
        self._something = asyncio.Event()
        self._emptied = asyncio.Event()
        self._batches: set[asyncio.Task[None]] = set()
        self._backoff = Backoff()
        self._clerk: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._clerk = asyncio.create_task(self._work())
        return self

    async def __aexit__(self, *_: object) -> None:
        """Give what is under way, and what waits, a moment to arrive."""
        if self.away_since_s is None and (len(self.outbox) or self._batches):
            self._emptied.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(GRACE_S):
                    await self._emptied.wait()
        chores = [*self._batches, *([self._clerk] if self._clerk else [])]
        for chore in chores:
            chore.cancel()
        await asyncio.gather(*chores, return_exceptions=True)
        if left := len(self.outbox):
            log.warning("updates lost since the bridge ends and the broker has not taken them", updates=left)

    def put(self, letter: Letter) -> None:
        """Take a letter; it goes soon, or gives way to a newer one."""
        self._lost(letter.rule, self.outbox.put(letter))
        self._something.set()

    async def _work(self) -> None:
        clock = asyncio.get_running_loop().time
        went_at_s = float("-inf")
        while True:
            await self._something.wait()
            if (wait_s := went_at_s + self._batch_s - clock()) > 0:
                await asyncio.sleep(wait_s)
            self._something.clear()
            at_most = 1 if self.away_since_s is not None else MOST_BATCHES_UNDER_WAY
            if len(self._batches) < at_most and (parcels := self.outbox.take()):
                went_at_s = clock()
                batch = asyncio.create_task(self._send(parcels))
                self._batches.add(batch)
                batch.add_done_callback(self._done)
                self._something.set()  # there may be more than one batch holds
            WAITING.set(len(self.outbox))

    def _done(self, batch: asyncio.Task[None]) -> None:
        self._batches.discard(batch)
        if not batch.cancelled() and (error := batch.exception()) is not None:
            log.error("a batch could not be sent", exc_info=error)
        if len(self.outbox):
            self._something.set()
        elif not self._batches:
            self._emptied.set()

    async def _send(self, parcels: Sequence[Parcel]) -> None:
        made = [parcel for parcel in parcels if parcel.create]
        if made:
            await self._deliver(made)
        for parcel in parcels:
            if not parcel.create:
                await self._deliver([parcel])

    async def _deliver(self, parcels: list[Parcel]) -> None:
        try:
            await self._write(parcels)
        except BrokerUnavailable as error:
            await self._wait_for_broker(parcels, error)
        except BrokerError:
            await self._deliver_one_by_one(parcels)
        except BaseException:
            self._count_lost(parcels)
            raise
        else:
            for parcel in parcels:
                self._count_taken(parcel)
            self.outbox.arrived(parcels)
            self._is_back()

    async def _deliver_one_by_one(self, parcels: Sequence[Parcel]) -> None:
        """Find out what it is that the broker does not take, so that the rest arrives all the same."""
        for place, parcel in enumerate(parcels):
            try:
                for version in parcel.one_by_one():
                    try:
                        await self._write([version])
                    except BrokerUnavailable:
                        raise
                    except BrokerError as error:
                        for letter in version.letters:
                            self._refused(letter, str(error))
                    else:
                        self._count_taken(version)
            except BrokerUnavailable as error:
                await self._wait_for_broker(parcels[place:], error)
                return
            except BaseException:
                self._count_lost(parcels[place:])
                raise
            self.outbox.arrived([parcel])
            self._is_back()

    def _count_taken(self, parcel: Parcel) -> None:
        for version in parcel.versions:
            for letter in version:
                self._taken(letter)

    async def _write(self, parcels: Sequence[Parcel]) -> None:
        if parcels[0].create:
            await self._broker.upsert([entity for parcel in parcels for entity in parcel.entities()])
            return
        for entity in parcels[0].entities():
            attributes = {name: value for name, value in entity.items() if name not in {"id", "type"}}
            await self._broker.append(parcels[0].entity_id, attributes)

    async def _wait_for_broker(self, parcels: Sequence[Parcel], error: BrokerUnavailable) -> None:
        if self.away_since_s is None:
            log.warning("broker away, updates wait", error=str(error), waiting=len(self.outbox))
            self.away_since_s = asyncio.get_running_loop().time()
            BROKER_AWAY.set(1)
        try:
            await self._backoff.wait()
        finally:
            self._count_lost(parcels)

    def _count_lost(self, parcels: Sequence[Parcel]) -> None:
        for rule, number in self.outbox.came_back(parcels).items():
            self._lost(rule, number)

    def _lost(self, rule: str, number: int) -> None:
        if number:
            self._dropped(rule, number, "broker_slow" if self.away_since_s is None else "broker_away")

    def _is_back(self) -> None:
        if self.away_since_s is not None:
            log.info("broker is back", waiting=len(self.outbox))
            self.away_since_s = None
            BROKER_AWAY.set(0)
        self._backoff.reset()
