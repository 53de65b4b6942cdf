"""The document of a snapshot: its members, limits and validation (clauses 5.2.41 and 5.5.15)."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, Final
from urllib.parse import urlsplit

import orjson

from handover.errors import Problem
from handover_broker.model.owner import OWNER, Owner
from handover_broker.model.problems import bad_request_data
from handover_broker.model.secrets import hidden_members, kept_members
from handover_broker.model.stored_documents import refuse_null, require_id, without_null
from handover_broker.model.validation import (
    duration_s,
    moment,
    require_uri,
    shown,
    timestamp,
    timestamp_now,
)

TYPE: Final = "Snapshot"
DEFAULT_LIFETIME_S: Final = 86400.0
MAX_LIFETIME_S: Final = 30 * 86400.0
"""A snapshot uses as much memory as its entities, and forgotten ones must not stay forever."""
MAX_SNAPSHOTS: Final = 64
"""Snapshots of a tenant; a new one evicts the one of lowest priority, among these the longest unused."""
MAX_ENTITIES: Final = 200_000
"""Entities in one snapshot."""
DEFAULT_PRIORITY: Final = 5
MAX_TOTAL_ENTITIES: Final = 1_000_000
"""Entities in all snapshots of a tenant; more evict snapshots by the same rule."""
PRESENT: Final = "snapshotQueries"
PAST: Final = "snapshotTemporalQueries"
QUERIES: Final = (PRESENT, PAST)
SETTABLE: Final = frozenset({"snapshotPriority", "snapshotLifetime", "endpoint", "receiverInfo"})
MEMBERS: Final = SETTABLE | {
    "id", "type", *QUERIES, "snapshotStatus", "snapshotQueriesDetails", "snapshotTemporalQueriesDetails",
    "createdAt", "modifiedAt", "expiresAt", "lastUsedAt",
}  # fmt: skip


SECRETS: Final = ("endpoint", "receiverInfo")
"""Where a snapshot has secrets: its address first."""


class Status(StrEnum):
    """The progress of a snapshot, or the result of one of its queries."""

    PREPARING = "preparing"
    SUCCESS = "success"
    PARTIAL = "partial"
    EMPTY = "empty"
    FAILURE = "failure"


@dataclass(slots=True, eq=False)
class Snapshot:
    """A snapshot. `document` is stored, and returned without the owner; `written_s` is the time of the last
    write.
    """

    id: str
    document: dict[str, Any]
    written_s: float = 0.0

    @property
    def status(self) -> Status:
        """Return the status."""
        return Status(self.document["snapshotStatus"])

    @property
    def owner(self) -> Owner | None:
        """Return who created it, with the rights of whom; None if an earlier version did."""
        return Owner.restored(self.document)

    @property
    def expires_s(self) -> float:
        """Return the expiry in seconds since 1970."""
        return moment(self.document["expiresAt"]) or 0.0

    def shown(self) -> dict[str, Any]:
        """Return the snapshot for a reader, without its secrets."""
        shown = hidden_members(self.document, *SECRETS)
        shown.pop(OWNER, None)
        return shown

    def stored(self) -> bytes:
        """Return the document for the journal."""
        return orjson.dumps(self.document)

    def changed(self, **members: Any) -> "Snapshot":
        """Return a copy with some members changed; None deletes a member."""
        document = {**self.document, **members, "modifiedAt": timestamp_now()}
        return Snapshot(self.id, {name: value for name, value in document.items() if value is not None})

    def failed(self, problem: Problem) -> "Snapshot":
        """Return a copy with the status `failure` and the reason at each of its queries."""
        reasons = {
            f"{name}Details": [details(Status.FAILURE, problem) for _ in self.document[name]]
            for name in QUERIES
            if name in self.document
        }
        return self.changed(snapshotStatus=Status.FAILURE.value, **reasons)

    def used(self) -> None:
        """Record the time of last use."""
        self.document["lastUsedAt"] = timestamp_now()


def restored(snapshot_id: str, body: bytes) -> Snapshot:
    """Return a stored snapshot. Raises an exception if it lacks what every operation needs."""
    document = orjson.loads(body)
    require_id(document["id"], snapshot_id)
    snapshot = Snapshot(snapshot_id, document)
    if not snapshot.expires_s or snapshot.status not in Status:
        raise ValueError(f"it expires at {document['expiresAt']!r}")
    for name, kind in (
        ("snapshotPriority", int),
        ("lastUsedAt", str),
        ("createdAt", str),
        ("modifiedAt", str),
    ):
        if not isinstance(document[name], kind):
            raise TypeError(f"its {name} is {document[name]!r}")
    return snapshot


def new_snapshot(snapshot_id: str, members: Mapping[str, Any]) -> Snapshot:
    """Return a new snapshot with the given members and the status `preparing`."""
    now = datetime.now(UTC)
    at = timestamp(now)
    document = {
        "id": snapshot_id,
        "type": TYPE,
        **{name: members[name] for name in (*QUERIES, *sorted(SETTABLE)) if members.get(name) is not None},
        "snapshotStatus": Status.PREPARING.value,
        "createdAt": at,
        "modifiedAt": at,
        "lastUsedAt": at,
        "expiresAt": expiry_of(now, members.get("snapshotLifetime")),
    }
    document.setdefault("snapshotPriority", DEFAULT_PRIORITY)
    return Snapshot(snapshot_id, document)


def expiry_of(start: datetime, lifetime: str | None) -> str:
    """Return the expiry of a snapshot created at `start`, with its lifetime within the broker's limits."""
    wanted_s = DEFAULT_LIFETIME_S if lifetime is None else duration_s(lifetime, '"snapshotLifetime"')
    lasts_s = min(max(wanted_s, 1.0), MAX_LIFETIME_S)
    return timestamp(datetime.fromtimestamp(start.timestamp() + lasts_s, UTC))


