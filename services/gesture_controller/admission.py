"""Admission: which gloves may connect, and the tokens by which they are known.

A glove with a token of its own is admitted with that token only. Any other glove shows the site's token
(HANDOVER_GLOVE_TOKEN) where one is set. Where none is set, it needs none if only this machine reaches the
port, and is refused if others do. New gloves that nobody declared are admitted up to a limit, so that
invented names cannot take the place of gloves that are in use.

Tokens are 256 random bits; only their SHA-256 is kept, and each is shown once, when it is made.
"""

import hashlib
import hmac
import secrets

from sqlalchemy import Engine, delete, insert, select

from services.gesture_controller.frames import Hello
from services.gesture_controller.people import tables
from services.gesture_controller.settings import ControllerSettings

TOKEN_BYTES = 32


class NotAdmitted(ValueError):
    """A glove may not connect now; the message says what to do, `kind` is a few words to count by.

    `retry` says whether the same glove may be admitted later.
    """

    def __init__(self, kind: str, reason: str, *, retry: bool = False) -> None:
        super().__init__(reason)
        self.kind = kind
        self.retry = retry


class TokenStore:
    """Hashes of the tokens of gloves in the database; every method blocks for the disk."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def load(self) -> dict[str, str]:
        """Return the hash of each glove's token."""
        with self._engine.connect() as connection:
            return {row.glove: row.sha256 for row in connection.execute(select(tables.tokens))}

    def save(self, glove: str, sha256: str | None) -> None:
        """Write the hash of the token of `glove`, in place of an older one; None removes it."""
        with self._engine.begin() as connection:
            connection.execute(delete(tables.tokens).where(tables.tokens.c.glove == glove))
            if sha256 is not None:
                connection.execute(insert(tables.tokens).values(glove=glove, sha256=sha256))


class Admission:
    """Decides which hello is accepted."""

    def __init__(self, settings: ControllerSettings, store: TokenStore) -> None:
        self._site_token = settings.token
        self._reachable = not settings.is_local
        self._max_undeclared = settings.max_undeclared_gloves
        self._hashes = store.load()

    def has_token(self, glove: str) -> bool:
        """Say whether `glove` has a token of its own."""
        return glove in self._hashes

    def set_hash(self, glove: str, sha256: str | None) -> None:
        """Know `glove` by another token from now on; by none of its own if `sha256` is None."""
        if sha256 is None:
            self._hashes.pop(glove, None)
        else:
            self._hashes[glove] = sha256

    def require_token(self, hello: Hello) -> None:
        """Return if `hello` shows the token that it needs; raise `NotAdmitted` if not.

        Tokens are compared in a time that does not tell how nearly they are right.
        """
        own, command = self._hashes.get(hello.glove), f"`handover glove token {hello.glove}`"
        if own is not None:
            if not hmac.compare_digest(own, hash_of(hello.token)):
                raise NotAdmitted(
                    "wrong token",
                    f"the token is wrong; {hello.glove} has a token of its own, so give it that one, or make "
                    f"another with {command}",
                )
        elif self._site_token is not None:
            if not hmac.compare_digest(self._site_token.encode(), hello.token.encode()):
                raise NotAdmitted(
                    "wrong token",
                    "the token is wrong; give the glove the HANDOVER_GLOVE_TOKEN of this site, or make one "
                    f"of its own with {command}",
                )
        elif self._reachable:
            raise NotAdmitted(
                "no token",
                f"{hello.glove} has no token, and others can reach this port; make one with {command} and "
                "give it to the glove as HANDOVER_GLOVE_TOKEN",
            )

    def require_slot(self, glove: str, undeclared: int) -> None:
        """Return if another glove that nobody declared may connect, beside `undeclared`; or raise."""
        if undeclared >= self._max_undeclared:
            raise NotAdmitted(
                "too many undeclared",
                f"{undeclared} gloves that nobody declared are known already; make a token for this one with "
                f"`handover glove token {glove}`, or raise HANDOVER_MAX_UNDECLARED_GLOVES",
                retry=True,
            )


def new_token() -> str:
    """Return a token for a glove."""
    return secrets.token_urlsafe(TOKEN_BYTES)


def hash_of(token: str) -> str:
    """Return the hash by which `token` is known."""
    return hashlib.sha256(token.encode()).hexdigest()
