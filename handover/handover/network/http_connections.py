"""HTTP connections: one request at a time, and its response by the head, as a whole, or as it arrives.

A receiver that answers 2xx has the notification, however its response ends (with its length, with the
connection, or not at all). `http_client` opens and pools them.
"""

import asyncio
import select
import sys
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Any, Final, cast

import httptools

MAX_IDLE: Final = 8
"""Idle connections kept open for each address."""
MAX_ANSWER_BYTES: Final = 256 * 1024
"""Bytes of a response that are read before the connection is closed."""
REST_TIMEOUT_S: Final = 1.0
"""Timeout for the rest of a response after its head; then the connection is closed."""
MAX_WAITING_BYTES: Final = 256 * 1024
"""Bytes of a streamed response that wait to be taken; then reading pauses."""

RawHeader = tuple[bytes, bytes]


class SendError(Exception):
    """The other side could not be reached or sent no valid response."""


class NoResponse(SendError):
    """The request may have been sent, and no whole response came: it may have been carried out."""


class ResponseTimeout(NoResponse):
    """The other side sent no response in time."""


class ResponseTooLarge(NoResponse):
    """The response exceeds the limit."""


@dataclass(frozen=True, slots=True)
class HttpResponse:
    """A whole response; the names of `headers` are in lower case."""

    status: int
    headers: dict[str, str]
    body: bytes


class Connection(asyncio.Protocol):
    """One connection, with one request at a time."""

    def __init__(self) -> None:
        self.max_answer_bytes = MAX_ANSWER_BYTES
        self.transport: asyncio.Transport | None = None
        self.reusable = False
        self.idle_since_s = 0.0
        self._parser: httptools.HttpResponseParser | None = None
        self._answer: asyncio.Future[Any] | None = None
        self._received = 0
        self._idle: list[Connection] | None = None
        self._rest_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(
            "asyncio.Transport", transport
        )  # uvloop's transport has the interface but not the class

    def request(self, data: bytes) -> "asyncio.Future[Any]":
        """Send a request; the future is the status of the response, in the subclass the whole response."""
        assert self.transport is not None  # noqa: S101 - connected before use
        self._answer = asyncio.get_running_loop().create_future()
        self._parser = httptools.HttpResponseParser(self)
        self._received = 0
        self.reusable = False
        self.transport.write(data)
        return self._answer

    def data_received(self, data: bytes) -> None:
        if self._parser is None:
            self.close()  # data without a request
            return
        self._received += len(data)
        try:
            self._parser.feed_data(data)
        except httptools.HttpParserError as error:
            self._fail(NoResponse(f"the answer is not HTTP ({error})"))
        if self._received > self.max_answer_bytes:
            self._fail(ResponseTooLarge(f"the answer has more than {self.max_answer_bytes} bytes"))

    def on_headers_complete(self) -> None:
        assert self._parser is not None  # noqa: S101 - it is what calls this
        if (status := self._parser.get_status_code()) >= 200:
            self._settle(status)

    def on_message_complete(self) -> None:
        assert self._parser is not None  # noqa: S101 - it is what calls this
        if self._parser.get_status_code() < 200:
            return
        self.reusable = self._parser.should_keep_alive()
        self._parser = None
        if self._idle is not None:
            self.release(self._idle)

    def connection_lost(self, exc: Exception | None) -> None:
        why = f"the connection was closed before an answer came{f' ({exc})' if exc else ''}"
        self._fail(NoResponse(why))

    def close(self) -> None:
        """Close the connection."""
        self.reusable = False
        if self._rest_timer is not None:
            self._rest_timer.cancel()
        if self.transport is not None:
            self.transport.abort()

    def release(self, idle: "list[Connection]") -> None:
        """Add the connection to the `idle` ones once its response is read to the end; close it otherwise.

        After its head, the rest of a response has `REST_TIMEOUT_S`. If the response ends with the connection,
        our side is closed at once, so that the other side need not wait for it.
        """
        answer, self._answer = self._answer, None  # an exception in it would refer back to this connection
        has_head = answer is not None and answer.done() and not answer.cancelled()
        if self._parser is not None and self.transport is not None and has_head and self.is_open:
            self._idle = idle
            self._rest_timer = asyncio.get_running_loop().call_later(REST_TIMEOUT_S, self.close)
            if not self._parser.should_keep_alive() and self.transport.can_write_eof():
                self.transport.write_eof()
            return
        self._idle = None
        if self._rest_timer is not None:
            self._rest_timer.cancel()
            self._rest_timer = None
        if self.reusable and self.is_open and len(idle) < MAX_IDLE:
            self.idle_since_s = asyncio.get_running_loop().time()
            idle.append(self)
        else:
            self.close()

    @property
    def is_open(self) -> bool:
        """Whether it is not closed, as far as the event loop has noticed."""
        return self.transport is not None and not self.transport.is_closing()

    @property
    def is_usable(self) -> bool:
        """Whether the idle connection can take a request.

        If the other side has closed it and the event loop has not noticed yet, its socket is readable.
        """
        if not self.is_open or self.transport is None:
            return False
        connected = self.transport.get_extra_info("socket")
        if connected is None or not hasattr(select, "poll"):  # Windows has none
            return True
        poll = select.poll()
        poll.register(connected.fileno(), select.POLLIN)
        return not poll.poll(0)

    def _settle(self, answer: Any) -> None:
        if self._answer is not None and not self._answer.done():
            self._answer.set_result(answer)

    def _fail(self, error: SendError) -> None:
        self.reusable = False
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(error)
        if self.transport is not None:
            self.transport.abort()


