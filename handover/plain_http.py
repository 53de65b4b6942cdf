"""Plain HTTP: an httpx transport for whoever talks to one server hundreds of times a second.

httpx's own transport serves every case, and takes half a millisecond of a core for a request; this one
serves http:// alone, over connections that stay open, in a tenth of that. All else (https, HEAD) goes to
httpx's own.
"""

import asyncio
from functools import partial
from typing import Any, Final, cast

import httptools
import httpx

MOST_OPEN: Final = 100
"""Connections at once, as many as httpx opens; who wants more waits."""
MOST_IDLE: Final = 20
"""Connections of one server that are kept while nothing is asked."""
IDLE_S: Final = 5.0
"""An idle connection is not used again after this: servers commonly close it then."""


class PlainHttp(httpx.AsyncBaseTransport):
    """Give it to an `httpx.AsyncClient`; it lives on one event loop. Raises what httpx raises."""

    def __init__(self) -> None:
        self._others = httpx.AsyncHTTPTransport(trust_env=False)
        self._idle: dict[tuple[str, int], list[_Connection]] = {}
        self._room = asyncio.Semaphore(MOST_OPEN)

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        """Ask, and return the answer once all of it is here."""
        if request.url.scheme != "http" or request.method in {"HEAD", "CONNECT"}:
            return await self._others.handle_async_request(request)
        body = await request.aread()
        timeouts = request.extensions.get("timeout", {})
        if self._room.locked():
            await _within(timeouts.get("pool"), self._room.acquire(), httpx.PoolTimeout)
        else:
            await self._room.acquire()
        try:
            return await self._ask(request, body, timeouts)
        finally:
            self._room.release()

    async def _ask(self, request: httpx.Request, body: bytes, timeouts: dict[str, Any]) -> httpx.Response:
        where = (request.url.raw_host.decode("ascii"), request.url.port or 80)
        idle = self._idle.setdefault(where, [])
        connection = self._kept(idle) or await self._connect(where, timeouts.get("connect"))
        try:
            return await connection.ask(_written(request, body), timeouts.get("read"))
        finally:
            if connection.is_reusable and len(idle) < MOST_IDLE:
                idle.append(connection)
            else:
                connection.close()

    @staticmethod
    def _kept(idle: "list[_Connection]") -> "_Connection | None":
        """Return the connection that was used last; those that have been idle too long are closed."""
        while idle:
            connection = idle.pop()
            if connection.is_fresh:
                return connection
            connection.close()
        return None

    @staticmethod
    async def _connect(where: tuple[str, int], timeout_s: float | None) -> "_Connection":
        host, port = where
        loop = asyncio.get_running_loop()
        opening = loop.create_connection(partial(_Connection, loop), host.strip("[]"), port)
        try:
            _, connection = await _within(timeout_s, opening, httpx.ConnectTimeout)
        except OSError as error:
            raise httpx.ConnectError(f"{host}:{port}: {error}") from error
        return cast("_Connection", connection)

    async def aclose(self) -> None:
        """Close all connections."""
        for idle in self._idle.values():
            for connection in idle:
                connection.close()
        self._idle.clear()
        await self._others.aclose()


class _Connection(asyncio.Protocol):
    """One connection: a request is written, its answer awaited; one at a time."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._transport: asyncio.Transport | None = None
        self._answer: asyncio.Future[httpx.Response] | None = None
        self._parser: httptools.HttpResponseParser | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._headers: list[tuple[bytes, bytes]] = []
        self._reason = b""
        self._body: list[bytes] = []
        self._ends_with_connection = False
        self._keeps_alive = False
        self._heard_s = 0.0

    @property
    def is_reusable(self) -> bool:
        """Whether another request may follow."""
        return self._keeps_alive and self._transport is not None and not self._transport.is_closing()

    @property
    def is_fresh(self) -> bool:
        """Whether it is reusable, and its server has no reason yet to close it."""
        return self.is_reusable and self._loop.time() - self._heard_s < IDLE_S

    async def ask(self, request: bytes, timeout_s: float | None) -> httpx.Response:
        """Send a request and return the answer; nothing may come for `timeout_s` at most."""
        assert self._transport is not None  # noqa: S101 - connected before use
        answer: asyncio.Future[httpx.Response] = self._loop.create_future()
        self._answer = answer
        self._parser = httptools.HttpResponseParser(self)
        self._keeps_alive = self._ends_with_connection = False
        self._heard_s = self._loop.time()
        self._forget()
        self._transport.write(request)
        if timeout_s is not None:
            self._timer = self._loop.call_later(timeout_s, self._look, timeout_s)
        try:
            return await answer
        finally:
            self._answer = self._parser = None
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None

    def close(self) -> None:
        """Close it at once."""
        if self._transport is not None:
            self._transport.abort()

    def _forget(self) -> None:
        self._headers, self._body, self._reason = [], [], b""

    def _look(self, timeout_s: float) -> None:
        """Give up if nothing was heard for long, else look again when that could be."""
        left_s = self._heard_s + timeout_s - self._loop.time()
        if left_s > 0:
            self._timer = self._loop.call_later(left_s, self._look, timeout_s)
        else:
            self._fail(httpx.ReadTimeout(f"nothing was answered within {timeout_s:g} s"))

    def _fail(self, error: Exception) -> None:
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(error)

    # What asyncio tells

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)  # uvloop's is one in all but its class

    def data_received(self, data: bytes) -> None:
        if self._parser is None:
            self.close()  # nobody asked
            return
        self._heard_s = self._loop.time()
        try:
            self._parser.feed_data(data)
        except httptools.HttpParserError as error:
            self._fail(httpx.RemoteProtocolError(f"what was answered is not HTTP: {error}"))

    def connection_lost(self, exc: Exception | None) -> None:
        if exc is None and self._ends_with_connection and self._parser is not None:
            self.on_message_complete()
        self._keeps_alive = False
        why = f" ({exc})" if exc else ""
        self._fail(httpx.ReadError(f"the connection was closed before an answer came{why}"))

    # What the parser tells

    def on_status(self, status: bytes) -> None:
        self._reason += status

    def on_header(self, name: bytes, value: bytes) -> None:
        self._headers.append((name, value))

    def on_headers_complete(self) -> None:
        told = {name.lower() for name, _ in self._headers}
        self._ends_with_connection = not told & {b"content-length", b"transfer-encoding"}

    def on_body(self, body: bytes) -> None:
        self._body.append(body)

    def on_message_complete(self) -> None:
        if self._parser is None:
            return
        status = self._parser.get_status_code()
        if status < httpx.codes.OK:  # more is to come
            self._forget()
            return
        self._keeps_alive = self._parser.should_keep_alive()
        if self._answer is not None and not self._answer.done():
            self._answer.set_result(
                httpx.Response(
                    status,
                    headers=self._headers,
                    stream=httpx.ByteStream(b"".join(self._body)),
                    extensions={"http_version": b"HTTP/1.1", "reason_phrase": self._reason},
                )
            )
        self._forget()


def _written(request: httpx.Request, body: bytes) -> bytes:
    lines = [b"%s %s HTTP/1.1" % (request.method.encode("ascii"), request.url.raw_path)]
    lines += [b"%s: %s" % (name, value) for name, value in request.headers.raw]
    return b"\r\n".join(lines) + b"\r\n\r\n" + body


async def _within(timeout_s: float | None, waiting: Any, error: type[httpx.TransportError]) -> Any:
    try:
        async with asyncio.timeout(timeout_s):
            return await waiting
    except TimeoutError:
        raise error(f"not within {timeout_s:g} s") from None
