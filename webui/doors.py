"""The doors: REST of the services, passed through as it is, so that the page needs one address only.

Bodies are passed on as they come, and not kept. A request's body that is short is received before the service
is asked, so that a client that sends slowly occupies no connection to a service; the server's timeouts end
it. A service that is away is said to be away, by name.
"""

import asyncio
import re
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Final, Self
from urllib.parse import unquote

import httpx
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from handover.errors import Problem
from handover.messages import message
from handover.telemetry import get_logger
from webui.metrics import AWAY
from webui.streams import READS, UPLOADS, Stream, Streams

log = get_logger(__name__)

METHODS: Final = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
HOP_BY_HOP: Final = frozenset(
    {
        "connection", "keep-alive", "proxy-authenticate", "proxy-authorization", "te", "trailer",
        "transfer-encoding", "upgrade", "proxy-connection",
    }
)  # fmt: skip
ONLY_TO_US: Final = frozenset({"host", "origin", "referer", "cookie", "expect"})
"""Headers of the browser that are meant for this server, not for those behind it."""
PATIENCE: Final = httpx.Timeout(30.0, connect=3.0, read=60.0)
MAX_BYTES_BEFORE_ASKING: Final = 256 * 1024
CONNECTIONS: Final = httpx.Limits(
    max_connections=UPLOADS.per_service + READS.per_service, max_keepalive_connections=16
)
_OWN_POLICY: Final = frozenset({"server", "date"})
_RUNG_BY_THE_BROKER: Final = re.compile(r"^notifications(/|$)")


class Doors:
    """One client a service; an asynchronous context manager while the doors are open."""

    def __init__(self, urls: Mapping[str, str], on_write: Callable[[str], None] = lambda _: None) -> None:
        self._urls = urls
        self._on_write = on_write
        self._clients: dict[str, httpx.AsyncClient] = {}
        self._streams = Streams()

    async def __aenter__(self) -> Self:
        for service, url in self._urls.items():
            self._clients[service] = httpx.AsyncClient(
                base_url=url, timeout=PATIENCE, limits=CONNECTIONS, trust_env=False
            )
        return self

    async def __aexit__(self, *_: object) -> None:
        for client in self._clients.values():
            await client.aclose()

    async def pass_through(self, service: str, path: str, request: Request) -> Response:
        """Return what `service` answers to `request` at `path` (as it was sent, still quoted).

        Raises `Problem`: 404 for what is no door, 429 and 503 when there are too many requests at once, 502
        and 504 for a service that is away or too slow.
        """
        client = self._clients.get(service)
        if client is None:
            there_are = ", ".join(self._clients)
            raise Problem(
                404,
                "No such service",
                message(
                    "page.no_such_service",
                    'there is no service "{service}"; there are {there_are}',
                    service=service,
                    there_are=there_are,
                ),
            )
        _require_plain(path)
        if _RUNG_BY_THE_BROKER.match(unquote(path)):
            raise Problem(
                404,
                "Not found",
                message(
                    "page.notifications_not_here",
                    "notifications reach {service} from the broker, not from here",
                    service=service,
                ),
            )
        content = await _received(request)
        limits = UPLOADS if isinstance(content, AsyncIterator) else READS
        stream = self._streams.admit(request.client.host if request.client else "", service, limits)
        try:
            answer = await self._ask(client, service, path, request, content)
        except asyncio.CancelledError:
            self._streams.leave(stream)
            if not stream.is_ended:
                raise
            raise Problem(
                408, "Request timeout", "the request gave way to others, which wait; send it again"
            ) from None
        except BaseException:
            self._streams.leave(stream)
            raise
        if request.method not in {"GET", "HEAD"} and answer.is_success:
            self._on_write(service)
        return _Passed(answer, service, self._streams, stream)

    async def _ask(
        self,
        client: httpx.AsyncClient,
        service: str,
        path: str,
        request: Request,
        content: bytes | AsyncIterator[bytes] | None,
    ) -> httpx.Response:
        url = client.base_url.copy_with(
            raw_path=client.base_url.raw_path.rstrip(b"/")
            + b"/"
            + path.encode("ascii")
            + (b"?" + request.scope["query_string"] if request.scope["query_string"] else b"")
        )
        asked = httpx.Request(
            request.method,
            url,
            headers=_inward(request),
            content=content,
            extensions={"timeout": PATIENCE.as_dict()},
        )
        try:
            return await client.send(asked, stream=True)
        except httpx.TimeoutException as error:
            raise self._away(service, 504, "does not answer in time", error) from None
        except (httpx.HTTPError, asyncio.IncompleteReadError) as error:
            raise self._away(service, 502, "does not answer", error) from None

    def _away(self, service: str, status: int, how: str, error: Exception) -> Problem:
        AWAY.labels(service).inc()
        log.warning("service away", service_asked=service, error=str(error) or type(error).__name__)
        return Problem(
            status,
            "Service away",
            message(
                "page.service_away",
                "{service} {how} ({urls}); see on the System page whether it runs, and try again",
                service=service,
                how=how,
                urls=self._urls[service],
            ),
            extra={"service": service},
        )