class ReadingConnection(Connection):
    """A connection that keeps the body of the response."""

    def __init__(self, max_answer_bytes: int) -> None:
        super().__init__()
        self.max_answer_bytes = max_answer_bytes
        self._headers: dict[str, str] = {}
        self._body: list[bytes] = []
        self._ends_with_the_connection = False

    def request(self, data: bytes) -> "asyncio.Future[Any]":
        """Send a request; the future is the `HttpResponse`."""
        self._headers, self._body = {}, []
        self._ends_with_the_connection = False
        return super().request(data)

    def on_header(self, name: bytes, value: bytes) -> None:
        key, text = name.decode("latin-1").lower(), value.decode("latin-1")
        self._headers[key] = f"{self._headers[key]}, {text}" if key in self._headers else text

    def on_headers_complete(self) -> None:
        assert self._parser is not None  # noqa: S101 - it is what calls this
        if self._parser.get_status_code() < 200:  # headers of an interim response; the final ones follow
            self._headers = {}
        self._ends_with_the_connection = (
            "content-length" not in self._headers and "transfer-encoding" not in self._headers
        )

    def on_body(self, body: bytes) -> None:
        self._body.append(body)

    def on_message_complete(self) -> None:
        assert self._parser is not None  # noqa: S101 - it is what calls this
        if (status := self._parser.get_status_code()) >= 200:
            self._settle(HttpResponse(status, self._headers, b"".join(self._body)))
        super().on_message_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        if exc is None and self._parser is not None and self._ends_with_the_connection:
            self.on_message_complete()
            self.reusable = False
        super().connection_lost(exc)