def require_valid(document: Any, *, has_queries: bool) -> Mapping[str, Any]:
    """Return the document of a new snapshot; raise a problem (400) if it is invalid."""
    if not isinstance(document, Mapping):
        raise bad_request_data(f"a snapshot is a JSON object, not {shown(document)}")
    if document.get("type", TYPE) != TYPE:
        raise bad_request_data(f'the type of a snapshot is "{TYPE}", not {shown(document["type"])}')
    refuse_null(document, "a snapshot")
    if "id" in document and not require_uri(document["id"], "the snapshot id").isascii():
        raise bad_request_data("the id of a snapshot is used in headers; use ASCII characters")
    allowed = SETTABLE | {"id", "type", "@context"} | (set(QUERIES) if has_queries else set())
    _check_members(document, allowed)
    if has_queries:
        _check_queries(document)
    return kept_members(document, {}, *SECRETS)


def require_valid_change(document: Any) -> Mapping[str, Any]:
    """Return the document of a change; raise a problem (400) if it is invalid."""
    if not isinstance(document, Mapping):
        raise bad_request_data(f"a change of a snapshot is a JSON object, not {shown(document)}")
    refuse_null(document, "a snapshot", deleting=1)
    _check_members(without_null(document), SETTABLE | {"@context", "type"})
    return document


def details(status: Status, problem: Problem | None = None) -> dict[str, Any]:
    """Return the details of one query (clause 5.2.42)."""
    result: dict[str, Any] = {"resultStatus": status.value}
    if problem is not None:
        result["problemDetails"] = problem.body()
    return result


def status_of(results: list[dict[str, Any]]) -> Status:
    """Return the status of a snapshot with these query results (clause 5.16.1.4)."""
    seen = {detail["resultStatus"] for detail in results}
    if len(seen) == 1:
        return Status(seen.pop())
    if Status.FAILURE in seen or Status.PARTIAL in seen:
        return Status.PARTIAL
    return Status.SUCCESS


def _check_members(document: Mapping[str, Any], allowed: set[str] | frozenset[str]) -> None:
    for name in document:
        if name not in allowed:
            why = "is set by the broker" if name in MEMBERS else "is no member of a snapshot"
            raise bad_request_data(f"{shown(name)} {why}; leave it out")
    priority = document.get("snapshotPriority", DEFAULT_PRIORITY)
    if not isinstance(priority, int) or isinstance(priority, bool) or not 1 <= priority <= 10:
        raise bad_request_data(f'"snapshotPriority" is a whole number from 1 to 10, not {shown(priority)}')
    if document.get("snapshotLifetime") is not None:
        duration_s(document["snapshotLifetime"], '"snapshotLifetime"')
    if document.get("endpoint") is not None:
        _check_endpoint(document["endpoint"])
    pairs = document.get("receiverInfo") or []
    if not isinstance(pairs, list):
        raise bad_request_data('receiverInfo is a list of objects such as {"key": "X-Cell", "value": "4"}')
    for pair in pairs:
        values = [pair.get("key"), pair.get("value")] if isinstance(pair, Mapping) else [None]
        if not all(isinstance(text, str) and text.isascii() and text.isprintable() for text in values):
            raise bad_request_data(
                f'each receiverInfo has a "key" and a "value" of plain text, not {shown(pair)}'
            )
        if not str(values[0]).replace("-", "").replace("_", "").isalnum():
            raise bad_request_data(f"receiverInfo {shown(values[0])} cannot be an HTTP header")


def _check_endpoint(endpoint: Any) -> None:
    try:
        parts = urlsplit(require_uri(endpoint, '"endpoint"'))
        usable = parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        usable = False
    if not usable or not endpoint.isascii():
        raise bad_request_data(
            f'"endpoint" is an address such as http://127.0.0.1:9000/ready, not {shown(endpoint)}'
        )


def _check_queries(document: Mapping[str, Any]) -> None:
    if not any(document.get(name) for name in QUERIES):
        raise bad_request_data('a snapshot has "snapshotQueries" or "snapshotTemporalQueries"; add one')
    for name in QUERIES:
        queries = document.get(name, [])
        if not isinstance(queries, list) or not all(
            isinstance(stored_query, Mapping) for stored_query in queries
        ):
            raise bad_request_data(f'"{name}" is a list of Query objects, not {shown(queries)}')
        for query in queries:
            if ("temporalQ" in query) is not (name == QUERIES[1]):
                need = "has a" if name == QUERIES[1] else "has no"
                raise bad_request_data(f'each Query in "{name}" {need} "temporalQ"; see {shown(dict(query))}')
