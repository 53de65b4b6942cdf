"""A shortcut for NGSI-LD requests: from uvicorn's parser to the broker, without ASGI.

An ASGI server passes each request in several messages, creates a task for it, and sends head and body of the
response separately, which takes a third of the broker's time. Everything else (health, metrics) uses ASGI.
"""

import asyncio
from collections.abc import Callable, Coroutine
from contextvars import copy_context
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import httptools
from starlette.types import Message, Receive
from uvicorn.protocols.http.flow_control import HIGH_WATER_LIMIT
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from handover.http.origin_guard import OriginPolicy
from handover.http.protocol import BODY, HEAD, IDLE, IN_USE, Connections, HttpProtocol
from handover.telemetry import get_logger
from handover_broker.request.request_context import (
    PREFIX,
    Request,
    Response,
    by_name,
    problem_response,
)

if TYPE_CHECKING:
    from uvicorn.config import Config
    from uvicorn.server import ServerState

log = get_logger(__name__)

_PREFIX: Final = PREFIX.encode()
_ONE_PIECE: Final = 256 * 1024
"""Maximum size of a response whose head and body are sent in one system call."""

_CONTROLS: Final = bytes({*range(32), 127} - {ord("\t")})

Handler = Callable[[Request, bytes | Receive], Coroutine[Any, Any, Response | None]]
"""Returns the response to a request, whose body is there or still to be received; None after a disconnect."""


class BrokerProtocol(HttpProtocol):
    """One connection. `handler` answers NGSI-LD requests that `policy` accepts."""

    __slots__ = ("_constant_headers", "_is_reading", "_next", "handler", "held", "policy")

    def __init__(
        self,
        config: "Config",
        server_state: "ServerState",
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        handler: Handler,
        policy: OriginPolicy,
        connections: Connections,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop, connections=connections)
        self.handler = handler
        self.policy = policy
        self.held: Callable[[], None] | None = None
        """Sends a response that has to wait until the client has read the last one."""
        self._next: RequestCycle | None = None
        self._is_reading = False
        self._constant_headers: tuple[object, bytes] = (None, b"")

    # Receiving

    def data_received(self, data: bytes) -> None:
        """Parse received bytes, and answer complete requests."""
        self._is_reading = True
        super().data_received(data)
        self._is_reading = False
        if self._next is not None:
            self._run_cycles()

    def on_message_begin(self) -> None:
        """Start a request."""
        self.phase, self.since_s = HEAD, 0.0
        self.url = b""
        self.headers = []
        self.expect_100_continue = False

    def on_header(self, name: bytes, value: bytes) -> None:
        """Add a header."""
        self.headers.append((name.lower(), value))

    def on_headers_complete(self) -> None:
        """Start a request whose head is complete."""
        if not self.url.startswith(_PREFIX) or self.parser.should_upgrade():
            url, headers = self.url, self.headers
            HttpToolsProtocol.on_message_begin(self)
            self.url = url
            for header in headers:
                super().on_header(*header)
            super().on_headers_complete()
            return
        self.require_acceptable_head()
        self.phase = BODY
        path, query = _split(self.url)
        method = self.parser.get_method().decode("ascii")
        before: Any = self.cycle
        cycle: Any = RequestCycle(
            self,
            Request(
                method,
                path,
                query,
                by_name(self.headers),
                address=None if self.client is None else self.client[0],
            ),
        )
        self.cycle = cycle
        if before is None or before.response_complete:
            self._next = cycle
        else:  # a pipelined request: answered after the one before
            self.flow.pause_reading()
            self.pipeline.appendleft((cycle, self.app))

    def on_body(self, body: bytes) -> None:
        """Add a piece of a body."""
        cycle: Any = self.cycle
        if not isinstance(cycle, RequestCycle):
            super().on_body(body)
            return
        self.body_bytes += len(body)
        self.body_piece = body
        if not cycle.response_complete:
            cycle.take(body)

    def on_message_complete(self) -> None:
        """Mark a request as complete."""
        cycle: Any = self.cycle
        if not isinstance(cycle, RequestCycle):
            super().on_message_complete()
            return
        cycle.more_body = False
        cycle.set()
        if cycle.response_complete:  # the client did not wait for 100 Continue
            self.phase, self.since_s = IDLE, 0.0
        else:
            self.phase = IN_USE

    # Sending

    def constant_headers(self) -> bytes:
        """Return the headers of every response; they change once a second."""
        headers = self.server_state.default_headers
        if self._constant_headers[0] is not headers:
            self._constant_headers = headers, b"".join(b"%b: %b\r\n" % header for header in headers)
        return self._constant_headers[1]

    def resume_writing(self) -> None:
        """Continue with responses that had to wait."""
        super().resume_writing()
        held, self.held = self.held, None
        if held is not None:
            held()

    def _start_asgi_task(self, cycle: Any, app: Any) -> None:
        if not isinstance(cycle, RequestCycle):
            super()._start_asgi_task(cycle, app)
            return
        self._next = cycle
        if not self._is_reading:
            self._run_cycles()

    def _run_cycles(self) -> None:
        """Answer the requests one after the other: most are answered synchronously."""
        self._is_reading = True
        while self._next is not None:
            cycle, self._next = self._next, None
            cycle.start()
        self._is_reading = False


