"""The form in which entities are copied and compared: normalized, with IRIs as names.

`createdAt`, `modifiedAt`, `deletedAt` and `instanceId` are the broker's own and left out. The three places of
clause 4.7.1 keep their short names: no @context changes them, and some brokers know them by these only.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from itertools import repeat
from typing import Any, Final, Protocol

VALUE_MEMBER: Final[Mapping[str, str]] = {
    "Property": "value",
    "GeoProperty": "value",
    "Relationship": "object",
    "LanguageProperty": "languageMap",
    "JsonProperty": "json",
    "VocabProperty": "vocab",
    "ListProperty": "valueList",
    "ListRelationship": "objectList",
}
_VALUE_MEMBERS: Final = frozenset(VALUE_MEMBER.values())
_PLACES: Final = frozenset({"location", "observationSpace", "operationSpace"})
_FROM_THE_BROKER: Final = frozenset({"createdAt", "modifiedAt", "deletedAt", "instanceId"})
_METADATA: Final = frozenset(
    {"type", "observedAt", "unitCode", "datasetId", "valueType", "objectType", "lang", "expiresAt",
     "entityIdSealed", "entityTypeSealed"}
)  # fmt: skip
_TERM_MEMBERS: Final = frozenset({"vocab", "valueType", "objectType", "entityTypeSealed"})
"""Members whose values are names."""
_UNFIT_IN_NAMES: Final = re.compile(r"""[\s"'()\[\]{}@=;,|<>]""")
_TIMES: Final = frozenset({"observedAt", "expiresAt"})
_DEFAULT_INSTANCE: Final = "@none"

Json = dict[str, Any]


class Terms(Protocol):
    """The names of an @context."""

    def expand(self, term: str) -> str:
        """Return the IRI of a name."""
        ...


def expanded(entity: Mapping[str, Any], terms: Terms) -> Json:
    """Return a normalized entity, whose names are in `terms`, with IRIs as names."""
    result: Json = {}
    for name, value in entity.items():
        if name == "@context" or (name in _FROM_THE_BROKER and isinstance(value, str)):
            continue
        if name == "type":
            result[name] = _expanded_names(value, terms)
        elif name == "id" or (name in {"scope", "expiresAt"} and not _is_attribute(value)):
            result[name] = value
        else:
            result[_name(name, terms)] = _attribute(value, terms)
    return result


def with_terms(entity: Mapping[str, Any]) -> Json:
    """Return an expanded entity for a request: itself, or with an @context for IRIs that are not written.

    Brokers refuse names with characters that have a meaning in queries, though a term may stand for them.
    """
    terms = _RequestTerms()
    renamed = expanded(entity, terms)
    if not terms.names:
        return dict(entity)
    return {"@context": {term: iri for iri, term in terms.names.items()}, **renamed}


class _RequestTerms:
    """Terms for the IRIs that cannot be written as names; the others stay."""

    def __init__(self) -> None:
        self.names: dict[str, str] = {}

    def expand(self, term: str) -> str:
        """Return the term of an IRI, or the IRI."""
        if not _UNFIT_IN_NAMES.search(term):
            return term
        return self.names.setdefault(term, f"copied{len(self.names)}")


def types_of(entity: Mapping[str, Any]) -> list[str]:
    """Return the types of an entity."""
    kinds = entity.get("type")
    return [str(kind) for kind in kinds] if isinstance(kinds, list) else [str(kinds)]


def has_instances(entity: Mapping[str, Any]) -> bool:
    """Return whether an attribute of the entity has several instances (`datasetId`), or one with a name."""
    return any(
        isinstance(value, list) or (isinstance(value, dict) and "datasetId" in value)
        for name, value in entity.items()
        if name not in {"type", "scope"}
    )


def _name(name: str, terms: Terms) -> str:
    return name if name in _PLACES else terms.expand(name)


def _expanded_names(value: Any, terms: Terms) -> Any:
    if isinstance(value, list):
        return [_expanded_names(name, terms) for name in value]
    return terms.expand(value) if isinstance(value, str) else value


def _attribute(value: Any, terms: Terms) -> Any:
    if isinstance(value, list):
        return [_instance(instance, terms) for instance in value]
    return _instance(value, terms)


def _instance(instance: Any, terms: Terms) -> Any:
    if not isinstance(instance, dict):
        return instance
    value_member = VALUE_MEMBER.get(str(instance.get("type")))
    result: Json = {}
    for member, value in instance.items():
        if member in _FROM_THE_BROKER and isinstance(value, str):
            continue
        if member == value_member or (member in _METADATA and not _is_attribute(value)):
            result[member] = _expanded_names(value, terms) if member in _TERM_MEMBERS else value
        else:
            result[_name(member, terms)] = _attribute(value, terms)
    return result


def _is_attribute(value: Any) -> bool:
    """Return whether the value of a reserved member is an attribute, whose IRI has that short name."""
    instances = value if isinstance(value, list) else [value]
    return bool(instances) and all(
        isinstance(instance, dict) and "type" in instance for instance in instances
    )


@dataclass(frozen=True, slots=True)
class Difference:
    """A member of an entity that two brokers do not have equally; None stands for an absent value."""

    member: str
    source: Any
    target: Any


def differences(source: Mapping[str, Any], target: Mapping[str, Any]) -> Iterator[Difference]:
    """Yield in what two expanded entities differ: by attribute, and by instance of it.

    The order of types and of instances has no meaning, and numbers and times are compared by value.
    """
    for member in (*source, *(name for name in target if name not in source)):
        first, second = source.get(member), target.get(member)
        if member == "type":
            if set(types_of(source)) != set(types_of(target)):
                yield Difference(member, first, second)
        elif member in {"id", "scope", "expiresAt"}:
            instances, other = _as_list(first), _as_list(second)
            if len(instances) != len(other) or not all(map(_is_same, instances, other, repeat(member))):
                yield Difference(member, first, second)
        else:
            before, after = _instances(first), _instances(second)
            for dataset in (*before, *(name for name in after if name not in before)):
                if not _is_same(before.get(dataset), after.get(dataset), member):
                    name = member if dataset == _DEFAULT_INSTANCE else f"{member} ({dataset})"
                    yield Difference(name, before.get(dataset), after.get(dataset))


def _as_list(value: Any) -> list[Any]:
    if value is None:
        return []
    return value if isinstance(value, list) else [value]


def _instances(value: Any) -> dict[str, Any]:
    """Return the instances of an attribute by datasetId."""
    return {
        str(instance.get("datasetId", _DEFAULT_INSTANCE))
        if isinstance(instance, dict)
        else _DEFAULT_INSTANCE: instance
        for instance in _as_list(value)
    }


def _is_same(first: Any, second: Any, member: str = "") -> bool:
    """Compare members of entities, whose times are compared as such, and sub-attributes."""
    if isinstance(first, dict) and isinstance(second, dict) and member not in _VALUE_MEMBERS:
        return first.keys() == second.keys() and all(
            _is_same(value, second[name], name) for name, value in first.items()
        )
    if member in _TIMES and isinstance(first, str) and isinstance(second, str):
        return _instant(first) == _instant(second)
    return _is_same_value(first, second)


def _is_same_value(first: Any, second: Any) -> bool:
    """Compare JSON values: 1 is 1.0, and not true."""
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(
            _is_same_value(value, second[name]) for name, value in first.items()
        )
    if isinstance(first, list) and isinstance(second, list):
        return len(first) == len(second) and all(map(_is_same_value, first, second))
    if isinstance(first, bool) or isinstance(second, bool):
        return first is second
    return bool(first == second)


def _instant(text: str) -> datetime | str:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return text
