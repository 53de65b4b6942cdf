"""The content of a frame: what one commit writes, as named, versioned records.

A line of JSON has the records by type:

    {"entity/1": [{"seq": 7, "tenant": "", "id": "urn:x", "body_size": 9}]}

The bodies follow the line, in the order of the records. A field that ends with `_size` is the length of a
body, null where there is none. Most bodies are JSON already, and are only copied.

The number behind the name of a type is its version: a record whose fields change gets the next one. A type or
version that is not in `_DECODERS` is refused.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import orjson

from handover_broker.storage.entries import DocumentKind, EntityRow, Entries, PendingNotification
from handover_broker.storage.history_archive import HistoryRow, TemporalOnlyRow
from handover_broker.storage.write_ahead_log.frames import UnknownVersion

ENTITY: Final = "entity/1"
HISTORY: Final = "history/1"
DOCUMENT: Final = "document/1"
NOTIFICATION: Final = "notification/1"
NOTIFICATION_DONE: Final = "notification_done/1"
HISTORY_CLEARED: Final = "history_cleared/1"
TEMPORAL_ONLY_ENTITY: Final = "temporal_only_entity/1"

_Fields = Mapping[str, Any]
_TakeBody = Callable[[int | None], bytes | None]
"""Returns the next body, of the given length; None for None."""


def encode(entries: Entries) -> bytes:
    """Return the entries of a commit as the content of a frame."""
    bodies: list[bytes] = []

    def size(body: bytes | None) -> int | None:
        if body is None:
            return None
        bodies.append(body)
        return len(body)

    records: dict[str, list[dict[str, Any]]] = {}
    if entries.entities:
        records[ENTITY] = [
            {"seq": seq, "tenant": row.tenant, "id": row.id, "body_size": size(row.body)}
            for seq, row in entries.entities.items()
        ]
    if entries.history:
        records[HISTORY] = [
            {
                "entity": row.entity,
                "seq": row.seq,
                "observed_from": row.observed_from,
                "observed_to": row.observed_to,
                "rewritten": row.rewritten,
                "body_size": size(row.body),
            }
            for row in entries.history
        ]
    if entries.documents:
        records[DOCUMENT] = [
            {"kind": kind, "tenant": tenant, "id": name, "body_size": size(body)}
            for (kind, tenant, name), body in entries.documents.items()
        ]
    if entries.pending:
        records[NOTIFICATION] = [
            {
                "seq": pending.seq,
                "tenant": pending.tenant,
                "subscription": pending.subscription,
                "entity": pending.entity,
                "at": pending.at,
                "body_size": size(pending.body),
                "headers_size": size(pending.headers),
            }
            for pending in entries.pending
        ]
    if entries.settled:
        records[NOTIFICATION_DONE] = [{"seq": seq} for seq in entries.settled]
    if entries.cleared:
        records[HISTORY_CLEARED] = [
            {"entity": entity, "before": before} for entity, before in entries.cleared
        ]
    if entries.temporal_only:
        records[TEMPORAL_ONLY_ENTITY] = [
            {"seq": seq, "tenant": row.tenant, "id": row.id, "body_size": size(row.body)}
            for seq, row in entries.temporal_only.items()
        ]
    return b"".join((orjson.dumps(records), b"\n", *bodies))


def decode(content: bytes) -> Entries:
    """Return the entries in a frame. Raises `UnknownVersion`."""
    records, take_body = _parse(content)
    entries = Entries()
    for record_type, rows in records.items():
        decoder = _DECODERS.get(record_type)
        if decoder is None:
            raise UnknownVersion(f'a record of the type "{record_type}"')
        decoder(entries, rows, take_body)
    return entries


def read_bodies(content: bytes) -> Iterator[tuple[str, dict[str, Any], dict[str, bytes | None]]]:
    """Yield each record of a frame, also of an unknown type: the type, other fields, and bodies by name."""
    records, take_body = _parse(content)
    for record_type, rows in records.items():
        for row in rows:
            if not isinstance(row, dict):
                yield record_type, {}, {}
                continue
            bodies = {
                name.removesuffix("_size"): take_body(value)
                for name, value in row.items()
                if name.endswith("_size")
            }
            yield record_type, {name: row[name] for name in row if not name.endswith("_size")}, bodies


def _parse(content: bytes) -> tuple[dict[str, list[_Fields]], _TakeBody]:
    """Return the records by type, and a function that returns the bodies one after the other."""
    line, _, _ = content.partition(b"\n")
    offset = len(line) + 1

    def take_body(size: int | None) -> bytes | None:
        nonlocal offset
        if size is None:
            return None
        offset += size
        return content[offset - size : offset]

    return orjson.loads(line), take_body


def _decode_entities(entries: Entries, rows: list[_Fields], take_body: _TakeBody) -> None:
    entries.entities = {
        row["seq"]: EntityRow(row["tenant"], row["id"], take_body(row["body_size"])) for row in rows
    }


def _decode_history(entries: Entries, rows: list[_Fields], take_body: _TakeBody) -> None:
    entries.history = [
        HistoryRow(
            row["entity"],
            row["seq"],
            row["observed_from"],
            row["observed_to"],
            row["rewritten"],
            take_body(row["body_size"]),
        )
        for row in rows
    ]


def _decode_documents(entries: Entries, rows: list[_Fields], take_body: _TakeBody) -> None:
    entries.documents = {
        (DocumentKind(row["kind"]), row["tenant"], row["id"]): take_body(row["body_size"]) for row in rows
    }


def _decode_pending(entries: Entries, rows: list[_Fields], take_body: _TakeBody) -> None:
    entries.pending = [
        PendingNotification(
            row["tenant"],
            row["subscription"],
            row["entity"],
            row["at"],
            take_body(row["body_size"]),
            row["seq"],
            take_body(row["headers_size"]),
        )
        for row in rows
    ]


def _decode_settled(entries: Entries, rows: list[_Fields], _: _TakeBody) -> None:
    entries.settled = [row["seq"] for row in rows]


def _decode_cleared(entries: Entries, rows: list[_Fields], _: _TakeBody) -> None:
    entries.cleared = [(row["entity"], row["before"]) for row in rows]


def _decode_temporal_only(entries: Entries, rows: list[_Fields], take_body: _TakeBody) -> None:
    entries.temporal_only = {
        row["seq"]: TemporalOnlyRow(row["tenant"], row["id"], take_body(row["body_size"])) for row in rows
    }


_DECODERS: Final[dict[str, Callable[[Entries, list[_Fields], _TakeBody], None]]] = {
    ENTITY: _decode_entities,
    HISTORY: _decode_history,
    DOCUMENT: _decode_documents,
    NOTIFICATION: _decode_pending,
    NOTIFICATION_DONE: _decode_settled,
    HISTORY_CLEARED: _decode_cleared,
    TEMPORAL_ONLY_ENTITY: _decode_temporal_only,
}
