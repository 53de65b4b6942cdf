"""Selects the snapshots to purge by a query on their members (clause 5.16.7)."""

from collections.abc import Callable, Iterator
from typing import Any, Final

from handover_broker.model.context import Context
from handover_broker.model.entity import Attributes, Entity
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import shown
from handover_broker.query.q_grammar import parse
from handover_broker.query.selection import Selection, compiled
from handover_federation.snapshots.snapshot import MEMBERS, SECRETS, TYPE, Snapshot

_MEMBERS: Final = MEMBERS - frozenset(SECRETS)
"""A purge must not find out secrets."""


def purge_filter(q: str | None, context: Context) -> Callable[[Snapshot], bool]:
    """Return a predicate for snapshots to purge; raise a problem (400) for an invalid query."""
    if not q:
        raise bad_request_data("a purge of snapshots has a q, for example q=snapshotPriority<5; add it")
    for name in _names(parse(q)):
        if name not in _MEMBERS:
            raise bad_request_data(
                f"a snapshot has no {shown(name)} to purge by; its members are {', '.join(sorted(_MEMBERS))}"
            )
    selection = Selection(query=compiled(q, context))
    expand = context.terms.expand

    def wants(snapshot: Snapshot) -> bool:
        document = snapshot.document
        attributes: Attributes = {
            expand(name): [{"type": "Property", "value": value}]
            for name, value in document.items()
            if name not in {"id", "type"}
        }
        remaining = Entity(
            snapshot.id, (expand(TYPE),), attributes, document["createdAt"], document["modifiedAt"],
            expires_at=document["expiresAt"],
        )  # fmt: skip
        return selection.wants(remaining)

    return wants


def _names(term: Any) -> Iterator[str]:
    """Yield the attributes in a parsed query."""
    for part in getattr(term, "terms", ()):
        yield from _names(part)
    path = getattr(term, "path", None)
    if path is not None:
        yield path.names[0]
