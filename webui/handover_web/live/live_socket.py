"""The WebSocket that sends the live state to a page, at most 30 messages a second.

A page that reads slowly receives fewer, larger batches with the newest values. A page that does not read at
all is disconnected; it reconnects by itself and receives a snapshot. Pages do not delay each other.
"""

import asyncio
from contextlib import suppress
from datetime import UTC, datetime

import orjson
from starlette.websockets import WebSocket, WebSocketDisconnect

from handover.telemetry import get_logger
from handover_datamodels.times import iso
from handover_web.live.live_state import PULSE, LiveState, Reader, Viewer
from handover_web.live.viewers import Viewers
from handover_web.metrics import BATCHES, COALESCED, PAGES, SLOW_PAGES

log = get_logger(__name__)

MIN_INTERVAL_S = 1 / 30
HEARTBEAT_INTERVAL_S = 1.0
"""A batch is sent at least this often, if need be an empty one; a page without one says that it is old."""
PULSE_INTERVAL_S = 0.15
"""The same for a page that subscribes to `pulse`, as the control of a robot does."""
SEND_TIMEOUT_S = 15.0
MAX_SUBSCRIPTIONS = 64


class LiveSocket:
    """Sends the live state to pages; disconnects a page that has not read for `send_timeout_s`."""

    def __init__(self, state: LiveState, viewers: Viewers, send_timeout_s: float = SEND_TIMEOUT_S) -> None:
        self._state = state
        self._viewers = viewers
        self._send_timeout_s = send_timeout_s
        PAGES.set_function(lambda: len(viewers))

    async def serve(self, socket: WebSocket, reader: Reader | None = None) -> None:
        """Send the live state to one page until either side closes the connection."""
        await socket.accept()
        changed = asyncio.Event()
        viewer = self._state.add_viewer(changed.set, reader)
        receiving = asyncio.create_task(self._receive(socket, viewer))
        sending = asyncio.create_task(self._send(socket, viewer, changed))
        try:
            await asyncio.wait({receiving, sending}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._state.remove_viewer(viewer)
            self._viewers.remove(viewer)
            for task in (receiving, sending):
                task.cancel()
            results = await asyncio.gather(receiving, sending, return_exceptions=True)
        for result in results:
            if isinstance(result, Exception) and not isinstance(result, WebSocketDisconnect | TimeoutError):
                raise result

    async def _send(self, socket: WebSocket, viewer: Viewer, changed: asyncio.Event) -> None:
        await self._viewers.add(viewer)
        coalesced_count = 0
        while True:
            changed.clear()
            message = viewer.next_message(iso(datetime.now(UTC), "milliseconds")).decode()
            try:
                async with asyncio.timeout(self._send_timeout_s):
                    await socket.send_text(message)
            except TimeoutError:
                SLOW_PAGES.inc()
                log.warning("page disconnected: it does not read", send_timeout_s=self._send_timeout_s)
                raise
            BATCHES.inc()
            await asyncio.sleep(MIN_INTERVAL_S)
            with suppress(TimeoutError):
                interval_s = PULSE_INTERVAL_S if PULSE in viewer.subscribed else HEARTBEAT_INTERVAL_S
                async with asyncio.timeout(interval_s - MIN_INTERVAL_S):
                    await changed.wait()
            COALESCED.inc(viewer.coalesced_count - coalesced_count)
            coalesced_count = viewer.coalesced_count

    async def _receive(self, socket: WebSocket, viewer: Viewer) -> None:
        while (message := await socket.receive())["type"] != "websocket.disconnect":
            topics = _subscribed_topics(message.get("text") or "")
            if topics is not None:
                viewer.subscribe(topics)
                self._viewers.notify()


def _subscribed_topics(text: str) -> list[str] | None:
    """Return the topics of a `subscribe` message, None for any other text."""
    with suppress(orjson.JSONDecodeError):
        message = orjson.loads(text)
        if isinstance(message, dict) and message.get("type") == "subscribe":
            topics = message.get("topics")
            if isinstance(topics, list):
                return [topic for topic in topics[:MAX_SUBSCRIPTIONS] if isinstance(topic, str)]
    return None
