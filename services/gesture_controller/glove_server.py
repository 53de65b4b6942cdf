"""The glove server: many gloves at once on TCP, one JSON object a line, and anything else besides.

A connection that says no hello soon, says a wrong one or sends a line without end is told why and closed;
a line that is no frame is dropped and counted. Whoever has not said hello waits in a small room from which
the oldest is shown out when it is full, so that a flood of connections cannot keep a glove away.
"""

import asyncio
import socket
from collections.abc import Callable
from typing import Any, Self, cast

import orjson

from handover.errors import UsageError
from handover.telemetry import get_logger
from services.gesture_controller import metrics
from services.gesture_controller.admission import NotAdmitted
from services.gesture_controller.frames import (
    MAX_LINE_BYTES,
    VERSION,
    BadFrame,
    BadHello,
    parse_frame,
    parse_hello,
)
from services.gesture_controller.glove import Glove
from services.gesture_controller.gloves import Gloves
from services.gesture_controller.settings import ControllerSettings

log = get_logger(__name__)

WAITING_ROOM = 128
"""Connections that may be open without having said hello."""

LINGER_S = 1.0
"""How long a refused connection may go on sending (unread) before it is cut: it should see the reason."""

KEEPALIVE = {"TCP_KEEPIDLE": 10, "TCP_KEEPINTVL": 5, "TCP_KEEPCNT": 3}


class GloveServer:
    """Listens for gloves; an asynchronous context manager while it does."""

    def __init__(self, settings: ControllerSettings, gloves: Gloves) -> None:
        self.gloves = gloves
        self.hello_timeout_s = settings.hello_timeout_s
        self.waiting: dict[GloveConnection, None] = {}
        self.open: set[GloveConnection] = set()
        self._host, self._port = settings.glove_host, settings.glove_port
        self._server: asyncio.Server | None = None

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        try:
            self._server = await loop.create_server(
                lambda: GloveConnection(self), self._host, self._port, backlog=1024
            )
        except OSError as error:
            raise UsageError(
                f"gloves cannot be awaited on {self._host}:{self._port} ({error.strerror or error}); "
                "set HANDOVER_GLOVE_HOST and HANDOVER_GLOVE_PORT to an address and port that are free"
            ) from None
        log.info("gloves are awaited", host=self._host, port=self._port)
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._server is not None:
            self._server.close()
        for connection in tuple(self.open):
            connection.end("the controller stops; connect again in a moment", retry=True)

    def admit(self, connection: "GloveConnection") -> None:
        """Let `connection` wait for its hello; show out the one that has waited longest if it is too many."""
        self.open.add(connection)
        self.waiting[connection] = None
        if len(self.waiting) > WAITING_ROOM:
            oldest = next(iter(self.waiting))
            metrics.REFUSED.labels("too many waiting").inc()
            oldest.end(f"more than {WAITING_ROOM} connections wait to say hello; say it at once", retry=True)