class StreamedResponse:
    """A response whose body may still arrive; header names and values are as they were received.

    Use `chunks` until their end, and `close` in any case.
    """

    def __init__(self, connection: "StreamingConnection", status: int, headers: list[RawHeader]) -> None:
        self.status = status
        self.headers = headers
        self._connection: StreamingConnection | None = connection
        self._idle: list[Connection] = []

    def whole(self) -> bytes | None:
        """Return the body if it has arrived; None before."""
        connection = self._connection
        return None if connection is None or not connection.is_complete else connection.taken()

    async def chunks(self, timeout_s: float) -> AsyncIterator[bytes]:
        """Yield the body; raise `SendError` if it breaks off, or stops for `timeout_s`."""
        while (connection := self._connection) is not None:
            if data := connection.taken():
                yield data
            elif connection.is_complete:
                return
            else:
                try:
                    async with asyncio.timeout(timeout_s):
                        await connection.more()
                except TimeoutError:
                    raise ResponseTimeout(f"the answer stopped for {timeout_s:g} s") from None

    def give_back_to(self, idle: "list[Connection]") -> None:
        """Set where the connection goes afterwards."""
        self._idle = idle

    def close(self) -> None:
        """Release the connection; one whose response is not complete is closed."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.finish(self._idle)


class StreamingConnection(Connection):
    """A connection that hands over the body as it arrives, and stops to read while nobody takes it."""

    def __init__(self) -> None:
        super().__init__()
        self.max_answer_bytes = sys.maxsize
        self.is_complete = False
        self._head: list[RawHeader] = []
        self._body: list[bytes] = []
        self._waiting_bytes = 0
        self._is_paused = False
        self._more: asyncio.Future[None] | None = None
        self._broken: SendError | None = None

    def request(self, data: bytes) -> "asyncio.Future[Any]":
        """Send a request; the future is the `StreamedResponse`."""
        self._head, self._body, self._waiting_bytes = [], [], 0
        self.is_complete, self._broken = False, None
        return super().request(data)

    def on_header(self, name: bytes, value: bytes) -> None:
        self._head.append((name, value))

    def on_headers_complete(self) -> None:
        assert self._parser is not None  # noqa: S101 - it is what calls this
        if (status := self._parser.get_status_code()) < 200:  # an interim response; the final one follows
            self._head = []
        else:
            self._settle(StreamedResponse(self, status, self._head))

    def on_body(self, body: bytes) -> None:
        self._body.append(body)
        self._waiting_bytes += len(body)
        if self._waiting_bytes > MAX_WAITING_BYTES and not self._is_paused and self.transport is not None:
            self._is_paused = True
            self.transport.pause_reading()
        self._wake()

    def on_message_complete(self) -> None:
        assert self._parser is not None  # noqa: S101 - it is what calls this
        if self._parser.get_status_code() >= 200:
            self.is_complete = True
            self._wake()
        super().on_message_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        names = {name.lower() for name, _ in self._head}
        if exc is None and self._parser is not None and not {b"content-length", b"transfer-encoding"} & names:
            self.on_message_complete()  # the response ends with the connection
            self.reusable = False
        super().connection_lost(exc)

    def taken(self) -> bytes:
        """Return what has arrived, and continue to read."""
        data = b"".join(self._body)
        self._body, self._waiting_bytes = [], 0
        if self._is_paused and self.transport is not None and self.is_open:
            self._is_paused = False
            self.transport.resume_reading()
        return data

    async def more(self) -> None:
        """Wait until more has arrived; raise `SendError` if the response has broken off."""
        if self._broken is not None:
            raise self._broken
        self._more = asyncio.get_running_loop().create_future()
        await self._more

    def finish(self, idle: "list[Connection]") -> None:
        """Become idle after a whole response; close otherwise."""
        self._body = []
        if self.is_complete:
            super().release(idle)
        else:
            self.close()

    def release(self, idle: "list[Connection]") -> None:
        """Keep the connection for the body of a response; one without a response is closed."""
        answer = self._answer
        if answer is not None and answer.done() and not answer.cancelled() and answer.exception() is None:
            answer.result().give_back_to(idle)
        else:
            self.close()

    def _fail(self, error: SendError) -> None:
        self._broken = error
        super()._fail(error)
        if self._more is not None and not self._more.done():
            self._more.set_exception(error)

    def _wake(self) -> None:
        if self._more is not None and not self._more.done():
            self._more.set_result(None)
