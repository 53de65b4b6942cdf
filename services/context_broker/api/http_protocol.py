"""The short way in: NGSI-LD requests go from uvicorn's parser straight to the broker.

An ASGI server hands over each request in several messages, gives it a task and sends head and body of an
answer apart, which costs a broker a third of its time. Everything else (health, metrics) takes the usual way.
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

from handover.http_protocol import BODY, HEAD, IDLE, IN_USE, Connections, HttpProtocol
from handover.origin_guard import OriginPolicy
from handover.telemetry import get_logger
from services.context_broker.request.request_context import (
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
"""Bytes of an answer up to which its head and body leave in one call to the system."""

_CONTROLS: Final = bytes({*range(32), 127} - {ord("\t")})

Handler = Callable[[Request, bytes | Receive], Coroutine[Any, Any, Response | None]]
"""Answers a request whose body is there or still to be received; None where the asker has gone."""


class BrokerProtocol(HttpProtocol):
    """One connection. `door` answers what is asked of NGSI-LD and accepted by `policy`."""

    __slots__ = ("_is_reading", "_next", "_said_always", "door", "held", "policy")

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
        """Sends an answer that has to wait until the asker took what was sent before."""
        self._next: RequestCycle | None = None
        self._is_reading = False
        self._said_always: tuple[object, bytes] = (None, b"")

    # What comes in

    def data_received(self, data: bytes) -> None:
        """Read what came, and answer the requests that it brought."""
        self._is_reading = True
        super().data_received(data)
        self._is_reading = False
        if self._next is not None:
            self._take_turns()

    def on_message_begin(self) -> None:
        """Begin to read a request."""
        self.phase, self.since_s = HEAD, 0.0
        self.url = b""
        self.headers = []
        self.expect_100_continue = False

    def on_header(self, name: bytes, value: bytes) -> None:
        """Note a header."""
        self.headers.append((name.lower(), value))

    def on_headers_complete(self) -> None:
        """Take a request whose head is there."""
        if not self.url.startswith(_PREFIX) or self.parser.should_upgrade():
            url, headers = self.url, self.headers
            HttpToolsProtocol.on_message_begin(self)
            self.url = url
            for header in headers:
                super().on_header(*header)
            super().on_headers_complete()
            return
        self.phase = BODY
        target = httptools.parse_url(self.url)
        method = self.parser.get_method().decode("ascii")
        before: Any = self.cycle
        cycle: Any = RequestCycle(
            self, Request(method, target.path, target.query or b"", by_name(self.headers))
        )
        self.cycle = cycle
        if before is None or before.response_complete:
            self._next = cycle
        else:  # asked before the answer to the last one was there: one after the other
            self.flow.pause_reading()
            self.pipeline.appendleft((cycle, self.app))

    def on_body(self, body: bytes) -> None:
        """Take a piece of a body."""
        cycle: Any = self.cycle
        if not isinstance(cycle, RequestCycle):
            super().on_body(body)
            return
        self.body_bytes += len(body)
        if not cycle.response_complete:
            cycle.take(body)

    def on_message_complete(self) -> None:
        """Note that a request is there as a whole."""
        cycle: Any = self.cycle
        if not isinstance(cycle, RequestCycle):
            super().on_message_complete()
            return
        cycle.more_body = False
        cycle.set()
        if cycle.response_complete:  # it did not wait for the body
            self.phase, self.since_s = IDLE, 0.0
        else:
            self.phase = IN_USE

    # What goes out

    def said_always(self) -> bytes:
        """Return the headers that every answer has; they change once a second."""
        headers = self.server_state.default_headers
        if self._said_always[0] is not headers:
            self._said_always = headers, b"".join(b"%b: %b\r\n" % header for header in headers)
        return self._said_always[1]

    def resume_writing(self) -> None:
        """Go on where answers had to wait."""
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
            self._take_turns()

    def _take_turns(self) -> None:
        """Answer what was asked, one after the other: most is answered before the next line runs."""
        self._is_reading = True
        while self._next is not None:
            cycle, self._next = self._next, None
            cycle.begin()
        self._is_reading = False


class RequestCycle:
    """One request and its answer; has what uvicorn's protocol looks for in a request under way.

    It goes as far as it can at once, and on when what it waits for is there, without a task: what needs one
    makes it.
    """

    __slots__ = (
        "_context", "_expects", "_news", "_protocol", "_request", "_work", "body", "disconnected",
        "keep_alive", "more_body", "response_complete",
    )  # fmt: skip

    def __init__(self, protocol: BrokerProtocol, request: Request) -> None:
        self.disconnected = False
        self.response_complete = False
        self.body = b""
        self.more_body = True
        headers, parser = request.headers, protocol.parser
        # Only who says "connection" can have a connection kept by HTTP/1.0, in which we keep none.
        is_plain = b"connection" not in headers or parser.get_http_version() != "1.0"
        self.keep_alive: bool = is_plain and parser.should_keep_alive()
        self._protocol = protocol
        self._request = request
        self._expects = b"expect" in headers and headers[b"expect"].lower() == b"100-continue"
        self._news: asyncio.Future[None] | None = None

    @property
    def message_event(self) -> "RequestCycle":
        """Return what is set when more has come; not kept, or no request would go before it is looked for."""
        return self

    def take(self, piece: bytes) -> None:
        """Take a piece of the body; nobody sends on while nobody reads."""
        self.body += piece
        if len(self.body) > HIGH_WATER_LIMIT:
            self._protocol.flow.pause_reading()
        self.set()

    def set(self) -> None:
        """Hear that more of the body is there, or that the asker has gone."""
        if self._news is not None and not self._news.done():
            self._news.set_result(None)

    def begin(self) -> None:
        """Begin to answer."""
        is_whole = not (self.more_body or self._expects)
        request, policy = self._request, self._protocol.policy
        if not policy.is_known(request.headers) and (
            refusal := policy.refusal(request.method, request.path, request.headers)
        ):
            self._end(problem_response(refusal))
            return
        self._work = self._protocol.handler(request, self.body if is_whole else self._receive)
        self._context = copy_context()
        self._context.run(self._go_on)

    def _go_on(self, _: object = None) -> None:
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
                self._protocol.loop.call_soon(self._go_on, context=self._context)
            else:
                awaited._asyncio_future_blocking = False  # who awaits it has seen it
                awaited.add_done_callback(self._go_on, context=self._context)

    async def _receive(self) -> Message:
        protocol = self._protocol
        if self._expects:
            self._expects = False
            protocol.transport.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        while self.more_body and not self.body and not self.disconnected:
            protocol.flow.resume_reading()
            self._news = protocol.loop.create_future()
            await self._news
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
        if protocol.transport.is_closing():
            return
        head = [STATUS_LINE[answer.status], protocol.said_always()]
        for name, value in answer.headers:
            # What clients sent, and is told back in a header, must not become a header of its own.
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
