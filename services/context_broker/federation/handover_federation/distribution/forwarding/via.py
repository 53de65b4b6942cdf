"""The Via header: the brokers that a request has passed, so that it is never sent in a loop.

Each broker is listed by an alias, which differs for each of its tenants (RFC 9110, clause 7.6.3; clauses
4.3.6.7 and 6.3.18 of the standard).
"""

import re
from functools import lru_cache
from typing import Final

_COMMENT: Final = re.compile(r"\([^()]*\)")
MAX_CHAIN_LENGTH: Final = 32
"""Brokers that a request may pass; a longer chain counts as a loop."""


@lru_cache(maxsize=1024)
def chain(via: bytes) -> tuple[str, ...]:
    """Return the aliases in a Via header, oldest first; unreadable entries are left out."""
    text = _COMMENT.sub("", via.decode("latin-1"))
    entries = (entry.split() for entry in text.split(","))
    return tuple(words[1] for words in entries if len(words) > 1)


def append_to_via(via: bytes, name: str) -> str:
    """Return the Via header with `name` appended."""
    before = via.decode("latin-1").strip()
    return f"{before}, 1.1 {name}" if before else f"1.1 {name}"
