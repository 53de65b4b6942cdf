"""Resource patterns: an entity id, or one with `*` for any characters; `*` alone is every resource."""

import re
from functools import lru_cache
from typing import Final

from handover.errors import UsageError

ANY_RESOURCE: Final = "*"
MAX_PATTERN_CHARACTERS: Final = 300
MAX_STARS: Final = 4
"""Limits the time of a comparison."""

_PATTERN: Final = re.compile(r"^[^\s\x00-\x1f]+$")


def require_pattern(pattern: str) -> str:
    """Return `pattern`; raise `UsageError` if it is invalid."""
    if len(pattern) > MAX_PATTERN_CHARACTERS or _PATTERN.match(pattern) is None:
        raise UsageError(
            f'"{pattern[:100]}" is no resource; write an entity id (urn:ngsi-ld:Device:demo:ur10-1), one '
            "with * for any characters, or * for every resource, with at most "
            f"{MAX_PATTERN_CHARACTERS} characters"
        )
    if pattern.count("*") > MAX_STARS:
        raise UsageError(f'the resource "{pattern[:100]}" has more than {MAX_STARS} *; use fewer')
    return pattern


def is_match(pattern: str, resource: str) -> bool:
    """Return whether `pattern` includes `resource`, an entity id or `*`.

    Only the pattern `*` includes the resource `*`: what concerns everything needs a grant for everything.
    """
    if pattern == ANY_RESOURCE:
        return True
    if resource == ANY_RESOURCE:
        return False
    return pattern == resource or ("*" in pattern and _compiled(pattern).fullmatch(resource) is not None)


@lru_cache(maxsize=4096)
def _compiled(pattern: str) -> re.Pattern[str]:
    return re.compile(".*".join(re.escape(part) for part in pattern.split("*")), re.DOTALL)
