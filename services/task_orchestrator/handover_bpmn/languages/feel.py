"""FEEL, the expressions of Camunda 8, in the subset that docs/reference/expressions.md lists.

An expression is parsed once into nested functions (closures) of a scope. A missing name and a value of the
wrong type give null, as in the standard (DMN 1.4, chapter 10). Loops and functions over lists take steps from
the budget of the evaluation, so that no expression runs for ever.
"""

import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import date, datetime
from functools import lru_cache
from typing import Any, TypeAlias

from handover_bpmn.languages.base import (
    MAX_NUMBER,
    ExpressionError,
    Json,
    Variables,
    evaluation_error,
    within_limits,
)
from handover_bpmn.languages.feel_functions import FUNCTIONS, Function
from handover_bpmn.languages.feel_values import (
    TYPES,
    Budget,
    FeelValue,
    Range,
    add,
    divide,
    has_type,
    is_number,
    is_same,
    multiply,
    number,
    order,
    power,
    read_path,
    subtract,
    to_datetime,
    to_duration,
    to_json,
)
from handover_bpmn.languages.times import read_now
from handover_bpmn.languages.tokens import Tokens, excerpt, unquote


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

_PATTERN = re.compile(
    r"""(?P<skip>\s+|//[^\n]*|/\*.*?\*/)
    |(?P<number>(?:[0-9]+(?:\.[0-9]+)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    |(?P<name>[^\W\d]\w*|`[^`]+`)
    |(?P<string>"(?:[^"\\]|\\.)*")
    |(?P<operator>\*\*|\.\.|!=|<=|>=|[-+*/=<>()\[\]{},:.@])""",
    re.VERBOSE | re.DOTALL,
)
_CLOCK = {"now", "today"}
_CALL = re.compile(
    r"(?:"
    + "|".join(name.replace(" ", r"\s+") for name in sorted({*FUNCTIONS, *_CLOCK}, key=len, reverse=True))
    + r")\s*\("
)
_TYPE = re.compile(r"of\s+(" + "|".join(name.replace(" ", r"\s+") for name in TYPES) + r")\b")
_WORDS = frozenset(
    {
        *("and", "or", "between", "in", "if", "then", "else", "for", "return", "some", "every", "satisfies"),
        *("instance", "of", "function"),
    }
)
_CONSTANTS: dict[str, Json] = {"true": True, "false": False, "null": None}
_SUMS: dict[str, Operator] = {"+": add, "-": subtract}
_PRODUCTS: dict[str, Operator] = {"*": multiply, "/": divide}


def _ordered(holds: Callable[[Any, Any], bool]) -> Operator:
    def compare(left: FeelValue, right: FeelValue, budget: Budget) -> bool | None:
        if type(left) is int and type(right) is int:
            return holds(left, right)
        found = order(left, right, budget)
        return None if found is None else holds(found, 0)

    return compare


def _differs(left: FeelValue, right: FeelValue, budget: Budget) -> bool | None:
    same = is_same(left, right, budget)
    return None if same is None else not same


_COMPARISONS: dict[str, Operator] = {
    "=": is_same,
    "!=": _differs,
    "<": _ordered(operator.lt),
    "<=": _ordered(operator.le),
    ">": _ordered(operator.gt),
    ">=": _ordered(operator.ge),
}


@dataclass(frozen=True, slots=True)
class FeelExpression:
    """A FEEL expression that was parsed and validated."""

    text: str
    _node: Node
    _names: frozenset[str]

    def value(self, variables: Variables) -> Json:
        """Return the value; raise `ExpressionError` only if a limit is exceeded."""
        try:
            budget = Budget()
            value = self._node(NameScope(variables, None, budget))
            if value is None or value is True or value is False:
                return value
            return within_limits(to_json(value, budget))
        except Exception as error:  # noqa: BLE001 - every failure is one of the expression
            raise evaluation_error(excerpt(self.text), error) from None

    def names(self) -> frozenset[str]:
        """Return the names that the expression reads; within a filter, they may be entries of its items."""
        return self._names


@lru_cache(maxsize=4096)
def read_feel(text: str) -> FeelExpression:
    """Return the expression `text`, with or without the `=` before it; raise `ExpressionError` for others."""
    stripped = text.strip()
    try:
        parser = _Parser(stripped, 1 if stripped.startswith("=") else 0)
        node = parser.whole()
    except RecursionError:
        raise ExpressionError(f"{excerpt(stripped)}: an expression is nested too deeply") from None
    except Exception as error:  # noqa: BLE001 - every failure is one of the expression
        raise evaluation_error(excerpt(stripped), error) from None
    return FeelExpression(stripped, node, frozenset(parser.names))


