"""Identities: which user a subject of the provider is, and sign-ins at the provider that are under way."""

import hmac
import secrets
import time
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, delete, func, insert, select

from handover.errors import Problem
from handover.security.permissions import Grant
from handover.security.secret_tokens import new_token, token_hash
from handover_accounts.openid_connect.provider import AuthorizationRequest
from handover_accounts.storage.changes import Change
from handover_accounts.storage.grants import add_grant, remove_grant
from handover_accounts.storage.tables import (
    grants,
    identities,
    provider_grants,
    provider_sessions,
    provider_sign_ins,
    users,
)

SIGN_IN_VALID_S: Final = 600.0
MAX_SIGN_INS: Final = 1000
"""Sign-ins that are under way; a further one ends the oldest."""


@dataclass(frozen=True, slots=True)
class BrowserAnswer:
    """What a browser brings back: the secret of its cookie, and the parameters of the provider."""

    secret: str
    state: str
    code: str
    iss: str | None


def begin(change: Change, redirect_uri: str) -> tuple[str, AuthorizationRequest]:
    """Note a sign-in that begins; return the secret of its browser, and what is sent to the provider."""
    table, now_s = provider_sign_ins, time.time()
    connection = change.connection
    connection.execute(delete(table).where(table.c.created_s <= now_s - SIGN_IN_VALID_S))
    oldest = select(table.c.secret_hash).order_by(table.c.created_s.desc()).offset(MAX_SIGN_INS - 1)
    for secret_hash in list(connection.execute(oldest).scalars()):
        connection.execute(delete(table).where(table.c.secret_hash == secret_hash))
    secret = new_token("signin")
    request = AuthorizationRequest(
        state=secrets.token_urlsafe(32),
        nonce=secrets.token_urlsafe(32),
        verifier=secrets.token_urlsafe(64),
        redirect_uri=redirect_uri,
    )
    connection.execute(
        insert(table).values(
            secret_hash=token_hash(secret),
            state=request.state,
            nonce=request.nonce,
            verifier=request.verifier,
            redirect_uri=redirect_uri,
            created_s=now_s,
        )
    )
    change.is_recorded = True  # nobody has identified yet
    return secret, request


def finish(change: Change, secret: str, state: str) -> AuthorizationRequest:
    """Return the request of a sign-in, which is used up. Raises `Problem` 403."""
    table = provider_sign_ins
    this = table.c.secret_hash == token_hash(secret)
    row = change.connection.execute(select(table).where(this)).mappings().first()
    change.connection.execute(delete(table).where(this))
    change.is_recorded = True
    if row is None or row["created_s"] <= time.time() - SIGN_IN_VALID_S:
        raise Problem(403, "Sign-in expired", "this sign-in was used, or took too long; sign in again")
    if not hmac.compare_digest(row["state"].encode(), state.encode()):
        raise Problem(403, "Wrong state", "the answer belongs to another sign-in; sign in again")
    return AuthorizationRequest(row["state"], row["nonce"], row["verifier"], row["redirect_uri"])


def user_of(connection: Connection, issuer: str, provider_subject: str) -> str | None:
    """Return the subject of the user who is a subject of the provider."""
    table = identities
    query = select(table.c.subject).where(
        table.c.issuer == issuer, table.c.provider_subject == provider_subject
    )
    subject = connection.execute(query).scalar()
    return None if subject is None else str(subject)


def set_identity(change: Change, subject: str, issuer: str, provider_subject: str | None) -> None:
    """Let a user sign in as a subject of the provider, and as no other. Raises `Problem` 409."""
    table = identities
    if provider_subject is not None:
        other = user_of(change.connection, issuer, provider_subject)
        if other not in {None, subject}:
            raise Problem(409, "Identity in use", "another user signs in with this identity of the provider")
    change.connection.execute(delete(table).where(table.c.subject == subject))
    if provider_subject is not None:
        change.connection.execute(
            insert(table).values(issuer=issuer, provider_subject=provider_subject, subject=subject)
        )
    change.record("identity.changed", subject, text=f"{issuer} {provider_subject or 'none'}"[:400])


def identity_of(connection: Connection, subject: str) -> dict[str, Any] | None:
    """Return the issuer and the subject there of a user, if there is one."""
    query = select(identities).where(identities.c.subject == subject)
    row = connection.execute(query).mappings().first()
    return None if row is None else dict(row)


def set_grants(change: Change, subject: str, new_grants: tuple[Grant, ...]) -> None:
    """Replace the grants that came from the provider; those that an admin gave remain.

    The last admin remains one: the grants of the provider cannot shut everybody out.
    """
    connection = change.connection
    ours = grants.join(provider_grants, provider_grants.c.grant_id == grants.c.id)
    query = select(grants.c.id, grants.c.role, grants.c.resource).select_from(ours)
    before = {
        (row.role, row.resource): row.id
        for row in connection.execute(query.where(grants.c.subject == subject))
    }
    wanted = {(grant.role.value, grant.resource): grant for grant in new_grants}
    for key, grant in wanted.items():
        if key in before:
            continue
        count = select(func.count()).select_from(grants)
        by_admin = count.where(
            grants.c.subject == subject, grants.c.role == grant.role, grants.c.resource == grant.resource
        )
        if not connection.execute(by_admin).scalar_one():
            grant_id = add_grant(change, subject, grant)
            connection.execute(insert(provider_grants).values(grant_id=grant_id))
    for key in before.keys() - wanted.keys():
        try:
            with connection.begin_nested():
                remove_grant(change, before[key])
                connection.execute(delete(provider_grants).where(provider_grants.c.grant_id == before[key]))
        except Problem:
            change.record("grant.kept", subject, text="the last admin remains one")


def keep_id_token(change: Change, session: str, id_token: str) -> None:
    """Store the ID token of a session, for signing out at the provider."""
    change.connection.execute(insert(provider_sessions).values(session=session, id_token=id_token))


def id_token_of(connection: Connection, session: str) -> str | None:
    """Return the ID token of a session that began at the provider."""
    table = provider_sessions
    id_token = connection.execute(select(table.c.id_token).where(table.c.session == session)).scalar()
    return None if id_token is None else str(id_token)


def is_name_free(connection: Connection, key: str) -> bool:
    """Return whether no user has a name."""
    query = select(func.count()).select_from(users).where(users.c.name_key == key)
    return not connection.execute(query).scalar_one()
