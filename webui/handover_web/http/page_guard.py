"""The guard of the page server: the session cookie of a browser becomes the access token of its user.

The page server keeps no sessions: it exchanges the cookie at `accounts` for an access token of a minute, uses
it for the browser's requests to services meanwhile, and forgets it when the session is revoked. A request
that changes something also needs the CSRF token of its session, in the header `X-CSRF-Token`: the cookie
alone, which a browser adds by itself, changes nothing.
"""

import asyncio
import hmac
import time
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from http.cookies import CookieError, SimpleCookie
from typing import Any, Final

from starlette.types import ASGIApp, Receive, Scope, Send

from handover.errors import Problem, UsageError
from handover.http.origin_guard import send_problem
from handover.messages import message
from handover.network.client_networks import network_of
from handover.runtime.clocks import Lifetime
from handover.security.authentication import Guard
from handover.security.caller import Caller, InvalidToken
from handover.security.secret_tokens import is_secret_token, token_hash
from handover.security.service_access import AccountsUnavailable
from handover.service_addresses import WEBUI
from handover_web.settings import WebuiSettings

CSRF_HEADER: Final = b"x-csrf-token"
RENEW_BEFORE_S: Final = 20.0
"""A token is renewed so long before it expires, so that it is valid when a service receives it."""
ACCOUNTS_TIMEOUT_S: Final = 20.0
"""A password may wait for others before it is checked."""
MAX_REMEMBERED: Final = 10_000
OPEN_PATHS: Final = frozenset(
    {"/api/session", "/api/session/link", "/api/session/link-use", "/api/session/request"}
)
"""Paths that a person who is not signed in may POST to; what they do depends on no cookie."""
_READS: Final = frozenset({"GET", "HEAD", "OPTIONS"})
_READING: Final = frozenset({"/session-tokens", "/links/preview"})
"""Requests to `accounts` with a body that change nothing, so that they may be repeated."""

Headers = Mapping[bytes, bytes]


@dataclass(frozen=True, slots=True)
class PageAccess:
    """What a session was exchanged for."""

    caller: Caller
    token: str
    csrf: str
    life: Lifetime
    """Until it is renewed."""
    is_station: bool = False
    network: str | None = None
    """The only network from which the session may be used."""

    def require_place(self, address: str | None) -> None:
        """Raise `Problem` 401 if the session may not be used from `address`."""
        if self.network is None or (address is not None and network_of(address) == self.network):
            return
        raise Problem(
            401,
            "Signed out",
            message("session.other_address", "this session was begun at another address; sign in again"),
        )