class GloveConnection(asyncio.Protocol):
    """One TCP connection: a hello, then frames."""

    def __init__(self, server: GloveServer) -> None:
        self._server = server
        self._now: Callable[[], float] = asyncio.get_running_loop().time
        self._transport: asyncio.Transport | None = None
        self._rest = bytearray()
        self._glove: Glove | None = None
        self._order: tuple[int, ...] | None = None
        self._ended = False
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Await the hello."""
        self._transport = cast("asyncio.Transport", transport)  # uvloop's is one in all but its class
        _keep_alive(self._transport)
        self._timer = asyncio.get_running_loop().call_later(self._server.hello_timeout_s, self._hello_missing)
        self._server.admit(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Let go of the glove: it comes again by itself."""
        self._ended = True
        self._leave_waiting_room()
        self._server.open.discard(self)
        if self._glove is not None:
            log.info("glove disconnected", glove=self._glove.name, reason=str(exc) if exc else "closed")
            self._glove.disconnect(self)
            self._server.gloves.count()

    def data_received(self, data: bytes) -> None:
        """Take the lines that are complete with `data`; the rest waits for more, up to the limit."""
        if self._ended:
            return
        end = data.rfind(b"\n")
        if end < 0:
            self._rest += data
        else:
            lines = (bytes(self._rest) + data[:end]).split(b"\n")
            self._rest = bytearray(data[end + 1 :])
            self._take(lines)
        if len(self._rest) > MAX_LINE_BYTES:
            self._line_too_long()

    def end(self, reason: str, *, retry: bool = False) -> None:
        """Tell the other side why, and whether to come again, and close."""
        if self._ended or self._transport is None:
            return
        self._say({"type": "error", "reason": reason, "retry": retry})
        self._ended = True
        self._rest.clear()
        self._leave_waiting_room()
        self._transport.close()

    def _take(self, lines: list[bytes]) -> None:
        now_s = self._now()
        taken = 0
        for line in lines:
            if self._ended:
                break
            if len(line) > MAX_LINE_BYTES:
                self._line_too_long()
            elif self._glove is None:
                self._greet(line)
            elif line and line != b"\r":
                taken += self._take_frame(self._glove, line, now_s)
        if taken:
            metrics.FRAMES.inc(taken)

    def _take_frame(self, glove: Glove, line: bytes, now_s: float) -> bool:
        try:
            frame = parse_frame(line, self._order)
        except BadFrame as bad:
            if not glove.dropped[bad.reason]:
                log.warning("line of a glove dropped", glove=glove.name, reason=bad.reason, line=line[:200])
            glove.drop(bad.reason)
            return False
        glove.take(frame, line, now_s)
        return True

    def _greet(self, line: bytes) -> None:
        try:
            hello = parse_hello(line)
        except BadHello as bad:
            self._refuse("bad hello", str(bad))
            return
        try:
            self._glove = self._server.gloves.connect(hello, self, self._now())
        except NotAdmitted as error:
            self._refuse(error.kind, str(error), retry=error.retry)
            return
        self._order = hello.order
        self._leave_waiting_room()
        self._say({"type": "ack", "version": VERSION, "glove": hello.glove})
        log.info("glove connected", glove=hello.glove, hand=hello.hand)

    def _hello_missing(self) -> None:
        self._refuse("no hello", f"no hello within {self._server.hello_timeout_s:g} s", retry=True)

    def _line_too_long(self) -> None:
        rule = f"a line holds at most {MAX_LINE_BYTES} bytes, end each with a newline"
        self._refuse("line too long", rule, retry=True)

    def _refuse(self, kind: str, reason: str, *, retry: bool = False) -> None:
        """Say why and hang up, but let the other side finish speaking so that it hears the reason."""
        if self._ended or self._transport is None:
            return
        metrics.REFUSED.labels(kind).inc()
        log.warning("connection refused", kind=kind, reason=reason, peer=self._peer())
        self._say({"type": "error", "reason": reason, "retry": retry})
        self._ended = True
        self._rest.clear()
        self._leave_waiting_room()
        if self._transport.can_write_eof():
            self._transport.write_eof()
        self._timer = asyncio.get_running_loop().call_later(LINGER_S, self._transport.close)

    def _leave_waiting_room(self) -> None:
        self._server.waiting.pop(self, None)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _say(self, words: dict[str, Any]) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(orjson.dumps(words) + b"\n")

    def _peer(self) -> str:
        peer = self._transport.get_extra_info("peername") if self._transport else None
        return f"{peer[0]}:{peer[1]}" if isinstance(peer, tuple) else str(peer)


def _keep_alive(transport: asyncio.Transport) -> None:
    """Have the network find out when a glove's machine has vanished without a word."""
    line = transport.get_extra_info("socket")
    if line is None:
        return
    line.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in KEEPALIVE.items():
        if hasattr(socket, option):
            line.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
