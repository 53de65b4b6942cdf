"""Entity matching: which entities are news, and which processes wait for the entities of a filter.

Both parts are pure. `SeenEntities` holds the digest of every entity that a filter has selected. An entity is
an event if it has no digest or another one. An entity that is no longer selected is forgotten, so it is an
event when it is selected again.
"""

import hashlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final

import orjson

from handover_bpmn.execution.queries import EntityWait
from handover_bpmn.execution.state import WaitType
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import KEY_LENGTH, EntityFilter
from handover_processes.process.process import Process

SeenChanges = Mapping[tuple[str, str], str | None]
"""Digests by filter and entity that a step has changed; None: forgotten."""

BASELINE: Final = ""
"""The id under which a filter is stored whose baseline is complete."""


CONTACT: Final = "contact"
"""The key under which the time is stored up to which all changes of conditions are known."""


def digest_of(content: Any) -> str:
    """Return the digest of JSON content, independent of the order of its members."""
    written = orjson.dumps(content, option=orjson.OPT_SORT_KEYS)
    return hashlib.sha256(written).hexdigest()[:KEY_LENGTH]


class SeenEntities:
    """The digests of the entities that were seen, by filter; `changes` are those of the present step."""

    def __init__(self, stored: Iterable[tuple[str, str, str]] = ()) -> None:
        self._digests: dict[str, dict[str, str]] = {}
        for key, entity, digest in stored:
            self._digests.setdefault(key, {})[entity] = digest

    def apply(self, changes: SeenChanges) -> None:
        """Take over what a step has changed, once it is written."""
        for (key, entity), digest in changes.items():
            if digest is not None:
                self._digests.setdefault(key, {})[entity] = digest
            elif entity in self._digests.get(key, {}):
                del self._digests[key][entity]
                if not self._digests[key]:
                    del self._digests[key]

    def keys(self) -> set[str]:
        """Return the filters that have seen entities or a baseline."""
        return set(self._digests)

    def has_baseline(self, key: str) -> bool:
        """Return whether the entities that existed when the filter was new are known."""
        return BASELINE in self._digests.get(key, {})

    def digest(self, key: str, entity: str, changes: SeenChanges) -> str | None:
        """Return the digest of an entity; None if the filter does not know it."""
        if (key, entity) in changes:
            return changes[key, entity]
        return self._digests.get(key, {}).get(entity)

    def entities(self, key: str) -> set[str]:
        """Return the ids of the entities of a filter, and the mark of its baseline."""
        return set(self._digests.get(key, ()))

    def news(self, key: str, present: Mapping[str, str]) -> list[str]:
        """Return the entities of `present` (id to digest) that are new or have changed."""
        digests = self._digests.get(key, {})
        return [entity for entity, digest in present.items() if digests.get(entity) != digest]

    def gone(self, key: str, present: Collection[str]) -> list[str]:
        """Return the known entities that are not `present`."""
        return [
            entity for entity in self._digests.get(key, {}) if entity != BASELINE and entity not in present
        ]


@dataclass
class EntityIndex:
    """The processes that wait for entities, by filter."""

    filters: dict[str, EntityFilter] = field(default_factory=dict)
    conditions: dict[str, int] = field(default_factory=dict)
    """Number of processes that wait for a condition, by filter."""
    new_conditions: set[str] = field(default_factory=set)
    """Filters with new waits for a condition, until the caller takes them away."""
    _waiting: dict[str, dict[str, None]] = field(default_factory=dict)
    _waits: dict[str, tuple[EntityWait, ...]] = field(default_factory=dict)

    def update(self, process: Process) -> None:
        """Index what a process waits for now."""
        process_id = process.record.id
        before = {wait.wait for wait in self._waits.get(process_id, ())}
        waits = () if process.run is None else process.run.entity_waits()
        if not waits and not before:
            return
        self.remove(process_id)
        if not waits:
            return
        self._waits[process_id] = waits
        for wait in waits:
            self.filters[wait.on.key] = wait.on
            self._waiting.setdefault(wait.on.key, {})[process_id] = None
            if wait.type is WaitType.CONDITION and wait.wait not in before:
                self.new_conditions.add(wait.on.key)
        for key in _condition_keys(waits):
            self.conditions[key] = self.conditions.get(key, 0) + 1

    def remove(self, process_id: str) -> None:
        """Forget a process."""
        waits = self._waits.pop(process_id, ())
        for key in {wait.on.key for wait in waits}:
            waiting = self._waiting[key]
            del waiting[process_id]
            if not waiting:
                del self._waiting[key], self.filters[key]
        for key in _condition_keys(waits):
            self.conditions[key] -= 1
            if not self.conditions[key]:
                del self.conditions[key]

    def waiting(self, key: str) -> list[str]:
        """Return the ids of the processes that wait for entities of a filter."""
        return list(self._waiting.get(key, ()))


def _condition_keys(waits: Iterable[EntityWait]) -> set[str]:
    return {wait.on.key for wait in waits if wait.type is WaitType.CONDITION}


def is_correlated(process: Process, wait: EntityWait, entity: Mapping[str, Any]) -> bool:
    """Return whether an entity is for a process that waits for it."""
    if wait.on.correlation is None:
        return True
    try:
        key = wait.on.correlated(entity)
    except ExpressionError:
        return False
    expected = process.record.key if wait.key is None else wait.key
    return key is not None and expected is not None and str(key) == str(expected)


def replay(evolution: Mapping[str, Any], present: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the states that an entity had, the oldest first, from its temporal evolution.

    What did not change has the value of `present`, the entity as it is now. An attribute that changed is
    missing before its first change. Changes without a valid time are ignored.
    """
    changed = {name: values for name, values in evolution.items() if _are_instances(values)}
    state = {name: value for name, value in present.items() if name not in changed}
    state |= {"id": evolution["id"], "type": evolution.get("type", present.get("type"))}
    moments: dict[datetime, dict[str, Any]] = {}
    for name, instances in changed.items():
        for instance in instances:
            moment = _moment(instance.get("modifiedAt") or instance.get("observedAt"))
            if moment is not None:
                value = {key: part for key, part in instance.items() if key not in _SYSTEM}
                moments.setdefault(moment, {})[name] = value
    states = []
    for _, values in sorted(moments.items()):
        state = state | values
        states.append(state)
    return states


_SYSTEM: Final = frozenset({"createdAt", "modifiedAt", "instanceId"})


def _are_instances(values: Any) -> bool:
    return isinstance(values, list) and all(isinstance(part, dict) for part in values)


def _moment(text: Any) -> datetime | None:
    try:
        moment = datetime.fromisoformat(text)
    except (TypeError, ValueError):
        return None
    return moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