class _Parser:
    """Recursive descent; each method returns the function that evaluates what it read."""

    def __init__(self, text: str, position: int) -> None:
        self.tokens = Tokens(text, _PATTERN, position)
        self.names: set[str] = set()
        self._local: list[str] = []
        self._is_bound = False
        self._partials = 0
        """How often `partial` was read so far."""
        self.tokens.advance()

    def whole(self) -> Node:
        """Read the whole text as an expression."""
        node = self.expression()
        if self.tokens.kind != "end":
            raise self.tokens.error(f"expected an operator or the end instead of {self.tokens.found()}")
        return node

    def expression(self) -> Node:
        """Read an expression up to a token that cannot continue it."""
        self.tokens.enter()
        is_bound, self._is_bound = self._is_bound, False
        if self.tokens.accept("if"):
            node = self._if()
        elif self.tokens.accept("for"):
            node = self._for()
        elif (word := self.tokens.accept("some", "every")) is not None:
            node = self._quantified(word)
        else:
            node = self._or()
        self._is_bound = is_bound
        self.tokens.leave()
        return node

    def _if(self) -> Node:
        condition = self.expression()
        self.tokens.expect("then")
        yes = self.expression()
        self.tokens.expect("else")
        no = self.expression()
        return lambda scope: yes(scope) if condition(scope) is True else no(scope)

    def _iterators(self) -> list[tuple[str, Node]]:
        """Read `a in list, b in 1..3`; the names stay local until the end of the body."""
        iterators: list[tuple[str, Node]] = []
        while True:
            name = self._name()
            self.tokens.expect("in")
            items = self.expression()
            if self.tokens.accept(".."):
                items = _make_range(items, self.expression())
            iterators.append((name, items))
            self._local.append(name)
            if not self.tokens.accept(","):
                return iterators

    def _body(self, count: int) -> tuple[Node, int]:
        """Read the body of a loop with `count` names; return it with the steps that an evaluation takes."""
        before = self.tokens.count
        body = self.expression()
        del self._local[-count:]
        return body, _weigh(self.tokens.count - before)

    def _for(self) -> Node:
        iterators = self._iterators()
        self.tokens.expect("return")
        self._local.append("partial")
        partials = self._partials
        body, weight = self._body(len(iterators) + 1)
        reads_partial = self._partials > partials

        def collect(scope: NameScope) -> FeelValue:
            results: list[FeelValue] = []
            try:
                for inner in _iterate(tuple(iterators), scope, weight):
                    if reads_partial:
                        scope.budget.spend(len(results))
                        inner.names = {"partial": [*results], **inner.names}
                    results.append(body(inner))
            except _NoItems:
                return None
            return results

        return collect

    def _quantified(self, word: str) -> Node:
        iterators = self._iterators()
        self.tokens.expect("satisfies")
        body, weight = self._body(len(iterators))
        decisive = word == "some"

        def decide(scope: NameScope) -> FeelValue:
            result: bool | None = not decisive
            try:
                for inner in _iterate(tuple(iterators), scope, weight):
                    value = body(inner)
                    if value is decisive:
                        return decisive
                    if not isinstance(value, bool):
                        result = None
            except _NoItems:
                return None
            return result

        return decide

    def _or(self) -> Node:
        operands = [self._and()]
        while self.tokens.accept("or"):
            operands.append(self._and())
        return operands[0] if len(operands) == 1 else _connect(tuple(operands), decisive=True)

    def _and(self) -> Node:
        operands = [self._comparison()]
        while self.tokens.accept("and"):
            operands.append(self._comparison())
        return operands[0] if len(operands) == 1 else _connect(tuple(operands), decisive=False)

    def _comparison(self) -> Node:
        left = self._sum()
        if self.tokens.accept("instance"):
            return self._instance(left)
        sign = self.tokens.accept(*_COMPARISONS, "between", "in")
        if sign is None:
            return left
        if sign == "between":
            start = self._sum()
            self.tokens.expect("and")
            limits = _make_range(start, self._sum())
            return lambda scope: limits(scope).includes(left(scope), scope.budget)
        if sign == "in":
            tests = self._tests()
            return lambda scope: _any_test(tests, left(scope), scope)
        if self.tokens.text in _COMPARISONS and self.tokens.kind == "operator":
            raise self.tokens.error(f"expected a value instead of {self.tokens.found()}")
        return _binary(_COMPARISONS[sign], left, self._sum())

    def _instance(self, value: Node) -> Node:
        tokens = self.tokens
        found = _TYPE.match(tokens.source, tokens.start) if tokens.text == "of" else None
        if found is None:
            raise tokens.error(f"expected `of` and a type; types are: {', '.join(TYPES)}")
        tokens.position = found.end()
        tokens.advance()
        name = " ".join(found.group(1).split())
        return lambda scope: has_type(value(scope), name)

    def _tests(self) -> tuple[Test, ...]:
        """Read the right side of `in`: a test, or tests in parentheses."""
        if not self.tokens.accept("("):
            return (self._test(),)
        self.tokens.enter()
        first = self._test()
        if self.tokens.accept(".."):
            self.tokens.leave()
            start = first
            limits = self._range_end(lambda scope: start(_ITSELF, scope), has_start=False)
            return (_membership(limits),)
        tests = [first]
        while self.tokens.accept(","):
            tests.append(self._test())
        self.tokens.expect(")")
        self.tokens.leave()
        return tuple(tests)

    def _test(self) -> Test:
        sign = self.tokens.accept(*_COMPARISONS)
        operand = self._sum()
        if sign is None:
            return _membership(operand)
        compare = _COMPARISONS[sign]
        return lambda value, scope: compare(value, operand(scope), scope.budget)

    def _sum(self) -> Node:
        return self._chain(_SUMS, lambda: self._chain(_PRODUCTS, self._power))

    def _chain(self, operators: dict[str, Operator], operand: Callable[[], Node]) -> Node:
        """Read operands with operators of one precedence between them, from left to right."""
        first = operand()
        rest: list[tuple[Operator, Node]] = []
        while (sign := self.tokens.accept(*operators)) is not None:
            rest.append((operators[sign], operand()))
        if not rest:
            return first
        if len(rest) == 1:
            return _binary(rest[0][0], first, rest[0][1])
        steps = tuple(rest)

        def chained(scope: NameScope) -> FeelValue:
            value = first(scope)
            for calculate, right in steps:
                value = calculate(value, right(scope), scope.budget)
            return value

        return chained

    def _power(self) -> Node:
        base = self._unary()
        steps: list[Node] = []
        while self.tokens.accept("**"):
            steps.append(self._unary())
        if not steps:
            return base

        def raised(scope: NameScope) -> FeelValue:
            value = base(scope)
            for step in steps:
                value = power(value, step(scope), scope.budget)
            return value

        return raised

    def _unary(self) -> Node:
        if not self.tokens.accept("-"):
            return self._postfix()
        self.tokens.enter()
        operand = self._unary()
        self.tokens.leave()
        return lambda scope: _negate(operand(scope))

    def _postfix(self) -> Node:
        node = self._primary()
        steps: list[Step] = []
        while self.tokens.kind == "operator" and self.tokens.text in (
            {"."} if self._is_bound else {".", "["}
        ):
            steps.append(_entry(self._name()) if self.tokens.accept(".") else self._filter())
        return _path(node, steps)

    def _filter(self) -> Step:
        self.tokens.advance()
        before = self.tokens.count
        self._local.append("item")
        condition = self.expression()
        self._local.pop()
        weight = _weigh(self.tokens.count - before)
        self.tokens.expect("]")
        return lambda value, scope: _select(value, condition, weight, scope)

    def _name(self) -> str:
        if self.tokens.kind != "name":
            raise self.tokens.error(f"expected a name instead of {self.tokens.found()}")
        name = self.tokens.text.strip("`")
        self.tokens.advance()
        return name

    def _primary(self) -> Node:  # noqa: PLR0911 - one return a kind of value
        tokens = self.tokens
        if tokens.kind == "number":
            return _constant(self._number())
        if tokens.kind == "string":
            return _constant(self._string())
        if tokens.kind == "name":
            return self._named()
        if tokens.accept("("):
            return self._parenthesis()
        if tokens.accept("["):
            return self._list()
        if tokens.accept("]"):
            start = self._sum()
            tokens.expect("..")
            return self._range_end(start, has_start=False)
        if tokens.accept("{"):
            return self._context()
        if tokens.accept("@"):
            return self._temporal()
        raise tokens.error(f"expected a value instead of {tokens.found()}")

    def _number(self) -> Json:
        text = self.tokens.text
        value = float(text)
        if math.isinf(value) or (text.isdecimal() and value > MAX_NUMBER):
            raise self.tokens.error("a number is too large")
        self.tokens.advance()
        return int(text) if text.isdecimal() else number(value)

    def _string(self) -> str:
        text = unquote(self.tokens.text, keeps_unknown=True)
        self.tokens.advance()
        return text

    def _temporal(self) -> Node:
        """Read a date or duration such as `@"2026-05-01"`."""
        start = self.tokens.start
        if self.tokens.kind != "string":
            raise self.tokens.error(f"expected a text in quotes instead of {self.tokens.found()}")
        text = self._string()
        value: FeelValue = to_duration(text)
        if value is None:
            moment = to_datetime(text)
            value = moment.date() if moment is not None and "T" not in text else moment
        if value is None:
            raise self.tokens.error(f'"{text[:40]}" is no ISO 8601 date, date and time, or duration', start)
        return _constant(value)

    def _named(self) -> Node:
        tokens, start = self.tokens, self.tokens.start
        call = _CALL.match(tokens.source, start)
        if call is not None:
            tokens.position = call.end()
            tokens.advance()
            return self._call(" ".join(call.group()[:-1].split()), start)
        if tokens.text in _CONSTANTS:
            return _constant(_CONSTANTS[self._name()])
        if tokens.text in _WORDS:
            raise tokens.error(f"expected a value instead of {tokens.found()}")
        name = self._name()
        if tokens.kind == "operator" and tokens.text == "(":
            raise tokens.error(
                f"the function {name}() is not supported; docs/reference/expressions.md lists the functions",
                start,
            )
        if name not in self._local:
            self.names.add(name)
        self._partials += name == "partial"
        return _variable(name)

    def _call(self, name: str, start: int) -> Node:
        """Read the arguments of a function; the cursor is behind the parenthesis."""
        self.tokens.enter()
        arguments: list[Node] = []
        if not self.tokens.accept(")"):
            arguments.append(self.expression())
            while self.tokens.accept(","):
                arguments.append(self.expression())
            if self.tokens.text == ":":
                raise self.tokens.error(
                    "named arguments are not supported; give the arguments in their order"
                )
            self.tokens.expect(")")
        self.tokens.leave()
        function = FUNCTIONS.get(name, Function(lambda _: None, 0, 0))
        if not function.least <= len(arguments) <= function.most:
            counts = (
                f"{function.least} to {function.most}" if function.least < function.most else function.least
            )
            raise self.tokens.error(f"{name}() has {counts} arguments, not {len(arguments)}", start)
        if name in _CLOCK:
            return _now if name == "now" else _today
        return _apply(function.call, tuple(arguments))

    def _parenthesis(self) -> Node:
        node = self.expression()
        if self.tokens.accept(".."):
            return self._range_end(node, has_start=False)
        self.tokens.expect(")")
        return node

    def _range_end(self, start: Node, *, has_start: bool) -> Node:
        self._is_bound = True  # the `[` of `]1..3[` begins no filter
        end = self._sum()
        self._is_bound = False
        closing = self.tokens.accept("]", ")", "[")
        if closing is None:
            raise self.tokens.error(f'expected "]" or ")" instead of {self.tokens.found()}')
        return _make_range(start, end, has_start=has_start, has_end=closing == "]")

    def _list(self) -> Node:
        items: list[Node] = []
        if self.tokens.accept("]"):
            return lambda _: []
        items.append(self.expression())
        if self.tokens.accept(".."):
            return self._range_end(items[0], has_start=True)
        while self.tokens.accept(","):
            items.append(self.expression())
        self.tokens.expect("]")
        return lambda scope: [item(scope) for item in items]

    def _context(self) -> Node:
        entries: list[tuple[str, Node]] = []
        self.tokens.enter()
        while not self.tokens.accept("}"):
            if entries:
                self.tokens.expect(",")
            key = self._string() if self.tokens.kind == "string" else self._name()
            self.tokens.expect(":")
            entries.append((key, self.expression()))
            self._local.append(key)
        self.tokens.leave()
        del self._local[len(self._local) - len(entries) :]

        def build(scope: NameScope) -> FeelValue:
            context: dict[str, FeelValue] = {}
            inner = scope.inner(context)
            for key, value in entries:
                context[key] = value(inner)
            return context

        return build


