"""The gate: who may come in by the one door, and what a browser may do with what it gets.

A page of another site must not act here in a person's name: what changes something, and the WebSocket, must
come from our own page (`Origin` equals `Host`). A name that somebody else points at this machine is refused
(DNS rebinding): a browser comes by a numeric address, as localhost, or by a name that the settings know.
"""

import ipaddress
import re
from collections.abc import Iterable, Mapping
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from handover.errors import Problem
from handover.service import problem_response

READS = frozenset({"GET", "HEAD", "OPTIONS"})
OPEN_TO_MACHINES = ("/healthz", "/readyz", "/metrics", "/context.jsonld", "/notifications/")
"""What platforms and the broker ask, by whatever name they know us; nothing of it is for a browser."""

ANSWER_HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data: blob:; "
    "style-src 'self' 'unsafe-inline'; font-src 'self' data:; worker-src 'self' blob:; object-src 'none'; "
    "base-uri 'self'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}

_HOST = re.compile(r"^(\[[0-9A-Fa-f:.]+\]|[^:\[\]/@\s]+)(?::(\d{1,5}))?$")


def host_and_port(host: str, scheme: str) -> tuple[str, int] | None:
    """Return the two parts of a `Host` header, None if it is none; the port may follow from the scheme."""
    met = _HOST.match(host)
    if met is None:
        return None
    port = int(met[2]) if met[2] else {"https": 443, "wss": 443}.get(scheme, 80)
    return met[1].lower().rstrip("."), port


def is_known_host(name: str, known: Iterable[str]) -> bool:
    """Say whether a browser may come by the host `name`."""
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return name == "localhost" or name.endswith(".localhost") or name in known
    return True


def is_same_origin(origin: str, host: str) -> bool:
    """Say whether a page of `origin` is ours, which was asked for as `host`."""
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    if parts.scheme not in {"http", "https"}:
        return False
    theirs = host_and_port(parts.netloc, parts.scheme)
    return theirs is not None and theirs == host_and_port(host, parts.scheme)


class Gate:
    """Stands before the application; `known_hosts` are the names that are ours besides the numeric ones."""

    def __init__(self, app: ASGIApp, known_hosts: Iterable[str]) -> None:
        self._app = app
        self._known_hosts = frozenset(name.lower() for name in known_hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let in what may come in; answer 403 with the reason to what may not."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope)

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in ANSWER_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        if refusal is None:
            await self._app(scope, receive, with_headers if scope["type"] == "http" else send)
        elif scope["type"] == "http":
            await problem_response(refusal)(scope, receive, with_headers)
        else:
            await receive()
            await send({"type": "websocket.close", "code": 4403, "reason": refusal.title})

    def _refusal(self, scope: Scope) -> Problem | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if not scope["path"].startswith(OPEN_TO_MACHINES):
            parts = host_and_port(host, scope["scheme"])
            if parts is None or not is_known_host(parts[0], self._known_hosts):
                return Problem(
                    403,
                    "Unknown host",
                    f'this server does not go by the name "{host}"; open it by its address, or add the name '
                    "to HANDOVER_WEBUI_HOSTS",
                )
        if scope["type"] == "http" and scope["method"] in READS:
            return None
        origin = headers.get("origin")
        from_elsewhere = origin is not None and not is_same_origin(origin, host)
        if from_elsewhere or (
            origin is None and headers.get("sec-fetch-site") in {"cross-site", "same-site"}
        ):
            return Problem(
                403,
                "Another site",
                f"a page of {origin or 'another site'} may not act here; use the page that this server shows",
            )
        return None
