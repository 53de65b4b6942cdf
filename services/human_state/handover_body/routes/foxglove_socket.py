"""A WebSocket for the Foxglove app: the live signals of all persons who consent, with the rights of its user.

The app sends no header, so the token stands in its address: `/foxglove?token=TOKEN`. As with every WebSocket
of ours, `Origin` is checked, the opening is audited, and the stream ends with the token or its grant.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Final

from fastapi import Depends, FastAPI
from starlette.websockets import WebSocket, WebSocketDisconnect

from handover.http.websocket_closing import close_websocket
from handover.security.guard import require, token_in_query
from handover.security.permissions import Permission
from handover_body.exchange.foxglove import SUBPROTOCOLS, FoxgloveStream
from handover_body.formats.json_messages import Recorded
from handover_body.monitoring.monitoring import Monitoring
from handover_body.monitoring.person_monitor import PersonMonitor

CHECK_EVERY_S: Final = 0.25
MAX_CLIENTS: Final = 8
NO_PROTOCOL_CODE: Final = 4400
TOO_MANY_CODE: Final = 4429


def add_foxglove(app: FastAPI, monitoring: Monitoring) -> None:
    """Add the WebSocket."""
    clients: set[_Client] = set()

    @app.websocket("/foxglove", dependencies=[Depends(token_in_query), require(Permission.READ_HEALTH_DATA)])
    async def foxglove(socket: WebSocket) -> None:
        """Send what the sensors of persons who consent send, by pseudonym."""
        subprotocol = next(
            (protocol for protocol in SUBPROTOCOLS if protocol in socket.scope["subprotocols"]), None
        )
        await socket.accept(subprotocol)
        if subprotocol is None:
            reason = f"this is for clients of Foxglove; ask for {' or '.join(SUBPROTOCOLS)}"
            await close_websocket(socket, NO_PROTOCOL_CODE, reason)
            return
        if len(clients) >= MAX_CLIENTS:
            await close_websocket(socket, TOO_MANY_CODE, f"{MAX_CLIENTS} clients are connected; close one")
            return
        client = _Client(socket, monitoring)
        clients.add(client)
        try:
            await client.run()
        finally:
            clients.discard(client)


class _Client:
    """Taps the monitors of all persons for one client. A monitor takes nothing without consent."""

    def __init__(self, socket: WebSocket, monitoring: Monitoring) -> None:
        self._socket = socket
        self._monitoring = monitoring
        self._stream = FoxgloveStream()
        self._has_news = asyncio.Event()
        self._tapped: dict[PersonMonitor, Callable[[Recorded], None]] = {}

    async def run(self) -> None:
        """Serve the client until it leaves."""
        tasks = [asyncio.create_task(self._send()), asyncio.create_task(self._receive())]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for monitor, tap in self._tapped.items():
                monitor.taps.discard(tap)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _receive(self) -> None:
        with suppress(WebSocketDisconnect, RuntimeError, KeyError):
            while True:
                self._stream.receive(await self._socket.receive_text())
                self._has_news.set()

    async def _send(self) -> None:
        while True:
            self._follow()
            for message in self._stream.take():
                if isinstance(message, bytes):
                    await self._socket.send_bytes(message)
                else:
                    await self._socket.send_text(message)
            with suppress(TimeoutError):
                async with asyncio.timeout(CHECK_EVERY_S):
                    await self._has_news.wait()
            self._has_news.clear()

    def _follow(self) -> None:
        """Tap new monitors; those of persons who withdrew their consent are gone."""
        present = set(self._monitoring.monitors.values())
        if self._tapped.keys() - present:
            self._stream.drop_waiting()
        self._tapped = {monitor: tap for monitor, tap in self._tapped.items() if monitor in present}
        for monitor in present - self._tapped.keys():
            tap = partial(self._take, monitor.person.pseudonym)
            self._tapped[monitor] = tap
            monitor.taps.add(tap)

    def _take(self, subject: str, item: Recorded) -> None:
        self._stream.publish(item, subject)
        self._has_news.set()
