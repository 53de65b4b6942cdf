"""Records of the write-ahead log: what one commit writes, encoded as bytes.

A record is a line of JSON with the keys of what is written and the length of each body, followed by the
bodies. Most bodies are JSON already, and are only copied.
"""

from collections.abc import Iterable
from typing import Any, Final

import orjson

from services.context_broker.storage.entries import (
    DocumentKey,
    DocumentKind,
    EntityRow,
    Entries,
    PendingNotification,
)
from services.context_broker.storage.history_archive import DepartedRow, HistoryRow

_NOTHING: Final[tuple[()]] = ()


def encoded(entries: Entries) -> bytes:
    """Return the entries of a commit as a record."""
    bodies: list[bytes] = []

    def size(body: bytes | None) -> int | None:
        if body is None:
            return None
        bodies.append(body)
        return len(body)

    said: dict[str, list[tuple[Any, ...]] | list[int]] = {
        "entities": [(place, *row[:2], size(row[2])) for place, row in entries.entities.items()],
        "history": [(*row[:5], size(row[5])) for row in entries.history],
    }
    if entries.documents:
        said["documents"] = [
            (kind.value, tenant, name, size(body)) for (kind, tenant, name), body in entries.documents.items()
        ]
    if entries.pending:
        said["pending"] = [
            (one.tenant, one.subscription, one.entity, one.at, one.seq, size(one.body), size(one.headers))
            for one in entries.pending
        ]
    if entries.settled:
        said["settled"] = entries.settled
    if entries.cleared:
        said["cleared"] = entries.cleared
    if entries.departed:
        said["departed"] = [
            (place, row.tenant, row.id, size(row.body)) for place, row in entries.departed.items()
        ]
    return b"".join((orjson.dumps(said), b"\n", *bodies))


def decoded(record: bytes) -> Entries:
    """Return the entries of a record."""
    line, _, _ = record.partition(b"\n")
    said: dict[str, list[Any]] = orjson.loads(line)
    at = len(line) + 1

    def body(size: int | None) -> bytes | None:
        nonlocal at
        if size is None:
            return None
        at += size
        return record[at - size : at]

    def rows(of: str) -> Iterable[Any]:
        return said.get(of, _NOTHING)

    # The order is that of `encoded`: the bodies follow each other.
    entities = {place: EntityRow(tenant, name, body(size)) for place, tenant, name, size in rows("entities")}
    history = [
        HistoryRow(place, seq, observed_from, observed_to, rewritten, body(size))
        for place, seq, observed_from, observed_to, rewritten, size in rows("history")
    ]
    documents: dict[DocumentKey, bytes | None] = {
        (DocumentKind(kind), tenant, name): body(size) for kind, tenant, name, size in rows("documents")
    }
    pending = [
        PendingNotification(tenant, subscription, entity, at_s, body(size), seq, body(headers))
        for tenant, subscription, entity, at_s, seq, size, headers in rows("pending")
    ]
    cleared = [(place, bound) for place, bound in rows("cleared")]
    departed = {
        place: DepartedRow(tenant, name, body(size)) for place, tenant, name, size in rows("departed")
    }
    return Entries(entities, documents, pending, list(rows("settled")), history, cleared, departed)
