"""The owners of subscriptions and registrations: their present rights, and the record of what they are sent.

`delivery.disclosure` says when which of these is asked. Grants are known from the request of the owner, and
stay valid until a revocation names the owner; then, and after a start, `accounts` is asked. An owner that was
deleted has no rights. What was stored before owners were recorded, or without accounts, belongs to nobody:
with accounts it receives what everybody with `read` may see, and a line in the log names it once.
"""

import asyncio
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Final

from handover.errors import Problem, UsageError
from handover.security.audit_trail import DONE, AuditEntry, is_recorded
from handover.security.authentication import Guard, caller_from
from handover.security.caller import Caller, CallerKind
from handover.security.permissions import OWNER_GRANTS, Grant, Permission, Role
from handover.security.service_access import AccountsUnavailable
from handover.telemetry import get_logger
from handover_broker.access.access_record import AccessLog
from handover_broker.access.rights import Rights, resource_prefix
from handover_broker.delivery.disclosure import Unverified
from handover_broker.model.entity import Entity
from handover_broker.model.owner import Owner
from handover_broker.model.personal_data import has_type_of, person_of, type_in

log = get_logger(__name__)

MAX_KNOWN: Final = 10_000
VERIFIED_S: Final = 300.0
"""How long grants count without asking again: a token that ends by itself is revoked by nobody."""
_NOBODY: Final = Caller(CallerKind.LOCAL, "", "nobody", (Grant(Role.VIEWER),))


@dataclass(frozen=True, slots=True)
class OwnerRights:
    """Implements `Receiver` with the rights of an owner in one tenant."""

    rights: Rights

    def shows(self, entity: Entity) -> bool:
        return self.rights.shows(entity)

    def may_see(self, entity_id: str, *, is_private: bool) -> bool:
        return self.rights.may_see(entity_id, is_private=is_private)

    def may_see_private(self, *, somewhere: bool = False) -> bool:
        if somewhere:
            return self.rights.caller.may_somewhere(Permission.READ_HEALTH_DATA)
        return self.rights.may_everywhere(Permission.READ_HEALTH_DATA)

    def private_name(self, entity: Entity) -> str | None:
        if not self.rights.is_private(entity.id, entity.types):
            return None
        return self.rights.prefix + (person_of(entity) or entity.id)


class OwnerReceivers:
    """Implements `Receivers` with the rights that `accounts` knows."""

    def __init__(self, guard: Guard, health_types: frozenset[str], own_tenant: str) -> None:
        self._log: AccessLog | None = None
        self._guard = guard
        self._health_types = health_types
        self._own_tenant = own_tenant
        self._callers: dict[str, tuple[Caller, float]] = {}
        """By subject, with the time of their verification on the monotonic clock."""
        self._locks: dict[str, asyncio.Lock] = {}
        self._has_warned = False

    def record_in(self, access_log: AccessLog) -> None:
        """Record in `access_log` which private entities are sent to whom."""
        self._log = access_log

    def note(self, caller: Caller) -> None:
        """Remember the grants of a caller that changes a subscription or a registration."""
        if caller.kind in {CallerKind.SERVICE, CallerKind.LOCAL}:
            return
        if len(self._callers) >= MAX_KNOWN:
            self._callers.clear()
        # The end of one session does not end what the person has subscribed to.
        self._callers[caller.subject] = replace(caller, session=None, expires_s=None), time.monotonic()

    def passes_credentials_on(self) -> bool:
        return not self._guard.has_accounts()

    def known(self, owner: Owner | None, tenant: str) -> OwnerRights | None:
        if not self._is_restricted(owner):
            return None
        caller = self._anonymous(owner) or self._verified_caller(owner)
        if caller is None:
            assert owner is not None  # noqa: S101 - `_anonymous`
            caller = Caller(owner.kind, owner.subject, owner.name, OWNER_GRANTS)
        return self._receiver(caller, tenant)

    async def verified(self, owner: Owner | None, tenant: str) -> OwnerRights | None:
        if not self._is_restricted(owner):
            return None
        return self._receiver(self._anonymous(owner) or await self._verify(owner), tenant)

    def strict(self, owner: Owner | None, tenant: str) -> OwnerRights | None:
        if not self._is_restricted(owner):
            return None
        return self._receiver(self._anonymous(owner) or self._verified_caller(owner) or _NOBODY, tenant)

    async def prepare(self, owners: Iterable[Owner | None]) -> None:
        for owner in owners:
            if self._is_restricted(owner) and self._anonymous(owner) is None:
                try:
                    await self._verify(owner)
                except Unverified as error:
                    log.warning("the rights of an owner are not verified", reason=str(error))

    def is_private(self, entity_id: str, types: Iterable[str]) -> bool:
        return type_in(entity_id) in self._health_types or has_type_of(types, self._health_types)

    async def record(self, owner: Owner | None, action: str, address: str, resources: Iterable[str]) -> None:
        names = list(dict.fromkeys(resources))
        if owner is None or self._log is None or not names or not self._is_restricted(owner):
            return
        caller = Caller(owner.kind, owner.subject, owner.name)
        if not is_recorded(caller):
            return
        try:
            await self._log.record_sent(
                [
                    AuditEntry(caller, action[:64], name, DONE, address[:400], is_personal=True)
                    for name in names
                ]
            )
        except Problem as problem:
            raise Unverified(problem.detail) from None

    def _receiver(self, caller: Caller, tenant: str) -> OwnerRights:
        prefix = resource_prefix(tenant, self._own_tenant)
        return OwnerRights(Rights(caller, prefix, self._health_types))

    def _is_restricted(self, owner: Owner | None) -> bool:
        return (owner is None or not owner.is_service) and self._guard.has_accounts()

    def _anonymous(self, owner: Owner | None) -> Caller | None:
        """Return the caller that stands for no known owner."""
        if owner is not None and owner.kind is not CallerKind.LOCAL:
            return None
        if not self._has_warned:
            self._has_warned = True
            log.warning(
                "a subscription or registration has no owner, so it is sent no data about bodies of persons; "
                "change it with an account that may read them"
            )
        return _NOBODY

    def _verified_caller(self, owner: Owner | None) -> Caller | None:
        """Return the owner with its grants, None if a later revocation may have changed them."""
        caller, verified_s = (None, 0.0) if owner is None else self._callers.get(owner.subject, (None, 0.0))
        if caller is None or not self._guard.is_valid_owner(caller):
            return None
        return caller if time.monotonic() - verified_s < VERIFIED_S else None

    async def _verify(self, owner: Owner | None) -> Caller:
        assert owner is not None  # noqa: S101 - `_anonymous`
        async with self._locks.setdefault(owner.subject, asyncio.Lock()):
            caller = self._verified_caller(owner)
            if caller is not None and self._guard.has_all_revocations():
                return caller
            try:
                document = await self._guard.access.call(
                    "POST", "/subjects/lookups", {"subject": owner.subject}
                )
                caller = _caller_of(owner, document)
            except (AccountsUnavailable, UsageError, KeyError, TypeError, ValueError) as error:
                raise Unverified(f"the rights of {owner.name} cannot be verified: {error}") from None
            self.note(caller)
            return caller


def _caller_of(owner: Owner, document: Any) -> Caller:
    """Return the owner with the grants that `accounts` knows; without any if it does not exist any more."""
    if document["active"]:
        return caller_from(document)
    return Caller(owner.kind, owner.subject, owner.name, (), revision=int(document["revision"]))
