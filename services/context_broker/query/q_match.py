"""A query made into a question that can be put to an entity (clause 4.9 of ETSI GS CIM 009).

What an index can answer of it is told by `q_index`.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final, Protocol

from services.context_broker.model.entity import SAYS, Entity, Instance
from services.context_broker.model.validation import moment
from services.context_broker.query.patterns import fits
from services.context_broker.query.q_grammar import (
    And,
    Compare,
    Exists,
    Kind,
    Link,
    Literal,
    Matches,
    Or,
    Path,
    Span,
    Term,
)

METADATA: Final = frozenset(
    {"observedAt", "unitCode", "datasetId", "createdAt", "modifiedAt", "valueType", "objectType", "lang"}
)
"""What an instance of an attribute has beside its value and its attributes."""
ENTITY_TIMES: Final = {
    "createdAt": "created_at",
    "modifiedAt": "modified_at",
    "expiresAt": "expires_at",
}
"""Times of an entity that a query may ask for, and where an entity has them."""

_PLAIN: Final = (str, int, float, bool)
_TIME_OF_DAY: Final = re.compile(r"\d{2}:\d{2}:\d{2}(?:[.,]\d+)?Z?")

Lookup = Callable[[str], Entity | None]
"""Finds the entity that a relationship leads to, by its id."""
Expand = Callable[[str], str]
Test = Callable[[Any], bool]
"""What a single value is compared by."""


def nobody(_: str) -> Entity | None:
    """Find no entity: for those who follow no relationships."""
    return None


class Predicate(Protocol):
    """A question that is put to an entity; `lookup` finds the entities that its relationships lead to."""

    def __call__(self, entity: Entity, lookup: Lookup = nobody, /) -> bool:
        """Say whether the answer is yes."""


class _Find(Protocol):
    def __call__(self, entity: Entity, lookup: Lookup, /) -> Iterator[Any]: ...


class Wordings(dict[str, Any]):
    """What a LanguageProperty says: any of its wordings may be what is asked for."""


class _Objects(list[Any]):
    """What a Relationship leads to: these are the same or not, but never greater, and fit no pattern."""


def predicate(term: Term, expand: Expand) -> Predicate:
    """Return the question that `term` puts to an entity; `expand` gives names their IRIs."""
    if isinstance(term, And | Or):
        return _combined(term, expand)
    if isinstance(term, Exists):
        find = finder(term.path, expand)
        return lambda entity, lookup=nobody: any(True for _ in find(entity, lookup))
    if isinstance(term, Matches):
        return _matching(term, expand)
    return _comparing(term, expand)


def finder(path: Path, expand: Expand) -> _Find:
    """Return what finds all values at `path`: of every instance, along every list and every link."""
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


def leaves(said: Any) -> Iterator[Any]:
    """Yield a value, or the values in its list."""
    if isinstance(said, list):
        for one in said:
            yield from leaves(one)
    else:
        yield said


def comparable(value: Any) -> Iterator[Any]:
    """Yield what of a value can be compared: itself, the items of a list, a typed value, wordings."""
    for leaf in leaves(value):
        if isinstance(leaf, Wordings):
            yield from leaves(list(leaf.values()))
        elif isinstance(leaf, dict):
            yield from leaves(leaf.get("@value", []))
        else:
            yield leaf


def _combined(term: And | Or, expand: Expand) -> Predicate:
    parts = tuple(predicate(part, expand) for part in term.terms)
    wanted = isinstance(term, Or)

    def holds(entity: Entity, lookup: Lookup = nobody) -> bool:
        for part in parts:  # written out, since this is asked of every candidate
            if part(entity, lookup) is wanted:
                return wanted
        return not wanted

    return holds


def _linked_finder(attribute: str, steps: list[tuple[str, str]], link: Link, expand: Expand) -> _Find:
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
    said = instance[SAYS[kind]]
    if kind in {"Property", "GeoProperty"}:
        return said
    if kind == "Relationship":
        return _Objects(said if isinstance(said, list) else (said,))
    if kind == "ListRelationship":
        return _Objects(one["object"] for one in said)
    return Wordings(said) if kind == "LanguageProperty" and isinstance(said, dict) else said


def _along(value: Any, trail: tuple[str, ...]) -> Iterator[Any]:
    if not trail:
        yield value
        return
    step, rest = trail[0], trail[1:]
    if isinstance(value, list):
        if step.isdecimal():
            yield from _along(value[int(step)], rest) if len(step) < 10 and int(step) < len(value) else ()
            return
        for one in value:
            yield from _along(one, trail)
    elif isinstance(value, dict):
        if step in value:
            yield from _along(value[step], rest)
        elif step == "*":
            for one in value.values():
                yield from _along(one, rest)


def _matching(term: Matches, expand: Expand) -> Predicate:
    find = finder(term.path, expand)
    expected, negated = term.pattern, term.negated

    def matches(entity: Entity, lookup: Lookup = nobody) -> bool:
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

    def compares(entity: Entity, lookup: Lookup = nobody) -> bool:
        found = False
        for value in find(entity, lookup):
            found = True
            if isinstance(value, _PLAIN):
                if test(value):
                    return not negated
            elif (of_objects or not isinstance(value, _Objects)) and any(map(test, comparable(value))):
                return not negated
        return found and negated

    return compares


def _any_of(tests: list[Test]) -> Test:
    if len(tests) == 1:
        return tests[0]
    return lambda leaf: any(test(leaf) for test in tests)


def _test(operator: str, value: Literal | Span, expand: Expand) -> Test:
    """Return what a single value is compared by; whoever asks for != turns the answer round for them all."""
    if isinstance(value, Span):
        low, high = _test(">=", value.low, expand), _test("<=", value.high, expand)
        return lambda leaf: low(leaf) and high(leaf)
    wanted = expand(str(value.value)) if value.kind is Kind.TERM else value.value
    if value.kind is Kind.TIME:
        return _time_test(_RELATIONS[operator], wanted)
    if operator in {"==", "!="}:
        return _equality_test(value.kind, wanted)
    relation = _RELATIONS[operator]
    if value.kind is Kind.TRUTH:
        return lambda leaf: isinstance(leaf, bool) and relation(leaf, wanted)
    if value.kind is Kind.NUMBER:
        return lambda leaf: (
            isinstance(leaf, int | float) and not isinstance(leaf, bool) and relation(leaf, wanted)
        )
    return lambda leaf: isinstance(leaf, str) and relation(leaf, wanted)


def _equality_test(kind: Kind, wanted: str | float | bool) -> Test:
    """Return the test that most queries are made of, as plain as can be. True is not 1 here."""
    if kind is Kind.TRUTH:
        return lambda leaf: leaf is wanted
    if kind is Kind.NUMBER:
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
