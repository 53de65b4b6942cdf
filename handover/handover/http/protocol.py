"""Connections: how long a server waits for a client, and how many connections it has.

uvicorn parses requests; this module adds limits, so that no client keeps a connection with an incomplete
request. `Connections` checks all connections of a server once a second, so requests need no timers:

- The head of a request has at most `MAX_HEAD_BYTES` and `MAX_HEAD_LINES`; what goes beyond is refused (431)
  before it is parsed. The same limits apply to what a chunked body has between its chunks: extensions and
  trailers, which no application sees.
- Of a connection about `MAX_PIPELINED` requests wait for the response to the one before. What comes after is
  neither parsed nor read until they are answered.
- In one turn of the event loop at most `MAX_STARTS_PER_TURN` requests start, those of connections first that
  had the least lately. So hundreds of connections that send request after request, and read no response, do
  not delay others.
- An unfinished request is ended (408) when its head takes longer than `http_header_timeout_s`, when no byte
  of its body comes for `http_body_timeout_s`, or when its body comes slower than `http_min_body_bytes_per_s`
  after that time. Time in which the service itself does not read does not count.
- An idle connection is closed after `KEEP_ALIVE_S`, one whose client does not read after
  `http_send_timeout_s`.
- An address has at most `http_max_unfinished_per_address` connections that have been unfinished for more than
  a second; the oldest are closed. Connections in use are not limited per address: on one machine all
  services, and behind a proxy all people, come from one address.
- A server has at most `http_max_connections`. The oldest unfinished ones give way to a newcomer, then those
  that have been idle for longest, then those whose client reads nothing of the response; if all are in use
  the newcomer is refused (503).

How heads are counted: a head ends with an empty line, and llhttp accepts nothing but CR LF as the end of a
line. Received bytes that are within the limits as a whole are parsed at once, which is the usual case. Others
are parsed in pieces that end where a head ends, each counted first. A piece that begins in a body may contain
the begin of the next head; it has at most `MAX_HEAD_BYTES`, and what comes after the body counts afterwards.

`HttpToolsProtocol` is no public API of uvicorn: pyproject.toml bounds its version, and a test names it.
"""

import asyncio
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

import orjson
from prometheus_client import Counter
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from handover.errors import Problem
from handover.http.connections import (
    AWAITED,
    BODY,
    HEAD,
    IDLE,
    IN_USE,
    REFUSED,
    UNFINISHED,
    UPGRADED,
    Connections,
    LimitedConnection,
)
from handover.settings import Settings

if TYPE_CHECKING:
    from uvicorn.config import Config
    from uvicorn.server import ServerState

__all__ = [
    "BODY",
    "HEAD",
    "IDLE",
    "IN_USE",
    "KEEP_ALIVE_S",
    "MAX_HEAD_BYTES",
    "MAX_HEAD_LINES",
    "MAX_PIPELINED",
    "Connections",
    "HttpProtocol",
]

KEEP_ALIVE_S: Final = 75.0
"""Longer than clients keep idle connections (httpx: 5 s), so that they never write to one that is closing."""
MAX_HEAD_BYTES: Final = 32 * 1024
MAX_HEAD_LINES: Final = 100
"""The request line and the headers, without the empty line at the end."""
MAX_WEBSOCKET_LINE_BYTES: Final = 8190
"""The library that speaks WebSocket refuses a longer line of the handshake."""
STALLED_S: Final = 5.0
"""A client that reads nothing for so long gives way to a newcomer where the server is full."""
MAX_PIPELINED: Final = 16
MAX_DISCARDED_BYTES: Final = 1 << 20
DISCARD_S: Final = 2.0
"""How long a connection stays open after a refusal for the client to read it: a connection that is closed
while bytes come in is reset, and the client may lose the response."""

_END_OF_HEAD: Final = b"\r\n\r\n"


CLOSED = Counter("handover_http_connections_closed_total", "Connections that the server ended", ["reason"])


