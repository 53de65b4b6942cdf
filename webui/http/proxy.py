"""A reverse proxy for the REST APIs of the services, so that the page needs one address only.

Bodies are streamed in both directions. A short request body is received before the service is contacted, so a
slow client occupies no connection to a service; the server's own timeouts end it. If a service cannot be
reached, the error names it.
"""

import asyncio
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, Self
from urllib.parse import unquote

import httpx
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from handover.errors import Problem
from handover.messages import Message, message
from handover.telemetry import get_logger
from handover.tls_trust import client_context
from webui.http.request_limits import READS, UPLOADS, ActiveRequest, ActiveRequests
from webui.metrics import UPSTREAM_ERRORS

log = get_logger(__name__)

METHODS: Final = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
HOP_BY_HOP_HEADERS: Final = frozenset(
    {
        "connection", "keep-alive", "proxy-authenticate", "proxy-authorization", "te", "trailer",
        "transfer-encoding", "upgrade", "proxy-connection",
    }
)  # fmt: skip
BROWSER_HEADERS: Final = frozenset({"host", "origin", "referer", "cookie", "expect"})
"""Headers that the browser sends to this server and that services must not receive."""
TIMEOUT: Final = httpx.Timeout(30.0, connect=3.0, read=60.0)
MAX_BUFFERED_BODY_BYTES: Final = 256 * 1024
CONNECTION_LIMITS: Final = httpx.Limits(
    max_connections=UPLOADS.per_service + READS.per_service, max_keepalive_connections=16
)
HeadersOf = Callable[[Request], Awaitable[Mapping[str, str]]]
"""Returns headers that replace those of the browser: the credentials of its user."""
OnWrite = Callable[[str, str], None]
"""Called after a successful write, with the service and the path."""

_OWN_HEADERS: Final = frozenset({"server", "date"})
_NOTIFICATION_PATH: Final = re.compile(r"^notifications(/|$)")


class ServiceProxy:
    """One HTTP client per service; an asynchronous context manager."""

    def __init__(
        self,
        urls: Mapping[str, str],
        on_write: OnWrite = lambda *_: None,
        ca_files: Sequence[Path] = (),
        headers_of: HeadersOf | None = None,
    ) -> None:
        self._urls = urls
        self._headers_of = headers_of
        self._on_write = on_write
        self._ca_files = ca_files
        self._clients: dict[str, httpx.AsyncClient] = {}
        self._active = ActiveRequests()

    async def __aenter__(self) -> Self:
        for service, url in self._urls.items():
            self._clients[service] = httpx.AsyncClient(
                base_url=url,
                timeout=TIMEOUT,
                limits=CONNECTION_LIMITS,
                trust_env=False,
                verify=client_context(*self._ca_files),
            )
        return self

    async def __aexit__(self, *_: object) -> None:
        for client in self._clients.values():
            await client.aclose()

    async def forward(self, service: str, path: str, request: Request) -> Response:
        """Forward `request` to `service` at `path` (percent-encoded, as received) and return the response.

        Raises `Problem`: 404 for an unknown service, 429 and 503 for too many concurrent requests, 502 and
        504 for a service that is unreachable or too slow.
        """
        client = self._clients.get(service)
        if client is None:
            services = ", ".join(self._clients)
            raise Problem(
                404,
                "No such service",
                message(
                    "page.no_such_service",
                    'there is no service "{service}"; the services are {services}',
                    service=service,
                    services=services,
                ),
            )
        _check_path(path)
        if _NOTIFICATION_PATH.match(unquote(path)):
            raise Problem(
                404,
                "Not found",
                message(
                    "page.notifications_not_here",
                    "{service} accepts notifications from the broker only, not through this server",
                    service=service,
                ),
            )
        credentials = {} if self._headers_of is None else await self._headers_of(request)
        content = await _read_body(request)
        limits = UPLOADS if isinstance(content, AsyncIterator) else READS
        active = self._active.admit(request.client.host if request.client else "", service, limits)
        try:
            response = await self._send(client, service, path, request, content, credentials)
        except asyncio.CancelledError:
            self._active.release(active)
            if not active.is_evicted:
                raise
            raise Problem(
                408, "Request timeout", "the request was ended to admit newer ones; send it again"
            ) from None
        except BaseException:
            self._active.release(active)
            raise
        if request.method not in {"GET", "HEAD"} and response.is_success:
            self._on_write(service, unquote(path))
        return _ProxiedResponse(response, service, self._active, active)

    async def _send(  # noqa: PLR0917 - internal
        self,
        client: httpx.AsyncClient,
        service: str,
        path: str,
        request: Request,
        content: bytes | AsyncIterator[bytes] | None,
        credentials: Mapping[str, str],
    ) -> httpx.Response:
        url = client.base_url.copy_with(
            raw_path=client.base_url.raw_path.rstrip(b"/")
            + b"/"
            + path.encode("ascii")
            + (b"?" + request.scope["query_string"] if request.scope["query_string"] else b"")
        )
        upstream_request = httpx.Request(
            request.method,
            url,
            headers=[*_request_headers(request), *_raw(credentials)],
            content=content,
            extensions={"timeout": TIMEOUT.as_dict()},
        )
        try:
            return await client.send(upstream_request, stream=True)
        except httpx.TimeoutException as error:
            detail = message(
                "page.service_timeout",
                "{service} did not respond in time ({url}); check its state on the System page and try again",
                service=service,
                url=self._urls[service],
            )
            raise _upstream_problem(service, 504, "Service timeout", detail, error) from None
        except (httpx.HTTPError, asyncio.IncompleteReadError) as error:
            detail = message(
                "page.service_unavailable",
                "{service} does not respond ({url}); check its state on the System page and try again",
                service=service,
                url=self._urls[service],
            )
            raise _upstream_problem(service, 502, "Service unavailable", detail, error) from None


