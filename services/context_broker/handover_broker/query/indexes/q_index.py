"""Conditions that every hit of a query fulfils, and that an index can evaluate.

The whole query is then evaluated for the entities that the indexes return.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import inf
from typing import Any

from handover_broker.model.entity import VALUE_MEMBER, Instance
from handover_broker.query.q_grammar import And, Compare, LiteralKind, Span, Term
from handover_broker.query.q_match import METADATA, leaves

Scalar = str | float | bool


@dataclass(frozen=True, slots=True)
class Equality:
    """The attribute (IRI) has one of `values`, or a list with one of them."""

    attribute: str
    values: frozenset[Scalar]


@dataclass(frozen=True, slots=True)
class Range:
    """The attribute (IRI) has a number from `low` to `high`, or a list with one; both included."""

    attribute: str
    low: float
    high: float


Condition = Equality | Range


def conditions(term: Term, expand: Callable[[str], str]) -> tuple[Condition, ...]:
    """Return conditions that every hit of `term` fulfils; none when an index does not help."""
    if isinstance(term, And):
        return tuple(condition for part in term.terms for condition in conditions(part, expand))
    if not isinstance(term, Compare) or len(term.path.names) != 1:
        return ()
    if term.path.trail or term.path.link is not None or term.path.names[0] in METADATA:
        return ()
    single = _condition(term, expand)
    return () if single is None else (single,)


def _condition(term: Compare, expand: Callable[[str], str]) -> Condition | None:
    attribute = expand(term.path.names[0])
    if term.operator != "==":
        return _bounded(attribute, term)
    if len(term.values) == 1 and isinstance(span := term.values[0], Span):
        low, high = span.low.value, span.high.value
        if (
            span.low.kind is LiteralKind.NUMBER
            and isinstance(low, int | float)
            and isinstance(high, int | float)
        ):
            return Range(attribute, low, high)
        return None
    values: set[Scalar] = set()
    for value in term.values:
        if isinstance(value, Span) or value.kind is LiteralKind.TIME:
            return None
        values.add(expand(str(value.value)) if value.kind is LiteralKind.TERM else value.value)
    return Equality(attribute, frozenset(values))


def _bounded(attribute: str, term: Compare) -> Range | None:
    value = term.values[0]
    if (
        isinstance(value, Span)
        or value.kind is not LiteralKind.NUMBER
        or not isinstance(value.value, int | float)
    ):
        return None
    if term.operator in {">", ">="}:
        return Range(attribute, value.value, inf)
    if term.operator in {"<", "<="}:
        return Range(attribute, -inf, value.value)
    return None


def scalars(instances: Iterable[Instance]) -> Iterator[Scalar]:
    """Yield every plain value that a condition may look for."""
    for instance in instances:
        for value in leaves(instance[VALUE_MEMBER[instance["type"]]]):
            yield from _scalars_of(value)


def _scalars_of(value: Any) -> Iterator[Scalar]:
    if isinstance(value, str | int | float):
        yield value
    elif isinstance(value, dict):
        for member in value.values():
            for leaf in leaves(member):
                if isinstance(leaf, str | int | float):
                    yield leaf
