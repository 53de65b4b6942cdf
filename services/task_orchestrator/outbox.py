"""Outbox: what was decided is told to the broker, right after it was written down and until it has arrived.

Messages of one stream (one process) go in order, streams side by side. While the broker is away they wait;
what it refuses for good is reported back. A message may arrive twice, after a crash: none does harm then.
"""

import asyncio
import random
from collections import deque
from collections.abc import Awaitable, Callable, Iterable

from prometheus_client import Counter, Gauge

from handover.alerts import clear_alert, raise_alert
from handover.broker import AlreadyExists, BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.errors import Problem
from handover.messages import message_in
from handover.settings import Settings
from handover.telemetry import get_logger
from services.task_orchestrator.records import Message, Saying

log = get_logger(__name__)

FIRST_RETRY_S, LAST_RETRY_S = 0.05, 2.0

WAITING = Gauge("handover_orchestrator_outbox_messages", "Messages that the broker has not got yet")
REFUSED = Counter("handover_orchestrator_refused_total", "Messages that the broker refused", ["saying"])

Refused = Callable[[Message, str], Awaitable[None]]


class Outbox:
    """Delivers messages; `refused` is awaited for each that the broker will never take."""

    def __init__(self, settings: Settings, broker: BrokerClient, refused: Refused) -> None:
        self._settings = settings
        self._broker = broker
        self._refused = refused
        self._streams: dict[str, deque[Message]] = {}
        self._couriers: dict[str, asyncio.Task[None]] = {}
        self._delivered: list[int] = []
        self._on_its_way: dict[str, int] = {}
        self._try_again = asyncio.Event()
        self.something_delivered = asyncio.Event()

    def send(self, messages: Iterable[Message]) -> None:
        """Deliver `messages`, which are in the database already, from now on."""
        for message in messages:
            self._streams.setdefault(message.stream, deque()).append(message)
            self._on_its_way[message.subject] = self._on_its_way.get(message.subject, 0) + 1
            WAITING.inc()
            if message.stream not in self._couriers:
                courier = asyncio.create_task(self._deliver_stream(message.stream))
                self._couriers[message.stream] = courier

    def on_its_way(self, subject: str) -> bool:
        """Say whether something about the entity `subject` has not arrived yet."""
        return subject in self._on_its_way

    def take_delivered(self) -> list[int]:
        """Return the numbers of messages that have arrived since the last call, to be struck off."""
        delivered, self._delivered = self._delivered, []
        self.something_delivered.clear()
        return delivered

    def put_back(self, delivered: list[int]) -> None:
        """Take back what `take_delivered` gave: it could not be struck off."""
        self._delivered += delivered
        if delivered:
            self.something_delivered.set()

    def broker_is_back(self) -> None:
        """Try at once what waits for the broker."""
        self._try_again.set()
        self._try_again = asyncio.Event()

    async def close(self) -> None:
        """Stop delivering; what has not arrived stays in the database."""
        couriers = list(self._couriers.values())
        for courier in couriers:
            courier.cancel()
        await asyncio.gather(*couriers, return_exceptions=True)

    async def _deliver_stream(self, stream: str) -> None:
        messages = self._streams[stream]
        try:
            while messages:
                try:
                    await self._deliver(messages[0])
                except Exception:
                    REFUSED.labels(messages[0].saying).inc()
                    log.exception("a message cannot be told", subject=messages[0].subject)
                self._arrived(messages.popleft())
        finally:
            del self._couriers[stream]
        del self._streams[stream]

    async def _deliver(self, message: Message) -> None:
        retry_s = FIRST_RETRY_S
        while True:
            try:
                await self._tell(message)
            except BrokerUnavailable as error:
                log.warning("broker away, message waits", subject=message.subject, error=str(error))
                await self._pause(retry_s * random.uniform(0.8, 1.2))  # noqa: S311 - jitter
                retry_s = min(2 * retry_s, LAST_RETRY_S)
            except BrokerError as error:
                if await self._report(message, error):
                    return
                await self._pause(LAST_RETRY_S)
            else:
                return

    async def _report(self, message: Message, error: BrokerError) -> bool:
        """Report that the broker refused `message`; return whether the report could be written down."""
        REFUSED.labels(message.saying).inc()
        log.error("broker refused", subject=message.subject, saying=message.saying, error=str(error))
        try:
            await self._refused(message, str(error))
        except Problem as problem:
            log.warning("the refusal could not be written down yet", error=str(problem))
            return False
        return True

    async def _tell(self, message: Message) -> None:
        match message.saying:
            case Saying.CREATE:
                try:
                    await self._broker.create(message.body)
                except AlreadyExists:
                    log.debug("already there", subject=message.subject)
            case Saying.UPSERT:
                await self._broker.upsert(message.body)
            case Saying.APPEND:
                try:
                    await self._broker.append(message.subject, message.body)
                except NotFound:
                    log.warning("no longer there", subject=message.subject)
            case Saying.DELETE:
                await self._broker.delete_batch(message.body)
            case Saying.RAISE:
                alert = {k: v for k, v in message.body.items() if not k.startswith("description")}
                said = message_in(message.body, "description") or ""
                await raise_alert(self._broker, self._settings, description=said, **alert)
            case Saying.CLEAR:
                await clear_alert(self._broker, self._settings, **message.body)

    def _arrived(self, message: Message) -> None:
        WAITING.dec()
        self._delivered.append(message.seq)
        left = self._on_its_way[message.subject] - 1
        if left:
            self._on_its_way[message.subject] = left
        else:
            del self._on_its_way[message.subject]
        self.something_delivered.set()

    async def _pause(self, seconds: float) -> None:
        try:
            async with asyncio.timeout(seconds):
                await self._try_again.wait()
        except TimeoutError:
            return
