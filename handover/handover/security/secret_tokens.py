"""Secret tokens: opaque 256-bit tokens of sessions, devices, scripts and services.

Only the hash of a token is stored. A fast hash is sufficient, since a token cannot be guessed as a password
can.
"""

import hashlib
import hmac
import re
import secrets
from typing import Final

TOKEN_BYTES: Final = 32
_TOKEN: Final = re.compile(r"^hnd_[a-z]{2,12}_[A-Za-z0-9_-]{43}$")


def new_token(kind: str) -> str:
    """Return a new token `hnd_<kind>_<43 characters>`; scanners of leaked secrets recognize the prefix."""
    return f"hnd_{kind}_{secrets.token_urlsafe(TOKEN_BYTES)}"


def is_secret_token(text: str) -> bool:
    """Return whether `text` has the form of a secret token."""
    return _TOKEN.match(text) is not None


def kind_of(token: str) -> str:
    """Return the kind of a secret token."""
    return token.split("_", 2)[1]


def token_hash(token: str) -> str:
    """Return what is stored of a token: SHA-256, in hexadecimal digits."""
    return hashlib.sha256(token.encode()).hexdigest()


def is_token(token: str, stored_hash: str) -> bool:
    """Return whether `stored_hash` is the hash of `token`, in constant time."""
    return hmac.compare_digest(token_hash(token), stored_hash)