_ITSELF = object()
"""Asks a membership test for its operand."""


def _weigh(count: int) -> int:
    return 1 + count // 4


def _variable(name: str) -> Node:
    def read(scope: NameScope) -> FeelValue:
        names = scope.names
        return names[name] if name in names else scope.read(name)

    return read


def _constant(value: FeelValue) -> Node:
    return lambda _: value


def _binary(calculate: Operator, left: Node, right: Node) -> Node:
    return lambda scope: calculate(left(scope), right(scope), scope.budget)


def _connect(operands: tuple[Node, ...], *, decisive: bool) -> Node:
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


def _negate(value: FeelValue) -> FeelValue:
    if is_number(value):
        return -value
    duration = None if isinstance(value, str) else to_duration(value)
    return None if duration is None else type(duration)(-duration.months, -duration.microseconds)


def _entry(name: str) -> Step:
    def read(value: FeelValue, scope: NameScope) -> FeelValue:
        return value.get(name) if type(value) is dict else read_path(value, name, scope.budget)

    return read


def _path(node: Node, steps: list[Step]) -> Node:
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


def _apply(call: Callable[..., FeelValue], arguments: tuple[Node, ...]) -> Node:
    if len(arguments) == 1:
        argument = arguments[0]
        return lambda scope: call(scope.budget, argument(scope))
    return lambda scope: call(scope.budget, *(argument(scope) for argument in arguments))


