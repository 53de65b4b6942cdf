"""Secret tokens of scripts, devices and services. Each is a subject of its own, with its own grants."""

import secrets
import time
from typing import Any, Final

from sqlalchemy import Connection, delete, func, insert, select

from handover.errors import Problem
from handover.security.caller import CallerKind
from handover.security.permissions import Grant, Role
from handover.security.secret_tokens import new_token, token_hash
from handover_accounts.storage.changes import Change, revision_of
from handover_accounts.storage.grants import add_grant, grants_of
from handover_accounts.storage.tables import grants, row_of_token, tokens

MAX_TOKENS: Final = 10_000


def issue(
    change: Change,
    kind: CallerKind,
    name: str,
    new_grants: tuple[Grant, ...],
    expires_s: float | None,
    *,
    subject: str | None = None,
) -> tuple[str, str]:
    """Issue a token; return its subject and the token, which is not stored. Raises `Problem` 409.

    `subject` is that of a revoked token which it replaces: its subscriptions, for example, remain its own.
    """
    connection = change.connection
    if connection.execute(select(func.count()).select_from(tokens)).scalar_one() >= MAX_TOKENS:
        raise Problem(409, "Too many tokens", f"{MAX_TOKENS} tokens are the maximum; revoke some")
    subject, token = subject or f"{kind}-{secrets.token_hex(12)}", new_token(kind)
    connection.execute(
        insert(tokens).values(
            subject=subject,
            kind=kind,
            name=name,
            token_hash=token_hash(token),
            created_s=time.time(),
            expires_s=expires_s,
        )
    )
    change.record("token.issued", subject, text=f"{kind} {name}")
    for grant in new_grants:
        add_grant(change, subject, grant)
    return subject, token


def replace_service_token(change: Change, service: str) -> str:
    """Issue the token of a service and revoke its previous ones; return the token."""
    previous = select(tokens.c.subject).where(tokens.c.kind == CallerKind.SERVICE, tokens.c.name == service)
    for subject in list(change.connection.execute(previous).scalars()):
        revoke_token(change, subject)
    _, token = issue(change, CallerKind.SERVICE, service, (), None)
    return token


def revoke_token(change: Change, subject: str) -> None:
    """Revoke a token. Raises `Problem` 404."""
    connection = change.connection
    if connection.execute(delete(tokens).where(tokens.c.subject == subject)).rowcount == 0:
        raise Problem(404, "Not found", f'there is no token "{subject[:64]}"')
    connection.execute(delete(grants).where(grants.c.subject == subject))
    change.revoke(subject)
    change.record("token.revoked", subject)


def find_token(connection: Connection, token: str) -> dict[str, Any] | None:
    """Return an active token; None if it is unknown or expired."""
    row = row_of_token(connection, tokens, token)
    if row is None or (row["expires_s"] is not None and row["expires_s"] <= time.time()):
        return None
    return dict(row)


def find_subject(connection: Connection, subject: str) -> dict[str, Any] | None:
    """Return the active token of a subject; None if it is unknown or expired."""
    row = connection.execute(select(tokens).where(tokens.c.subject == subject)).mappings().first()
    if row is None or (row["expires_s"] is not None and row["expires_s"] <= time.time()):
        return None
    return dict(row)


def introspected(connection: Connection, token: str) -> dict[str, Any]:
    """Return what `POST /introspection` answers."""
    revision = revision_of(connection)
    row = find_token(connection, token)
    if row is None:
        return {"active": False}
    is_service = row["kind"] == CallerKind.SERVICE
    token_grants = (Grant(Role.SERVICE),) if is_service else grants_of(connection, row["subject"])
    return {
        "active": True,
        "kind": row["kind"],
        "subject": row["subject"],
        "name": row["name"],
        "grants": [{"role": grant.role, "resource": grant.resource} for grant in token_grants],
        "person": None,
        "session": None,
        "revision": revision,
    }


def token_rows(connection: Connection) -> list[dict[str, Any]]:
    """Return all tokens, without what identifies them, the newest first."""
    return [
        dict(row) for row in connection.execute(select(tokens).order_by(tokens.c.created_s.desc())).mappings()
    ]
