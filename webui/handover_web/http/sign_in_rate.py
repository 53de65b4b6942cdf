"""The rate of attempts to sign in of one address, checked before anything else is done for a request.

`accounts` limits attempts by address and account, before a password is hashed. A flood of them would still
cost a request to `accounts` each, which other requests wait for. So this server refuses the excess itself,
without reading the body.

Many people may share an address, so an address has far more attempts than a person needs. While attempts come
as a flood, from many addresses perhaps, each address has few. An address from which nobody has tried to sign
in for a while always has some: a flood shuts nobody out.
"""

import math
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from handover.errors import Problem
from handover.http.origin_guard import send_problem
from handover.messages import message
from handover.network.client_networks import network_of
from handover_web.http.page_guard import OPEN_PATHS
from handover_web.metrics import REJECTED_REQUESTS


@dataclass(frozen=True, slots=True)
class Rate:
    """`burst` attempts, which come back at `per_s`."""

    per_s: float
    burst: float


USUAL: Final = Rate(5.0, 50.0)
"""Of an address."""
IN_A_FLOOD: Final = Rate(0.2, 3.0)
"""Of an address, while there are more attempts than `OF_ALL`."""
OF_ALL: Final = Rate(30.0, 300.0)
SIGN_IN_PATH: Final = "/api/session"
MAX_NETWORKS: Final = 50_000
"""Of more addresses, the ones that were quiet for longest are forgotten."""


@dataclass(slots=True)
class _Spent:
    """Attempts that have not come back yet."""

    attempts: float
    at_s: float

    def pass_time(self, now_s: float, per_s: float) -> None:
        self.attempts = max(self.attempts - (now_s - self.at_s) * per_s, 0.0)
        self.at_s = now_s


class SignInRate:
    """ASGI middleware that answers 429 to attempts to sign in beyond the rate of their address."""

    def __init__(self, app: ASGIApp, clock: Callable[[], float] = time.monotonic) -> None:
        self._app = app
        self._clock = clock
        self._all = _Spent(0.0, clock())
        self._networks: OrderedDict[str, _Spent] = OrderedDict()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] == "http" and scope["method"] == "POST" and scope["path"] in OPEN_PATHS:
            network = network_of(str(scope["client"][0]) if scope.get("client") else "")
            wait_s = self._attempt(network)
            if wait_s:
                REJECTED_REQUESTS.labels("sign-in").inc()
                await send_problem(send, _too_many(wait_s))
                return
            if scope["path"] == SIGN_IN_PATH:
                send = self._forgiving(network, send)
        await self._app(scope, receive, send)

    def _forgiving(self, network: str, send: Send) -> Send:
        """Return `send`, which forgets the attempts of a network when one has succeeded."""

        async def observed(sent: Message) -> None:
            if sent["type"] == "http.response.start" and sent["status"] < 300:
                self._networks.pop(network, None)
            await send(sent)

        return observed

    def _attempt(self, network: str) -> int:
        """Count an attempt; return 0 if it may be made, else the seconds to wait."""
        now_s = self._clock()
        self._all.pass_time(now_s, OF_ALL.per_s)
        self._all.attempts = min(self._all.attempts + 1.0, 2 * OF_ALL.burst)  # it ends soon after the flood
        rate = IN_A_FLOOD if self._all.attempts > OF_ALL.burst else USUAL
        spent = self._networks.setdefault(network, _Spent(0.0, now_s))
        self._networks.move_to_end(network)
        if len(self._networks) > MAX_NETWORKS:
            self._networks.popitem(last=False)
        spent.pass_time(now_s, rate.per_s)
        over = spent.attempts + 1.0 - rate.burst
        if over > 0:
            return math.ceil(over / rate.per_s)
        spent.attempts += 1.0
        return 0


def _too_many(wait_s: int) -> Problem:
    return Problem(
        429,
        "Too many attempts",
        message(
            "session.too_many_attempts",
            "too many attempts to sign in come from this address; try again in {seconds} s",
            seconds=wait_s,
        ),
        extra={"retryAfterS": wait_s},
    )
