"""Identifiers: the badge number, QR code, PIN and gesture by which a person is recognized at a station.

They identify and do not authenticate: a badge can be lent, a gesture be seen. So they give no right of their
own. Each names one user. They are stored as HMACs with a key in a file of its own, since a PIN has too few
digits for a plain hash.
"""

import hashlib
import hmac
import re
import secrets
from enum import StrEnum
from pathlib import Path
from typing import Final

from sqlalchemy import Connection, delete, insert, select

from handover.errors import Problem
from handover.files.durable_files import replace_durably
from handover.security.secret_tokens import new_token
from handover_accounts.storage.changes import Change
from handover_accounts.storage.tables import identifiers

KEY_BYTES: Final = 32
_PIN: Final = re.compile(r"^\d{4,12}$", re.ASCII)
_NUMBER: Final = re.compile(r"^[A-Za-z0-9][A-Za-z0-9_.:-]{3,63}$")
EASY_PINS: Final = frozenset(["0123456789", "9876543210", "1212121212", "1122334455"])


class IdentifierKind(StrEnum):
    """How a person is recognized."""

    BADGE = "badge"
    QR = "qr"
    PIN = "pin"
    GESTURE = "gesture"


class IdentifierHashes:
    """The HMACs of identifiers; the key is made with the first one."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._key: bytes | None = None

    def of(self, kind: IdentifierKind, value: str) -> str:
        """Return what is stored of an identifier."""
        return hmac.new(self._read_key(), f"{kind}:{value}".encode(), hashlib.sha256).hexdigest()

    def _read_key(self) -> bytes:
        if self._key is None:
            try:
                self._key = self._file.read_bytes()
            except FileNotFoundError:
                self._key = secrets.token_bytes(KEY_BYTES)
                replace_durably(self._file, self._key, mode=0o600)
        return self._key


def checked_identifier(kind: IdentifierKind, value: str) -> str:
    """Return an identifier; raise `Problem` 422."""
    text = value.strip()
    if kind is IdentifierKind.PIN:
        if _PIN.match(text) is None:
            raise Problem(422, "Invalid PIN", "a PIN has 4 to 12 digits")
        if len(set(text)) == 1 or any(text in easy for easy in EASY_PINS):
            raise Problem(422, "Invalid PIN", "this PIN is too easy; use other digits")
    elif kind is IdentifierKind.GESTURE:
        if not 0 < len(text) <= 100:
            raise Problem(422, "Invalid gesture", "give the name of a gesture, as on the page of gestures")
    elif _NUMBER.match(text) is None:
        raise Problem(
            422, "Invalid number", "a badge number has 4 to 64 letters, digits or . : _ - without spaces"
        )
    return text


def new_qr_code() -> str:
    """Return the content of a new QR code."""
    return new_token("badge")


def set_identifier(
    change: Change, hashes: IdentifierHashes, subject: str, kind: IdentifierKind, value: str | None
) -> None:
    """Set the identifier of a kind of a user, or remove it. Raises `Problem` 409 if another user has it."""
    table = identifiers
    change.connection.execute(delete(table).where(table.c.subject == subject, table.c.kind == kind))
    if value is not None:
        stored = hashes.of(kind, value)
        same = select(table.c.subject).where(table.c.kind == kind, table.c.value_hash == stored)
        if change.connection.execute(same).scalar() is not None:
            raise Problem(409, "In use", f"another person has this {kind}; choose another")
        change.connection.execute(insert(table).values(kind=kind, value_hash=stored, subject=subject))
    change.record("identifier.removed" if value is None else "identifier.set", subject, text=str(kind))


def identified(connection: Connection, hashes: IdentifierHashes, kind: IdentifierKind, value: str) -> str:
    """Return the subject of the user who is recognized; raise `Problem` 404."""
    table = identifiers
    query = select(table.c.subject).where(
        table.c.kind == kind, table.c.value_hash == hashes.of(kind, value.strip())
    )
    subject = connection.execute(query).scalar()
    if subject is None:
        raise Problem(404, "Not recognized", f"nobody has this {kind}; try again, or ask an engineer")
    return str(subject)


def kinds_of(connection: Connection, subject: str) -> list[str]:
    """Return by what a user is recognized."""
    query = select(identifiers.c.kind).where(identifiers.c.subject == subject)
    return sorted(connection.execute(query).scalars())
