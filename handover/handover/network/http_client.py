"""HTTP client: pooled connections, opened only to addresses that a resolver allows.

A general client costs about a millisecond of processor time per request, this one about a tenth of that.

`PooledHttpClient.post` returns the status as soon as the head of the response is complete. A receiver that
answers 2xx has the notification, however its response ends (with its length, with the connection, or not at
all). The rest of the response is read and discarded. `BodyReadingHttpClient.request` returns whole
responses, up to a limit that also holds for the inflated body. `StreamingHttpClient.stream` returns a
response as it arrives, for a proxy. None of them follows redirects.
"""

import asyncio
import select
import socket
import ssl
import sys
import zlib
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, Protocol, cast
from urllib.parse import urlsplit

import httptools

from handover.network.outbound_policy import AddressRefused
from handover.network.tls_trust import client_context, handshake_fault

MAX_IDLE: Final = 8
"""Idle connections kept open for each address."""
MAX_ANSWER_BYTES: Final = 256 * 1024
"""Bytes of a response that are read before the connection is closed."""
MAX_RESPONSE_BYTES: Final = 32 * 1024 * 1024
"""The same where the body is needed: a page of a thousand entities of 32 KB."""
REST_TIMEOUT_S: Final = 1.0
"""Timeout for the rest of a response after its head; then the connection is closed."""
FRESH_S: Final = 1.0
"""Idle time up to which a connection is reused for a request that must not be sent twice. Servers close
idle connections later than that."""
MAX_WAITING_BYTES: Final = 256 * 1024
"""Bytes of a streamed response that wait to be taken; then reading pauses."""
_INFLATED: Final = frozenset({"gzip", "x-gzip", "deflate"})


RawHeader = tuple[bytes, bytes]


class Resolver(Protocol):
    """Decides which addresses a client connects to."""

    async def resolved(self, host: str, port: int) -> list[str]:
        """Return the allowed addresses of `host`, in the order to try them.

        Raises `AddressRefused` when all are refused, `OSError` when the name cannot be resolved.
        """
        ...


class AnyAddress:
    """The resolver of the system: every address is allowed."""

    async def resolved(self, host: str, port: int) -> list[str]:
        """Return the addresses of `host`; raise `OSError` when the name cannot be resolved."""
        known = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
        return list(dict.fromkeys(str(one[4][0]) for one in known))


ANY_ADDRESS: Final = AnyAddress()


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


@dataclass(frozen=True, slots=True)
class Address:
    """The parts of a URL: what to connect to, and what to request there."""

    host: str
    port: int
    tls: bool
    target: str
    host_header: str
    tls_name: str = ""
    """The name that its certificate must have, if that is not `host`."""


@lru_cache(maxsize=4096)
def address(url: str) -> Address:
    """Return the parts of `url`, a valid http or https URL."""
    parts = urlsplit(url)
    tls = parts.scheme == "https"
    host = parts.hostname or ""
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    return Address(host, parts.port or (443 if tls else 80), tls, target, parts.netloc.rpartition("@")[2])


class _Connection(asyncio.Protocol):
    """One connection, with one request at a time."""

    def __init__(self) -> None:
        self.max_answer_bytes = MAX_ANSWER_BYTES
        self.transport: asyncio.Transport | None = None
        self.reusable = False
        self.idle_since_s = 0.0
        self._parser: httptools.HttpResponseParser | None = None
        self._answer: asyncio.Future[Any] | None = None
        self._received = 0
        self._idle: list[_Connection] | None = None
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

    def release(self, idle: "list[_Connection]") -> None:
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


