"""The doors: REST of the services, passed through as it is, so that the page needs one address only.

Bodies flow through both ways without being kept. A service that is away is said to be away, by name.
"""

import asyncio
import re
from collections.abc import AsyncIterator, Mapping
from typing import Final, Self
from urllib.parse import unquote

import httpx
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response, StreamingResponse

from handover.errors import Problem
from handover.telemetry import get_logger
from webui.metrics import AWAY

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
MOST_CONNECTIONS: Final = httpx.Limits(max_connections=64, max_keepalive_connections=16)
_OWN_POLICY: Final = frozenset({"server", "date"})
_RUNG_BY_THE_BROKER: Final = re.compile(r"^notifications(/|$)")


class Doors:
    """One client a service; an asynchronous context manager while the doors are open."""

    def __init__(self, urls: Mapping[str, str]) -> None:
        self._urls = urls
        self._clients: dict[str, httpx.AsyncClient] = {}

    async def __aenter__(self) -> Self:
        for service, url in self._urls.items():
            self._clients[service] = httpx.AsyncClient(
                base_url=url, timeout=PATIENCE, limits=MOST_CONNECTIONS, trust_env=False
            )
        return self

    async def __aexit__(self, *_: object) -> None:
        for client in self._clients.values():
            await client.aclose()

    async def pass_through(self, service: str, path: str, request: Request) -> Response:
        """Return what `service` answers to `request` at `path` (as it was sent, still quoted).

        Raises `Problem`: 404 for what is no door, 502 and 504 for a service that is away or too slow.
        """
        client = self._clients.get(service)
        if client is None:
            there_are = ", ".join(self._clients)
            raise Problem(404, "No such service", f'there is no service "{service}"; there are {there_are}')
        if _RUNG_BY_THE_BROKER.match(unquote(path)):
            raise Problem(404, "Not found", f"notifications reach {service} from the broker, not from here")
        answer = await self._ask(client, service, path, request)
        return StreamingResponse(
            self._body(answer, service),
            answer.status_code,
            _outward(answer, service),
        )

    async def _ask(
        self, client: httpx.AsyncClient, service: str, path: str, request: Request
    ) -> httpx.Response:
        has_body = "content-length" in request.headers or "transfer-encoding" in request.headers
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
            content=request.stream() if has_body else None,
            extensions={"timeout": PATIENCE.as_dict()},
        )
        try:
            return await client.send(asked, stream=True)
        except ClientDisconnect:
            raise Problem(499, "Gone", "the browser went away before it had sent everything") from None
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
            f"{service} {how} ({self._urls[service]}); see on the System page whether it runs, and try again",
            extra={"service": service},
        )

    async def _body(self, answer: httpx.Response, service: str) -> AsyncIterator[bytes]:
        try:
            async for chunk in answer.aiter_raw():
                yield chunk
        except httpx.HTTPError as error:
            log.warning("an answer broke off", service_asked=service, error=str(error))
            raise
        finally:
            await answer.aclose()


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
