"""Posting notifications: a small HTTP client that keeps its connections open.

A general client costs about a millisecond of processor time a request; this one a tenth of that, which is
what lets a notification leave right after its commit. It posts, reads the status and forgets the rest.
"""

import asyncio
import ssl
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, cast
from urllib.parse import urlsplit

import httptools

MOST_IDLE: Final = 8
"""Open connections kept for each address while nothing is sent."""
LARGEST_ANSWER: Final = 256 * 1024
"""Bytes of an answer that are read before the connection is given up."""


class SendError(Exception):
    """The subscriber could not be reached or did not answer properly."""


@dataclass(frozen=True, slots=True)
class Address:
    """Where a URL leads: what to connect to, and what to ask there."""

    host: str
    port: int
    tls: bool
    target: str
    host_header: str


@lru_cache(maxsize=4096)
def address(url: str) -> Address:
    """Return where `url` leads; it has been checked to be an http or https URL."""
    parts = urlsplit(url)
    tls = parts.scheme == "https"
    host = parts.hostname or ""
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    return Address(host, parts.port or (443 if tls else 80), tls, target, parts.netloc.rpartition("@")[2])


class _Connection(asyncio.Protocol):
    """One connection: a request is written, its answer awaited; one at a time."""

    def __init__(self) -> None:
        self.transport: asyncio.Transport | None = None
        self.reusable = False
        self._parser: httptools.HttpResponseParser | None = None
        self._answer: asyncio.Future[int] | None = None
        self._received = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast("asyncio.Transport", transport)  # uvloop's is one in all but its class

    def request(self, data: bytes) -> "asyncio.Future[int]":
        """Send a request; the future is the status of the answer."""
        assert self.transport is not None  # noqa: S101 - connected before use
        self._answer = asyncio.get_running_loop().create_future()
        self._parser = httptools.HttpResponseParser(self)
        self._received = 0
        self.reusable = False
        self.transport.write(data)
        return self._answer

    def data_received(self, data: bytes) -> None:
        if self._parser is None:
            self.close()  # nobody asked
            return
        self._received += len(data)
        try:
            self._parser.feed_data(data)
        except httptools.HttpParserError as error:
            self._fail(f"the answer is not HTTP ({error})")
        if self._received > LARGEST_ANSWER:
            self._fail(f"the answer has more than {LARGEST_ANSWER} bytes")

    def on_message_complete(self) -> None:
        assert self._parser is not None  # noqa: S101 - it is what calls this
        status = self._parser.get_status_code()
        if status < 200:
            return
        self.reusable = self._parser.should_keep_alive()
        self._parser = None
        if self._answer is not None and not self._answer.done():
            self._answer.set_result(status)

    def connection_lost(self, exc: Exception | None) -> None:
        self._fail(f"the connection was closed before an answer came{f' ({exc})' if exc else ''}")

    def close(self) -> None:
        """Give the connection up."""
        self.reusable = False
        if self.transport is not None:
            self.transport.abort()

    @property
    def is_open(self) -> bool:
        """Whether the other side has not closed it."""
        return self.transport is not None and not self.transport.is_closing()

    def _fail(self, why: str) -> None:
        self.reusable = False
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(SendError(why))
        if self.transport is not None:
            self.transport.abort()


class HttpSender:
    """Posts to many addresses, over connections that are kept open between posts."""

    def __init__(self) -> None:
        self._idle: dict[tuple[str, int, bool], list[_Connection]] = {}
        self._tls: ssl.SSLContext | None = None

    async def post(self, url: str, headers: Iterable[tuple[str, str]], body: bytes, timeout_s: float) -> int:
        """Return the status of the answer; raise `SendError` when there is none within `timeout_s`."""
        where = address(url)
        lines = [
            f"POST {where.target} HTTP/1.1",
            f"Host: {where.host_header}",
            f"Content-Length: {len(body)}",
        ]
        lines += [f"{name}: {value}" for name, value in headers]
        request = ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1") + body
        try:
            async with asyncio.timeout(timeout_s):
                return await self._exchange(where, request)
        except TimeoutError:
            raise SendError(f"no answer within {timeout_s:g} s") from None
        except OSError as error:
            raise SendError(error.strerror or str(error) or type(error).__name__) from None

    def close(self) -> None:
        """Close all connections."""
        for connections in self._idle.values():
            for connection in connections:
                connection.close()
        self._idle.clear()

    async def _exchange(self, where: Address, request: bytes) -> int:
        idle = self._idle.setdefault((where.host, where.port, where.tls), [])
        while idle:
            connection = idle.pop()
            if connection.is_open:
                try:
                    return await self._ask(connection, request, idle)
                except SendError:
                    break  # the other side may have closed it while it was idle: once more on a new one
        return await self._ask(await self._connect(where), request, idle)

    async def _connect(self, where: Address) -> _Connection:
        if where.tls and self._tls is None:
            self._tls = await asyncio.to_thread(ssl.create_default_context)
        loop = asyncio.get_running_loop()
        _, connection = await loop.create_connection(
            _Connection, where.host, where.port, ssl=self._tls if where.tls else None
        )
        return connection

    @staticmethod
    async def _ask(connection: _Connection, request: bytes, idle: list[_Connection]) -> int:
        try:
            return await connection.request(request)
        finally:
            if connection.reusable and connection.is_open and len(idle) < MOST_IDLE:
                idle.append(connection)
            else:
                connection.close()
