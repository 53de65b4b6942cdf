"""Callers: who sent a request, and with which grants."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from handover.errors import HandoverError
from handover.security.permissions import (
    OWNER_GRANTS,
    Grant,
    Permission,
    is_allowed,
    is_allowed_somewhere,
)
from handover.security.resource_patterns import ANY_RESOURCE


class InvalidToken(HandoverError):
    """A token that is damaged, expired, or not signed by a known key."""


class CallerKind(StrEnum):
    """What a caller is."""

    USER = "user"
    SERVICE = "service"
    SCRIPT = "script"
    DEVICE = "device"
    LOCAL = "local"
    """Somebody on the same machine, while no account exists."""


@dataclass(frozen=True, slots=True)
class Caller:
    """A caller that was authenticated, or is local.

    `subject` is the random id in audit records, `person` the id of the Person entity of a user, if any.
    `session` names the session or the stored token; a revocation may name it or the subject. `revision` is
    the position in the stream of revocations at which the grants were read; an older one than a revocation is
    invalid.
    """

    kind: CallerKind
    subject: str
    name: str
    grants: tuple[Grant, ...] = ()
    person: str | None = None
    session: str | None = None
    revision: int = 0
    expires_s: float | None = None
    """Unix time after which the caller has to authenticate again."""

    @property
    def own_name(self) -> str | None:
        """The name of a caller that has identified itself; None where the name of another one is given."""
        return None if self.kind in {CallerKind.LOCAL, CallerKind.SERVICE} else self.name

    def acting_name(self, client_name: str) -> str:
        """Return the name under which the caller acts.

        A person who is signed in acts under the own name, whatever name a client gives; `client_name`
        counts in local mode and for services, which act for others.
        """
        return client_name.strip() if self.own_name is None else self.own_name

    def may(self, permission: Permission, resource: str = ANY_RESOURCE) -> bool:
        """Return whether the caller has `permission` for `resource` (an entity id; `*`: for everything)."""
        return is_allowed(self.grants, permission, resource)

    def may_somewhere(self, permission: Permission) -> bool:
        """Return whether the caller has `permission` for at least one resource."""
        return is_allowed_somewhere(self.grants, permission)


LOCAL_OWNER: Final = Caller(CallerKind.LOCAL, "local", "local owner", OWNER_GRANTS)
