"""History: the changes of entities, recorded for the temporal API.

How it works: each change of an entity adds one row to the history, in the commit of the change itself, so
that history and entities never differ. The row has the instances of attributes that the change wrote, and the
type and datasetId of those that it deleted. Unchanged instances are the same objects before and after a
change, so that finding the written ones compares identities and not values.

The key of a row is the sequence number of the entity and the time of the change (`seq`), made unique per
entity. The instanceId of an instance is computed from the key and its position in the row and is not
stored. For this reason deleted instances leave a None in their row: the positions of the others must not
change.

Example: an entity with sequence number 7 is created with a and b, then a is written, then b is deleted. The
rows are `(7, t1) {attributes: {a: [1], b: [2]}}`, `(7, t2) {attributes: {a: [3]}}` and
`(7, t3) {attributes: {}, deleted: {b: [[Property, null]]}}`. The instanceId of a's second value is
`urn:ngsi-ld:Instance:7-<t2 in hex>-0`.
"""

import re
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, Final

import orjson

from handover_broker.model.entity import NULL, VALUE_MEMBER, Attributes, Event, Instance, dataset_of
from handover_broker.model.validation import has_expired, moment, timestamp, timestamp_now
from handover_broker.storage.entries import Entries
from handover_broker.storage.history_archive import HistoryRow, TemporalOnlyRow

SCOPE: Final = "scope"
"""The name of the scopes among the attributes of an entity (whose names are IRIs)."""
DRIFT_S: Final = 1.0
"""How far the time in a row's key may be from the modifiedAt in it: keys of one instant must differ."""

_ID: Final = re.compile(r"urn:ngsi-ld:Instance:([0-9a-f]{1,15})-([0-9a-f]{1,15})-([0-9a-f]{1,7})")
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_CLOCK_LENGTH: Final = len("2024-05-01T12:00:00.123456Z")
"""The length of times of the clock."""

Deletions = dict[str, list[tuple[str, str | None] | None]]
"""By attribute: type and datasetId of each deleted instance."""


@dataclass(slots=True)
class RowContent:
    """The content of a row. Instances that were removed later are None, so that positions stay the same."""

    attributes: dict[str, list[Instance | None]] = field(default_factory=dict)
    deleted: Deletions = field(default_factory=dict)
    scopes: list[str] | None = None
    """The scopes after the change, None if it did not change them."""

    def stored(self) -> bytes:
        """Return the body of the row; raises `orjson.JSONEncodeError` if nested too deep."""
        fields: dict[str, Any] = {"attributes": self.attributes}
        if self.deleted:
            fields["deleted"] = self.deleted
        if self.scopes is not None:
            fields["scopes"] = self.scopes
        return orjson.dumps(fields)

    @classmethod
    def restored(cls, stored: bytes) -> "RowContent":
        """Return the change in the body of a row."""
        return cls(**orjson.loads(stored))

    @staticmethod
    def may_set_scopes(stored: bytes) -> bool:
        """Return quickly whether `stored` may set scopes: the scopes after a change are its last member."""
        return stored.endswith(b"]}") or b'"scope":' in stored

    def is_empty(self) -> bool:
        """Return whether all instances have been removed."""
        lists: Iterable[list[Any]] = (*self.attributes.values(), *self.deleted.values())
        return self.scopes is None and all(instance is None for instances in lists for instance in instances)

    def observed(self, at_s: float) -> tuple[float | None, float | None]:
        """Return the first and the last observedAt in it; scopes count as observed at `at_s`."""
        times = [
            seen
            for instances in self.attributes.values()
            for instance in instances
            if instance is not None
            and "observedAt" in instance
            and (seen := moment(instance["observedAt"])) is not None
        ]
        if self.scopes is not None:
            times.append(at_s)
        if len(times) <= 1:
            return (times[0], times[0]) if times else (None, None)
        return min(times), max(times)

    def instances(self, seq: int) -> Iterator[tuple[str, int, Instance]]:
        """Yield each instance with its attribute (IRI, or `SCOPE`) and its position.

        A deletion is an instance with the value `NULL` and a deletedAt (clauses 4.5.7 and 4.5.8).
        """
        position = 0
        for name, instances in self.attributes.items():
            for instance in instances:
                if instance is not None:
                    yield name, position, instance
                position += 1
        if self.deleted:
            at = time_of(seq)
            for name, deletions in self.deleted.items():
                for gone in deletions:
                    if gone is not None:
                        yield name, position, _deletion(*gone, at)
                    position += 1
        if self.scopes is not None:
            yield SCOPE, position, _scope_instance(self.scopes, time_of(seq))

    def without(self, attribute: str, position: int) -> bool:
        """Remove the instance at `position`; return whether `attribute` had one there."""
        lists: list[tuple[str, list[Any]]] = [*self.attributes.items(), *self.deleted.items()]
        for name, instances in lists:
            if position < len(instances):
                is_wanted = name == attribute and instances[position] is not None
                if is_wanted:
                    instances[position] = None
                return is_wanted
            position -= len(instances)
        if attribute == SCOPE and position == 0 and self.scopes is not None:
            self.scopes = None
            return True
        return False

    def cut(self, attribute: str, concerns: Callable[[str | None], bool]) -> bool:
        """Remove all instances of an attribute with certain datasetIds; return whether there were any."""
        has_cut = False
        instances = self.attributes.get(attribute, [])
        for position, instance in enumerate(instances):
            if instance is not None and concerns(dataset_of(instance)):
                instances[position] = None
                has_cut = True
        deletions = self.deleted.get(attribute, [])
        for position, gone in enumerate(deletions):
            if gone is not None and concerns(gone[1]):
                deletions[position] = None
                has_cut = True
        if attribute == SCOPE and self.scopes is not None and concerns(None):
            self.scopes = None
            has_cut = True
        return has_cut

    def put(self, position: int, instance: Instance) -> None:
        """Replace the instance at `position`."""
        for instances in self.attributes.values():
            if position < len(instances):
                instances[position] = instance
                return
            position -= len(instances)

    def find(self, attribute: str, position: int) -> Instance | None:
        """Return the instance of `attribute` at `position`, None if there is none."""
        for name, instances in self.attributes.items():
            if position < len(instances):
                return instances[position] if name == attribute else None
            position -= len(instances)
        return None


