"""Places for WebSockets: what one person opens keeps nobody else out, and control finds a place.

A server has `http_max_websockets`. A tenth of them, at most `MAX_RESERVED`, is kept for what moves or changes
something and for our own services; what only reads has the others. A session and a person have limits of
their own; the local owner has none, since without accounts everybody on the machine is the local owner.
"""

from collections import Counter as Tally
from typing import Final

from prometheus_client import Counter
from starlette.types import Scope

from handover.errors import Problem
from handover.security.caller import Caller, CallerKind
from handover.security.permissions import READING, Permission
from handover.settings import Settings

MAX_RESERVED: Final = 50
_PLACE: Final = "handover.place"

REFUSED: Final = Counter("handover_websockets_refused_total", "WebSockets refused for a limit", ["limit"])


class WebSocketPlaces:
    """The open WebSockets of one server by session, by person, and of those who only read."""

    def __init__(self, settings: Settings) -> None:
        most = settings.http_max_websockets
        self._max_reading = most - min(MAX_RESERVED, most // 10)
        self._max_of_session = settings.http_max_websockets_per_session
        self._max_of_person = settings.http_max_websockets_per_person
        self._open: Tally[str] = Tally()
        self._reading = 0

    def take(self, caller: Caller, permission: Permission, scope: Scope) -> None:
        """Take a place for the WebSocket of `scope`, unless it has one; raise `Problem` 429 or 503."""
        if _PLACE in scope:
            return
        reads = permission in READING and caller.kind is not CallerKind.SERVICE
        names: tuple[str, ...] = ()
        if caller.kind not in {CallerKind.SERVICE, CallerKind.LOCAL}:
            names = (f"session {caller.session}", f"person {caller.subject}")
            for name, limit in zip(names, (self._max_of_session, self._max_of_person), strict=True):
                if self._open[name] >= limit:
                    REFUSED.labels(name.partition(" ")[0]).inc()
                    raise Problem(
                        429,
                        "Too many WebSockets",
                        f"{caller.name} has {limit} open; close another page first",
                    )
        if reads and self._reading >= self._max_reading:
            REFUSED.labels("server").inc()
            raise Problem(503, "Too many WebSockets", "close another page, and try again in a moment")
        self._open.update(names)
        self._reading += reads
        scope[_PLACE] = names, reads

    def free(self, scope: Scope) -> None:
        """Free the place of a WebSocket that has ended, if it had one."""
        names, reads = scope.pop(_PLACE, ((), False))
        self._reading -= reads
        for name in names:
            self._open[name] -= 1
            if not self._open[name]:
                del self._open[name]
