"""Nodes of FEEL: the functions of a scope of which an expression consists."""

import operator
from collections.abc import Callable, Iterator, Mapping
from datetime import date, datetime
from typing import Any, TypeAlias

from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.languages.feel.values import (
    Budget,
    FeelValue,
    Range,
    add,
    divide,
    is_number,
    is_same,
    multiply,
    order,
    power,
    read_path,
    subtract,
    to_duration,
    to_json,
)
from handover_bpmn.languages.times import read_now


class NameScope:
    """The names that are visible: those of a loop, filter or context before those around it."""

    __slots__ = ("budget", "names", "parent")

    def __init__(self, names: Mapping[str, FeelValue], parent: "NameScope | None", budget: Budget) -> None:
        self.names = names
        self.parent = parent
        self.budget = budget

    def inner(self, names: Mapping[str, FeelValue]) -> "NameScope":
        """Return a scope within this one."""
        return NameScope(names, self, self.budget)

    def read(self, name: str) -> FeelValue:
        """Return the value of `name`; None if there is none."""
        scope: NameScope | None = self
        while scope is not None:
            if name in scope.names:
                return scope.names[name]
            scope = scope.parent
        return None


Node: TypeAlias = Callable[[NameScope], FeelValue]
Step: TypeAlias = Callable[[FeelValue, NameScope], FeelValue]
Test: TypeAlias = Callable[[FeelValue, NameScope], bool | None]
Operator: TypeAlias = Callable[[FeelValue, FeelValue, Budget], FeelValue]
SUMS: dict[str, Operator] = {"+": add, "-": subtract}
PRODUCTS: dict[str, Operator] = {"*": multiply, "/": divide}


def _ordered(holds: Callable[[Any, Any], bool]) -> Operator:
    def compare(left: FeelValue, right: FeelValue, budget: Budget) -> bool | None:
        if type(left) is int and type(right) is int:
            return holds(left, right)
        ordering = order(left, right, budget)
        return None if ordering is None else holds(ordering, 0)

    return compare


def _differs(left: FeelValue, right: FeelValue, budget: Budget) -> bool | None:
    same = is_same(left, right, budget)
    return None if same is None else not same


COMPARISONS: dict[str, Operator] = {
    "=": is_same,
    "!=": _differs,
    "<": _ordered(operator.lt),
    "<=": _ordered(operator.le),
    ">": _ordered(operator.gt),
    ">=": _ordered(operator.ge),
}


ITSELF = object()
"""Asks a membership test for its operand."""


def weigh(count: int) -> int:
    """Return the steps that an evaluation of `count` tokens takes."""
    return 1 + count // 4


def variable(name: str) -> Node:
    """Return the value of a name; null if there is none."""

    def read(scope: NameScope) -> FeelValue:
        names = scope.names
        return names[name] if name in names else scope.read(name)

    return read


def constant(value: FeelValue) -> Node:
    """Return always the same value."""
    return lambda _: value


def binary(calculate: Operator, left: Node, right: Node) -> Node:
    """Return the result of an operator."""
    return lambda scope: calculate(left(scope), right(scope), scope.budget)


def connect(operands: tuple[Node, ...], *, decisive: bool) -> Node:
    """Return `or` (decisive True) or `and` (decisive False) with three values: null if nothing decides."""

    def connected(scope: NameScope) -> FeelValue:
        result: bool | None = not decisive
        for operand in operands:
            value = operand(scope)
            if value is decisive:
                return decisive
            if value is not True and value is not False:
                result = None
        return result

    return connected


def negate(value: FeelValue) -> FeelValue:
    """Return a number or duration with the other sign; null for other values."""
    if is_number(value):
        return -value
    duration = None if isinstance(value, str) else to_duration(value)
    return None if duration is None else type(duration)(-duration.months, -duration.microseconds)


def entry(name: str) -> Step:
    """Return the entry of a context, or the property of a value."""

    def read(value: FeelValue, scope: NameScope) -> FeelValue:
        return value.get(name) if type(value) is dict else read_path(value, name, scope.budget)

    return read


def follow_path(node: Node, steps: list[Step]) -> Node:
    """Return the value after all steps of a path."""
    if not steps:
        return node
    if len(steps) == 1:
        step = steps[0]
        return lambda scope: step(node(scope), scope)

    def follow(scope: NameScope) -> FeelValue:
        value = node(scope)
        for step in steps:
            value = step(value, scope)
        return value

    return follow


def call_function(call: Callable[..., FeelValue], arguments: tuple[Node, ...]) -> Node:
    """Return the result of a function."""
    if len(arguments) == 1:
        argument = arguments[0]
        return lambda scope: call(scope.budget, argument(scope))
    return lambda scope: call(scope.budget, *(argument(scope) for argument in arguments))


def _variables(scope: NameScope) -> Mapping[str, FeelValue]:
    while scope.parent is not None:
        scope = scope.parent
    return scope.names


def read_now_of(scope: NameScope) -> FeelValue:
    """Return the moment of the evaluation."""
    return read_now(_variables(scope))


def read_today_of(scope: NameScope) -> FeelValue:
    """Return the day of the evaluation."""
    return read_now(_variables(scope)).date()


def make_range(
    start: Node, end: Node, *, has_start: bool = True, has_end: bool = True
) -> Callable[[NameScope], Range]:
    """Return the range between two values."""
    return lambda scope: Range(start(scope), end(scope), has_start, has_end)


