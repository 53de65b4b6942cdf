"""Via: whom a request has passed, so that a question never goes round in circles.

The chain of brokers stands in the Via header (RFC 9110, clause 7.6.3; clauses 4.3.6.7 and 6.3.18 of the
standard), each by its alias, which is another for each of its tenants.
"""

import re
from functools import lru_cache
from typing import Final

_COMMENT: Final = re.compile(r"\([^()]*\)")
MAX_CHAIN_LENGTH: Final = 32
"""Brokers that a request may pass: a chain that is longer is as good as a loop."""


@lru_cache(maxsize=1024)
def chain(via: bytes) -> tuple[str, ...]:
    """Return whom a request has passed, the first first; what cannot be read is left out."""
    text = _COMMENT.sub("", via.decode("latin-1"))
    entries = (entry.split() for entry in text.split(","))
    return tuple(words[1] for words in entries if len(words) > 1)


def append_to_via(via: bytes, name: str) -> str:
    """Return the Via header with `name` at its end."""
    before = via.decode("latin-1").strip()
    return f"{before}, 1.1 {name}" if before else f"1.1 {name}"
