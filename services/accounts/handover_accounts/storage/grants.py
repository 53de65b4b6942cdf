"""Grants of users and tokens: a role for the resources that a pattern includes."""

import secrets
import time
from typing import Any, Final

from sqlalchemy import Connection, bindparam, delete, func, insert, select

from handover.errors import Problem, UsageError
from handover.security.permissions import Grant, Role
from handover.security.resource_patterns import ANY_RESOURCE, require_pattern
from handover_accounts.storage.changes import Change
from handover_accounts.storage.tables import grants, users

MAX_GRANTS: Final = 100
"""Of one subject: all of them are in each access token."""
PEOPLE_ROLES: Final = tuple(role for role in Role if role is not Role.SERVICE)


_GRANTS_OF: Final = (
    select(grants.c.role, grants.c.resource)
    .where(grants.c.subject == bindparam("subject"))
    .order_by(grants.c.created_s, grants.c.id)
)


def checked_grant(role: str, resource: str) -> Grant:
    """Return a grant that people and tokens may have; raise `Problem` 422."""
    try:
        checked_role = Role(role)
    except ValueError:
        checked_role = Role.SERVICE
    if checked_role is Role.SERVICE:
        raise Problem(422, "No such role", f'"{role[:40]}" is no role; use one of {", ".join(PEOPLE_ROLES)}')
    try:
        return Grant(checked_role, require_pattern(resource))
    except UsageError as error:
        raise Problem(422, "Invalid resource", str(error)) from None


def grants_of(connection: Connection, subject: str) -> tuple[Grant, ...]:
    """Return the grants of a user or token."""
    rows = connection.execute(_GRANTS_OF, {"subject": subject})
    return tuple(Grant(Role(role), resource) for role, resource in rows)


def grant_rows(connection: Connection) -> dict[str, list[dict[str, Any]]]:
    """Return all grants by subject."""
    by_subject: dict[str, list[dict[str, Any]]] = {}
    for row in connection.execute(select(grants).order_by(grants.c.created_s, grants.c.id)).mappings():
        by_subject.setdefault(row["subject"], []).append(
            {"id": row["id"], "role": row["role"], "resource": row["resource"]}
        )
    return by_subject


def add_grant(change: Change, subject: str, grant: Grant) -> str:
    """Add a grant and return its id; an equal one is returned unchanged. Raises `Problem` 409."""
    connection = change.connection
    same = select(grants.c.id).where(
        grants.c.subject == subject, grants.c.role == grant.role, grants.c.resource == grant.resource
    )
    existing = connection.execute(same).scalar()
    if existing is not None:
        change.record("grant.kept", subject, text=_words(grant))
        return str(existing)
    count = connection.execute(
        select(func.count()).select_from(grants).where(grants.c.subject == subject)
    ).scalar_one()
    if count >= MAX_GRANTS:
        raise Problem(
            409, "Too many grants", f"{count} grants are the maximum; use a pattern such as urn:…:ur10-*"
        )
    grant_id = secrets.token_hex(8)
    connection.execute(
        insert(grants).values(
            id=grant_id, subject=subject, role=grant.role, resource=grant.resource, created_s=time.time()
        )
    )
    change.revoke(subject)
    change.record("grant.added", subject, text=_words(grant))
    return grant_id


def remove_grant(change: Change, grant_id: str) -> None:
    """Remove a grant. Raises `Problem` 404, and 409 for the last grant of the last admin."""
    connection = change.connection
    row = connection.execute(select(grants).where(grants.c.id == grant_id)).mappings().first()
    if row is None:
        raise Problem(404, "Not found", f'there is no grant "{grant_id[:40]}"')
    connection.execute(delete(grants).where(grants.c.id == grant_id))
    require_admin(connection)
    change.revoke(row["subject"])
    change.record("grant.removed", row["subject"], text=_words(Grant(Role(row["role"]), row["resource"])))


def require_admin(connection: Connection) -> None:
    """Raise `Problem` 409 if no user is an admin any more: nobody could grant anything then."""
    if not admin_names(connection):
        raise Problem(409, "Last admin", "the last admin cannot be removed; make another user an admin first")


def admin_names(connection: Connection) -> list[str]:
    """Return the names of the users who can grant every role, sorted."""
    query = (
        select(users.c.name)
        .select_from(grants.join(users, users.c.subject == grants.c.subject))
        .where(grants.c.role == Role.ADMIN, grants.c.resource == ANY_RESOURCE)
    )
    return list(connection.execute(query.distinct().order_by(users.c.name)).scalars())


def _words(grant: Grant) -> str:
    return f"{grant.role} for {grant.resource}"
