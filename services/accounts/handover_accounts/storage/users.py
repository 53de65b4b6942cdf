"""Users: a random subject, a name, a password, perhaps a Person entity."""

import re
import secrets
import time
import unicodedata
from typing import Any, Final

from sqlalchemy import Connection, delete, func, insert, or_, select, update

from handover.errors import Problem
from handover_accounts.storage.changes import Change
from handover_accounts.storage.grants import require_admin
from handover_accounts.storage.sessions import delete_orphans
from handover_accounts.storage.tables import (
    audit,
    grants,
    identifiers,
    identities,
    joins,
    links,
    places,
    sessions,
    stations,
    users,
)

MAX_USERS: Final = 10_000
_NAME: Final = re.compile(r"^[^\W_](?:[\w .@+'-]*[\w.])?$")


def name_key(name: str) -> str:
    """Return what two spellings of a name have in common."""
    return unicodedata.normalize("NFKC", name).strip().casefold()


def checked_name(name: str) -> str:
    """Return a name for a new user; raise `Problem` 422."""
    text = unicodedata.normalize("NFKC", name).strip()
    if not 2 <= len(text) <= 64 or _NAME.match(text) is None:
        raise Problem(
            422,
            "Invalid name",
            "a name has 2 to 64 letters, digits, spaces or . @ + ' - _ and begins with a letter or digit",
        )
    return text


def find_by_name(connection: Connection, name: str) -> dict[str, Any] | None:
    """Return the user with that name, if there is one."""
    row = connection.execute(select(users).where(users.c.name_key == name_key(name))).mappings().first()
    return None if row is None else dict(row)


def find(connection: Connection, subject: str) -> dict[str, Any]:
    """Return a user; raise `Problem` 404."""
    row = connection.execute(select(users).where(users.c.subject == subject)).mappings().first()
    if row is None:
        raise Problem(404, "Not found", f'there is no user "{subject[:64]}"; they may have been deleted')
    return dict(row)


def add_user(change: Change, name: str, password_hash: str | None) -> str:
    """Add a user and return its subject; without a password the user signs in at the provider.

    Raises `Problem` 409 if the name is in use.
    """
    connection = change.connection
    if find_by_name(connection, name) is not None:
        raise Problem(409, "Name in use", f'the name "{name}" is in use; choose another')
    if connection.execute(select(func.count()).select_from(users)).scalar_one() >= MAX_USERS:
        raise Problem(409, "Too many users", f"{MAX_USERS} users are the maximum; delete some")
    subject = f"user-{secrets.token_hex(12)}"
    now_s = time.time()
    connection.execute(
        insert(users).values(
            subject=subject,
            name=name,
            name_key=name_key(name),
            password_hash=password_hash,
            created_s=now_s,
            password_changed_s=now_s,
        )
    )
    change.record("user.added", subject, text=name)
    return subject


def set_password(change: Change, subject: str, password_hash: str, *, kept_session: str | None) -> None:
    """Set a password and end all other sessions of the user."""
    connection = change.connection
    connection.execute(
        update(users)
        .where(users.c.subject == subject)
        .values(password_hash=password_hash, password_changed_s=time.time())
    )
    change.record("password.changed", subject)
    end_sessions_of(change, subject, kept_session=kept_session)


def set_person(change: Change, subject: str, person: str | None) -> None:
    """Set the Person entity of a user."""
    find(change.connection, subject)
    change.connection.execute(update(users).where(users.c.subject == subject).values(person=person))
    change.revoke(subject)
    change.record("user.changed", subject, text=f"person: {person or 'none'}")


def end_sessions_of(change: Change, subject: str, *, kept_session: str | None = None) -> int:
    """End the sessions of a user, except one; return how many ended."""
    connection = change.connection
    query = select(sessions.c.id).where(sessions.c.subject == subject)
    ended = [session for session in connection.execute(query).scalars() if session != kept_session]
    for session in ended:
        connection.execute(delete(sessions).where(sessions.c.id == session))
        change.revoke(session)
        change.record("session.ended", subject)
    return len(ended)


def renew_sessions_of(change: Change, subject: str) -> None:
    """Make the access tokens of the sessions of a user invalid; the sessions get new ones."""
    connection = change.connection
    for session in list(
        connection.execute(select(sessions.c.id).where(sessions.c.subject == subject)).scalars()
    ):
        change.revoke(session)


def delete_user(change: Change, subject: str) -> dict[str, Any]:
    """Delete a user with everything that names them; return what remains and why."""
    connection = change.connection
    row = find(connection, subject)
    end_sessions_of(change, subject)
    connection.execute(delete(joins).where(joins.c.station == subject))
    for station in list(
        connection.execute(select(joins.c.station).where(joins.c.subject == subject)).scalars()
    ):
        renew_sessions_of(change, station)
    for table in (grants, places, links, identities, identifiers, joins, stations):
        connection.execute(delete(table).where(table.c.subject == subject))
    delete_orphans(connection)
    connection.execute(delete(users).where(users.c.subject == subject))
    require_admin(connection)
    change.revoke(subject)
    change.record("user.deleted", subject)
    connection.execute(
        delete(audit.texts).where(or_(audit.texts.c.subject == subject, audit.texts.c.about == subject))
    )
    records = connection.execute(
        select(func.count())
        .select_from(audit.records)
        .where(or_(audit.records.c.subject == subject, audit.records.c.resource == subject))
    ).scalar_one()
    remains = [
        {
            "what": "auditRecords",
            "count": int(records),
            "why": "The audit logs prove that nothing was changed later. Their records name the random id "
            f"{subject}, without a name, until they expire; this is the number in accounts, and the other "
            "services have more. Human state keeps the name beside its records, for the persons whose "
            "health data this account has seen.",
        }
    ]
    if row["person"] is not None:
        remains.append(
            {
                "what": row["person"],
                "count": 1,
                "why": "The Person entity, with gestures and calibrations, belongs to the cell and not to "
                "the account. Delete it on the page of gestures.",
            }
        )
    return {"subject": subject, "remains": remains}
