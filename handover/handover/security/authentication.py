"""Authentication: the callers of a service, and whether they have a permission now.

A caller is one of these:

- with `Authorization: Bearer` and an access token: verified here, by the public keys of `accounts`;
- with `Authorization: Bearer` and a secret token (a script, a device): `accounts` is asked, and its answer is
  used for at most `INTROSPECTION_S`;
- without credentials: the local owner, if the request is local and no account exists (`local_mode`).
"""

import math
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Self

from handover.errors import Problem, UsageError
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.clocks import Lifetime
from handover.runtime.retry import Backoff
from handover.security.accounts_mark import AccountsMark
from handover.security.audit_trail import current_request
from handover.security.caller import LOCAL_OWNER, Caller, CallerKind, InvalidToken
from handover.security.keys_in_force import PUBLIC_KEYS_FILE, RELOAD_INTERVAL_S, KeysInForce
from handover.security.local_mode import is_local
from handover.security.permissions import READING, Grant, Permission, Role
from handover.security.protection import is_reachable_by_others
from handover.security.resource_patterns import ANY_RESOURCE
from handover.security.revocations import LONG_POLL_S, FollowedRevocations, RevocationState
from handover.security.secret_tokens import is_secret_token, token_hash
from handover.security.service_access import REQUEST_TIMEOUT_S, AccountsUnavailable, ServiceAccess
from handover.security.websocket_places import WebSocketPlaces
from handover.settings import Settings
from handover.telemetry import get_logger

if TYPE_CHECKING:
    from handover.security.access_tokens import PublicKeys

log = get_logger(__name__)

INTROSPECTION_S: Final = 30.0
MAX_REMEMBERED_TOKENS: Final = 10_000

Introspect = Callable[[str], Awaitable[Mapping[str, Any]]]
"""Returns what `accounts` knows of a secret token, as `POST /introspection` does."""


