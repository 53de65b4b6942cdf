"""Sessions: an opaque token of the browser, of which only the hash is stored, with place and device."""

import base64
import hashlib
import hmac
import secrets
import time
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, bindparam, delete, func, insert, select, update

from handover.errors import Problem
from handover.security.secret_tokens import is_secret_token, new_token, token_hash
from handover_accounts.storage.changes import Change
from handover_accounts.storage.tables import (
    grants,
    places,
    provider_grants,
    provider_sessions,
    row_of_token,
    sessions,
    state,
    stations,
    users,
)

MAX_SESSIONS: Final = 50
"""Of one user; a further sign-in ends the oldest."""
MAX_PLACES: Final = 50


_WITH_USER: Final = (
    select(
        sessions.c.id,
        sessions.c.subject,
        sessions.c.created_s,
        sessions.c.seen_s,
        sessions.c.address,
        users.c.name,
        users.c.person,
        stations.c.subject.label("station"),
        select(func.coalesce(func.max(state.c.revision), 0)).scalar_subquery().label("revision"),
    )
    .select_from(
        sessions.join(users, users.c.subject == sessions.c.subject).outerjoin(
            stations, stations.c.subject == sessions.c.subject
        )
    )
    .where(sessions.c.token_hash == bindparam("token_hash"))
)


@dataclass(frozen=True, slots=True)
class SessionLimits:
    """When sessions end: after `idle_s` without a request, and `max_s` after the sign-in."""

    idle_s: float
    max_s: float

    def ends_s(self, row: Any) -> float:
        """Return the Unix time at which a session ends, unless it is used before."""
        return float(min(row["seen_s"] + self.idle_s, row["created_s"] + self.max_s))


def csrf_token(session_token: str) -> str:
    """Return the CSRF token of a session; it is derived from the session token and does not reveal it."""
    digest = hmac.new(session_token.encode(), b"csrf", hashlib.sha256).digest()
    return base64.urlsafe_b64encode(digest).rstrip(b"=").decode()


def open_session(change: Change, subject: str, *, method: str, address: str, device: str) -> tuple[str, str]:
    """Open a session of a user; return its id and its token."""
    connection = change.connection
    now_s = time.time()
    oldest = connection.execute(
        select(sessions.c.id)
        .where(sessions.c.subject == subject)
        .order_by(sessions.c.seen_s.desc())
        .offset(MAX_SESSIONS - 1)
    ).scalars()
    for session in list(oldest):
        end_session(change, session)
    session_id, token = f"session-{secrets.token_hex(12)}", new_token("session")
    connection.execute(
        insert(sessions).values(
            id=session_id,
            token_hash=token_hash(token),
            subject=subject,
            method=method,
            address=address[:64],
            device=device[:300],
            created_s=now_s,
            seen_s=now_s,
        )
    )
    remember_place(connection, subject, address, now_s)
    change.record("session.opened", subject, text=f"{method} from {address[:64]}, {device[:300]}")
    return session_id, token


def remember_place(connection: Connection, subject: str, address: str, now_s: float) -> None:
    """Note that a user has signed in from an address; the oldest are forgotten."""
    here = (places.c.subject == subject) & (places.c.address == address[:64])
    if connection.execute(update(places).where(here).values(seen_s=now_s)).rowcount == 0:
        connection.execute(insert(places).values(subject=subject, address=address[:64], seen_s=now_s))
        addresses = select(places.c.address).where(places.c.subject == subject)
        for old in connection.execute(
            addresses.order_by(places.c.seen_s.desc()).offset(MAX_PLACES)
        ).scalars():
            connection.execute(delete(places).where(places.c.subject == subject, places.c.address == old))


def is_known_place(connection: Connection, subject: str, address: str) -> bool:
    """Return whether a user has signed in from an address before."""
    query = select(func.count()).select_from(places)
    here = query.where(places.c.subject == subject, places.c.address == address[:64])
    return bool(connection.execute(here).scalar_one())


def find_session(connection: Connection, token: str, limits: SessionLimits) -> dict[str, Any] | None:
    """Return the session of a token; None if it has ended."""
    row = row_of_token(connection, sessions, token)
    return None if row is None or limits.ends_s(row) <= time.time() else dict(row)


def require_session(connection: Connection, token: str, limits: SessionLimits) -> dict[str, Any]:
    """Return the session of a token; raise `Problem` 401 if it has ended."""
    session = find_session(connection, token, limits)
    if session is None:
        raise Problem(401, "Signed out", "the session has ended; sign in again")
    return session


def find_session_with_user(
    connection: Connection, token: str, limits: SessionLimits
) -> dict[str, Any] | None:
    """Return the session of a token, with `name` and `person` of its user; None if it has ended.

    `station` is None unless the user is a station, and `revision` the number of the last revocation. All is
    read by one statement, so the grants that are read afterwards are never older than the revision.
    """
    if not is_secret_token(token):
        return None
    row = connection.execute(_WITH_USER, {"token_hash": token_hash(token)}).mappings().first()
    return None if row is None or limits.ends_s(row) <= time.time() else dict(row)


def sessions_of(connection: Connection, subject: str, limits: SessionLimits) -> list[dict[str, Any]]:
    """Return the sessions of a user that have not ended, the latest used first."""
    query = select(sessions).where(sessions.c.subject == subject).order_by(sessions.c.seen_s.desc())
    now_s = time.time()
    return [dict(row) for row in connection.execute(query).mappings() if limits.ends_s(row) > now_s]


def end_session(change: Change, session_id: str, *, subject: str | None = None) -> None:
    """End a session (of `subject`). Raises `Problem` 404."""
    query = select(sessions.c.subject).where(sessions.c.id == session_id)
    owner = change.connection.execute(query).scalar()
    if owner is None or (subject is not None and owner != subject):
        raise Problem(404, "Not found", "there is no such session; it may have ended")
    change.connection.execute(delete(sessions).where(sessions.c.id == session_id))
    change.revoke(session_id)
    change.record("session.ended", owner)


def delete_ended(change: Change, limits: SessionLimits) -> int:
    """Delete the sessions that have ended by time; return how many."""
    now_s = time.time()
    ended = (sessions.c.seen_s <= now_s - limits.idle_s) | (sessions.c.created_s <= now_s - limits.max_s)
    rows = change.connection.execute(select(sessions.c.id, sessions.c.subject).where(ended)).all()
    change.connection.execute(delete(sessions).where(ended))
    for session, owner in rows:
        change.revoke(session)
        change.record("session.expired", owner)
    delete_orphans(change.connection)
    return len(rows)


def delete_orphans(connection: Connection) -> None:
    """Delete what belongs to sessions and grants that have ended."""
    open_sessions, present = select(sessions.c.id), select(grants.c.id)
    connection.execute(delete(provider_sessions).where(provider_sessions.c.session.not_in(open_sessions)))
    connection.execute(delete(provider_grants).where(provider_grants.c.grant_id.not_in(present)))
