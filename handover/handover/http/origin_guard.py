"""The origin check: accepts or refuses requests by their headers `Host` and `Origin`.

A foreign web page must not use a server only because the browser can reach it:

- A request of HTTP/1.1 has exactly one `Host` (RFC 9112, 3.2), else it is refused (400).
- `Host`: a foreign name that resolves to this machine (DNS rebinding) is refused. Accepted are loopback
  names, numeric addresses, the host names in our own `HANDOVER_*_URL` settings, and `HANDOVER_ALLOWED_HOSTS`.
- `Origin`: the page must be the server's own (same host and port), or be listed in
`HANDOVER_ALLOWED_ORIGINS`. A
  request without `Origin` is accepted, since programs send none, unless `Sec-Fetch-Site` names another site;
  navigation by a link changes nothing and is accepted.

`serving.serve` wraps every application in `OriginGuard`. A protocol that answers without ASGI uses
`OriginPolicy`: `is_known` costs three dictionary look-ups and is sufficient for nearly all requests.
"""

import ipaddress
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, Self
from urllib.parse import urlsplit

import orjson
from prometheus_client import Counter
from starlette.types import ASGIApp, Receive, Scope, Send

from handover.errors import Problem
from handover.settings import Settings

OPEN_BY_ANY_NAME: Final = frozenset({"/healthz", "/readyz", "/metrics", "/context.jsonld"})
"""Paths that platforms and brokers read under any host name."""
MAX_REMEMBERED_HOSTS: Final = 1000

REFUSED = Counter("handover_http_requests_refused_total", "Requests refused for their headers", ["reason"])

_READS: Final = frozenset({"GET", "HEAD"})
_HOST: Final = re.compile(r"^(\[[0-9A-Fa-f:.]+\]|[^:\[\]/@\s]+)(?::(\d{1,5}))?$")
_DEFAULT_PORTS: Final = {"https": 443, "wss": 443}


class OriginPolicy:
    """Which hosts and origins are accepted; `hosts` are the names besides loopback and numeric addresses."""

    def __init__(self, hosts: Iterable[str] = (), origins: Iterable[str] = ()) -> None:
        self._hosts = frozenset(host.lower().rstrip(".") for host in hosts)
        self._origins = frozenset(origin.lower().rstrip("/") for origin in origins)
        self._known: set[bytes | None] = set()

    @classmethod
    def of(cls, settings: Settings, urls: Iterable[str] = ()) -> Self:
        """Return the policy of a server with `settings`, which is also reached at `urls`."""
        named = (urlsplit(url).hostname or "" for url in (*settings.own_urls(), *urls))
        return cls((*named, settings.host, *settings.allowed_hosts), settings.allowed_origins)

    def is_known(self, headers: Mapping[bytes, bytes]) -> bool:
        """Return whether a request has a known `Host` and is not from a browser, so it is accepted."""
        return (
            headers.get(b"host") in self._known
            and b"origin" not in headers
            and b"sec-fetch-site" not in headers
        )

    def refusal(
        self,
        method: str,
        path: str,
        headers: Mapping[bytes, bytes],
        *,
        scheme: str = "http",
        needs_host: bool = True,
    ) -> Problem | None:
        """Return why a request is refused; None if it is accepted. `headers` are by name in lower case."""
        host_header = headers.get(b"host")
        host = "" if host_header is None else host_header.decode("latin-1")
        if (host_header is None and needs_host) or "," in host:  # repeated headers are joined by commas
            REFUSED.labels("host").inc()
            return Problem(400, "Bad request", "a request of HTTP/1.1 needs one Host header; send one")
        if host_header is not None and host_header not in self._known:
            parts = host_and_port(host, scheme)
            if parts is not None and is_known_host(parts[0], self._hosts):
                if len(self._known) >= MAX_REMEMBERED_HOSTS:
                    self._known = set()
                self._known.add(host_header)
            elif method not in _READS or path not in OPEN_BY_ANY_NAME:
                REFUSED.labels("host").inc()
                return Problem(
                    403,
                    "Unknown host",
                    f'this server has no name "{host[:200]}"; use its address, or add the name '
                    "to HANDOVER_ALLOWED_HOSTS",
                )
        if self._is_accepted_page(method, host, headers):
            return None
        REFUSED.labels("origin").inc()
        page = headers.get(b"origin", b"another site").decode("latin-1")
        return Problem(
            403,
            "Foreign origin",
            f"a page of {page[:200]} may not use this server; use the page of the server, or add the origin "
            "to HANDOVER_ALLOWED_ORIGINS",
        )

    def _is_accepted_page(self, method: str, host: str, headers: Mapping[bytes, bytes]) -> bool:
        origin = headers.get(b"origin")
        if origin is not None:
            page = origin.decode("latin-1")
            return is_same_origin(page, host) or page.lower() in self._origins
        if headers.get(b"sec-fetch-site") not in {b"cross-site", b"same-site"}:
            return True
        return method in _READS and headers.get(b"sec-fetch-mode") == b"navigate"


class OriginGuard:
    """An ASGI application that passes requests to `app` if `policy` accepts them, else answers 403."""

    def __init__(self, app: ASGIApp, policy: OriginPolicy) -> None:
        self._app = app
        self._policy = policy

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        headers = _by_name(scope["headers"])
        refusal = None
        if not self._policy.is_known(headers):
            method = scope["method"] if scope["type"] == "http" else "CONNECT"
            refusal = self._policy.refusal(
                method,
                scope["path"],
                headers,
                scheme=scope["scheme"],
                needs_host=scope.get("http_version") != "1.0",
            )
        if refusal is None:
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            await send_problem(send, refusal)
        else:
            await receive()
            await send({"type": "websocket.close", "code": 4403, "reason": refusal.title})


async def send_problem(send: Send, problem: Problem) -> None:
    """Answer with `problem`, without a web framework."""
    body = orjson.dumps(problem.body())
    headers = [
        (b"content-type", b"application/problem+json"),
        (b"content-length", str(len(body)).encode()),
        (b"x-content-type-options", b"nosniff"),
    ]
    if (retry_after_s := (problem.extra or {}).get("retryAfterS")) is not None:
        headers.append((b"retry-after", str(retry_after_s).encode()))
    await send({"type": "http.response.start", "status": problem.status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


def host_and_port(host: str, scheme: str) -> tuple[str, int] | None:
    """Return host and port of a `Host` header (default port by the scheme); None if it is invalid."""
    met = _HOST.match(host)
    if met is None:
        return None
    port = int(met[2]) if met[2] else _DEFAULT_PORTS.get(scheme, 80)
    return met[1].lower().rstrip("."), port


def is_known_host(name: str, hosts: Iterable[str]) -> bool:
    """Return whether `name` is loopback, a numeric address, or one of `hosts`."""
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return name == "localhost" or name.endswith(".localhost") or name in hosts
    return True


def is_same_origin(origin: str, host: str) -> bool:
    """Return whether a page of `origin` comes from the server `host`.

    A proxy may add TLS, so the page's scheme gives the default port of both.
    """
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    if parts.scheme not in {"http", "https"}:
        return False
    theirs = host_and_port(parts.netloc, parts.scheme)
    return theirs is not None and theirs == host_and_port(host, parts.scheme)


def _by_name(headers: Sequence[tuple[bytes, bytes]]) -> dict[bytes, bytes]:
    by_name: dict[bytes, bytes] = {}
    for name, value in headers:
        by_name[name] = by_name[name] + b", " + value if name in by_name else value
    return by_name
