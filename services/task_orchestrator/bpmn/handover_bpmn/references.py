"""References to entities, as a process file writes them: `Device:glove-1` or a URN."""

import re

_SHORT = re.compile(r"[A-Z][A-Za-z0-9]*:[A-Za-z0-9_.-]+", re.ASCII)
_URN = re.compile(r"urn:[a-z0-9][a-z0-9-]{0,31}:[^\s<>\"]+", re.ASCII)


def is_reference(text: object) -> bool:
    """Return whether `text` refers to an entity."""
    return isinstance(text, str) and bool(_SHORT.fullmatch(text) or _URN.fullmatch(text))