def membership(operand: Node) -> Test:
    """Return the test whether a value is, or is within, the value of `operand`."""

    def test(value: FeelValue, scope: NameScope) -> FeelValue:
        expected = operand(scope)
        if value is ITSELF:
            return expected
        if isinstance(expected, Range):
            return expected.includes(value, scope.budget)
        if isinstance(expected, list) and not isinstance(value, list):
            scope.budget.spend(len(expected))
            return any(_is_member(value, item, scope.budget) for item in expected)
        return is_same(value, expected, scope.budget)

    return test


def _is_member(value: FeelValue, item: FeelValue, budget: Budget) -> bool:
    is_included = item.includes(value, budget) if isinstance(item, Range) else is_same(value, item, budget)
    return is_included is True


def meets_any(tests: tuple[Test, ...], value: FeelValue, scope: NameScope) -> bool | None:
    """Return whether a value meets a test; null if none is met and one is undecided."""
    result: bool | None = False
    for test in tests:
        is_met = test(value, scope)
        if is_met is True:
            return True
        if is_met is None:
            result = None
    return result


class _NoItems(Exception):
    """A loop runs over null."""


def _is_date(value: FeelValue) -> bool:
    return isinstance(value, date) and not isinstance(value, datetime)


def _items(value: FeelValue, budget: Budget) -> Iterator[FeelValue]:
    """Yield what a loop visits: the items of a list, the integers or dates of a range, or the value itself.

    Raises `ExpressionError` for another range, which has no items.
    """
    if isinstance(value, list):
        yield from value
    elif isinstance(value, Range):
        start, end = value.start, value.end
        if _is_date(start) and _is_date(end):
            ordinals = Range(start.toordinal(), end.toordinal(), value.has_start, value.has_end)
            yield from (date.fromordinal(ordinal) for ordinal in _items(ordinals, budget))
            return
        if not (type(start) is int and type(end) is int):
            raise ExpressionError(
                "a loop or filter runs over a list, or over a range of whole numbers or of dates, not over "
                f"a range from {_described(start, budget)} to {_described(end, budget)}"
            )
        step = 1 if start <= end else -1
        first = start if value.has_start else start + step
        for current in range(first, end + step if value.has_end else end, step):
            budget.spend(1)
            yield current
    elif value is not None:
        yield value


def iterate(iterators: tuple[tuple[str, Node], ...], scope: NameScope, weight: int) -> Iterator[NameScope]:
    """Yield a scope for each combination of the items, the last iterator fastest."""
    (name, items), *rest = iterators
    visited = items(scope)
    if visited is None:
        raise _NoItems
    for item in _items(visited, scope.budget):
        scope.budget.spend(weight)
        inner = scope.inner({name: item})
        if rest:
            yield from iterate(tuple(rest), inner, weight)
        else:
            yield inner


def select_items(value: FeelValue, condition: Node, weight: int, scope: NameScope) -> FeelValue:
    """Return the item at a position (from 1, or from -1 at the end), or the items that meet a condition."""
    if value is None:
        return None
    items = list(_items(value, scope.budget))
    first = items[0] if items else None
    selector = condition(_item_scope(first, scope))
    if is_number(selector):
        position = int(selector)
        if position != selector or position == 0 or abs(position) > len(items):
            return None
        return items[position - 1] if position > 0 else items[position]
    selected = []
    for index, item in enumerate(items):
        scope.budget.spend(weight)
        if (selector if index == 0 else condition(_item_scope(item, scope))) is True:
            selected.append(item)
    return selected


def _item_scope(item: FeelValue, scope: NameScope) -> NameScope:
    """Return the scope of a filter for an item; an entry named `item` comes before the item itself."""
    return scope.inner({"item": item, **item} if isinstance(item, dict) else {"item": item})


def _described(value: FeelValue, budget: Budget) -> str:
    return f"{to_json(value, budget)!r:.40}" if value is not None else "null"


def loop(iterators: tuple[tuple[str, Node], ...], body: Node, weight: int, *, reads_partial: bool) -> Node:
    """Return the values of a body for all combinations of the items; `partial` are those so far."""

    def collect(scope: NameScope) -> FeelValue:
        results: list[FeelValue] = []
        try:
            for inner in iterate(iterators, scope, weight):
                if reads_partial:
                    scope.budget.spend(len(results))
                    inner.names = {"partial": [*results], **inner.names}
                results.append(body(inner))
        except _NoItems:
            return None
        return results

    return collect


def quantify(iterators: tuple[tuple[str, Node], ...], body: Node, weight: int, *, decisive: bool) -> Node:
    """Return `some` (decisive True) or `every` (decisive False) with three values."""

    def decide(scope: NameScope) -> FeelValue:
        result: bool | None = not decisive
        try:
            for inner in iterate(iterators, scope, weight):
                value = body(inner)
                if value is decisive:
                    return decisive
                if not isinstance(value, bool):
                    result = None
        except _NoItems:
            return None
        return result

    return decide


def chain(first: Node, steps: tuple[tuple[Operator, Node], ...]) -> Node:
    """Return the result of operators of one precedence, from left to right."""

    def calculate_all(scope: NameScope) -> FeelValue:
        value = first(scope)
        for calculate, right in steps:
            value = calculate(value, right(scope), scope.budget)
        return value

    return calculate_all


def raise_to(base: Node, exponents: tuple[Node, ...]) -> Node:
    """Return a power, from left to right."""
    return chain(base, tuple((power, exponent) for exponent in exponents))


def build_context(entries: tuple[tuple[str, Node], ...]) -> Node:
    """Return a context, whose entries see those before them."""

    def build(scope: NameScope) -> FeelValue:
        context: dict[str, FeelValue] = {}
        inner = scope.inner(context)
        for key, node in entries:
            context[key] = node(inner)
        return context

    return build
