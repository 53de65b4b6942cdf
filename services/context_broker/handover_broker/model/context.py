"""An @context as a value: the terms that expand and compact names, and the document they come from."""

from dataclasses import dataclass
from typing import Any

from handover_broker.model.entity import Terms


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """An @context that is ready for use.

    `document` is what the client gave, `text` the same as JSON, `link` its URL if it has one. `parts` are the
    local identifiers of the stored contexts that it was made of.
    """

    key: int
    terms: Terms
    document: Any
    text: bytes
    link: str | None
    parts: frozenset[str] = frozenset()

    def is_made_of(self, local_id: str) -> bool:
        """Return whether a stored context is part of it."""
        return local_id in self.parts


def link_header(url: str) -> str:
    """Return the value of the Link header that names an @context."""
    return f'<{url}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'