class _ProxiedResponse(StreamingResponse):
    """The response of a service, streamed to the client."""

    def __init__(
        self, response: httpx.Response, service: str, requests: ActiveRequests, active: ActiveRequest
    ) -> None:
        super().__init__(self._chunks(), response.status_code, _response_headers(response, service))
        self._response, self._service = response, service
        self._active, self._request = requests, active

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response, and release it afterwards."""
        try:
            await super().__call__(scope, receive, send)
        except asyncio.CancelledError:
            if not self._request.is_evicted:
                raise
            log.warning("proxied response evicted", upstream=self._service)
        except httpx.HTTPError as error:  # the headers are sent already: close the connection
            log.warning("proxied response broken off", upstream=self._service, error=str(error))
        finally:
            self._active.release(self._request)
            await self._response.aclose()

    async def _chunks(self) -> AsyncIterator[bytes]:
        async for chunk in self._response.aiter_raw():
            yield chunk


def _upstream_problem(service: str, status: int, title: str, detail: Message, error: Exception) -> Problem:
    UPSTREAM_ERRORS.labels(service).inc()
    log.warning("service unavailable", upstream=service, error=str(error) or type(error).__name__)
    return Problem(status, title, detail, extra={"service": service})


async def _read_body(request: Request) -> bytes | AsyncIterator[bytes] | None:
    """Return a short body as bytes, a long one as an iterator of chunks, None without a body."""
    if "content-length" not in request.headers and "transfer-encoding" not in request.headers:
        return None
    chunks = request.stream()
    head = bytearray()
    async for chunk in chunks:
        head += chunk
        if len(head) > MAX_BUFFERED_BODY_BYTES:
            return _chained(bytes(head), chunks)
    return bytes(head)


async def _chained(head: bytes, rest: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    yield head
    async for chunk in rest:
        yield chunk


def _check_path(path: str) -> None:
    """Raise `Problem` 400 if `path` is ambiguous.

    Clients and servers resolve dot segments, empty segments and backslashes differently, so the service could
    read another path than the one checked here. A percent-encoded slash stays within its segment.
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


def _raw(headers: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.encode("ascii"), value.encode("ascii")) for name, value in headers.items()]


def _request_headers(request: Request) -> list[tuple[bytes, bytes]]:
    dropped = (
        HOP_BY_HOP_HEADERS | BROWSER_HEADERS | _connection_options(request.headers.get("connection", ""))
    )
    return [
        (name, value)
        for name, value in request.headers.raw
        if (word := name.decode("latin-1").lower()) not in dropped and not word.startswith("sec-")
    ]


def _response_headers(response: httpx.Response, service: str) -> dict[str, str]:
    dropped = HOP_BY_HOP_HEADERS | _OWN_HEADERS | _connection_options(response.headers.get("connection", ""))
    headers = {name: value for name, value in response.headers.items() if name.lower() not in dropped}
    location = headers.get("location", "")
    if location.startswith("/") and not location.startswith("//"):
        headers["location"] = f"/api/{service}{location}"
    return headers


def _connection_options(connection: str) -> frozenset[str]:
    return frozenset(name.strip().lower() for name in connection.split(",") if name.strip())