class Guard:
    """Authenticates the callers of `service`, an asynchronous context manager that follows the revocations.

    `revocations` and `introspect` are given by `accounts` only, which has both itself.
    """

    def __init__(
        self,
        settings: Settings,
        service: str,
        *,
        revocations: RevocationState | None = None,
        introspect: Introspect | None = None,
    ) -> None:
        self.settings = settings
        self._keys = KeysInForce(settings.security_folder, AccountsMark(settings, service))
        self.access = ServiceAccess(settings, service, keys=self._keys)
        self._followed = FollowedRevocations() if revocations is None else None
        self._revocations: RevocationState = revocations or self._followed  # type: ignore[assignment]
        self._introspect = introspect or self._ask_accounts
        self._remembered: OrderedDict[str, tuple[Caller, Lifetime]] = OrderedDict()
        self._tasks = BackgroundTasks(f"guard of {service}")
        self.places = WebSocketPlaces(settings)

    async def __aenter__(self) -> Self:
        self._keys.keys()
        await self._tasks.__aenter__()
        if self._followed is not None and not self.access.is_component():  # only services may read them
            self._tasks.start_restarting(self._follow, self._followed)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__(None, None, None)
        self.access.close()

    def has_accounts(self) -> bool:
        """Return whether accounts exist, so that everybody identifies."""
        return self._keys.keys() is not None

    async def authenticate(self, address: str | None, headers: Mapping[bytes, bytes]) -> Caller:
        """Return the caller of a request from `address`; `headers` are by name in lower case.

        Raises `Problem` 401 without valid credentials, 503 if they cannot be checked.
        """
        caller = self.authenticate_now(address, headers)
        return await self._introspected(_bearer(headers) or "") if caller is None else caller

    def authenticate_now(self, address: str | None, headers: Mapping[bytes, bytes]) -> Caller | None:
        """Return the caller as `authenticate` does; None if `accounts` has to be asked.

        Raises `Problem` 401 without valid credentials.
        """
        keys = self._keys.keys()
        if keys is None:
            return self._without_accounts(address, headers)
        token = _bearer(headers)
        if token is None:
            raise _unauthenticated(
                "this request has no credentials; sign in, or send a token (Authorization: Bearer)"
            )
        caller = self._remembered_caller(token)
        if caller is None:
            if is_secret_token(token):
                return None
            caller = self._verified(token, keys)
            self._remember(token, caller)
        return self._not_revoked(caller)

    def _not_revoked(self, caller: Caller) -> Caller:
        if self._revocations.is_revoked(caller):
            raise _unauthenticated("the session or token was revoked; sign in again")
        return caller

    def _without_accounts(self, address: str | None, headers: Mapping[bytes, bytes]) -> Caller:
        if is_reachable_by_others(self.settings, self.settings.host):
            # A component, which `require_protection` admits.
            raise _unauthenticated(
                "this component has no public keys of accounts, so it accepts no callers; copy "
                f"{PUBLIC_KEYS_FILE} of the cell to {self.settings.security_folder}, and start it again"
            )
        if is_local(address, headers):
            return LOCAL_OWNER
        raise _unauthenticated(
            "without accounts only requests of the same machine, to a loopback name and without a proxy, are "
            "accepted; run `handover secure` to set up accounts"
        )

    @staticmethod
    def _verified(token: str, keys: "PublicKeys") -> Caller:
        try:
            return keys.verify(token)
        except InvalidToken as error:
            raise _unauthenticated(str(error)) from None

    async def _introspected(self, token: str) -> Caller:
        try:
            document = await self._introspect(token)
        except (AccountsUnavailable, UsageError) as error:
            log.warning("a token cannot be checked", reason=str(error))
            raise Problem(503, "Accounts unavailable", "the token cannot be checked now; try again") from None
        if not document.get("active"):
            raise _unauthenticated("the token is unknown, expired or revoked")
        caller = replace(caller_from(document), expires_s=time.time() + INTROSPECTION_S)
        self._remember(token, caller)
        return self._not_revoked(caller)

    async def _ask_accounts(self, token: str) -> Mapping[str, Any]:
        return await self.access.call("POST", "/introspection", {"token": token})

    def _remembered_caller(self, token: str) -> Caller | None:
        key = token_hash(token)
        remembered = self._remembered.get(key)
        if remembered is None:
            return None
        caller, life = remembered
        # A secret token outlives the revocation of its grants: `accounts` is asked about it again.
        if life.is_over() or self._revocations.is_revoked(caller):
            del self._remembered[key]
            return None
        return caller

    def _remember(self, token: str, caller: Caller) -> None:
        if len(self._remembered) >= MAX_REMEMBERED_TOKENS:
            self._remembered.popitem(last=False)
        # By both clocks: one that is set back must not lengthen what was known of a token.
        left_s = math.inf if caller.expires_s is None else caller.expires_s - time.time()
        self._remembered[token_hash(token)] = caller, Lifetime.begin(left_s)

    async def renewed(self, caller: Caller, address: str | None, headers: Mapping[bytes, bytes]) -> Caller:
        """Return the caller of a connection that lasts longer than a token, with its present grants.

        Raises `Problem` 401 if the credentials with which it was opened are valid no more, 503 if they were
        revoked or changed and cannot be checked.
        """
        is_expired = caller.expires_s is not None and caller.expires_s <= time.time()
        if self.is_valid(caller) and not (is_expired and is_secret_token(_bearer(headers) or "")):
            return caller
        try:
            return await self.authenticate(address, headers)
        except Problem as problem:
            if problem.status == 503 and self.is_valid(caller):
                return caller
            raise

    def is_valid(self, caller: Caller) -> bool:
        """Return whether `caller` was not revoked, for connections that last longer than a token."""
        if caller.kind is CallerKind.LOCAL:
            return not self.has_accounts()
        return not self._revocations.is_revoked(caller)

    def is_valid_owner(self, caller: Caller) -> bool:
        """Return whether the grants of `caller`, who may be absent now, are those of no later revocation."""
        return not self._revocations.is_revoked(caller)

    def has_all_revocations(self) -> bool:
        """Return whether no revocation can have been missed."""
        return self._revocations.is_current()

    def require(self, caller: Caller, permission: Permission, resource: str = ANY_RESOURCE) -> None:
        """Raise `Problem` unless `caller` has `permission` for `resource` (an entity id; `*`: for
        everything).
        """
        act = current_request()
        if act is not None and act.caller is caller and act.permission is permission:
            act.resource = resource
        self.require_current(permission)
        if not caller.may(permission, resource):
            raise not_allowed(caller, permission, resource)

    def require_somewhere(self, caller: Caller, permission: Permission) -> None:
        """Raise `Problem` unless `caller` has `permission` for at least one resource."""
        self.require_current(permission)
        if not caller.may_somewhere(permission):
            raise not_allowed(caller, permission)

    def require_current(self, permission: Permission) -> None:
        """Raise `Problem` 503 if `permission` changes something and a revocation may have been missed."""
        if permission in READING or not self.has_accounts() or self._revocations.is_current():
            return
        raise Problem(
            503,
            "Rights cannot be verified",
            "accounts has not answered in the last 5 s, so nothing is moved or changed; try again, start "
            "accounts, or check HANDOVER_ACCOUNTS_URL",
        )

    async def _follow(self, revocations: FollowedRevocations) -> None:
        backoff = Backoff(max_s=RELOAD_INTERVAL_S)
        while True:
            if not self.has_accounts():
                await backoff.wait()
                continue
            wait_s = LONG_POLL_S if revocations.is_current() else 0.0
            path = f"/revocations?after={revocations.position}&waitS={wait_s}"
            try:
                revocations.apply(
                    await self.access.call("GET", path, timeout_s=LONG_POLL_S + REQUEST_TIMEOUT_S)
                )
                backoff.reset()
            except (AccountsUnavailable, UsageError, KeyError, TypeError, ValueError) as error:
                if backoff.failures == 0:
                    log.warning("the revocations cannot be read", reason=str(error))
                await backoff.wait()


def caller_from(document: Mapping[str, Any]) -> Caller:
    """Return the caller that `accounts` describes in an answer to an introspection."""
    return Caller(
        kind=CallerKind(document["kind"]),
        subject=str(document["subject"]),
        name=str(document["name"]),
        grants=tuple(Grant(Role(grant["role"]), str(grant["resource"])) for grant in document["grants"]),
        person=document.get("person"),
        session=document.get("session"),
        revision=int(document["revision"]),
    )


def _bearer(headers: Mapping[bytes, bytes]) -> str | None:
    header = headers.get(b"authorization", b"").decode("latin-1")
    scheme, _, token = header.partition(" ")
    return token.strip() if scheme.lower() == "bearer" and token.strip() else None


def _unauthenticated(why: str) -> Problem:
    return Problem(401, "Not signed in", why)


def not_allowed(caller: Caller, permission: Permission, resource: str = ANY_RESOURCE) -> Problem:
    """Return the problem of a caller without a permission: which one is missing, and which roles have it."""
    where = "" if resource == ANY_RESOURCE else f" for {resource}"
    roles = [role for role in Role if role is not Role.SERVICE and permission in role.permissions]
    way_out = f"an admin can grant the role {' or '.join(roles)}" if roles else "only services have it"
    return Problem(
        403,
        "Not allowed",
        f'"{caller.name}" has no permission "{permission}"{where}; {way_out}',
        extra={"permission": permission, "resource": resource, "roles": roles},
    )