def _variables(scope: NameScope) -> Mapping[str, FeelValue]:
    while scope.parent is not None:
        scope = scope.parent
    return scope.names


def _now(scope: NameScope) -> FeelValue:
    return read_now(_variables(scope))


def _today(scope: NameScope) -> FeelValue:
    return read_now(_variables(scope)).date()


def _make_range(
    start: Node, end: Node, *, has_start: bool = True, has_end: bool = True
) -> Callable[[NameScope], Range]:
    return lambda scope: Range(start(scope), end(scope), has_start, has_end)


def _membership(operand: Node) -> Test:
    """Return the test whether a value is, or is within, the value of `operand`."""

    def test(value: FeelValue, scope: NameScope) -> FeelValue:
        found = operand(scope)
        if value is _ITSELF:
            return found
        if isinstance(found, Range):
            return found.includes(value, scope.budget)
        if isinstance(found, list) and not isinstance(value, list):
            scope.budget.spend(len(found))
            return any(_is_member(value, item, scope.budget) for item in found)
        return is_same(value, found, scope.budget)

    return test


def _is_member(value: FeelValue, item: FeelValue, budget: Budget) -> bool:
    found = item.includes(value, budget) if isinstance(item, Range) else is_same(value, item, budget)
    return found is True


def _any_test(tests: tuple[Test, ...], value: FeelValue, scope: NameScope) -> bool | None:
    result: bool | None = False
    for test in tests:
        found = test(value, scope)
        if found is True:
            return True
        if found is None:
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