def _split(url: bytes) -> tuple[bytes, bytes]:
    """Return path and query of a target that begins with a path."""
    if b"#" in url or not url.isascii():
        target = httptools.parse_url(url)
        return target.path, target.query or b""
    path, _, query = url.partition(b"?")
    return path, query


class RequestCycle:
    """One request and its response, with the attributes that uvicorn's protocol expects of an active request.

    The handler's coroutine is driven without a task: it runs as far as it can at once, and continues when
    what it waits for is done. An operation that needs a task creates one.
    """

    __slots__ = (
        "_context", "_data_arrived", "_expects", "_protocol", "_request", "_work", "body", "disconnected",
        "keep_alive", "more_body", "needs_host", "response_complete",
    )  # fmt: skip

    def __init__(self, protocol: BrokerProtocol, request: Request) -> None:
        self.disconnected = False
        self.response_complete = False
        self.body = b""
        self.more_body = True
        headers, parser = request.headers, protocol.parser
        # HTTP/1.0 keeps a connection only if the client asks for it; that is not supported.
        self.needs_host = b"host" not in headers and parser.get_http_version() != "1.0"
        is_plain = b"connection" not in headers or parser.get_http_version() != "1.0"
        self.keep_alive: bool = is_plain and parser.should_keep_alive()
        self._protocol = protocol
        self._request = request
        self._expects = b"expect" in headers and headers[b"expect"].lower() == b"100-continue"
        self._data_arrived: asyncio.Future[None] | None = None

    @property
    def message_event(self) -> "RequestCycle":
        """Return this object as the event of new data; uvicorn sets it."""
        return self

    def take(self, piece: bytes) -> None:
        """Add a piece of the body; stop reading from the client while the handler does not read."""
        self.body += piece
        if len(self.body) > HIGH_WATER_LIMIT:
            self._protocol.flow.pause_reading()
        self.set()

    def set(self) -> None:
        """Wake the handler: more of the body is there, or the client has disconnected."""
        if self._data_arrived is not None and not self._data_arrived.done():
            self._data_arrived.set_result(None)

    def start(self) -> None:
        """Start to answer."""
        is_whole = not (self.more_body or self._expects)
        request, policy = self._request, self._protocol.policy
        if not policy.is_known(request.headers) and (
            refusal := policy.refusal(
                request.method, request.path, request.headers, needs_host=self.needs_host
            )
        ):
            self._end(problem_response(refusal))
            return
        self._work = self._protocol.handler(request, self.body if is_whole else self._receive)
        self._context = copy_context()
        self._context.run(self._resume)

    def _resume(self, _: object = None) -> None:
        try:
            awaited = self._work.send(None)
        except StopIteration as end:
            self._end(end.value)
        except asyncio.CancelledError:  # the broker stops
            self._protocol.transport.close()
        except Exception:
            log.exception("a request was not answered", path=self._request.path)
            self._protocol.transport.close()
        else:
            if awaited is None:
                self._protocol.loop.call_soon(self._resume, context=self._context)
            else:
                awaited._asyncio_future_blocking = False  # as asyncio.Task does
                awaited.add_done_callback(self._resume, context=self._context)

    async def _receive(self) -> Message:
        protocol = self._protocol
        if self._expects:
            self._expects = False
            protocol.transport.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        while self.more_body and not self.body and not self.disconnected:
            protocol.flow.resume_reading()
            self._data_arrived = protocol.loop.create_future()
            await self._data_arrived
        if self.disconnected:
            return {"type": "http.disconnect"}
        piece, self.body = self.body, b""
        return {"type": "http.request", "body": piece, "more_body": self.more_body}

    def _end(self, answer: Response | None) -> None:
        if answer is None:
            return
        if self._protocol.flow.write_paused:
            self._protocol.held = partial(self._send, answer)
        else:
            self._send(answer)

    def _send(self, answer: Response) -> None:
        protocol = self._protocol
        if self.disconnected or protocol.transport.is_closing():
            return
        head = [STATUS_LINE[answer.status], protocol.constant_headers()]
        for name, value in answer.headers:
            # A value that is echoed in a header must not inject another header.
            head += (name, b": ", value.translate(None, _CONTROLS), b"\r\n")
        body = answer.body
        if answer.status != 204:
            head.append(b"content-length: %d\r\n" % len(body))
        head.append(b"\r\n" if self.keep_alive else b"connection: close\r\n\r\n")
        if self._request.method == "HEAD":
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
