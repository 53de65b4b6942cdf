"""The connections of a server: how many there are, which give way, and whose request starts next.

All are looked at once a second, so that requests need no timers. `protocol` has the limits of one connection.
"""

import asyncio
import math
import os
from collections import Counter as Tally
from collections.abc import Iterator
from heapq import heappop, heappush
from ipaddress import ip_network
from typing import Any, Final

from prometheus_client import Gauge

from handover.network.outbound_policy import address_of
from handover.settings import Settings
from handover.telemetry import get_logger

log = get_logger(__name__)

LOOK_EVERY_S: Final = 1.0
YOUNG_S: Final = 1.0
"""A connection so young is not closed for its address's sake: many may be made at once, and soon send."""
RESERVED_FILES: Final = 128
"""Open files that a service needs for other things than connections."""
MAX_FILES: Final = 65_536
MAX_STARTS_PER_TURN: Final = 4
"""A start costs about a millisecond."""
CREDIT: Final = 2
"""So many rounds a connection is ahead of those that always have a request waiting."""

# What a connection does. Constants of the module: a member of an Enum costs ten times as much to read (3.11).
AWAITED: Final = "awaited"
"""Its first request has not begun."""
HEAD: Final = "head"
BODY: Final = "body"
IN_USE: Final = "in use"
IDLE: Final = "idle"
REFUSED: Final = "refused"
"""It is only read until the client has the refusal."""
UPGRADED: Final = "upgraded"
UNFINISHED: Final = frozenset({AWAITED, HEAD, BODY, REFUSED})

OPEN = Gauge("handover_http_connections", "Connections by what they do", ["state"])


class LimitedConnection:
    """A connection with HTTP, as far as `Connections` needs it; one that became a WebSocket is none."""

    __slots__ = ("last_round",)

    loop: asyncio.AbstractEventLoop
    transport: asyncio.Transport
    client: tuple[str, int] | None
    phase: str
    since_s: float
    last_round: int

    def start(self, cycle: Any, app: Any) -> None:
        """Start a request."""
        raise NotImplementedError

    def look(self, settings: Settings, now_s: float, passed_s: float) -> str:
        """End the connection if its time is over; return what it does."""
        raise NotImplementedError

    def has_stalled(self) -> bool:
        """Say whether the client reads nothing of its response."""
        raise NotImplementedError

    def end(self, reason: str) -> None:
        """End the connection; a client that has sent a part of a request learns why."""
        raise NotImplementedError


class Connections:
    """The connections of one server, and their limits."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.max_open = max(16, min(settings.http_max_connections, raise_file_limit() - RESERVED_FILES))
        self._proxies = tuple(ip_network(proxy) for proxy in settings.trusted_proxies)
        self._open: set[Any] = set()
        self._looked_s = 0.0
        self._is_looking = False
        self._waiting: list[tuple[int, int, LimitedConnection, Any, Any]] = []
        """The requests that wait for their start: a heap by round, then by arrival."""
        self._round = 0
        self._arrivals = 0
        self._started = 0
        """Starts in this turn of the event loop."""

    def opened(self, connection: LimitedConnection, everything: set[Any]) -> bool:
        """Take note of a new connection; say whether it may stay. `everything` are those of the server."""
        self._open = everything
        if not self._is_looking:
            self._is_looking = True
            self._looked_s = connection.loop.time()
            connection.loop.call_later(LOOK_EVERY_S, self._look, connection.loop)
        if len(everything) <= self.max_open:
            return True
        return self._make_way(connection)

    def start(self, connection: LimitedConnection, cycle: Any, app: Any) -> None:
        """Start a request, at once if there are few, else in its turn (start-time fair queueing)."""
        if self._started == 0:
            connection.loop.call_soon(self._next_turn, connection.loop)
        turn = max(connection.last_round + 1, self._round - CREDIT)
        connection.last_round = turn
        if self._started < MAX_STARTS_PER_TURN and not self._waiting:
            self._started += 1
            self._round = max(self._round, turn)
            connection.start(cycle, app)
            return
        self._started = max(self._started, 1)
        self._arrivals += 1
        heappush(self._waiting, (turn, self._arrivals, connection, cycle, app))

    def _next_turn(self, loop: asyncio.AbstractEventLoop) -> None:
        self._started = 0
        while self._waiting and self._started < MAX_STARTS_PER_TURN:
            turn, _, connection, cycle, app = heappop(self._waiting)
            self._round = max(self._round, turn)
            if not connection.transport.is_closing():
                self._started += 1
                connection.start(cycle, app)
        if self._started:
            loop.call_soon(self._next_turn, loop)

    def may_be_websocket(self) -> bool:
        """Say whether one more connection may become a WebSocket."""
        return len(self._open) - sum(1 for _ in self._http()) < self._settings.http_max_websockets

    def _http(self) -> Iterator[LimitedConnection]:
        return (connection for connection in self._open if isinstance(connection, LimitedConnection))

    def _make_way(self, newcomer: LimitedConnection) -> bool:
        """Close a few connections at once, so that the next newcomers find it cheap."""
        others = [
            other for other in self._http() if other is not newcomer and not other.transport.is_closing()
        ]
        others.sort(key=lambda other: other.since_s or math.inf)
        waiting = [other for other in others if other.phase in UNFINISHED]
        idle = [other for other in others if other.phase is IDLE]
        stalled = [other for other in others if other.has_stalled()]
        victims = (waiting + idle + stalled)[: max(1, self.max_open // 50)]
        for victim in victims:
            victim.end("too many")
        return bool(victims)

    def _look(self, loop: asyncio.AbstractEventLoop) -> None:
        now_s = loop.time()
        passed_s, self._looked_s = now_s - self._looked_s, now_s
        states: Tally[str] = Tally()
        unfinished: dict[str, list[LimitedConnection]] = {}
        for connection in list(self._http()):
            if connection.transport.is_closing():
                continue
            states[connection.look(self._settings, now_s, passed_s)] += 1
            if connection.phase in UNFINISHED and now_s - connection.since_s > YOUNG_S:
                address = connection.client[0] if connection.client else ""
                unfinished.setdefault(address, []).append(connection)
        states["websocket"] = len(self._open) - sum(1 for _ in self._http())
        for address, waiting in unfinished.items():
            if self._is_proxy(address):
                continue  # the connections of all its clients
            excess = len(waiting) - self._settings.http_max_unfinished_per_address
            if excess > 0:
                waiting.sort(key=lambda connection: connection.since_s)
                for connection in waiting[:excess]:
                    connection.end("too many unfinished")
        for state in ("unfinished", "idle", "in use", "websocket"):
            OPEN.labels(state).set(states[state])
        self._is_looking = bool(self._open)
        if self._is_looking:
            loop.call_later(LOOK_EVERY_S, self._look, loop)

    def _is_proxy(self, address: str) -> bool:
        ip = address_of(address) if self._proxies else None
        return ip is not None and any(ip in network for network in self._proxies)


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
