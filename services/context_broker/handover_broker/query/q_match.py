"""Compiles a query to a predicate on entities (clause 4.9 of ETSI GS CIM 009).

`q_index` has the part that indexes can evaluate.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final, Protocol

from handover_broker.model.entity import VALUE_MEMBER, Entity, Instance
from handover_broker.model.validation import moment
from handover_broker.query.patterns import fits
from handover_broker.query.q_grammar import (
    And,
    Compare,
    Exists,
    LinkPath,
    Literal,
    LiteralKind,
    Matches,
    Or,
    Path,
    Span,
    Term,
)

METADATA: Final = frozenset(
    {"observedAt", "unitCode", "datasetId", "createdAt", "modifiedAt", "valueType", "objectType", "lang"}
)
"""Members of an instance besides its value and its sub-attributes."""
ENTITY_TIMES: Final = {
    "createdAt": "created_at",
    "modifiedAt": "modified_at",
    "expiresAt": "expires_at",
}
"""Times of an entity that a query may use, and their members."""

_PLAIN: Final = (str, int, float, bool)
_TIME_OF_DAY: Final = re.compile(r"\d{2}:\d{2}:\d{2}(?:[.,]\d+)?Z?")

Lookup = Callable[[str], Entity | None]
"""Finds a linked entity by its id."""
Expand = Callable[[str], str]
Test = Callable[[Any], bool]
"""The test of a single value."""


def no_lookup(_: str) -> Entity | None:
    """Find no entity: for queries without links."""
    return None


class Predicate(Protocol):
    """A predicate on an entity; `lookup` finds its linked entities."""

    def __call__(self, entity: Entity, lookup: Lookup = no_lookup, /) -> bool:
        """Return whether the entity matches."""


class _Find(Protocol):
    def __call__(self, entity: Entity, lookup: Lookup, /) -> Iterator[Any]: ...


class LanguageMap(dict[str, Any]):
    """The texts of a LanguageProperty: a query matches any of them."""


class _Objects(list[Any]):
    """The objects of a Relationship: they can be equal or not, but neither greater nor match a pattern."""


def predicate(term: Term, expand: Expand) -> Predicate:
    """Return the predicate of `term`; `expand` returns the IRIs of names."""
    if isinstance(term, And | Or):
        return _combined(term, expand)
    if isinstance(term, Exists):
        find = finder(term.path, expand)
        return lambda entity, lookup=no_lookup: any(True for _ in find(entity, lookup))
    if isinstance(term, Matches):
        return _matching(term, expand)
    return _comparing(term, expand)


def finder(path: Path, expand: Expand) -> _Find:
    """Return a function that finds all values at `path`: of every instance, in every list and link."""
    first, *below = path.names
    trail, link = path.trail, path.link
    if first in ENTITY_TIMES and not below and link is None:
        member = ENTITY_TIMES[first]
        return lambda entity, _: iter(() if (at := getattr(entity, member)) is None else (at,))
    attribute = expand(first)
    steps = [(name, expand(name)) for name in below]
    if link is not None:
        return _linked_finder(attribute, steps, link, expand)
    if not below and not trail:
        return lambda entity, _: map(_said, entity.attributes.get(attribute, ()))

    def find(entity: Entity, _: Lookup) -> Iterator[Any]:
        for value in _descend(entity.attributes.get(attribute, ()), steps):
            yield from _along(value, trail)

    return find


def leaves(value: Any) -> Iterator[Any]:
    """Yield a value, or the elements of a list."""
    if isinstance(value, list):
        for item in value:
            yield from leaves(item)
    else:
        yield value


def comparable(value: Any) -> Iterator[Any]:
    """Yield the comparable values in a value: itself, the elements of a list, a typed value, texts."""
    for leaf in leaves(value):
        if isinstance(leaf, LanguageMap):
            yield from leaves(list(leaf.values()))
        elif isinstance(leaf, dict):
            yield from leaves(leaf.get("@value", []))
        else:
            yield leaf


def _combined(term: And | Or, expand: Expand) -> Predicate:
    parts = tuple(predicate(part, expand) for part in term.terms)
    wanted = isinstance(term, Or)

    def holds(entity: Entity, lookup: Lookup = no_lookup) -> bool:
        for part in parts:  # no helper functions, since this runs for every candidate
            if part(entity, lookup) is wanted:
                return wanted
        return not wanted

    return holds


def _linked_finder(attribute: str, steps: list[tuple[str, str]], link: LinkPath, expand: Expand) -> _Find:
    types = frozenset(map(expand, link.types))
    find = finder(link.path, expand)

    def follow(entity: Entity, lookup: Lookup) -> Iterator[Any]:
        for value in _descend(entity.attributes.get(attribute, ()), steps):
            if isinstance(value, _Objects):
                for target in dict.fromkeys(leaves(value)):
                    linked = lookup(target)
                    if linked is not None and (not types or not types.isdisjoint(linked.types)):
                        yield from find(linked, lookup)

    return follow


def _descend(instances: Iterable[Instance], steps: list[tuple[str, str]]) -> Iterator[Any]:
    if not steps:
        for instance in instances:
            yield _said(instance)
        return
    (name, iri), *rest = steps
    for instance in instances:
        if name in METADATA and not rest:
            if name in instance:
                yield instance[name]
        else:
            yield from _descend(instance.get(iri, ()), rest)


def _said(instance: Instance) -> Any:
    kind = instance["type"]
    value = instance[VALUE_MEMBER[kind]]
    if kind in {"Property", "GeoProperty"}:
        return value
    if kind == "Relationship":
        return _Objects(value if isinstance(value, list) else (value,))
    if kind == "ListRelationship":
        return _Objects(part["object"] for part in value)
    return LanguageMap(value) if kind == "LanguageProperty" and isinstance(value, dict) else value


def _along(value: Any, trail: tuple[str, ...]) -> Iterator[Any]:
    if not trail:
        yield value
        return
    step, rest = trail[0], trail[1:]
    if isinstance(value, list):
        if step.isdecimal():
            yield from _along(value[int(step)], rest) if len(step) < 10 and int(step) < len(value) else ()
            return
        for item in value:
            yield from _along(item, trail)
    elif isinstance(value, dict):
        if step in value:
            yield from _along(value[step], rest)
        elif step == "*":
            for item in value.values():
                yield from _along(item, rest)


def _matching(term: Matches, expand: Expand) -> Predicate:
    find = finder(term.path, expand)
    expected, negated = term.pattern, term.negated

    def matches(entity: Entity, lookup: Lookup = no_lookup) -> bool:
        texts = [
            leaf
            for value in find(entity, lookup)
            if not isinstance(value, _Objects)
            for leaf in comparable(value)
            if isinstance(leaf, str)
        ]
        return bool(texts) and any(fits(expected, text) for text in texts) is not negated

    return matches


def _comparing(term: Compare, expand: Expand) -> Predicate:
    find = finder(term.path, expand)
    test = _any_of([_test(term.operator, value, expand) for value in term.values])
    negated = term.operator == "!="
    of_objects = term.operator in {"==", "!="}

    def compares(entity: Entity, lookup: Lookup = no_lookup) -> bool:
        has_match = False
        for value in find(entity, lookup):
            has_match = True
            if isinstance(value, _PLAIN):
                if test(value):
                    return not negated
            elif (of_objects or not isinstance(value, _Objects)) and any(map(test, comparable(value))):
                return not negated
        return has_match and negated

    return compares


def _any_of(tests: list[Test]) -> Test:
    if len(tests) == 1:
        return tests[0]
    return lambda leaf: any(test(leaf) for test in tests)


def _test(operator: str, value: Literal | Span, expand: Expand) -> Test:
    """Return the test of a single value; the caller of != negates the result for all of them."""
    if isinstance(value, Span):
        low, high = _test(">=", value.low, expand), _test("<=", value.high, expand)
        return lambda leaf: low(leaf) and high(leaf)
    wanted = expand(str(value.value)) if value.kind is LiteralKind.TERM else value.value
    if value.kind is LiteralKind.TIME:
        return _time_test(_RELATIONS[operator], wanted)
    if operator in {"==", "!="}:
        return _equality_test(value.kind, wanted)
    relation = _RELATIONS[operator]
    if value.kind is LiteralKind.TRUTH:
        return lambda leaf: isinstance(leaf, bool) and relation(leaf, wanted)
    if value.kind is LiteralKind.NUMBER:
        return lambda leaf: (
            isinstance(leaf, int | float) and not isinstance(leaf, bool) and relation(leaf, wanted)
        )
    return lambda leaf: isinstance(leaf, str) and relation(leaf, wanted)


def _equality_test(kind: LiteralKind, wanted: str | float | bool) -> Test:
    """Return the most frequent test, as simple as possible. True is not 1 here."""
    if kind is LiteralKind.TRUTH:
        return lambda leaf: leaf is wanted
    if kind is LiteralKind.NUMBER:
        return lambda leaf: leaf == wanted and not isinstance(leaf, bool)
    return lambda leaf: bool(leaf == wanted)


def _time_test(relation: Callable[[Any, Any], bool], wanted: str | float) -> Test:
    if isinstance(wanted, str):
        of_day = _of_day(wanted)
        return lambda leaf: (
            isinstance(leaf, str)
            and _TIME_OF_DAY.fullmatch(leaf) is not None
            and relation(_of_day(leaf), of_day)
        )
    return lambda leaf: isinstance(leaf, str) and (at := moment(leaf)) is not None and relation(at, wanted)


def _of_day(text: str) -> str:
    return text.rstrip("Z").replace(",", ".")


_RELATIONS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "==": lambda a, b: a == b,
    "!=": lambda a, b: a == b,
    ">": lambda a, b: a > b,
    "<": lambda a, b: a < b,
    ">=": lambda a, b: a >= b,
    "<=": lambda a, b: a <= b,
}