class _Passed(StreamingResponse):
    """The answer of a service, passed on as it comes."""

    def __init__(self, answer: httpx.Response, service: str, streams: Streams, stream: Stream) -> None:
        super().__init__(self._pieces(), answer.status_code, _outward(answer, service))
        self._answer, self._service = answer, service
        self._streams, self._stream = streams, stream

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the answer; let go of it whatever happens."""
        try:
            await super().__call__(scope, receive, send)
        except asyncio.CancelledError:
            if not self._stream.is_ended:
                raise
            log.warning("an answer gave way to other requests", service_asked=self._service)
        except httpx.HTTPError as error:  # what was promised cannot be kept: the connection is closed
            log.warning("an answer broke off", service_asked=self._service, error=str(error))
        finally:
            self._streams.leave(self._stream)
            await self._answer.aclose()

    async def _pieces(self) -> AsyncIterator[bytes]:
        async for piece in self._answer.aiter_raw():
            yield piece


async def _received(request: Request) -> bytes | AsyncIterator[bytes] | None:
    """Return the body of `request` if it is short, what gives its pieces if not, None if there is none."""
    if "content-length" not in request.headers and "transfer-encoding" not in request.headers:
        return None
    pieces = request.stream()
    begun = bytearray()
    async for piece in pieces:
        begun += piece
        if len(begun) > MAX_BYTES_BEFORE_ASKING:
            return _joined(bytes(begun), pieces)
    return bytes(begun)


async def _joined(begun: bytes, rest: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    yield begun
    async for piece in rest:
        yield piece


def _require_plain(path: str) -> None:
    """Return if `path` means the same to everybody who reads it; raise `Problem` 400 if not.

    Clients and servers resolve dot segments, empty segments and backslashes differently, so a path with them
    could be one thing where it is checked and another where it arrives. A quoted slash stays in its segment.
    """
    segments = unquote(path).split("/")
    if "//" in f"/{path}" or "\\" in unquote(path) or not {".", ".."}.isdisjoint(segments):
        raise Problem(
            400,
            "Bad path",
            message(
                "page.bad_path",
                'the path has "." or "..", a backslash, or two slashes in a row; write it '
                "without them (percent-encode a slash within a name as %2F)",
            ),
        )


def _inward(request: Request) -> list[tuple[bytes, bytes]]:
    left_out = HOP_BY_HOP | ONLY_TO_US | _named_in(request.headers.get("connection", ""))
    return [
        (name, value)
        for name, value in request.headers.raw
        if (word := name.decode("latin-1").lower()) not in left_out and not word.startswith("sec-")
    ]


def _outward(answer: httpx.Response, service: str) -> dict[str, str]:
    left_out = HOP_BY_HOP | _OWN_POLICY | _named_in(answer.headers.get("connection", ""))
    headers = {name: value for name, value in answer.headers.items() if name.lower() not in left_out}
    location = headers.get("location", "")
    if location.startswith("/") and not location.startswith("//"):
        headers["location"] = f"/api/{service}{location}"
    return headers


def _named_in(connection: str) -> frozenset[str]:
    return frozenset(name.strip().lower() for name in connection.split(",") if name.strip())