class _ReadingConnection(_Connection):
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

    def __init__(self, connection: "_StreamingConnection", status: int, headers: list[RawHeader]) -> None:
        self.status = status
        self.headers = headers
        self._connection: _StreamingConnection | None = connection
        self._idle: list[_Connection] = []

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

    def give_back_to(self, idle: "list[_Connection]") -> None:
        """Set where the connection goes afterwards."""
        self._idle = idle

    def close(self) -> None:
        """Release the connection; one whose response is not complete is closed."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.finish(self._idle)


class _StreamingConnection(_Connection):
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

    def finish(self, idle: "list[_Connection]") -> None:
        """Become idle after a whole response; close otherwise."""
        self._body = []
        if self.is_complete:
            super().release(idle)
        else:
            self.close()

    def release(self, idle: "list[_Connection]") -> None:
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


class PooledHttpClient:
    """Posts to many addresses over pooled connections. `ca_files` (PEM) name authorities that are trusted
    besides those of the system."""

    def __init__(self, resolver: Resolver = ANY_ADDRESS, ca_files: Sequence[Path] = ()) -> None:
        self._resolver = resolver
        self._ca_files = ca_files
        self._make_connection: Callable[[], _Connection] = _Connection
        self._idle: dict[tuple[str, int, bool], list[_Connection]] = {}
        self._tls: ssl.SSLContext | None = None

    async def post(self, url: str, headers: Iterable[tuple[str, str]], body: bytes, timeout_s: float) -> int:
        """Return the status of the response; raise `SendError` when there is none within `timeout_s`."""
        status: int = await self._send("POST", url, headers, body, timeout_s, may_repeat=True)
        return status

    async def _send(
        self,
        method: str,
        url: str | Address,
        headers: Iterable[tuple[str, str]],
        body: bytes,
        timeout_s: float,
        *,
        may_repeat: bool,
    ) -> Any:
        where = url if isinstance(url, Address) else address(url)
        lines = [f"{method} {where.target} HTTP/1.1", f"Host: {where.host_header}"]
        if body or method != "GET":
            lines.append(f"Content-Length: {len(body)}")
        lines += [f"{name}: {value}" for name, value in headers]
        request = ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1") + body
        try:
            async with asyncio.timeout(timeout_s):
                return await self._request(where, request, may_repeat=may_repeat)
        except TimeoutError:
            raise ResponseTimeout(f"no answer within {timeout_s:g} s") from None
        except AddressRefused as refused:
            raise SendError(str(refused)) from None
        except UnicodeError as error:
            raise SendError(f"{where.host} is no name of a machine ({error})") from None
        except OSError as error:
            fault = handshake_fault(error, where.host_header) if where.tls else None
            raise SendError(fault or error.strerror or str(error) or type(error).__name__) from None

    def close(self) -> None:
        """Close all connections."""
        for connections in self._idle.values():
            for connection in connections:
                connection.close()
        self._idle.clear()

    async def _request(self, where: Address, request: bytes, *, may_repeat: bool) -> Any:
        idle = self._idle.setdefault((where.host, where.port, where.tls), [])
        now_s = asyncio.get_running_loop().time()
        while idle:
            connection = idle.pop()
            if not connection.is_usable:
                connection.close()
                continue
            if not may_repeat and now_s - connection.idle_since_s > FRESH_S:
                connection.close()
                continue
            try:
                return await self._ask(connection, request, idle)
            except ResponseTooLarge:
                raise
            except SendError:
                if not may_repeat:
                    raise
                break  # the other side may have closed the idle connection: retry once on a new one
        return await self._ask(await self._connect(where), request, idle)

    async def _connect(self, where: Address) -> _Connection:
        """Connect to the first allowed address of the host that accepts.

        The name is resolved here and the checked address is used, so that a later change of the name has no
        effect.
        """
        if where.tls and self._tls is None:
            self._tls = await asyncio.to_thread(client_context, *self._ca_files)
        loop = asyncio.get_running_loop()
        tls = self._tls if where.tls else None
        failure: OSError | None = None
        for resolved in await self._resolver.resolved(where.host, where.port):
            try:
                _, connection = await loop.create_connection(
                    self._make_connection,
                    resolved,
                    where.port,
                    ssl=tls,
                    server_hostname=(where.tls_name or where.host) if tls else None,
                )
            except OSError as error:
                failure = error
            else:
                return connection
        raise failure or OSError(f"{where.host} has no address")

    @staticmethod
    async def _ask(connection: _Connection, request: bytes, idle: list[_Connection]) -> Any:
        try:
            return await connection.request(request)
        finally:
            connection.release(idle)


class BodyReadingHttpClient(PooledHttpClient):
    """Sends requests to many addresses and reads whole responses, up to `max_response_bytes`, also
    inflated."""

    def __init__(
        self,
        resolver: Resolver = ANY_ADDRESS,
        ca_files: Sequence[Path] = (),
        max_response_bytes: int = MAX_RESPONSE_BYTES,
    ) -> None:
        super().__init__(resolver, ca_files)
        self._max_response_bytes = max_response_bytes
        self._make_connection = partial(_ReadingConnection, max_response_bytes)

    async def request(
        self,
        method: str,
        url: str | Address,
        headers: Iterable[tuple[str, str]],
        body: bytes,
        timeout_s: float,
    ) -> HttpResponse:
        """Return the decoded response; raise `SendError` when there is none within `timeout_s`.

        `url` may be given in parts, which saves a client of one server the cache of parsed URLs.
        A POST or PATCH with an unknown result is not sent again: it may have been carried out.
        """
        may_repeat = method not in {"POST", "PATCH"}
        reply: HttpResponse = await self._send(method, url, headers, body, timeout_s, may_repeat=may_repeat)
        if len(reply.body) > self._max_response_bytes:  # its end came with the bytes beyond the limit
            raise ResponseTooLarge(f"the answer has more than {self._max_response_bytes} bytes")
        coding = reply.headers.get("content-encoding", "identity").strip().lower()
        if coding == "identity" or not reply.body:
            return reply
        if coding not in _INFLATED:
            raise SendError(f"the answer has the Content-Encoding {coding}, which is not read")
        return replace(reply, body=await asyncio.to_thread(inflate, reply.body, self._max_response_bytes))


class StreamingHttpClient(PooledHttpClient):
    """Sends requests to many addresses, and hands over responses as they arrive."""

    def __init__(
        self,
        resolver: Resolver = ANY_ADDRESS,
        ca_files: Sequence[Path] = (),
        connect_timeout_s: float = 3.0,
    ) -> None:
        super().__init__(resolver, ca_files)
        self._make_connection = _StreamingConnection
        self._connect_timeout_s = connect_timeout_s

    async def _connect(self, where: Address) -> _Connection:
        async with asyncio.timeout(self._connect_timeout_s):
            return await super()._connect(where)

    async def stream(
        self,
        method: str,
        url: str | Address,
        headers: Iterable[tuple[str, str]],
        body: bytes,
        timeout_s: float,
    ) -> StreamedResponse:
        """Return the response once its head is there; raise `SendError` when there is none in `timeout_s`.

        Not for HEAD, whose response has lengths without bodies. A POST or PATCH with an unknown result is not
        sent again.
        """
        may_repeat = method not in {"POST", "PATCH"}
        reply: StreamedResponse = await self._send(
            method, url, headers, body, timeout_s, may_repeat=may_repeat
        )
        return reply


def inflate(body: bytes, max_bytes: int) -> bytes:
    """Return the inflated body in gzip or zlib format; raise `ResponseTooLarge` beyond `max_bytes`."""
    inflater = zlib.decompressobj(wbits=zlib.MAX_WBITS | 32)  # 32: detect gzip or zlib by the header
    try:
        text = inflater.decompress(body, max_bytes + 1)
    except zlib.error as error:
        raise SendError(f"the answer cannot be inflated ({error})") from None
    if len(text) > max_bytes:
        raise ResponseTooLarge(f"the answer inflates to more than {max_bytes} bytes")
    if not inflater.eof:
        raise SendError("the answer cannot be inflated (it is cut)")
    return text
