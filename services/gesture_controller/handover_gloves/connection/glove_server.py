"""The glove server: accepts gloves on TCP, one JSON object a line.

A connection without a hello in time, with an invalid hello or with a line that is too long gets the reason
and is closed. Invalid frames are dropped and counted. The number of connections that have not sent a hello is
limited; beyond the limit the oldest of them is closed, so that a flood of connections cannot block gloves.

When accounts are set up, each open connection needs what a new one needs: a glove whose hello had no token,
as local mode allows, gets the reason and is closed.
"""

import asyncio
import socket
from collections.abc import Callable
from typing import Any, Self, cast

import orjson

from handover.errors import UsageError
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.keys_in_force import RELOAD_INTERVAL_S
from handover.telemetry import get_logger
from handover.transport_security.server_certificate import ServerCertificate
from handover.transport_security.tls_listener import Listener, listen
from handover_gloves import metrics
from handover_gloves.connection.glove_registry import GloveRegistry
from handover_gloves.gloves.connection_state import ConnectionRefused
from handover_gloves.gloves.glove import Glove
from handover_gloves.recognition.frames import (
    MAX_LINE_BYTES,
    VERSION,
    BadFrame,
    BadHello,
    parse_frame,
    parse_hello,
)
from handover_gloves.settings import ControllerSettings

log = get_logger(__name__)

HELLO_TIMEOUT_S = 5.0
MAX_WAITING_FOR_HELLO = 128
"""Connections without a hello that may be open at once."""

REFUSAL_LINGER_S = 1.0
"""How long a refused connection stays open, so that the other side can read the reason."""

KEEPALIVE = {"TCP_KEEPIDLE": 10, "TCP_KEEPINTVL": 5, "TCP_KEEPCNT": 3}