class PageGuard(Guard):
    """Authenticates browsers by their cookie, and programs by their token as every service does."""

    def __init__(self, settings: WebuiSettings) -> None:
        super().__init__(settings, WEBUI)
        self.cookie_name = f"handover_{settings.webui_port}"
        self._accesses: OrderedDict[str, PageAccess] = OrderedDict()
        self._exchanging: dict[str, asyncio.Task[PageAccess]] = {}

    async def authenticate(self, address: str | None, headers: Headers) -> Caller:
        """Return the caller of a request, by its token or by its cookie."""
        session = self.session_of(headers)
        if session is None or b"authorization" in headers or not self.has_accounts():
            return await super().authenticate(address, headers)
        access = await self.access_of(session)
        access.require_place(address)
        return access.caller

    def session_of(self, headers: Headers) -> str | None:
        """Return the session token in the cookie of a request, if it has one."""
        try:
            cookies = SimpleCookie(headers.get(b"cookie", b"").decode("latin-1"))
        except CookieError:
            return None
        for name in (f"__Host-{self.cookie_name}", self.cookie_name):
            if name in cookies and is_secret_token(cookies[name].value):
                return str(cookies[name].value)
        return None

    async def access_of(self, session: str) -> PageAccess:
        """Return the access of a session. Raises `Problem`: 401 if it has ended, 503 without `accounts`."""
        key = token_hash(session)
        access = self._accesses.get(key)
        if access is not None and not access.life.is_over() and self.is_valid(access.caller):
            return access
        if key not in self._exchanging:  # the requests of a page that loads share one exchange
            task = self._exchanging[key] = asyncio.create_task(self._exchange(key, session))
            task.add_done_callback(lambda _: self._exchanging.pop(key, None))
        return await asyncio.shield(self._exchanging[key])

    async def _exchange(self, key: str, session: str) -> PageAccess:
        self._accesses.pop(key, None)
        asked = Lifetime.begin(0)
        document = await self.ask_accounts("/session-tokens", {"session": session})
        keys = self._keys.keys()
        if keys is None:
            why = "there are no public keys; run `handover accounts set-up`"
            raise Problem(503, "Accounts unavailable", why)
        token = str(document["token"])
        try:
            caller = keys.verify(token)
        except InvalidToken as error:
            raise Problem(
                503, "Accounts unavailable", f"the answer of accounts is invalid: {error}"
            ) from None
        access = PageAccess(
            caller,
            token,
            str(document["csrf"]),
            replace(asked, life_s=float(document["expiresInS"]) - RENEW_BEFORE_S),
            document.get("isStation") is True,
            document.get("network"),
        )
        while len(self._accesses) >= MAX_REMEMBERED:
            self._accesses.popitem(last=False)
        self._accesses[key] = access
        return access

    async def ask_accounts(self, path: str, body: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Send a request of the page server to `accounts`, without a body a GET.

        Raises `Problem` as it answered; 503 if it did not act, 504 if a change may have been made.
        """
        method = "GET" if body is None else "POST"
        try:
            return await self.access.call(method, path, body, timeout_s=ACCOUNTS_TIMEOUT_S)
        except AccountsUnavailable as error:
            self._require_accounts()
            problem = error.problem or {}
            status = problem.get("status")
            if isinstance(status, int) and 400 <= status < 500:
                retry = {"retryAfterS": problem["retryAfterS"]} if "retryAfterS" in problem else None
                raise Problem(
                    status, str(problem.get("title", "")), str(problem.get("detail", "")), extra=retry
                ) from None
            if error.may_have_acted and method == "POST" and path not in _READING:
                raise Problem(
                    504,
                    "No answer of accounts",
                    message(
                        "session.no_answer",
                        "accounts may have done it, and its answer is missing ({reason}); see whether it is "
                        "done, by signing in, before you try again",
                        reason=str(error),
                    ),
                ) from None
            raise Problem(503, "Accounts unavailable", f"signing in is not possible now: {error}") from None
        except UsageError as error:
            self._require_accounts()
            raise Problem(503, "Accounts unavailable", str(error)) from None

    def _require_accounts(self) -> None:
        """Raise `Problem` 409 where there are no accounts: trying again would not help."""
        if not self.has_accounts():
            raise Problem(
                409,
                "No accounts",
                message(
                    "session.no_accounts",
                    "there are no accounts here, so nobody signs in; `handover secure` adds the first one",
                ),
            ) from None

    def forget(self, session: str) -> None:
        """Forget the access of a session that has ended."""
        self._accesses.pop(token_hash(session), None)

    async def service_headers(self, headers: Headers) -> dict[str, str]:
        """Return the headers that the request of a browser is given on its way to a service."""
        session = self.session_of(headers)
        if session is None or b"authorization" in headers or not self.has_accounts():
            return {}
        return {"Authorization": f"Bearer {(await self.access_of(session)).token}"}

    async def renewed(self, caller: Caller, address: str | None, headers: Headers) -> Caller:
        """Return the caller of an open page with its present grants.

        Raises `Problem` 401 when the session has ended, or its access has expired while accounts is down.
        """
        session = self.session_of(headers)
        if session is None or b"authorization" in headers or not self.has_accounts():
            return await super().renewed(caller, address, headers)
        try:
            access = await self.access_of(session)
            access.require_place(address)
        except Problem as problem:
            if problem.status == 401 or not self.is_valid(caller) or _is_expired(caller):
                raise Problem(401, "Signed out", "the session has ended; sign in again") from None
            return caller
        return access.caller

    async def require_csrf_token(self, method: str, path: str, headers: Headers) -> None:
        """Raise `Problem` 403 unless a request that changes something by a cookie has the CSRF token."""
        if method in _READS or (method == "POST" and path in OPEN_PATHS) or not self.has_accounts():
            return
        session = self.session_of(headers)
        if session is None or b"authorization" in headers:
            return
        token = headers.get(CSRF_HEADER, b"")
        if not hmac.compare_digest(token, (await self.access_of(session)).csrf.encode()):
            raise Problem(403, "No CSRF token", "reload the page and try again")


def _is_expired(caller: Caller) -> bool:
    return caller.expires_s is not None and caller.expires_s <= time.time()


class CsrfCheck:
    """ASGI middleware that refuses changes by a cookie alone."""

    def __init__(self, app: ASGIApp, guard: PageGuard) -> None:
        self._app = app
        self._guard = guard

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] == "http":
            try:
                await self._guard.require_csrf_token(scope["method"], scope["path"], dict(scope["headers"]))
            except Problem as problem:
                await send_problem(send, problem)
                return
        await self._app(scope, receive, send)
