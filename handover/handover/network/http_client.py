"""HTTP client: pooled connections, opened only to addresses that a resolver allows.

A general client costs about a millisecond of processor time per request, this one about a tenth of that.

`PooledHttpClient.post` returns the status as soon as the head of the response is complete. A receiver that
answers 2xx has the notification, however its response ends (with its length, with the connection, or not at
all). The rest of the response is read and discarded. `BodyReadingHttpClient.request` returns whole
responses, up to a limit that also holds for the inflated body. `StreamingHttpClient.stream` returns a
response as it arrives, for a proxy. None of them follows redirects.
"""

import asyncio
import socket
import ssl
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, Protocol
from urllib.parse import urlsplit

from handover.network.http_connections import (
    MAX_ANSWER_BYTES,
    Connection,
    HttpResponse,
    NoResponse,
    RawHeader,
    ReadingConnection,
    ResponseTimeout,
    ResponseTooLarge,
    SendError,
    StreamedResponse,
    StreamingConnection,
)
from handover.network.outbound_policy import AddressRefused
from handover.network.tls_trust import client_context, handshake_fault

__all__ = [
    "ANY_ADDRESS",
    "MAX_ANSWER_BYTES",
    "MAX_RESPONSE_BYTES",
    "Address",
    "AnyAddress",
    "BodyReadingHttpClient",
    "HttpResponse",
    "NoResponse",
    "PooledHttpClient",
    "RawHeader",
    "Resolver",
    "ResponseTimeout",
    "ResponseTooLarge",
    "SendError",
    "StreamedResponse",
    "StreamingHttpClient",
    "address",
    "inflate",
]

MAX_RESPONSE_BYTES: Final = 32 * 1024 * 1024
"""Bytes of a response whose body is needed: a page of a thousand entities of 32 KB."""
FRESH_S: Final = 1.0
"""Idle time up to which a connection is reused for a request that must not be sent twice. Servers close
idle connections later than that."""
_INFLATED: Final = frozenset({"gzip", "x-gzip", "deflate"})


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
        answers = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
        return list(dict.fromkeys(str(address_info[4][0]) for address_info in answers))


ANY_ADDRESS: Final = AnyAddress()


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


class PooledHttpClient:
    """Posts to many addresses over pooled connections. `ca_files` (PEM) name authorities that are trusted
    besides those of the system."""

    def __init__(self, resolver: Resolver = ANY_ADDRESS, ca_files: Sequence[Path] = ()) -> None:
        self._resolver = resolver
        self._ca_files = ca_files
        self._make_connection: Callable[[], Connection] = Connection
        self._idle: dict[tuple[str, int, bool], list[Connection]] = {}
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

    async def _connect(self, where: Address) -> Connection:
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
    async def _ask(connection: Connection, request: bytes, idle: list[Connection]) -> Any:
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
        self._make_connection = partial(ReadingConnection, max_response_bytes)

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
        self._make_connection = StreamingConnection
        self._connect_timeout_s = connect_timeout_s

    async def _connect(self, where: Address) -> Connection:
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
