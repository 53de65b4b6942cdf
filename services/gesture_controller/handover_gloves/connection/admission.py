"""Admission: which gloves may connect, and their tokens.

A glove that has a token must send it. Any other glove must send the token of the site (HANDOVER_GLOVE_TOKEN)
if there is one: with accounts there always is (`handover.security.glove_token`). Without accounts and a site
token, no token is needed on loopback, and gloves are refused on any other address. New gloves that nobody
declared are admitted up to a limit, so that invented names cannot block gloves in use.

When accounts are set up, the connections of gloves that were admitted without a token have to end: the glove
server then requires the token of each open connection again.

A token is shown once, when it is made; the database has only its hash (`handover.security.secret_tokens`).
"""

import hmac

from sqlalchemy import Engine, delete, insert, select

from handover.security.keys_in_force import KeysInForce
from handover.security.secret_tokens import is_token
from handover_gloves import tables
from handover_gloves.gloves.connection_state import ConnectionRefused
from handover_gloves.recognition.frames import Hello
from handover_gloves.settings import ControllerSettings


class TokenStore:
    """Hashes of the tokens of gloves in the database; every method blocks on the database."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def load(self) -> dict[str, str]:
        """Return the hash of each glove's token."""
        with self._engine.connect() as connection:
            return {row.glove: row.sha256 for row in connection.execute(select(tables.tokens))}

    def save(self, glove: str, sha256: str | None) -> None:
        """Write the hash of the token of `glove`; None deletes it."""
        with self._engine.begin() as connection:
            connection.execute(delete(tables.tokens).where(tables.tokens.c.glove == glove))
            if sha256 is not None:
                connection.execute(insert(tables.tokens).values(glove=glove, sha256=sha256))


class Admission:
    """Decides which hello is accepted."""

    def __init__(self, settings: ControllerSettings, store: TokenStore) -> None:
        self._settings = settings
        self._keys = KeysInForce(settings.security_folder)
        self._is_exposed = not settings.is_local
        self._max_undeclared = settings.max_undeclared_gloves
        self._hashes = store.load()

    def has_accounts(self) -> bool:
        """Return True if accounts exist, so that every glove needs a token. Raises `UsageError`."""
        return self._keys.keys() is not None

    def has_token(self, glove: str) -> bool:
        """Return True if `glove` has its own token."""
        return glove in self._hashes

    def set_hash(self, glove: str, sha256: str | None) -> None:
        """Set the hash of the token of `glove`; None removes the token."""
        if sha256 is None:
            self._hashes.pop(glove, None)
        else:
            self._hashes[glove] = sha256

    def require_token(self, hello: Hello) -> None:
        """Raise `ConnectionRefused` unless `hello` has the required token; compares in constant time."""
        site = self._settings.token
        own, command = self._hashes.get(hello.glove), f"`handover glove token {hello.glove}`"
        if own is not None:
            if not is_token(hello.token, own):
                raise ConnectionRefused(
                    "wrong token",
                    f"the token is wrong; {hello.glove} has a token of its own, so give it that one, or make "
                    f"another with {command}",
                )
        elif site is not None:
            if not hmac.compare_digest(site.encode(), hello.token.encode()):
                raise ConnectionRefused(
                    "wrong token",
                    "the token is wrong; give the glove the HANDOVER_GLOVE_TOKEN of this site, or make one "
                    f"of its own with {command}",
                )
        elif self.has_accounts():
            raise ConnectionRefused(
                "no token",
                f"{hello.glove} has no token, and with accounts every glove has one; make one with {command} "
                "and give it to the glove as HANDOVER_GLOVE_TOKEN",
            )
        elif self._is_exposed:
            raise ConnectionRefused(
                "no token",
                f"{hello.glove} has no token, and others can reach this port; make one with {command} and "
                "give it to the glove as HANDOVER_GLOVE_TOKEN",
            )

    def require_slot(self, glove: str, undeclared: int) -> None:
        """Raise `ConnectionRefused` if `undeclared` gloves are the limit already."""
        if undeclared >= self._max_undeclared:
            raise ConnectionRefused(
                "too many undeclared",
                f"{undeclared} gloves that nobody declared are known already; make a token for this one with "
                f"`handover glove token {glove}`, or raise HANDOVER_MAX_UNDECLARED_GLOVES",
                retry=True,
            )
