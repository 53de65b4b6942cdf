"""Connections: how long a server waits for a client, and how many connections it has.

uvicorn parses requests; this module adds limits, so that no client keeps a connection with an incomplete
request. `Connections` checks all connections of a server once a second, so requests need no timers:

- An unfinished request is ended (408) when its head takes longer than `http_header_timeout_s`, when no byte
  of its body comes for `http_body_timeout_s`, or when its body comes slower than `http_min_body_bytes_per_s`
  after that time. Time in which the service itself does not read does not count.
- An idle connection is closed after `KEEP_ALIVE_S`, one whose client does not read after
  `http_send_timeout_s`.
- An address has at most `http_max_unfinished_per_address` connections that have been unfinished for more than
  a second; the oldest are closed. Connections in use are not limited per address: on one machine all
  services, and behind a proxy all people, come from one address.
- A server has at most `http_max_connections`. The oldest unfinished ones give way to a newcomer, then those
  that have been idle for longest; if all are in use the newcomer is refused (503).

`HttpToolsProtocol` is no public API of uvicorn: pyproject.toml bounds its version, and a test names it.
"""

import asyncio
import math
import os
from collections import Counter as Tally
from collections.abc import Iterator
from ipaddress import ip_network
from typing import TYPE_CHECKING, Any, Final

import orjson
from prometheus_client import Counter, Gauge
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from handover.errors import Problem
from handover.outbound_policy import address_of
from handover.settings import Settings
from handover.telemetry import get_logger

if TYPE_CHECKING:
    from uvicorn.config import Config
    from uvicorn.server import ServerState

log = get_logger(__name__)

KEEP_ALIVE_S: Final = 75.0
"""Longer than clients keep idle connections (httpx: 5 s), so that they never write to one that is closing."""
LOOK_EVERY_S: Final = 1.0
YOUNG_S: Final = 1.0
"""A connection so young is not closed for its address's sake: many may be made at once, and soon send."""
RESERVED_FILES: Final = 128
"""Open files that a service needs for other things than connections."""
MAX_FILES: Final = 65_536

# What a connection does. Constants of the module: a member of an Enum costs ten times as much to read (3.11).
AWAITED: Final = "awaited"
"""Its first request has not begun."""
HEAD: Final = "head"
BODY: Final = "body"
IN_USE: Final = "in use"
IDLE: Final = "idle"
UNFINISHED: Final = frozenset({AWAITED, HEAD, BODY})

OPEN = Gauge("handover_http_connections", "Connections by what they do", ["state"])
CLOSED = Counter("handover_http_connections_closed_total", "Connections that the server ended", ["reason"])