@dataclass(frozen=True, slots=True)
class TemporalOnlyEntity:
    """An entity with a history only: `deleted_at` is None if it never was a current entity.

    `expires_at` is when its history expires, None if only retention deletes it (clause 4.22). `former_types`
    are those that it had lost; rights count for them, too.
    """

    types: tuple[str, ...]
    scopes: tuple[str, ...]
    created_at: str
    modified_at: str
    deleted_at: str | None
    expires_at: str | None = None
    former_types: tuple[str, ...] = ()

    def has_expired_at(self, now_s: float) -> bool:
        """Return whether its history has expired."""
        return has_expired(self.expires_at, now_s)

    def stored(self) -> bytes:
        """Return the body of the stored row."""
        former = {"formerTypes": self.former_types} if self.former_types else {}
        return orjson.dumps(
            {
                "types": self.types,
                "scopes": self.scopes,
                "createdAt": self.created_at,
                "modifiedAt": self.modified_at,
                "deletedAt": self.deleted_at,
                "expiresAt": self.expires_at,
                **former,
            }
        )

    @classmethod
    def restored(cls, stored: bytes) -> "TemporalOnlyEntity":
        """Return the entity in the body of a stored row."""
        fields = orjson.loads(stored)
        return cls(
            tuple(fields["types"]),
            tuple(fields["scopes"]),
            fields["createdAt"],
            fields["modifiedAt"],
            fields["deletedAt"],
            fields["expiresAt"],
            tuple(fields.get("formerTypes", ())),
        )


class HistoryRecorder:
    """Adds the history rows to the commits of changes."""

    def __init__(self) -> None:
        self._last = 0

    def record(self, tenant: str, event: Event, entries: Entries) -> None:
        """Add the row of one change; raises `orjson.JSONEncodeError` if it is nested too deep."""
        before, after = event.before, event.after
        entity = after or before
        assert entity is not None  # noqa: S101 - a change has at least one end
        if after is None or (before is not None and after.modified_at == before.modified_at):
            at = timestamp_now()  # two changes of an entity never share a key
        else:
            at = after.modified_at
        if after is None:
            entries.temporal_only[entity.seq] = TemporalOnlyRow(
                tenant,
                entity.id,
                TemporalOnlyEntity(
                    entity.types,
                    entity.scopes,
                    entity.created_at,
                    entity.modified_at,
                    at,
                    former_types=entity.former_types,
                ).stored(),
            )
        change = change_of(event)
        if change is not None:
            entries.history.append(self.row(entity.seq, change, at))

    def row(self, entity_seq: int, change: RowContent, at: str) -> HistoryRow:
        """Return the row of a change of an entity."""
        seq = micros_of(at)
        if seq <= self._last < seq + 1_000_000:
            seq = self._last + 1  # several changes in one instant, or a coarse clock
        self._last = seq
        return HistoryRow(entity_seq, seq, *change.observed(seq / 1_000_000), 0, change.stored())