class GloveServer:
    """Listens for gloves; an asynchronous context manager."""

    def __init__(
        self, settings: ControllerSettings, gloves: GloveRegistry, *, hello_timeout_s: float = HELLO_TIMEOUT_S
    ) -> None:
        self.gloves = gloves
        self.hello_timeout_s = hello_timeout_s
        self.waiting: dict[GloveConnection, None] = {}
        self.open: set[GloveConnection] = set()
        self._host, self._port = settings.glove_host, settings.glove_port
        self._server: Listener | None = None
        self._certificate = ServerCertificate.of(settings)
        self._tasks = BackgroundTasks("glove server")

    async def __aenter__(self) -> Self:
        try:
            self._server = await listen(
                lambda: GloveConnection(self),
                self._host,
                self._port,
                self._certificate,
                handshake_timeout_s=self.hello_timeout_s,
            )
        except OSError as error:
            raise UsageError(
                f"the glove server cannot listen on {self._host}:{self._port} ({error.strerror or error}); "
                "set HANDOVER_GLOVE_HOST and HANDOVER_GLOVE_PORT to an address and port that are free"
            ) from None
        log.info("glove server listens", host=self._host, port=self._port, tls=self._certificate is not None)
        await self._tasks.__aenter__()
        self._tasks.start(self._end_local_mode)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()
        if self._server is not None:
            self._server.close()
        for connection in tuple(self.open):
            connection.end("the controller stops; connect again in a moment", retry=True)

    def add(self, connection: "GloveConnection") -> None:
        """Add a connection that has not sent its hello; close the oldest such one beyond the limit."""
        self.open.add(connection)
        self.waiting[connection] = None
        if len(self.waiting) > MAX_WAITING_FOR_HELLO:
            oldest = next(iter(self.waiting))
            metrics.CONNECTIONS_REFUSED.labels("too many waiting").inc()
            reason = f"more than {MAX_WAITING_FOR_HELLO} connections have sent no hello; send it at once"
            oldest.end(reason, retry=True)

    async def _end_local_mode(self) -> None:
        """Wait until accounts exist, which is for good; then end what was admitted without a token."""
        while not self._has_accounts():  # noqa: ASYNC110 - another process writes the file
            await asyncio.sleep(RELOAD_INTERVAL_S)
        for connection in tuple(self.open):
            connection.require_token()

    def _has_accounts(self) -> bool:
        try:
            return self.gloves.admission.has_accounts()
        except UsageError as error:
            log.warning("whether accounts exist is unknown", reason=str(error))
            return False


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
        """Start the timeout for the hello."""
        self._transport = cast("asyncio.Transport", transport)  # uvloop's is one in all but its class
        _keep_alive(self._transport)
        self._timer = asyncio.get_running_loop().call_later(self._server.hello_timeout_s, self._hello_missing)
        self._server.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Disconnect the glove; it reconnects by itself."""
        self._ended = True
        self._stop_waiting()
        self._server.open.discard(self)
        if self._glove is not None:
            log.info("glove disconnected", glove=self._glove.name, reason=str(exc) if exc else "closed")
            self._glove.disconnect(self)
            self._server.gloves.count_connected()

    def data_received(self, data: bytes) -> None:
        """Process the complete lines; keep an incomplete one, up to the limit."""
        if self._ended:
            return
        end = data.rfind(b"\n")
        if end < 0:
            self._rest += data
        else:
            lines = (bytes(self._rest) + data[:end]).split(b"\n")
            self._rest = bytearray(data[end + 1 :])
            self._process(lines)
        if len(self._rest) > MAX_LINE_BYTES:
            self._line_too_long()

    def end(self, reason: str, *, retry: bool = False) -> None:
        """Send the reason, and whether to reconnect, and close."""
        if self._ended or self._transport is None:
            return
        self._send({"type": "error", "reason": reason, "retry": retry})
        self._ended = True
        self._rest.clear()
        self._stop_waiting()
        self._transport.close()

    def require_token(self) -> None:
        """End the connection if its glove would not be admitted now."""
        if self._glove is None:
            return
        try:
            self._server.gloves.admission.require_token(self._glove.connection.hello)
        except ConnectionRefused as refused:
            self._refuse(refused.kind, str(refused), retry=refused.retry)

    def _process(self, lines: list[bytes]) -> None:
        now_s = self._now()
        received = 0
        for line in lines:
            if self._ended:
                break
            if len(line) > MAX_LINE_BYTES:
                self._line_too_long()
            elif self._glove is None:
                self._process_hello(line)
            elif line and line != b"\r":
                received += self._process_frame(self._glove, line, now_s)
        if received:
            metrics.FRAMES_RECEIVED.inc(received)

    def _process_frame(self, glove: Glove, line: bytes, now_s: float) -> bool:
        try:
            frame = parse_frame(line, self._order)
        except BadFrame as bad:
            if not glove.connection.traffic.dropped[bad.reason]:
                log.warning("line of a glove dropped", glove=glove.name, reason=bad.reason, line=line[:200])
            glove.connection.traffic.drop(bad.reason)
            return False
        glove.receive(frame, line, now_s)
        return True

    def _process_hello(self, line: bytes) -> None:
        try:
            hello = parse_hello(line)
        except BadHello as bad:
            self._refuse("bad hello", str(bad))
            return
        try:
            self._glove = self._server.gloves.connect(hello, self, self._now())
        except ConnectionRefused as error:
            self._refuse(error.kind, str(error), retry=error.retry)
            return
        self._order = hello.order
        self._stop_waiting()
        self._send({"type": "ack", "version": VERSION, "glove": hello.glove})
        log.info("glove connected", glove=hello.glove, hand=hello.hand)

    def _hello_missing(self) -> None:
        self._refuse("no hello", f"no hello within {self._server.hello_timeout_s:g} s", retry=True)

    def _line_too_long(self) -> None:
        rule = f"a line holds at most {MAX_LINE_BYTES} bytes, end each with a newline"
        self._refuse("line too long", rule, retry=True)

    def _refuse(self, kind: str, reason: str, *, retry: bool = False) -> None:
        """Send the reason and close our direction; wait so that the other side can read it."""
        if self._ended or self._transport is None:
            return
        metrics.CONNECTIONS_REFUSED.labels(kind).inc()
        log.warning("connection refused", kind=kind, reason=reason, peer=self._peer())
        self._send({"type": "error", "reason": reason, "retry": retry})
        self._ended = True
        self._rest.clear()
        self._stop_waiting()
        if self._transport.can_write_eof():
            self._transport.write_eof()
        self._timer = asyncio.get_running_loop().call_later(REFUSAL_LINGER_S, self._transport.close)

    def _stop_waiting(self) -> None:
        self._server.waiting.pop(self, None)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _send(self, message: dict[str, Any]) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(orjson.dumps(message) + b"\n")

    def _peer(self) -> str:
        peer = self._transport.get_extra_info("peername") if self._transport else None
        return f"{peer[0]}:{peer[1]}" if isinstance(peer, tuple) else str(peer)


def _keep_alive(transport: asyncio.Transport) -> None:
    """Detect a peer that has vanished without closing the connection."""
    connection = transport.get_extra_info("socket")
    if connection is None:
        return
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in KEEPALIVE.items():
        if hasattr(socket, option):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
