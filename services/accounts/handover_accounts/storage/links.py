"""One-time links: for the first owner, for people who are invited, and for a new password.

The secret stands in the fragment of the address, which browsers neither send nor log.
"""

import json
import secrets
import time
from typing import Any, Final

from sqlalchemy import Connection, delete, func, insert, or_, select

from handover.errors import Problem
from handover.security.permissions import OWNER_GRANTS, Grant, Role
from handover.security.secret_tokens import new_token, token_hash
from handover_accounts.storage.changes import Change
from handover_accounts.storage.grants import add_grant, checked_grant
from handover_accounts.storage.tables import audit, links, row_of_token
from handover_accounts.storage.users import add_user, find, set_password

LINK_ID: Final = "link-"
"""What the ids of links begin with."""
OWNER, INVITATION, PASSWORD = "owner", "invitation", "password"
MAX_LINKS: Final = 1000
OWNER_LINK_VALID_S: Final = 24 * 3600.0


def make_link(
    change: Change,
    purpose: str,
    *,
    valid_s: float,
    name: str | None = None,
    subject: str | None = None,
    grants: tuple[Grant, ...] = (),
) -> tuple[str, str, float]:
    """Make a link; return its id, its secret, which is not stored, and its expiry. Raises `Problem` 409."""
    connection = change.connection
    now_s = time.time()
    connection.execute(delete(links).where(links.c.expires_s <= now_s))
    if purpose == OWNER:
        connection.execute(delete(links).where(links.c.purpose == OWNER))
    if purpose == PASSWORD:
        find(connection, subject or "")
        connection.execute(delete(links).where(links.c.subject == subject))
    if connection.execute(select(func.count()).select_from(links)).scalar_one() >= MAX_LINKS:
        raise Problem(409, "Too many links", f"{MAX_LINKS} open links are the maximum; withdraw some")
    link_id, secret = f"{LINK_ID}{secrets.token_hex(8)}", new_token("link")
    expires_s = now_s + valid_s
    connection.execute(
        insert(links).values(
            id=link_id,
            token_hash=token_hash(secret),
            purpose=purpose,
            name=name,
            subject=subject,
            grants=json.dumps([[grant.role, grant.resource] for grant in grants]),
            created_s=now_s,
            expires_s=expires_s,
        )
    )
    change.record(f"link.{purpose}", subject or link_id, text=name)
    return link_id, secret, expires_s


def make_owner_link(change: Change) -> str:
    """Make the link of an owner, who gets every role; return its secret. An earlier one becomes invalid."""
    return make_link(change, OWNER, valid_s=OWNER_LINK_VALID_S, grants=OWNER_GRANTS)[1]


def find_link(connection: Connection, secret: str) -> dict[str, Any]:
    """Return an open link; raise `Problem` 404."""
    row = row_of_token(connection, links, secret)
    if row is None or row["expires_s"] <= time.time():
        raise Problem(
            404, "Invalid link", "the link was used already, has expired, or was replaced; ask for another"
        )
    return dict(row)


def use_link(change: Change, secret: str, name: str | None, password_hash: str) -> str:
    """Use a link: add a user with its grants, or set a new password; return the subject of the user."""
    connection = change.connection
    link = find_link(connection, secret)
    connection.execute(delete(links).where(links.c.id == link["id"]))
    if link["purpose"] == PASSWORD:
        subject = str(link["subject"])
        find(connection, subject)
        set_password(change, subject, password_hash, kept_session=None)
        return subject
    subject = add_user(change, name or link["name"] or "", password_hash)
    for role, resource in json.loads(link["grants"]):
        add_grant(change, subject, checked_grant(Role(role), resource))
    # The invitation may name the person: that text belongs to the user now, and is deleted with the user.
    connection.execute(delete(audit.texts).where(or_(audit.texts.c.about == link["id"])))
    change.record("link.used", subject)
    return subject


def link_rows(connection: Connection) -> list[dict[str, Any]]:
    """Return the open links, the newest first."""
    query = select(links).where(links.c.expires_s > time.time()).order_by(links.c.created_s.desc())
    return [dict(row) for row in connection.execute(query).mappings()]


def withdraw_link(change: Change, link_id: str) -> None:
    """Make an open link invalid. Raises `Problem` 404."""
    if change.connection.execute(delete(links).where(links.c.id == link_id)).rowcount == 0:
        raise Problem(404, "Not found", "there is no such open link; it may have been used")
    change.record("link.withdrawn", link_id)
