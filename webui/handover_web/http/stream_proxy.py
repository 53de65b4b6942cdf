"""What a service streams to a page, such as the live signals of a person: a WebSocket proxy to it.

The service gets the credentials of the user and decides. A message is read only when the one before was sent,
so nothing queues here: the service drops what is too old for a browser that does not read.
"""

import asyncio
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from handover.errors import Problem
from handover.http.websocket_closing import close_websocket
from handover.network.tls_trust import tls_of
from handover_web.http.page_guard import PageGuard

OPEN_TIMEOUT_S: Final = 3.0
CLOSE_TIMEOUT_S: Final = 1.0
SEND_TIMEOUT_S: Final = 15.0
MAX_MESSAGE_BYTES: Final = 8 * 1024 * 1024
"""More than a packet of the most values that the service sends."""
MAX_WAITING_MESSAGES: Final = 4
UNAVAILABLE_CODE: Final = 4502
"""The close code for a service that does not answer."""


class StreamProxy:
    """Passes on the streams of the services at `urls`, by the name of the service."""

    def __init__(self, urls: Mapping[str, str], guard: PageGuard, ca_files: Sequence[Path]) -> None:
        self._urls = urls
        self._guard = guard
        self._ca_files = ca_files

    async def serve(self, socket: WebSocket, service: str, path: str) -> None:
        """Pass on the stream at `path` (percent-encoded) with the query until one side ends it."""
        await socket.accept()
        try:
            credentials = await self._guard.service_headers(dict(socket.scope["headers"]))
        except Problem as problem:
            await close_websocket(socket, 4000 + problem.status, str(problem.detail))
            return
        passing = asyncio.create_task(self._pass_on(socket, service, path, credentials))
        leaving = asyncio.create_task(_until_left(socket))
        try:
            await asyncio.wait({passing, leaving}, return_when=asyncio.FIRST_COMPLETED)
            ended = passing.result() if passing.done() else None  # None: the browser has left
        finally:
            for task in (passing, leaving):
                task.cancel()
            await asyncio.gather(passing, leaving, return_exceptions=True)
        if ended is not None:
            await close_websocket(socket, *ended)

    async def _pass_on(
        self, socket: WebSocket, service: str, path: str, credentials: dict[str, str]
    ) -> tuple[int, str] | None:
        """Return the close code and the reason; None when the browser does not read any more."""
        query = socket.scope.get("query_string", b"").decode("latin-1")
        url = f"ws{self._urls[service].removeprefix('http')}{path}{'?' * bool(query)}{query}"
        try:
            async with connect(
                url,
                additional_headers=credentials,
                ssl=tls_of(url, self._ca_files),
                proxy=None,
                compression=None,
                open_timeout=OPEN_TIMEOUT_S,
                close_timeout=CLOSE_TIMEOUT_S,
                max_size=MAX_MESSAGE_BYTES,
                max_queue=MAX_WAITING_MESSAGES,
            ) as link:
                async for text in link:
                    if isinstance(text, str) and not await _is_sent(socket, text):
                        return None
                return link.close_code or 1000, link.close_reason or ""
        except ConnectionClosed as closed:
            received = closed.rcvd
            return (UNAVAILABLE_CODE, "") if received is None else (received.code, received.reason)
        except InvalidStatus as refused:
            return 4000 + refused.response.status_code, f"{service} refused"
        except (OSError, TimeoutError, InvalidHandshake) as error:
            return UNAVAILABLE_CODE, f"{service} does not answer: {error}"


async def _is_sent(socket: WebSocket, text: str) -> bool:
    """Send `text`; return False if the browser has left, or does not read."""
    try:
        async with asyncio.timeout(SEND_TIMEOUT_S):
            await socket.send_text(text)
    except (TimeoutError, WebSocketDisconnect, RuntimeError):
        return False
    return True


async def _until_left(socket: WebSocket) -> None:
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