class HttpProtocol(HttpToolsProtocol, LimitedConnection):
    """One connection, which `limits` looks at.

    A request that begins only sets `phase`, and `since_s` to 0; the next look replaces that by its own time.
    One that ends sets `since_s`: of the idle connections, the one that was used last is closed last.
    """

    # uvicorn's protocol has so many attributes that more would make all of them slower.
    __slots__ = (
        "_body_of", "_body_s", "_discarded_bytes", "_head_bytes", "_head_end", "_head_lines", "_quiet_s",
        "_refusal", "_rest", "_seen_bytes", "_stalled_s", "_unread_bytes", "body_bytes", "body_piece",
        "limits", "phase", "since_s",
    )  # fmt: skip

    flow: "_Flow"

    def __init__(
        self,
        config: "Config",
        server_state: "ServerState",
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        connections: Connections,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self.limits = connections
        self.last_round = 0
        self.phase: str = AWAITED
        self.since_s = 0.0
        self.body_bytes = 0
        self.body_piece = b""
        """The last part of a body in what is parsed, unless the body has ended with an empty chunk."""
        self._body_of: Any = None
        """The request whose body was looked at last; how long it took so far, and how long nothing came."""
        self._body_s = self._quiet_s = 0.0
        self._seen_bytes = 0
        self._unread_bytes = 0
        self._stalled_s = 0.0
        self._head_bytes = self._head_lines = 0
        """The size of the unfinished head, or of what came in a body since the last byte of its content."""
        self._head_end = b""
        """The last bytes of the unfinished head: its end may come in two pieces."""
        self._refusal: Problem | None = None
        """Is sent after the responses to the requests before."""
        self._discarded_bytes = 0
        self._rest = b""
        """What came after the requests that wait."""

    # Receiving

    def data_received(self, data: bytes) -> None:
        """Parse received bytes, unless a head goes beyond its limits."""
        if self._rest:
            self._rest += data
        elif (
            self._head_bytes
            or len(data) > MAX_HEAD_BYTES
            or data.count(b"\n") > MAX_HEAD_LINES
            or self.phase is REFUSED
            or len(self.pipeline) >= MAX_PIPELINED
        ):
            self._receive_in_pieces(data)
        else:
            self._parse(data)

    def _receive_in_pieces(self, data: bytes) -> None:
        while data and self.phase is not REFUSED and self.phase is not UPGRADED:
            if self.transport.is_closing():
                return
            if len(self.pipeline) >= MAX_PIPELINED:
                self._rest = data
                self.flow.hold()
                return
            if self.phase is BODY:
                piece = data[:MAX_HEAD_BYTES]
            else:
                if self.phase is not HEAD:
                    data = self._after_empty_lines(data)
                piece = data[: self._end_of_head(data)]
                # The empty line, which a complete head has, does not count.
                lines = self._head_lines + piece.count(b"\n") - self._ends_head(piece)
                if self._head_bytes + len(piece) > MAX_HEAD_BYTES or lines > MAX_HEAD_LINES:
                    self._refuse_in_turn(_too_large_head())
                    return
                if not piece:
                    return
            data = data[len(piece) :]
            self._parse(piece)
        if self.phase is REFUSED:
            self._discard(data)

    def _continue(self) -> None:
        """Parse what came after the requests that had to wait."""
        rest, self._rest = self._rest, b""
        if rest and not self.transport.is_closing():
            self.data_received(rest)
        if not self._rest:
            self.flow.release()

    def _end_of_head(self, data: bytes) -> int | None:
        """Return the length of the unfinished head in `data`; None without its end."""
        end = (self._head_end + data[:3]).find(_END_OF_HEAD)
        if end >= 0:
            return end + 4 - len(self._head_end)
        end = data.find(_END_OF_HEAD)
        return None if end < 0 else end + 4

    def _ends_head(self, piece: bytes) -> bool:
        return (self._head_end + piece[-4:]).endswith(_END_OF_HEAD)

    def _parse(self, piece: bytes) -> None:
        """Parse `piece`, and count what it has of a head that is unfinished afterwards."""
        phase, body_bytes = self.phase, self.body_bytes
        super().data_received(piece)
        body, self.body_piece = self.body_piece, b""
        if self.phase is HEAD:
            self._count_unfinished(piece, body, is_new=self.body_bytes > body_bytes)
        elif self.phase is BODY and phase is BODY and self.body_bytes == body_bytes:
            self._head_bytes += len(piece)
            self._head_lines += piece.count(b"\n")
        elif self.phase is phase and phase is not BODY and piece.isspace():
            self._after_empty_lines(piece)
        else:
            self._head_bytes = self._head_lines = 0
            self._head_end = b""
            return
        if self._head_bytes > MAX_HEAD_BYTES or self._head_lines > MAX_HEAD_LINES:
            self._refuse_in_turn(_too_large_head())

    def _after_empty_lines(self, data: bytes) -> bytes:
        """Count the empty lines before a head, which the parser skips, as its lines; return what follows."""
        rest = data.lstrip(b"\r\n")
        empty = data[: len(data) - len(rest)]
        self._head_bytes += len(empty)
        self._head_lines += empty.count(b"\n")
        return rest

    def _count_unfinished(self, piece: bytes, body: bytes, *, is_new: bool) -> None:
        """Count the head at the end of `piece`; `body` is the last part of a body in it, if it has a length.

        An unfinished head has no empty line, so it comes after the last one: that before the body or in it.
        """
        if is_new or _END_OF_HEAD in piece:
            self._head_bytes = self._head_lines = 0
            self._head_end = b""
            piece = piece[_after_empty_line(piece) :]
            piece = piece[len(body) - _after_empty_line(body) :]
        self._head_bytes += len(piece)
        self._head_lines += piece.count(b"\n")
        self._head_end = (self._head_end + piece[-3:])[-3:]

    def _discard(self, data: bytes) -> None:
        self._discarded_bytes += len(data)
        if self._discarded_bytes > MAX_DISCARDED_BYTES:
            self.flow.pause_reading()

    # Events of uvicorn's parser

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self.flow = _Flow(transport)
        self.since_s = self.loop.time()
        if not self.limits.opened(self, self.connections):
            CLOSED.labels("refused").inc()
            self.refuse(Problem(503, "Too many connections", "all are in use; try again in a moment"))

    def on_message_begin(self) -> None:
        """Begin to read a request."""
        self.phase, self.since_s = HEAD, 0.0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Take a request whose head is there."""
        self.require_acceptable_head()
        self.phase = BODY
        super().on_headers_complete()
        if not self.parser.should_upgrade():
            self.headers = []  # trailers go here, and not to the headers that the application has

    def require_acceptable_head(self) -> None:
        """Raise `_Refused` for a head with too many lines.

        The parser ends when it is raised, and calls `send_400_response`.
        """
        self.body_piece = b""
        if len(self.headers) >= MAX_HEAD_LINES:
            self._refusal = _too_large_head()
            raise _Refused

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP, or what a limit refuses."""
        self._refuse_in_turn(self._refusal or Problem(400, "Bad request", msg))

    def on_body(self, body: bytes) -> None:
        """Take a piece of a body."""
        self.body_bytes += len(body)
        self.body_piece = body
        super().on_body(body)

    def on_chunk_header(self) -> None:
        """Begin a chunk of a body: the last one has no content."""
        self.body_piece = b""

    def on_message_complete(self) -> None:
        """Note that a request is there as a whole."""
        self.phase = IN_USE
        if not self._is_answering():  # the answer did not wait for the body
            self.phase, self.since_s = IDLE, self.loop.time()
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Go on to the next request, or wait for one."""
        self.server_state.total_requests += 1
        if self.transport.is_closing():
            return
        self.flow.resume_reading()
        if self.pipeline:
            self._start_asgi_task(*self.pipeline.pop())
            if self._rest and not self.pipeline:  # which may have the body of the request that has started
                self.loop.call_soon(self._continue)
        elif self.phase is REFUSED and self._refusal is not None:
            self.refuse(self._refusal)
        elif self.phase is IN_USE:
            self.phase, self.since_s = IDLE, self.loop.time()

    def _start_asgi_task(self, cycle: Any, app: Any) -> None:
        self.limits.start(self, cycle, app)

    def start(self, cycle: Any, app: Any) -> None:
        """Start a request now."""
        super()._start_asgi_task(cycle, app)

    def handle_websocket_upgrade(self) -> None:
        """Hand the connection over, unless there are too many."""
        if any(len(name) + len(value) + 4 > MAX_WEBSOCKET_LINE_BYTES for name, value in self._handshake()):
            self.refuse(_too_large_head())
        elif self.limits.may_be_websocket():
            self.phase = UPGRADED
            super().handle_websocket_upgrade()
        else:
            CLOSED.labels("too many websockets").inc()
            self.refuse(Problem(503, "Too many WebSockets", "close another page, and try again in a moment"))

    def _handshake(self) -> Iterator[tuple[bytes, bytes]]:
        yield self.url, b" HTTP/1.1 "
        yield from self.headers

    # What is looked at once a second

    def look(self, settings: Settings, now_s: float, passed_s: float) -> str:
        """End the connection if its time is over; return what it does."""
        self.since_s = self.since_s or now_s
        if self.flow.write_paused:
            self._look_at_sending(settings, passed_s)
            return "in use"
        self._stalled_s = 0.0
        waited_s = now_s - self.since_s
        if self.phase is REFUSED:
            if waited_s > DISCARD_S and self._refusal is None:
                self.transport.abort()
        elif self.phase is IDLE:
            if waited_s > self.timeout_keep_alive:
                self.end("idle")
        elif self.phase is BODY:
            self._look_at_body(settings, passed_s)
        elif (
            self.phase is not IN_USE
            and waited_s > settings.http_header_timeout_s
            and not self._is_answering()
        ):
            self.end("header timeout")
        return "unfinished" if self.phase in UNFINISHED else self.phase

    def _look_at_body(self, settings: Settings, passed_s: float) -> None:
        if self._body_of is not self.cycle:
            self._body_of, self.body_bytes, self._seen_bytes = self.cycle, 0, 0
            self._body_s = self._quiet_s = 0.0
            return
        if self.flow.read_paused:  # it is the service that does not read
            self._quiet_s = 0.0
            return
        self._body_s += passed_s
        self._quiet_s = self._quiet_s + passed_s if self.body_bytes == self._seen_bytes else 0.0
        self._seen_bytes = self.body_bytes
        timeout_s = settings.http_body_timeout_s
        is_slow = self.body_bytes < (self._body_s - timeout_s) * settings.http_min_body_bytes_per_s
        if self._quiet_s > timeout_s or is_slow:
            self.end("body timeout")

    def _look_at_sending(self, settings: Settings, passed_s: float) -> None:
        unread = self.transport.get_write_buffer_size()
        self._stalled_s = self._stalled_s + passed_s if unread >= self._unread_bytes else 0.0
        self._unread_bytes = unread
        if self._stalled_s > settings.http_send_timeout_s:
            CLOSED.labels("send timeout").inc()
            self.transport.abort()

    def has_stalled(self) -> bool:
        """Say whether the client reads nothing of its response."""
        return self._stalled_s >= STALLED_S

    def _is_answering(self) -> bool:
        """Say whether the answer to a request whose head is there has not been sent yet."""
        cycle: Any = self.cycle
        return cycle is not None and not cycle.response_complete

    def end(self, reason: str) -> None:
        """End the connection; a client that has sent a part of a request learns why."""
        CLOSED.labels(reason).inc()
        self.end_with(Problem(408, "Request timeout", f"the request did not come in time ({reason})"))

    def end_with(self, problem: Problem) -> None:
        """End the connection; a client that has sent a part of a request gets `problem`."""
        waits_for_us = self._is_answering() and not getattr(self.cycle, "response_started", False)
        if (self.phase is HEAD and not self._is_answering()) or (
            self.phase is BODY and waits_for_us and not self.pipeline
        ):
            self.refuse(problem)
        else:
            self.transport.abort()

    def _refuse_in_turn(self, problem: Problem) -> None:
        """Refuse what came last, after the responses to the requests before."""
        CLOSED.labels("refused request").inc()
        if self.phase is BODY:
            self.end_with(problem)
        elif self._is_answering():
            self.phase, self._refusal = REFUSED, problem
            self.flow.pause_reading()
        else:
            self.refuse(problem)

    def refuse(self, problem: Problem) -> None:
        """Answer with `problem`, and close the connection when the client has had time to read it."""
        if self.transport.is_closing():
            return
        self.phase, self.since_s, self._refusal = REFUSED, self.loop.time(), None
        cycle: Any = self.cycle
        if cycle is not None:
            cycle.disconnected = True
            cycle.message_event.set()
        body = orjson.dumps(problem.body())
        self.transport.write(
            STATUS_LINE[problem.status] + b"content-type: application/problem+json\r\ncontent-length: "
            b"%d\r\nconnection: close\r\n\r\n%b" % (len(body), body)
        )
        if self.transport.can_write_eof():
            self.transport.write_eof()
        else:
            self.transport.close()


def _after_empty_line(piece: bytes) -> int:
    """Return where the rest of `piece` begins after its last empty line; 0 without one."""
    position = piece.rfind(_END_OF_HEAD)
    return 0 if position < 0 else position + len(_END_OF_HEAD)


class _Flow(FlowControl):
    """The flow control of a connection; while it is held nothing is read, whatever a request wants."""

    _is_held = False

    def hold(self) -> None:
        """Stop to read until `release`."""
        self._is_held = True
        self.pause_reading()

    def release(self) -> None:
        """Read again."""
        self._is_held = False
        self.resume_reading()

    def resume_reading(self) -> None:
        """Read again, unless the connection is held."""
        if not self._is_held:
            super().resume_reading()


class _Refused(Exception):
    """Ends the parser; the connection has the reason."""


def _too_large_head() -> Problem:
    return Problem(
        431,
        "Request head too large",
        f"the request line and the headers have more than {MAX_HEAD_BYTES} bytes or {MAX_HEAD_LINES} lines; "
        "send fewer and shorter ones",
    )
