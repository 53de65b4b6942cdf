"""A reverse proxy for the REST APIs of the services, so that the page needs one address only.

Bodies are streamed in both directions. A short request body is received before the service is contacted, so a
slow client occupies no connection to a service; the server's own timeouts end it. If a service cannot be
reached, the error names it.

Requests with a short body, nearly all, go through `StreamingHttpClient`, which costs a fraction of the
processor time of httpx. A short response that has arrived as a whole is sent at once. httpx sends long
bodies, and HEAD.
"""

import asyncio
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Self
from urllib.parse import unquote

import httpx
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from handover.errors import Problem
from handover.messages import Message, message
from handover.network.http_client import (
    RawHeader,
    ResponseTimeout,
    SendError,
    StreamedResponse,
    StreamingHttpClient,
    address,
)
from handover.network.tls_trust import client_context
from handover.telemetry import get_logger
from handover_web.http.request_limits import READS, UPLOADS, ActiveRequest, ActiveRequests
from handover_web.metrics import UPSTREAM_ERRORS

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
READ_TIMEOUT_S: Final = 60.0
TIMEOUT: Final = httpx.Timeout(30.0, connect=3.0, read=READ_TIMEOUT_S)
MAX_BUFFERED_BODY_BYTES: Final = 256 * 1024
CONNECTION_LIMITS: Final = httpx.Limits(
    max_connections=UPLOADS.per_service + READS.per_service, max_keepalive_connections=16
)
HeadersOf = Callable[[Request, bool], Awaitable[Mapping[str, str]]]
"""Returns headers that replace those of the browser: the credentials of its user, if need be new ones."""
OnWrite = Callable[[str, str, str], None]
"""Called after a successful write, with the method, the service and the path."""

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
        self._addresses = {service: address(url) for service, url in urls.items()}
        self._http = StreamingHttpClient(ca_files=ca_files)
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
        self._http.close()
        for client in self._clients.values():
            await client.aclose()

    def serves(self, service: str) -> bool:
        """Return whether there is a service of this name."""
        return service in self._urls

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
        credentials = {} if self._headers_of is None else await self._headers_of(request, False)
        content = await _read_body(request)
        limits = UPLOADS if isinstance(content, AsyncIterator) else READS
        active = self._active.admit(request.client.host if request.client else "", service, limits)
        try:
            if request.method == "HEAD" or isinstance(content, AsyncIterator):
                response: httpx.Response | StreamedResponse = await self._send_long(
                    client, service, path, request, content, credentials
                )
            else:
                response = await self._send(service, path, request, content or b"", credentials)
                if response.status == 401 and credentials and self._headers_of is not None:
                    # The service may know of new grants before this server: then the token is an old one.
                    # A request that is not authenticated has done nothing.
                    response.close()
                    credentials = await self._headers_of(request, True)
                    response = await self._send(service, path, request, content or b"", credentials)
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
        status = response.status_code if isinstance(response, httpx.Response) else response.status
        if request.method not in {"GET", "HEAD"} and 200 <= status < 300:
            self._on_write(request.method, service, unquote(path))
        if isinstance(response, httpx.Response):
            return _ProxiedResponse(
                _chunks_of(response),
                response.aclose,
                status,
                response.headers.raw,
                service,
                self._active,
                active,
            )
        headers, body = response.headers, response.whole()
        if body is None:
            return _ProxiedResponse(
                response.chunks(READ_TIMEOUT_S),
                _closing(response),
                status,
                headers,
                service,
                self._active,
                active,
            )
        response.close()
        self._active.release(active)
        return _raw_response(body, status, _response_headers(headers, service))

    async def _send(
        self,
        service: str,
        path: str,
        request: Request,
        content: bytes,
        credentials: Mapping[str, str],
    ) -> StreamedResponse:
        query = request.scope["query_string"]
        where = self._addresses[service]
        target = f"{where.target.rstrip('/')}/{path}{'?' + query.decode('latin-1') if query else ''}"
        headers = [
            (name.decode("latin-1"), value.decode("latin-1"))
            for name, value in _request_headers(request)
            if name.lower() != b"content-length"
        ]
        try:
            return await self._http.stream(
                request.method,
                replace(where, target=target),
                [*headers, *credentials.items()],
                content,
                READ_TIMEOUT_S,
            )
        except ResponseTimeout as error:
            raise self._timeout(service, error) from None
        except SendError as error:
            raise self._unavailable(service, error) from None

    async def _send_long(  # noqa: PLR0917 - internal
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
            raise self._timeout(service, error) from None
        except (httpx.HTTPError, asyncio.IncompleteReadError) as error:
            raise self._unavailable(service, error) from None

    def _timeout(self, service: str, error: Exception) -> Problem:
        detail = message(
            "page.service_timeout",
            "{service} did not respond in time ({url}); check its state on the page Services and try again",
            service=service,
            url=self._urls[service],
        )
        return _upstream_problem(service, 504, "Service timeout", detail, error)

    def _unavailable(self, service: str, error: Exception) -> Problem:
        detail = message(
            "page.service_unavailable",
            "{service} does not respond ({url}); check its state on the page Services and try again",
            service=service,
            url=self._urls[service],
        )
        return _upstream_problem(service, 502, "Service unavailable", detail, error)


class _ProxiedResponse(StreamingResponse):
    """The response of a service, streamed to the client."""

    def __init__(  # noqa: PLR0917 - internal
        self,
        chunks: AsyncIterator[bytes],
        close: Callable[[], Awaitable[None]],
        status: int,
        headers: Sequence[RawHeader],
        service: str,
        requests: ActiveRequests,
        active: ActiveRequest,
    ) -> None:
        super().__init__(chunks, status)
        self.raw_headers = _response_headers(headers, service)
        self._close, self._service = close, service
        self._active, self._request = requests, active

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response, and release it afterwards."""
        try:
            await super().__call__(scope, receive, send)
        except asyncio.CancelledError:
            if not self._request.is_evicted:
                raise
            log.warning("proxied response evicted", upstream=self._service)
        except (httpx.HTTPError, SendError) as error:  # the headers are sent already: close the connection
            log.warning("proxied response broken off", upstream=self._service, error=str(error))
        finally:
            self._active.release(self._request)
            await self._close()


async def _chunks_of(response: httpx.Response) -> AsyncIterator[bytes]:
    async for chunk in response.aiter_raw():
        yield chunk


def _closing(response: StreamedResponse) -> Callable[[], Awaitable[None]]:
    async def close() -> None:
        response.close()

    return close


def _raw_response(body: bytes, status: int, headers: list[RawHeader]) -> Response:
    """Return a response with a body that is encoded already, and exactly these headers."""
    response = Response(status_code=status)
    response.body = body
    if not any(name == b"content-length" for name, _ in headers) and status not in {204, 304}:
        headers.append((b"content-length", str(len(body)).encode()))
    response.raw_headers = headers
    return response


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


def _response_headers(headers: Sequence[RawHeader], service: str) -> list[RawHeader]:
    named = [(name.lower(), value) for name, value in headers]
    options = next((value for name, value in named if name == b"connection"), b"").decode("latin-1")
    dropped = HOP_BY_HOP_HEADERS | _OWN_HEADERS | _connection_options(options)
    kept = [(name, value) for name, value in named if name.decode("latin-1") not in dropped]
    return [
        (name, f"/api/{service}".encode() + value)
        if name == b"location" and value.startswith(b"/") and not value.startswith(b"//")
        else (name, value)
        for name, value in kept
    ]


def _connection_options(connection: str) -> frozenset[str]:
    return frozenset(name.strip().lower() for name in connection.split(",") if name.strip())