def change_of(event: Event) -> RowContent | None:
    """Return the difference of a change, None if there is none. Unchanged instances are the same objects."""
    before, after, written = event
    if after is None:
        assert before is not None  # noqa: S101 - a change has at least one end
        gone = {name: _kinds(instances) for name, instances in before.attributes.items()}
        return RowContent({}, gone, [] if before.scopes else None)
    if before is None:
        scopes = list(after.scopes) if after.scopes else None
        return RowContent(after.attributes, {}, scopes)  # type: ignore[arg-type]  # read only
    attributes: Attributes = {}
    deleted: Deletions = {}
    old = before.attributes
    added = 0
    for name in written if old.keys() == after.attributes.keys() else after.attributes:
        instances, was = after.attributes[name], old.get(name)
        if was is instances:
            continue
        if was is None:
            attributes[name] = instances
            added += 1
        elif len(was) == len(instances) == 1 and dataset_of(was[0]) == dataset_of(instances[0]):
            if was[0] is not instances[0]:
                attributes[name] = instances
        else:
            _compare(name, was, instances, attributes, deleted)
    if len(after.attributes) - added < len(old):
        for name in old.keys() - after.attributes.keys():
            deleted[name] = _kinds(old[name])
    scopes = None if before.scopes == after.scopes else list(after.scopes)
    if not attributes and not deleted and scopes is None:
        return None
    return RowContent(attributes, deleted, scopes)  # type: ignore[arg-type]  # lists without gaps


def _compare(
    name: str, was: list[Instance], instances: list[Instance], attributes: Attributes, deleted: Deletions
) -> None:
    identities = {id(instance) for instance in was}
    if new := [instance for instance in instances if id(instance) not in identities]:
        attributes[name] = new
    datasets = {dataset_of(instance) for instance in instances}
    if gone := [instance for instance in was if dataset_of(instance) not in datasets]:
        deleted[name] = _kinds(gone)


def instance_id(entity_seq: int, seq: int, position: int) -> str:
    """Return the instanceId of the instance at `position` of a row."""
    return f"urn:ngsi-ld:Instance:{entity_seq:x}-{seq:x}-{position:x}"


def parse_instance_id(instance: str) -> tuple[int, int, int] | None:
    """Return sequence number, seq and position in an instanceId; None for one of another broker."""
    match = _ID.fullmatch(instance)
    if match is None:
        return None
    entity_seq, seq, position = (int(part, 16) for part in match.groups())
    return entity_seq, seq, position


def micros_of(at: str) -> int:
    """Return the microseconds from 1970 to `at`, a date-time in UTC.

    Raises `ValueError` or `TypeError` for anything else.
    """
    if len(at) == _CLOCK_LENGTH and at[16] == ":" and at[19] == "." and at[26] == "Z":
        decimals = at[20:26]
        if decimals.isascii() and decimals.isdecimal():
            return _second_of(at[:19]) + int(decimals)
    since = datetime.fromisoformat(at) - _EPOCH
    return (since.days * 86_400 + since.seconds) * 1_000_000 + since.microseconds


@lru_cache(maxsize=16)
def _second_of(text: str) -> int:
    """Return the microseconds from 1970 to a time in UTC without decimals: most are of the present second."""
    return micros_of(f"{text}Z")


def time_of(seq: int) -> str:
    """Return the time in the key of a row, as the broker writes it."""
    seconds, micros = divmod(seq, 1_000_000)
    return timestamp(datetime.fromtimestamp(seconds, UTC).replace(microsecond=micros))


def seq_before(days: float) -> int:
    """Return the key of a change `days` ago."""
    return int((time.time() - days * 86_400) * 1_000_000)


def _kinds(instances: Iterable[Instance]) -> list[tuple[str, str | None] | None]:
    return [(instance["type"], dataset_of(instance)) for instance in instances]


def _deletion(kind: str, dataset: str | None, at: str) -> Instance:
    value = {"@none": NULL} if kind == "LanguageProperty" else NULL
    instance: Instance = {"type": kind, VALUE_MEMBER[kind]: value, "deletedAt": at}
    if dataset is not None:
        instance["datasetId"] = dataset
    return instance


def _scope_instance(scopes: list[str], at: str) -> Instance:
    if not scopes:
        return {"type": "Property", "value": [], "deletedAt": at}
    value = scopes[0] if len(scopes) == 1 else scopes
    return {
        "type": "Property",
        "value": value,
        **dict.fromkeys(("createdAt", "modifiedAt"), at),
    }
