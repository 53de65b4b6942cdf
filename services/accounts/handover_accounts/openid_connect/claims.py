"""Claims of a provider as the name and the grants of a user.

`HANDOVER_OIDC_ROLES` maps values of one claim to grants:

    handover-admins=admin, line-1=engineer@urn:ngsi-ld:Device:demo:ur10-*

The claim (`HANDOVER_OIDC_ROLES_CLAIM`) is a name, or a path through objects: `groups`, `realm_access.roles`.
Its value is a text, a list of texts, or a list of objects with a `name`, as in FIWARE Keyrock.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from handover.errors import Problem, UsageError
from handover.security.permissions import Grant
from handover.security.resource_patterns import ANY_RESOURCE
from handover_accounts.storage.grants import checked_grant
from handover_accounts.storage.users import checked_name

NAME_CLAIMS: Final = ("preferred_username", "username", "name", "email", "sub")
"""The claims for the name of a new user, in this order; `username` is that of Keyrock."""

Claims = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class RoleMapping:
    """The claim that has roles, and the grants for its values."""

    claim: str
    grants: Mapping[str, tuple[Grant, ...]]

    def grants_of(self, claims: Claims) -> tuple[Grant, ...]:
        """Return the grants of the values that the claim has; other values give none."""
        mapped = (grant for value in values_of(claims, self.claim) for grant in self.grants.get(value, ()))
        return tuple(dict.fromkeys(mapped))


def role_mapping(claim: str, entries: Sequence[str]) -> RoleMapping:
    """Return the mapping of the settings; raise `UsageError` for an entry that is none."""
    grants: dict[str, tuple[Grant, ...]] = {}
    for entry in entries:
        value, _, grant_text = entry.rpartition("=")
        role, _, resource = grant_text.partition("@")
        value = value.strip()
        if not value:
            raise _invalid(entry, "it has no value before the =")
        try:
            grant = checked_grant(role.strip(), resource.strip() or ANY_RESOURCE)
        except Problem as problem:
            raise _invalid(entry, problem.detail) from None
        grants[value] = (*grants.get(value, ()), grant)
    return RoleMapping(claim, grants)


def _invalid(entry: str, why: str) -> UsageError:
    return UsageError(
        f'HANDOVER_OIDC_ROLES: "{entry}": {why}; write value=role or value=role@resource, with commas between'
    )


def values_of(claims: Claims, claim: str) -> Iterator[str]:
    """Yield the values of a claim, by its name or by a path through objects."""
    part: Any = claims.get(claim)
    if part is None:
        part = claims
        for step in claim.split("."):
            part = part.get(step) if isinstance(part, Mapping) else None
    for value in part if isinstance(part, list) else [part]:
        named = value.get("name") if isinstance(value, Mapping) else value
        if isinstance(named, str):
            yield named


def name_of(claims: Claims) -> str:
    """Return a name for a new user; raise `Problem` 422 if no claim has a possible one."""
    for claim in NAME_CLAIMS:
        name = claims.get(claim)
        if isinstance(name, str):
            try:
                return checked_name(name)
            except Problem:
                continue
    names = ", ".join(NAME_CLAIMS)
    raise Problem(422, "No name", f"the provider gives no name for an account; it needs one of {names}")
