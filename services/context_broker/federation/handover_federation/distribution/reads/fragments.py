"""Merges the fragments of one entity from several sources (clauses 4.3.6 and 4.5.5.3).

The newest instance of each attribute counts, and one without a time loses. Ties are broken by a fixed rule,
so that the order of responses never matters.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import orjson

from handover_broker.model.entity import Attributes, Entity, Instance, Terms, dataset_of
from handover_broker.model.entity_parser import expand, read_entity
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import moment, timestamp_now

_TIMES: Final = ("createdAt", "modifiedAt")
_UNKNOWN: Final = float("-inf")


@dataclass(frozen=True, slots=True)
class Fragment:
    """The part of an entity that one source returned.

    `rank` breaks ties, the lowest wins: the broker's own fragment has (0, ""), the others their mode and the
    id of their registration. `fills_gaps`: the fragment is from an auxiliary source.
    """

    entity: Entity
    rank: tuple[int, str]
    fills_gaps: bool = False


def merged(fragments: Iterable[Fragment]) -> Entity:
    """Return the entity merged from all fragments (at least one, all with one id)."""
    ordered = sorted(fragments, key=_strength)
    if len(ordered) == 1:
        return ordered[0].entity
    first = ordered[0].entity
    primary = [fragment for fragment in ordered if not fragment.fills_gaps]
    attributes = _merged_attributes(primary)
    for name, instances in _merged_attributes(
        fragment for fragment in ordered if fragment.fills_gaps
    ).items():
        attributes.setdefault(name, instances)
    entities = [fragment.entity for fragment in ordered]
    return Entity(
        first.id,
        tuple(dict.fromkeys(kind for entity in entities for kind in entity.types)),
        attributes,
        min(entity.created_at for entity in entities),
        max(entity.modified_at for entity in entities),
        min(entity.seq for entity in entities),
        tuple(dict.fromkeys(scope for entity in entities for scope in entity.scopes)),
        next((entity.expires_at for entity in entities if entity.expires_at is not None), None),
    )


def without_expired(document: Any, now_s: float) -> Any:
    """Return the document of an entity without expired parts; None if the entity itself has expired
    (4.22)."""
    if not isinstance(document, dict):
        return document
    if _is_over(document, now_s):
        return None
    valid: dict[str, Any] = {}
    for name, value in document.items():
        if isinstance(value, list) and any(_is_over(instance, now_s) for instance in value):
            valid[name] = [instance for instance in value if not _is_over(instance, now_s)]
        elif name in _NO_ATTRIBUTES or not _is_over(value, now_s):
            valid[name] = value
    return {name: value for name, value in valid.items() if value != [] or document[name] == []}


def _is_over(value: Any, now_s: float) -> bool:
    ends = value.get("expiresAt") if isinstance(value, dict) else None
    at_s = moment(ends) if isinstance(ends, str) else None
    return at_s is not None and at_s <= now_s


def read_fragment(document: Any, terms: Terms, seq: int) -> Entity:
    """Return the entity in a document of a source, with the times in it; raise a problem if it is invalid.

    `seq` is its place in the order of entities, as it was not created here.
    """
    if not isinstance(document, Mapping):
        raise bad_request_data("an entity is a JSON object")
    change = read_entity({name: value for name, value in document.items() if name != "@context"}, terms)
    entity_id = change.id or ""
    attributes = dict(change.attributes)
    for name, attribute in document.items():
        if name not in _NO_ATTRIBUTES and (iri := expand(name, terms)) in attributes:
            attributes[iri] = _with_times(attributes[iri], attribute)
    now = timestamp_now()
    created = _time(document.get("createdAt")) or now
    return Entity(
        entity_id,
        change.types,
        attributes,
        created,
        _time(document.get("modifiedAt")) or created,
        seq,
        change.scopes or (),
        change.expires_at,
    )


_NO_ATTRIBUTES: Final = frozenset(
    {"id", "@id", "type", "@type", "@context", "scope", "expiresAt", "createdAt", "modifiedAt", "deletedAt"}
)


def _with_times(instances: list[Instance], attribute: Any) -> list[Instance]:
    value = attribute if isinstance(attribute, list) else [attribute]
    if len(value) != len(instances):
        return instances
    return [
        {**instance, **{name: part[name] for name in _TIMES if _time(part.get(name))}}
        if isinstance(part, Mapping)
        else instance
        for instance, part in zip(instances, value, strict=True)
    ]


def _time(text: Any) -> str | None:
    return text if isinstance(text, str) and moment(text) is not None else None


def _strength(fragment: Fragment) -> tuple[bool, tuple[int, str], bytes]:
    return fragment.fills_gaps, fragment.rank, _written(fragment.entity.attributes)


def _merged_attributes(fragments: Iterable[Fragment]) -> Attributes:
    best: dict[str, dict[str | None, tuple[Any, Instance]]] = {}
    for fragment in fragments:
        for name, instances in fragment.entity.attributes.items():
            by_dataset = best.setdefault(name, {})
            for instance in instances:
                dataset = dataset_of(instance)
                age = _age(instance)
                if dataset not in by_dataset or age > by_dataset[dataset][0]:
                    by_dataset[dataset] = age, instance
    return {name: [instance for _, instance in by_dataset.values()] for name, by_dataset in best.items()}


def _age(instance: Instance) -> tuple[float, float]:
    """Return the age of an instance for comparison: its observedAt, then its modifiedAt.

    Fragments come in the order of their rank, so that the first of equals stays.
    """
    return _moment(instance.get("observedAt")), _moment(instance.get("modifiedAt"))


def _moment(text: Any) -> float:
    at = moment(text) if isinstance(text, str) else None
    return _UNKNOWN if at is None else at


def _written(attributes: Attributes) -> bytes:
    return orjson.dumps(attributes, option=orjson.OPT_SORT_KEYS)
