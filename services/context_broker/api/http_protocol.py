"""The short way in: NGSI-LD requests go from uvicorn's parser straight to the broker.

An ASGI server hands over each request in several messages and sends head and body of an answer apart, which
costs a broker a quarter of its time. Everything else that comes in (health, metrics) takes the usual way.
"""

import asyncio
from collections.abc import Awaitable, Callable, MutableMapping
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote

import httptools
from uvicorn.protocols.http.httptools_impl import HEADER_VALUE_RE, STATUS_LINE, HttpToolsProtocol

from services.context_broker.api.exchange import PREFIX, Answer

if TYPE_CHECKING:
    from uvicorn.config import Config
    from uvicorn.server import ServerState

_PREFIX: Final = PREFIX.encode()
_ONE_PIECE: Final = 256 * 1024
"""Bytes of an answer up to which its head and body leave in one call to the system."""

Door = Callable[[MutableMapping[str, Any], Callable[[], Awaitable[Any]]], Awaitable[Answer | None]]
"""Answers a request given as ASGI's scope and receive; None where the asker has gone."""


class BrokerProtocol(HttpToolsProtocol):
    """One connection. `door` answers what is asked of NGSI-LD."""

    def __init__(
        self,
        config: "Config",
        server_state: "ServerState",
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        door: Door,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self.door = door

    def on_headers_complete(self) -> None:
        """Take a request whose head is there."""
        if not self.url.startswith(_PREFIX) or self.parser.should_upgrade():
            super().on_headers_complete()
            return
        url = httptools.parse_url(self.url)
        raw = url.path
        path = raw.decode("ascii")
        scope = self.scope
        scope["method"] = self.parser.get_method().decode("ascii")
        scope["raw_path"] = raw
        scope["path"] = unquote(path) if "%" in path else path
        scope["query_string"] = url.query or b""
        before: Any = self.cycle
        turn: Any = Turn(self, scope)
        self.cycle = turn
        if before is None or before.response_complete:
            self._start_asgi_task(turn, self.app)
        else:  # asked before the answer to the last one was there: one after the other
            self.flow.pause_reading()
            self.pipeline.appendleft((turn, self.app))


class Turn:
    """One request and its answer; has what uvicorn's protocol looks for in a request under way."""

    def __init__(self, protocol: BrokerProtocol, scope: Any) -> None:
        self.disconnected = False
        self.response_complete = False
        self.body = bytearray()
        self.more_body = True
        parser = protocol.parser
        self.keep_alive: bool = parser.get_http_version() != "1.0" and parser.should_keep_alive()
        self._protocol = protocol
        self._scope = scope
        self._expects = protocol.expect_100_continue
        self._news: asyncio.Future[None] | None = None
        self.message_event = self

    def set(self) -> None:
        """Hear that more of the body is there, or that the asker has gone."""
        if self._news is not None and not self._news.done():
            self._news.set_result(None)

    async def run_asgi(self, _: Any) -> None:
        """Answer."""
        answer = await self._protocol.door(self._scope, self._receive)
        if answer is not None and not self.disconnected:
            await self._send(answer)

    async def _receive(self) -> dict[str, Any]:
        if self._expects:
            self._expects = False
            self._protocol.transport.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        while self.more_body and not self.body and not self.disconnected:
            self._protocol.flow.resume_reading()
            self._news = self._protocol.loop.create_future()
            await self._news
        if self.disconnected:
            return {"type": "http.disconnect"}
        piece, self.body = bytes(self.body), bytearray()
        return {"type": "http.request", "body": piece, "more_body": self.more_body}

    async def _send(self, answer: Answer) -> None:
        protocol = self._protocol
        if protocol.flow.write_paused:
            await protocol.flow.drain()
            if self.disconnected:
                return
        head = [STATUS_LINE[answer.status]]
        for name, value in protocol.server_state.default_headers:
            head += (name, b": ", value, b"\r\n")
        for name, value in answer.headers:
            # What clients sent, and is told back in a header, must not become a header of its own.
            plain = HEADER_VALUE_RE.sub(b"", value) if HEADER_VALUE_RE.search(value) else value
            head += (name, b": ", plain, b"\r\n")
        body = answer.body
        if answer.status != 204:
            head.append(b"content-length: %d\r\n" % len(body))
        head.append(b"\r\n" if self.keep_alive else b"connection: close\r\n\r\n")
        if self._scope["method"] == "HEAD":
            body = b""
        if len(body) <= _ONE_PIECE:
            head.append(body)
            protocol.transport.write(b"".join(head))
        else:
            protocol.transport.writelines((b"".join(head), body))
        self.response_complete = True
        if not self.keep_alive:
            protocol.transport.close()
        protocol.on_response_complete()
