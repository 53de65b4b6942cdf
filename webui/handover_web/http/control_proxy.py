"""The control of robots by browsers: a WebSocket proxy to the service of the robot.

The service gets the credentials of the user, and decides about rights, lease and motion. Nothing queues here:
of the inputs and of the states only the newest waits (`ControlLink`, `_send_states`). The dead-man function
stays with the service: a browser that is lost ends the connection, and silence alone stops the robot.
"""

import asyncio
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import orjson
from starlette.websockets import WebSocket, WebSocketDisconnect

from handover.control.control_link import ControlLink
from handover.errors import Problem
from handover.http.websocket_closing import close_websocket
from handover.telemetry import get_logger
from handover_web.http.page_guard import PageGuard

log = get_logger(__name__)

FOREIGN_CODE: Final = 4403
MAX_INPUT_CHARS: Final = 4096
MAX_WAITING_MESSAGES: Final = 16
"""Errors that wait for a browser that does not read; the oldest are dropped."""
READ_TIMEOUT_S: Final = 15.0


class ControlProxy:
    """Passes on the control of robots to the services at `urls`, by the name of the service."""

    def __init__(self, urls: Mapping[str, str], guard: PageGuard, ca_files: Sequence[Path]) -> None:
        self._urls = urls
        self._guard = guard
        self._ca_files = ca_files

    async def serve(self, socket: WebSocket, service: str, path: str) -> None:
        """Pass on the control of a robot at `path` (percent-encoded) until one side ends it.

        `EndOfStreams` ends the side of the browser when the session or the grant of the user ends.
        """
        await socket.accept()
        headers = dict(socket.scope["headers"])
        if self._guard.session_of(headers) is not None and b"origin" not in headers:
            # A browser always sends it, and `OriginGuard` has compared it; a cookie alone moves nothing.
            await close_websocket(socket, FOREIGN_CODE, "the request has no Origin")
            return
        try:
            credentials = await self._guard.service_headers(headers)
        except Problem as problem:
            await close_websocket(socket, 4000 + problem.status, problem.detail)
            return
        states = _Messages()
        query = socket.scope.get("query_string", b"").decode("latin-1")
        url = f"ws{self._urls[service].removeprefix('http')}{path}{'?' * bool(query)}{query}"
        link = ControlLink(url, credentials, states.put, self._ca_files)
        running = asyncio.create_task(link.run())
        others = [
            asyncio.create_task(_receive(socket, link)),
            asyncio.create_task(_send(socket, states)),
        ]
        try:
            await asyncio.wait({running, *others}, return_when=asyncio.FIRST_COMPLETED)
            ended = running.result() if running.done() else None  # None: the browser has left
        finally:
            for task in (running, *others):
                task.cancel()
            await asyncio.gather(running, *others, return_exceptions=True)
        if ended is not None:
            await close_websocket(socket, ended.code, ended.reason)


class _Messages:
    """Messages for a browser: the newest state, and errors."""

    def __init__(self) -> None:
        self._state: str | None = None
        self._others: deque[str] = deque(maxlen=MAX_WAITING_MESSAGES)
        self._has_some = asyncio.Event()

    def put(self, text: str) -> None:
        """Add a message; a state replaces the one that waits."""
        if orjson.loads(text).get("type") == "state":
            self._state = text
        else:
            self._others.append(text)
        self._has_some.set()

    async def next(self) -> str:
        """Wait for a message and remove it."""
        await self._has_some.wait()
        if self._others:
            text = self._others.popleft()
        else:
            text, self._state = self._state or "", None
        if not self._others and self._state is None:
            self._has_some.clear()
        return text


async def _receive(socket: WebSocket, link: ControlLink) -> None:
    while (message := await socket.receive())["type"] != "websocket.disconnect":
        text = message.get("text")
        if text is not None and len(text) <= MAX_INPUT_CHARS:
            link.put(text)


async def _send(socket: WebSocket, states: _Messages) -> None:
    while True:
        text = await states.next()
        try:
            async with asyncio.timeout(READ_TIMEOUT_S):
                await socket.send_text(text)
        except (TimeoutError, WebSocketDisconnect, RuntimeError):
            return
