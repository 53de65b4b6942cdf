"""Sending: messages wait in the database, and each channel has a task of its own.

So a mail server that hangs delays nothing but its own channel, and no message is lost by `kill -9`. A message
that was sent just before the end of the process may be sent again, with the same id. Failed attempts are
repeated with backoff for `MAX_AGE_S`.

Throttling: while more messages wait than the channel may send now, they are sent together in one. What counts
is in the log, so that a restart does not begin with a full allowance.
"""

import asyncio
import time
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from typing import Final

import orjson

from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger
from handover_alerts import metrics
from handover_alerts.model.configuration import Channel, Throttle
from handover_alerts.senders import NotSent, Outgoing, Senders
from handover_alerts.storage.store import FAILED, SENT, WAITING, Message, Store

log = get_logger(__name__)

MAX_TOGETHER: Final = 200
MAX_AGE_S: Final = 86_400.0
MIN_RETRY_S, MAX_RETRY_S = 1.0, 300.0
LOOK_S: Final = 2.0


class Sending:
    """Sends what waits; run `run` as a task. `channel_of` returns a channel by its name."""

    def __init__(
        self,
        store: Store,
        senders: Senders,
        channel_of: Callable[[str], Channel | None],
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._store = store
        self._senders = senders
        self._channel_of = channel_of
        self._clock = clock
        self._sent_s: defaultdict[str, deque[float]] = defaultdict(deque)
        self._busy: set[str] = set()
        self._wake = asyncio.Event()

    def wake(self) -> None:
        """Look for messages now."""
        self._wake.set()

    async def run(self) -> None:
        """Send until cancelled."""
        self._sent_s.clear()  # another replica may have sent meanwhile
        async with BackgroundTasks("alert router") as tasks:
            while True:
                self._wake.clear()
                waiting = await asyncio.to_thread(self._store.waiting_channels)
                metrics.WAITING.set(sum(waiting.values()))
                for name in waiting.keys() - self._busy:
                    self._busy.add(name)
                    tasks.start(self._drain, name)
                try:
                    async with asyncio.timeout(LOOK_S):
                        await self._wake.wait()
                except TimeoutError:
                    continue

    async def _drain(self, name: str) -> None:
        backoff = Backoff(MIN_RETRY_S, MAX_RETRY_S)
        try:
            await self._load_sent(name)
            while waiting := await asyncio.to_thread(self._store.waiting, name, MAX_TOGETHER):
                channel = self._channel_of(name)
                if channel is None:
                    await self._mark(waiting, FAILED, f'there is no channel "{name}" any more')
                    continue
                allowed = self._allowance(name, channel.throttle)
                if allowed <= 0:
                    await asyncio.sleep(LOOK_S)
                    continue
                together = waiting if len(waiting) > allowed else waiting[:1]
                if not await self._send(channel, together):
                    await backoff.wait()
                    continue
                backoff.reset()
                self._sent_s[name].append(self._clock())
        finally:
            self._busy.discard(name)

    async def _load_sent(self, name: str) -> None:
        """Count what an earlier run has sent."""
        channel = self._channel_of(name)
        if name in self._sent_s or channel is None:
            return
        since_us = int((self._clock() - channel.throttle.per_s) * 1e6)
        sent = await asyncio.to_thread(self._store.sent_since, name, since_us, channel.throttle.maximum)
        self._sent_s[name].extend(sent)

    async def _send(self, channel: Channel, together: Sequence[Message]) -> bool:
        """Send messages in one; return whether the channel works."""
        try:
            await self._senders.send(channel, outgoing(together))
        except NotSent as fault:
            is_old = self._clock() - together[0].created_us / 1e6 > MAX_AGE_S
            state = FAILED if fault.is_final or is_old else WAITING
            log.warning("message not sent", channel=together[0].channel, state=state, reason=str(fault))
            metrics.SENT.labels(channel.type, "failed" if state == FAILED else "repeated").inc()
            await self._mark(together, state, str(fault)[:1000])
            return state == FAILED
        metrics.SENT.labels(channel.type, "sent").inc()
        await self._mark(together, SENT)
        return True

    async def _mark(self, messages: Sequence[Message], state: str, error: str | None = None) -> None:
        numbers = [message.id for message in messages if message.id is not None]
        await asyncio.to_thread(self._store.mark, numbers, state, int(self._clock() * 1e6), error)

    def _allowance(self, name: str, throttle: Throttle) -> int:
        sent = self._sent_s[name]
        while sent and sent[0] <= self._clock() - throttle.per_s:
            sent.popleft()
        return throttle.maximum - len(sent)


def outgoing(messages: Sequence[Message]) -> Outgoing:
    """Return one message with the content of several."""
    alerts = [orjson.loads(message.body) for message in messages]
    first = messages[0]
    identifier = f"handover-{first.id}-{first.created_us}"
    if len(messages) == 1:
        return Outgoing(identifier, first.subject, str(alerts[0].get("text", "")), alerts)
    subject = f"{len(messages)} messages about Alerts"
    text = "\n\n".join(str(alert.get("text", "")) for alert in alerts)
    return Outgoing(identifier, subject, text, alerts)
