"""Live: the one WebSocket over which a page is told everything, at most 30 times a second.

A page that reads slowly gets fewer, larger batches with the newest values; one that does not read at all is
let go, and comes back by itself to a snapshot. No page waits for another.
"""

import asyncio
from contextlib import suppress
from datetime import UTC, datetime

import orjson
from starlette.websockets import WebSocket, WebSocketDisconnect

from datamodels.times import iso
from handover.telemetry import get_logger
from webui.audience import Audience
from webui.metrics import BATCHES, COALESCED, PAGES, TOO_SLOW
from webui.world import Reader, World

log = get_logger(__name__)

LEAST_PAUSE_S = 1 / 30
SAYS_SOMETHING_EVERY_S = 5.0
"""A batch, if need be an empty one, is sent so often: silence tells a page that the link is broken."""
BLOCKED_S = 15.0
MOST_WANTED = 64


class Live:
    """Tells pages about the world; one that has not read for `patience_s` is let go."""

    def __init__(self, world: World, audience: Audience, patience_s: float = BLOCKED_S) -> None:
        self._world = world
        self._audience = audience
        self._patience_s = patience_s
        PAGES.set_function(lambda: audience.size)

    async def show(self, page: WebSocket) -> None:
        """Tell `page` everything until it goes or is let go."""
        await page.accept()
        news = asyncio.Event()
        reader = self._world.open_reader(news.set)
        listening = asyncio.create_task(self._listen(page, reader))
        sending = asyncio.create_task(self._send(page, reader, news))
        try:
            await asyncio.wait({listening, sending}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._world.close_reader(reader)
            self._audience.leave(reader)
            for half in (listening, sending):
                half.cancel()
            ends = await asyncio.gather(listening, sending, return_exceptions=True)
        for end in ends:
            if isinstance(end, Exception) and not isinstance(end, WebSocketDisconnect | TimeoutError):
                raise end

    async def _send(self, page: WebSocket, reader: Reader, news: asyncio.Event) -> None:
        await self._audience.join(reader)
        overtaken = 0
        while True:
            news.clear()
            batch = reader.take(iso(datetime.now(UTC), "milliseconds")).decode()
            try:
                async with asyncio.timeout(self._patience_s):
                    await page.send_text(batch)
            except TimeoutError:
                TOO_SLOW.inc()
                log.warning("a page does not read and is let go", blocked_s=self._patience_s)
                raise
            BATCHES.inc()
            await asyncio.sleep(LEAST_PAUSE_S)
            with suppress(TimeoutError):
                async with asyncio.timeout(SAYS_SOMETHING_EVERY_S - LEAST_PAUSE_S):
                    await news.wait()
            COALESCED.inc(reader.overtaken - overtaken)
            overtaken = reader.overtaken

    async def _listen(self, page: WebSocket, reader: Reader) -> None:
        while (said := await page.receive())["type"] != "websocket.disconnect":
            topics = _wanted(said.get("text") or "")
            if topics is not None:
                reader.want(topics)
                self._audience.changed()


def _wanted(said: str) -> list[str] | None:
    """Return the topics that a page says it wants, None if it says something else."""
    with suppress(orjson.JSONDecodeError):
        wish = orjson.loads(said)
        if isinstance(wish, dict) and wish.get("type") == "want" and isinstance(wish.get("topics"), list):
            return [topic for topic in wish["topics"][:MOST_WANTED] if isinstance(topic, str)]
    return None