class Connections:
    """The connections of one server, and their limits."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.max_open = max(16, min(settings.http_max_connections, raise_file_limit() - RESERVED_FILES))
        self._proxies = tuple(ip_network(one) for one in settings.trusted_proxies)
        self._open: set[Any] = set()
        self._looked_s = 0.0
        self._is_looking = False

    def opened(self, connection: "HttpProtocol", everything: set[Any]) -> bool:
        """Take note of a new connection; say whether it may stay. `everything` are those of the server."""
        self._open = everything
        if not self._is_looking:
            self._is_looking = True
            self._looked_s = connection.loop.time()
            connection.loop.call_later(LOOK_EVERY_S, self._look, connection.loop)
        if len(everything) <= self.max_open:
            return True
        return self._make_way(connection)

    def may_be_websocket(self) -> bool:
        """Say whether one more connection may become a WebSocket."""
        return len(self._open) - sum(1 for _ in self._http()) < self._settings.http_max_websockets

    def _http(self) -> Iterator["HttpProtocol"]:
        return (one for one in self._open if isinstance(one, HttpProtocol))

    def _make_way(self, newcomer: "HttpProtocol") -> bool:
        """Close a few connections at once, so that the next newcomers find it cheap."""
        others = [one for one in self._http() if one is not newcomer and not one.transport.is_closing()]
        others.sort(key=lambda one: one.since_s or math.inf)
        waiting = [one for one in others if one.phase in UNFINISHED]
        idle = [one for one in others if one.phase is IDLE]
        victims = (waiting + idle)[: max(1, self.max_open // 50)]
        for victim in victims:
            victim.end("too many")
        return bool(victims)

    def _look(self, loop: asyncio.AbstractEventLoop) -> None:
        now_s = loop.time()
        passed_s, self._looked_s = now_s - self._looked_s, now_s
        states: Tally[str] = Tally()
        unfinished: dict[str, list[HttpProtocol]] = {}
        for one in list(self._http()):
            if one.transport.is_closing():
                continue
            states[one.look(self._settings, now_s, passed_s)] += 1
            if one.phase in UNFINISHED and now_s - one.since_s > YOUNG_S:
                unfinished.setdefault(one.client[0] if one.client else "", []).append(one)
        states["websocket"] = len(self._open) - sum(1 for _ in self._http())
        for address, waiting in unfinished.items():
            if self._is_proxy(address):
                continue  # the connections of all its clients
            excess = len(waiting) - self._settings.http_max_unfinished_per_address
            if excess > 0:
                waiting.sort(key=lambda one: one.since_s)
                for one in waiting[:excess]:
                    one.end("too many unfinished")
        for state in ("unfinished", "idle", "in use", "websocket"):
            OPEN.labels(state).set(states[state])
        self._is_looking = bool(self._open)
        if self._is_looking:
            loop.call_later(LOOK_EVERY_S, self._look, loop)

    def _is_proxy(self, address: str) -> bool:
        ip = address_of(address) if self._proxies else None
        return ip is not None and any(ip in network for network in self._proxies)


class HttpProtocol(HttpToolsProtocol):
    """One connection, which `limits` looks at.

    A request that begins only sets `phase`, and `since_s` to 0; the next look replaces that by its own time.
    One that ends sets `since_s`: of the idle connections, the one that was used last is closed last.
    """

    # uvicorn's protocol has so many attributes that more would make all of them slower.
    __slots__ = (
        "_body_of", "_body_s", "_quiet_s", "_seen_bytes", "_stalled_s", "_unread_bytes",
        "body_bytes", "limits", "phase", "since_s",
    )  # fmt: skip

    def __init__(
        self,
        config: "Config",
        server_state: "ServerState",
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        connections: Connections,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self.limits = connections
        self.phase: str = AWAITED
        self.since_s = 0.0
        self.body_bytes = 0
        self._body_of: Any = None
        """The request whose body was looked at last; how long it took so far, and how long nothing came."""
        self._body_s = self._quiet_s = 0.0
        self._seen_bytes = 0
        self._unread_bytes = 0
        self._stalled_s = 0.0

    # Events of uvicorn's parser

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self.since_s = self.loop.time()
        if not self.limits.opened(self, self.connections):
            CLOSED.labels("refused").inc()
            self.refuse(Problem(503, "Too many connections", "all are in use; try again in a moment"))

    def on_message_begin(self) -> None:
        """Begin to read a request."""
        self.phase, self.since_s = HEAD, 0.0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Take a request whose head is there."""
        self.phase = BODY
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Take a piece of a body."""
        self.body_bytes += len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """Note that a request is there as a whole."""
        self.phase = IN_USE
        if not self._is_answering():  # the answer did not wait for the body
            self.phase, self.since_s = IDLE, self.loop.time()
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Go on to the next request, or wait for one."""
        self.server_state.total_requests += 1
        if self.transport.is_closing():
            return
        self.flow.resume_reading()
        if self.pipeline:
            self._start_asgi_task(*self.pipeline.pop())
        elif self.phase is IN_USE:
            self.phase, self.since_s = IDLE, self.loop.time()

    def handle_websocket_upgrade(self) -> None:
        """Hand the connection over, unless there are too many."""
        if self.limits.may_be_websocket():
            super().handle_websocket_upgrade()
        else:
            CLOSED.labels("too many websockets").inc()
            self.refuse(Problem(503, "Too many WebSockets", "close another page, and try again in a moment"))

    # What is looked at once a second

    def look(self, settings: Settings, now_s: float, passed_s: float) -> str:
        """End the connection if its time is over; return what it does."""
        self.since_s = self.since_s or now_s
        if self.flow.write_paused:
            self._look_at_sending(settings, passed_s)
            return "in use"
        self._stalled_s = 0.0
        waited_s = now_s - self.since_s
        if self.phase is IDLE:
            if waited_s > self.timeout_keep_alive:
                self.end("idle")
        elif self.phase is BODY:
            self._look_at_body(settings, passed_s)
        elif (
            self.phase is not IN_USE
            and waited_s > settings.http_header_timeout_s
            and not self._is_answering()
        ):
            self.end("header timeout")
        return "unfinished" if self.phase in UNFINISHED else self.phase

    def _look_at_body(self, settings: Settings, passed_s: float) -> None:
        if self._body_of is not self.cycle:
            self._body_of, self.body_bytes, self._seen_bytes = self.cycle, 0, 0
            self._body_s = self._quiet_s = 0.0
            return
        if self.flow.read_paused:  # it is the service that does not read
            self._quiet_s = 0.0
            return
        self._body_s += passed_s
        self._quiet_s = self._quiet_s + passed_s if self.body_bytes == self._seen_bytes else 0.0
        self._seen_bytes = self.body_bytes
        timeout_s = settings.http_body_timeout_s
        is_slow = self.body_bytes < (self._body_s - timeout_s) * settings.http_min_body_bytes_per_s
        if self._quiet_s > timeout_s or is_slow:
            self.end("body timeout")

    def _look_at_sending(self, settings: Settings, passed_s: float) -> None:
        unread = self.transport.get_write_buffer_size()
        self._stalled_s = self._stalled_s + passed_s if unread >= self._unread_bytes else 0.0
        self._unread_bytes = unread
        if self._stalled_s > settings.http_send_timeout_s:
            CLOSED.labels("send timeout").inc()
            self.transport.abort()

    def _is_answering(self) -> bool:
        """Say whether the answer to a request whose head is there has not been sent yet."""
        cycle: Any = self.cycle
        return cycle is not None and not cycle.response_complete

    def end(self, reason: str) -> None:
        """End the connection; a client that has sent a part of a request learns why."""
        CLOSED.labels(reason).inc()
        waits_for_us = self._is_answering() and not getattr(self.cycle, "response_started", False)
        if (self.phase is HEAD and not self._is_answering()) or (self.phase is BODY and waits_for_us):
            self.refuse(Problem(408, "Request timeout", f"the request did not come in time ({reason})"))
        else:
            self.transport.abort()

    def refuse(self, problem: Problem) -> None:
        """Answer with `problem`, and close the connection."""
        cycle: Any = self.cycle
        if cycle is not None:
            cycle.disconnected = True
        body = orjson.dumps(problem.body())
        self.transport.write(
            STATUS_LINE[problem.status] + b"content-type: application/problem+json\r\ncontent-length: "
            b"%d\r\nconnection: close\r\n\r\n%b" % (len(body), body)
        )
        self.transport.close()


def raise_file_limit() -> int:
    """Allow this process as many open files as the system lets it have; return how many."""
    if os.name != "posix":
        return MAX_FILES
    import resource  # noqa: PLC0415 - not on every system

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MAX_FILES if hard == resource.RLIM_INFINITY else min(hard, MAX_FILES)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        except (OSError, ValueError) as error:
            log.warning("the limit of open files cannot be raised", limit=soft, error=str(error))
            return soft
    return wanted
