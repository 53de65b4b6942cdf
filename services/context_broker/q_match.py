"""A query made into a question that can be put to an entity, and the plain equalities an index can answer."""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from services.context_broker.entity import SAYS, Entity, Instance
from services.context_broker.patterns import fits
from services.context_broker.q_grammar import (
    And,
    Compare,
    Exists,
    Kind,
    Literal,
    Matches,
    Or,
    Path,
    Span,
    Term,
)
from services.context_broker.words import moment

Predicate = Callable[[Entity], bool]
Scalar = str | float | bool
_METADATA: Final = frozenset(
    {"observedAt", "unitCode", "datasetId", "createdAt", "modifiedAt", "valueType", "objectType", "lang"}
)


class _Wordings(dict[str, Any]):
    """What a LanguageProperty says: any of its wordings may be what is asked for."""


@dataclass(frozen=True, slots=True)
class Equality:
    """What must hold of every hit: the attribute (IRI) has, or holds in its list, one of `values`."""

    attribute: str
    values: frozenset[Scalar]


def predicate(term: Term, expand: Callable[[str], str]) -> Predicate:
    """Return the question that `term` puts to an entity; `expand` gives names their IRIs."""
    if isinstance(term, And):
        parts = tuple(predicate(part, expand) for part in term.terms)
        return lambda entity: all(part(entity) for part in parts)
    if isinstance(term, Or):
        parts = tuple(predicate(part, expand) for part in term.terms)
        return lambda entity: any(part(entity) for part in parts)
    if isinstance(term, Exists):
        find = _finder(term.path, expand)
        return lambda entity: any(True for _ in find(entity))
    if isinstance(term, Matches):
        return _matching(term, expand)
    return _comparing(term, expand)


def equality(term: Term, expand: Callable[[str], str]) -> Equality | None:
    """Return an equality that every hit of `term` fulfils, None when an index cannot help."""
    if isinstance(term, And):
        return next((found for part in term.terms if (found := equality(part, expand))), None)
    if not isinstance(term, Compare) or term.operator != "==":
        return None
    if len(term.path.names) != 1 or term.path.trail or term.path.names[0] in _METADATA:
        return None
    values: set[Scalar] = set()
    for value in term.values:
        if isinstance(value, Span) or value.kind is Kind.TIME:
            return None
        values.add(value.value)
        if isinstance(value.value, str):
            values.add(expand(value.value))
    return Equality(expand(term.path.names[0]), frozenset(values))


def scalars(instances: Iterable[Instance]) -> Iterator[Scalar]:
    """Yield every plain value that an equality may be looking for."""
    for instance in instances:
        for said in _leaves(instance[SAYS[instance["type"]]]):
            yield from _scalars_of(said)


def _scalars_of(said: Any) -> Iterator[Scalar]:
    if isinstance(said, str | int | float):
        yield said
    elif isinstance(said, dict):
        for value in said.values():
            for leaf in _leaves(value):
                if isinstance(leaf, str | int | float):
                    yield leaf


def _leaves(said: Any) -> Iterator[Any]:
    """Yield a value, or the values in its list."""
    if isinstance(said, list):
        for one in said:
            yield from _leaves(one)
    else:
        yield said


def _finder(path: Path, expand: Callable[[str], str]) -> Callable[[Entity], Iterator[Any]]:
    """Return what finds all values at `path`: of every instance, and along every list."""
    first, *below = path.names
    trail = path.trail
    steps = [(name, expand(name)) for name in below]
    if first in {"createdAt", "modifiedAt"} and not below:
        at_entity = "created_at" if first == "createdAt" else "modified_at"
        return lambda entity: iter((getattr(entity, at_entity),))
    attribute = expand(first)

    def find(entity: Entity) -> Iterator[Any]:
        found = _descend(entity.attributes.get(attribute, ()), steps)
        for value in found:
            yield from _along(value, trail)

    return find


def _descend(instances: Iterable[Instance], steps: list[tuple[str, str]]) -> Iterator[Any]:
    if not steps:
        for instance in instances:
            yield _said(instance)
        return
    (name, iri), *rest = steps
    for instance in instances:
        if name in _METADATA and not rest:
            if name in instance:
                yield instance[name]
        else:
            yield from _descend(instance.get(iri, ()), rest)


def _said(instance: Instance) -> Any:
    kind = instance["type"]
    said = instance[SAYS[kind]]
    if kind == "ListRelationship":
        return [one["object"] for one in said]
    return _Wordings(said) if kind == "LanguageProperty" else said


def _along(value: Any, trail: tuple[str, ...]) -> Iterator[Any]:
    if not trail:
        yield value
    elif isinstance(value, list):
        for one in value:
            yield from _along(one, trail)
    elif isinstance(value, dict):
        if trail[0] == "*":
            for one in value.values():
                yield from _along(one, trail[1:])
        elif trail[0] in value:
            yield from _along(value[trail[0]], trail[1:])


def _matching(term: Matches, expand: Callable[[str], str]) -> Predicate:
    find = _finder(term.path, expand)
    expected, negated = term.pattern, term.negated

    def matches(entity: Entity) -> bool:
        found = list(find(entity))
        if not found:
            return False
        return any(_any_text_fits(expected, value) for value in found) is not negated

    return matches


def _any_text_fits(expected: re.Pattern[str], value: Any) -> bool:
    return any(isinstance(leaf, str) and fits(expected, leaf) for leaf in _comparable(value))


def _comparing(term: Compare, expand: Callable[[str], str]) -> Predicate:
    find = _finder(term.path, expand)
    tests = tuple(_test(term.operator, value, expand) for value in term.values)
    negated = term.operator == "!="

    def compares(entity: Entity) -> bool:
        found = list(find(entity))
        if not found:
            return False
        held = any(test(leaf) for value in found for leaf in _comparable(value) for test in tests)
        return held is not negated

    return compares


def _comparable(value: Any) -> Iterator[Any]:
    """Yield what of a value can be compared: itself, the items of a list, a typed value, wordings."""
    for leaf in _leaves(value):
        if isinstance(leaf, _Wordings):
            yield from _leaves(list(leaf.values()))
        elif isinstance(leaf, dict):
            yield from _leaves(leaf.get("@value", []))
        else:
            yield leaf


def _test(operator: str, value: Literal | Span, expand: Callable[[str], str]) -> Callable[[Any], bool]:
    if isinstance(value, Span):
        low, high = _test(">=", value.low, expand), _test("<=", value.high, expand)
        return lambda leaf: low(leaf) and high(leaf)
    relation = _RELATIONS[operator]
    wanted = value.value
    if value.kind is Kind.TRUTH:
        return lambda leaf: isinstance(leaf, bool) and relation(leaf, wanted)
    if value.kind is Kind.NUMBER:
        return lambda leaf: (
            isinstance(leaf, int | float) and not isinstance(leaf, bool) and relation(leaf, wanted)
        )
    if value.kind is Kind.TIME and not isinstance(wanted, str):
        return lambda leaf: (
            isinstance(leaf, str) and (at := moment(leaf)) is not None and relation(at, wanted)
        )
    also = expand(wanted) if isinstance(wanted, str) and operator in {"==", "!="} else wanted
    return lambda leaf: isinstance(leaf, str) and (relation(leaf, wanted) or leaf == also)


_RELATIONS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "==": lambda a, b: a == b,
    "!=": lambda a, b: a == b,  # whoever uses it turns the answer round, over all values at once
    ">": lambda a, b: a > b,
    "<": lambda a, b: a < b,
    ">=": lambda a, b: a >= b,
    "<=": lambda a, b: a <= b,
}
