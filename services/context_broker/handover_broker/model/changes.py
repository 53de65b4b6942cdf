"""Changes of entities: pure functions from the entity before to the entity after.

Clauses 5.6.1 to 5.6.5, 5.6.17 and 5.6.18 (create, append, update, partial update, delete, merge, replace).
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from handover_broker.model.entity import (
    NULL,
    VALUE_MEMBER,
    Attributes,
    Entity,
    Instance,
    dataset_of,
    is_deletion,
)
from handover_broker.model.entity_parser import Change
from handover_broker.model.nesting import MAX_NESTING, too_deep
from handover_broker.model.validation import moment

PRESENT = "the entity has this attribute already and noOverwrite is set"


class Outcome(NamedTuple):
    """An entity after a change, the attributes (IRIs) that were written, and those that were refused, with
    reasons.

    An attribute is in both if some of its instances were written and others refused.
    """

    entity: Entity
    touched: frozenset[str]
    refused: Mapping[str, str]


def created(change: Change, at: str, seq: int) -> Entity:
    """Return a new entity, which takes over the instances of `change`."""
    assert change.id is not None  # noqa: S101 - read_entity has seen to it
    attributes = change.attributes
    for instances in attributes.values():
        for instance in instances:
            instance["createdAt"] = instance["modifiedAt"] = at
    end = _end(None, change)
    first = _first_end(end, attributes)
    return Entity(change.id, change.types, attributes, at, at, seq, change.scopes or (), end, first)


def replaced(before: Entity, change: Change, at: str) -> Outcome:
    """Return the replaced entity; its sequence number and createdAt stay (clause 5.6.18)."""
    attributes = {
        name: _stamped(instances, _by_dataset(before, name), at)
        for name, instances in change.attributes.items()
    }
    types = change.types or before.types
    end = _end(None, change)
    after = Entity(
        before.id,
        types,
        attributes,
        before.created_at,
        at,
        before.seq,
        change.scopes or (),
        end,
        _first_end(end, attributes),
    )
    return Outcome(after, frozenset(attributes), {})


def appended(before: Entity, change: Change, at: str, *, overwrite: bool = True) -> Outcome:
    """Return the entity with attributes added; existing instances are overwritten, or refused.

    Scopes are overwritten too, or added to the existing ones (clause 5.6.3).
    """
    attributes = dict(before.attributes)
    refused: dict[str, str] = {}
    if change.scopes and before.scopes and not overwrite:
        change = change._replace(scopes=tuple(dict.fromkeys((*before.scopes, *change.scopes))))
    written: Attributes = {}
    for name, instances in change.attributes.items():
        remaining = _by_dataset(before, name)
        new = (
            instances
            if overwrite
            else [instance for instance in instances if dataset_of(instance) not in remaining]
        )
        if len(new) < len(instances):
            refused[name] = PRESENT
        if new:
            written[name] = new
            _write(attributes, name, new, at)
    if refused:
        change = change._replace(attributes=written)
    return _outcome(before, change, attributes, at, refused)


def updated(before: Entity, change: Change, at: str) -> Outcome:
    """Return the entity with attributes overwritten, or added if they do not exist (5.6.2 and 5.5.8).

    Scopes are overwritten if there are any, and ignored otherwise, as the standard requires.
    """
    attributes = dict(before.attributes)
    if change.scopes is not None and not before.scopes:
        change = change._replace(scopes=None)
    for name, instances in change.attributes.items():
        _write(attributes, name, instances, at)
    return _outcome(before, change, attributes, at, {})


def merged(before: Entity, change: Change, at: str, observed_at: str | None = None) -> Outcome:
    """Return the entity merged with `change`, value objects too (a JSON merge patch with NULL for null).

    `observed_at` is set on attributes that had one and do not get another one (clause 5.6.17).
    """
    attributes = dict(before.attributes)
    for name, instances in change.attributes.items():
        old = _by_dataset(before, name)
        mixed: list[Instance] = []
        for new in instances:
            was = old.get(dataset_of(new))
            if is_deletion(new):
                mixed.append(new)
                continue
            merged_one = _merge(was, new)
            if observed_at is not None and "observedAt" not in new and was and "observedAt" in was:
                merged_one["observedAt"] = observed_at
            mixed.append(merged_one)
        _write(attributes, name, mixed, at)
    return _outcome(before, change, attributes, at, {})


def partially_updated(before: Entity, name: str, part: Instance, at: str) -> Outcome:
    """Return the entity with members of one instance of the attribute `name` overwritten.

    Raises `KeyError` if the attribute has no instance with the datasetId of `part`.
    """
    was = _by_dataset(before, name)[dataset_of(part)]
    same_kind = was["type"] == part["type"]
    attributes = dict(before.attributes)
    _write(attributes, name, [{**was, **part} if same_kind else part], at)
    return _outcome(before, Change(None, (), {name: [part]}), attributes, at, {})


def without(before: Entity, name: str, dataset: str | None, at: str, *, every: bool = False) -> Outcome:
    """Return the entity without the attribute `name`, or without its instance of `dataset`.

    Raises `KeyError` if there is none.
    """
    instances = before.attributes[name]
    remaining = [] if every else [instance for instance in instances if dataset_of(instance) != dataset]
    if len(remaining) == len(instances):
        raise KeyError(name)
    attributes = dict(before.attributes)
    if remaining:
        attributes[name] = remaining
    else:
        del attributes[name]
    return _outcome(before, Change(None, (), {name: []}), attributes, at, {})


def pruned(before: Entity, names: frozenset[str], at: str, *, keep: bool) -> Outcome:
    """Return the entity without the attributes `names` (IRIs), or with no others (clause 5.6.21)."""
    gone = [name for name in before.attributes if (name in names) is not keep]
    if not gone:
        return Outcome(before, frozenset(), {})
    attributes = {name: before.attributes[name] for name in before.attributes if (name in names) is keep}
    return _outcome(before, Change(None, (), {name: [] for name in gone}), attributes, at, {})


def outlived(before: Entity, now_s: float, at: str) -> Outcome:
    """Return the entity without attributes that have expired at `now_s` (seconds since 1970)."""
    attributes: Attributes = {}
    touched: set[str] = set()
    for name, instances in before.attributes.items():
        remaining = [
            instance
            for instance in instances
            if "expiresAt" not in instance or _seconds(instance["expiresAt"]) > now_s
        ]
        if remaining:
            attributes[name] = remaining
            if len(remaining) < len(instances):
                touched.add(name)
    first = _first_end(before.expires_at, attributes)
    after = replace(before, attributes=attributes, modified_at=at, ends_at=first, rendered={})
    return Outcome(after, frozenset(touched), {})


def _outcome(
    before: Entity, change: Change, attributes: Attributes, at: str, refused: Mapping[str, str]
) -> Outcome:
    types = tuple(dict.fromkeys((*before.types, *change.types))) if change.types else before.types
    scopes = before.scopes if change.scopes is None else change.scopes
    expires_at = _end(before.expires_at, change)
    named = frozenset(change.attributes)
    if not named and types == before.types and scopes == before.scopes and expires_at == before.expires_at:
        return Outcome(before, named, refused)
    touched = named.intersection(attributes)  # deleted attributes are not part of the change
    first = expires_at
    if before.ends_at is not None:
        first = _first_end(expires_at, attributes)
    elif _first_end(None, change.attributes) is not None:
        first = _first_end(expires_at, {name: attributes.get(name, []) for name in named})
    after = Entity(before.id, types, attributes, before.created_at, at, before.seq, scopes, expires_at, first)
    return Outcome(after, touched, refused)


def _end(before: str | None, change: Change) -> str | None:
    """Return the expiry of the entity after a change."""
    if change.expires_at is None:
        return before
    return None if change.expires_at == NULL else change.expires_at


def _first_end(end: str | None, attributes: Attributes) -> str | None:
    """Return the earliest of `end` and the expiries of attributes, None if there is none."""
    for instances in attributes.values():
        for instance in instances:
            if "expiresAt" in instance:
                other: str = instance["expiresAt"]
                end = other if end is None else min(end, other, key=_seconds)
    return end


def _seconds(end: str) -> float:
    return moment(end) or 0.0


def _by_dataset(entity: Entity, name: str) -> dict[str | None, Instance]:
    return {dataset_of(instance): instance for instance in entity.attributes.get(name, ())}


def _write(attributes: Attributes, name: str, instances: Iterable[Instance], at: str) -> None:
    result = {dataset_of(instance): instance for instance in attributes.get(name, ())}
    for new in instances:
        dataset = dataset_of(new)
        if is_deletion(new):
            result.pop(dataset, None)
        else:
            result[dataset] = _stamp(_without_nulls(new), result.get(dataset), at)
    if result:
        attributes[name] = list(result.values())
    else:
        attributes.pop(name, None)


def _stamped(instances: Iterable[Instance], old: Mapping[str | None, Instance], at: str) -> list[Instance]:
    return [_stamp(instance, old.get(dataset_of(instance)), at) for instance in instances]


def _stamp(instance: Instance, old: Instance | None, at: str) -> Instance:
    return {**instance, "createdAt": old["createdAt"] if old else at, "modifiedAt": at}


def _merge(old: Instance | None, new: Instance) -> Instance:
    """Return an instance after a merge; a new instance may contain NULL too."""
    value_member = VALUE_MEMBER[new["type"]]
    if old is None or old["type"] != new["type"]:
        return {**new, value_member: _merge_values(None, new[value_member])}
    result = {**old, value_member: _merge_values(old[value_member], new[value_member])}
    for member, value in new.items():
        if ":" not in member or member not in old:
            if member != value_member:
                result[member] = value
            continue
        inner = {dataset_of(instance): instance for instance in old[member]}
        for item in value:
            was = inner.get(dataset_of(item))
            inner[dataset_of(item)] = item if is_deletion(item) else _merge(was, item)
        result[member] = list(inner.values())
    return result


def _merge_values(old: Any, new: Any, depth: int = 0) -> Any:
    if not isinstance(new, dict):
        return new
    if depth > MAX_NESTING:
        raise too_deep()
    result = dict(old) if isinstance(old, dict) else {}
    for key, value in new.items():
        if value == NULL:
            result.pop(key, None)
        else:
            result[key] = _merge_values(result.get(key), value, depth + 1)
    return result


def _without_nulls(instance: Instance) -> Instance:
    """Return the instance without members and sub-attributes that are NULL."""
    for member, value in instance.items():
        if value == NULL or (":" in member and _reports_deletion(value)):
            break
    else:
        return instance
    result: Instance = {}
    for member, value in instance.items():
        if value == NULL:
            continue
        if ":" not in member:
            result[member] = value
        elif remaining := [part for part in value if not is_deletion(part)]:
            result[member] = remaining
    return result


def _reports_deletion(instances: Iterable[Instance]) -> bool:
    return any(is_deletion(instance) for instance in instances)