def _iterate(iterators: tuple[tuple[str, Node], ...], scope: NameScope, weight: int) -> Iterator[NameScope]:
    """Yield a scope for each combination of the items, the last iterator fastest."""
    (name, items), *rest = iterators
    visited = items(scope)
    if visited is None:
        raise _NoItems
    for item in _items(visited, scope.budget):
        scope.budget.spend(weight)
        inner = scope.inner({name: item})
        if rest:
            yield from _iterate(tuple(rest), inner, weight)
        else:
            yield inner


def _select(value: FeelValue, condition: Node, weight: int, scope: NameScope) -> FeelValue:
    """Return the item at a position (from 1, or from -1 at the end), or the items that meet a condition."""
    if value is None:
        return None
    items = list(_items(value, scope.budget))
    first = items[0] if items else None
    found = condition(_item_scope(first, scope))
    if is_number(found):
        position = int(found)
        if position != found or position == 0 or abs(position) > len(items):
            return None
        return items[position - 1] if position > 0 else items[position]
    selected = []
    for index, item in enumerate(items):
        scope.budget.spend(weight)
        if (found if index == 0 else condition(_item_scope(item, scope))) is True:
            selected.append(item)
    return selected


def _item_scope(item: FeelValue, scope: NameScope) -> NameScope:
    """Return the scope of a filter for an item; an entry named `item` comes before the item itself."""
    return scope.inner({"item": item, **item} if isinstance(item, dict) else {"item": item})


def _described(value: FeelValue, budget: Budget) -> str:
    return f"{to_json(value, budget)!r:.40}" if value is not None else "null"
