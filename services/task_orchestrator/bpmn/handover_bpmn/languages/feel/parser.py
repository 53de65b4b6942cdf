"""Parser of FEEL: reads an expression into functions of a scope."""

import math
import re
from collections.abc import Callable

from handover_bpmn.languages.base import MAX_NUMBER, Json
from handover_bpmn.languages.feel.function import Function
from handover_bpmn.languages.feel.functions import FUNCTIONS
from handover_bpmn.languages.feel.nodes import (
    COMPARISONS,
    ITSELF,
    PRODUCTS,
    SUMS,
    Node,
    Operator,
    Step,
    Test,
    binary,
    build_context,
    call_function,
    chain,
    connect,
    constant,
    entry,
    follow_path,
    loop,
    make_range,
    meets_any,
    membership,
    negate,
    quantify,
    raise_to,
    read_now_of,
    read_today_of,
    select_items,
    variable,
    weigh,
)
from handover_bpmn.languages.feel.values import TYPES, FeelValue, has_type, number, to_datetime, to_duration
from handover_bpmn.languages.tokens import Tokens, unquote

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


class FeelParser:
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
                items = make_range(items, self.expression())
            iterators.append((name, items))
            self._local.append(name)
            if not self.tokens.accept(","):
                return iterators

    def _body(self, count: int) -> tuple[Node, int]:
        """Read the body of a loop with `count` names; return it with the steps that an evaluation takes."""
        before = self.tokens.count
        body = self.expression()
        del self._local[-count:]
        return body, weigh(self.tokens.count - before)

    def _for(self) -> Node:
        iterators = self._iterators()
        self.tokens.expect("return")
        self._local.append("partial")
        partials = self._partials
        body, weight = self._body(len(iterators) + 1)
        reads_partial = self._partials > partials

        return loop(tuple(iterators), body, weight, reads_partial=reads_partial)

    def _quantified(self, word: str) -> Node:
        iterators = self._iterators()
        self.tokens.expect("satisfies")
        body, weight = self._body(len(iterators))
        return quantify(tuple(iterators), body, weight, decisive=word == "some")

    def _or(self) -> Node:
        operands = [self._and()]
        while self.tokens.accept("or"):
            operands.append(self._and())
        return operands[0] if len(operands) == 1 else connect(tuple(operands), decisive=True)

    def _and(self) -> Node:
        operands = [self._comparison()]
        while self.tokens.accept("and"):
            operands.append(self._comparison())
        return operands[0] if len(operands) == 1 else connect(tuple(operands), decisive=False)

    def _comparison(self) -> Node:
        left = self._sum()
        if self.tokens.accept("instance"):
            return self._instance(left)
        sign = self.tokens.accept(*COMPARISONS, "between", "in")
        if sign is None:
            return left
        if sign == "between":
            start = self._sum()
            self.tokens.expect("and")
            limits = make_range(start, self._sum())
            return lambda scope: limits(scope).includes(left(scope), scope.budget)
        if sign == "in":
            tests = self._tests()
            return lambda scope: meets_any(tests, left(scope), scope)
        if self.tokens.text in COMPARISONS and self.tokens.kind == "operator":
            raise self.tokens.error(f"expected a value instead of {self.tokens.found()}")
        return binary(COMPARISONS[sign], left, self._sum())

    def _instance(self, value: Node) -> Node:
        tokens = self.tokens
        match = _TYPE.match(tokens.source, tokens.start) if tokens.text == "of" else None
        if match is None:
            raise tokens.error(f"expected `of` and a type; types are: {', '.join(TYPES)}")
        tokens.position = match.end()
        tokens.advance()
        name = " ".join(match.group(1).split())
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
            limits = self._range_end(lambda scope: start(ITSELF, scope), has_start=False)
            return (membership(limits),)
        tests = [first]
        while self.tokens.accept(","):
            tests.append(self._test())
        self.tokens.expect(")")
        self.tokens.leave()
        return tuple(tests)

    def _test(self) -> Test:
        sign = self.tokens.accept(*COMPARISONS)
        operand = self._sum()
        if sign is None:
            return membership(operand)
        compare = COMPARISONS[sign]
        return lambda value, scope: compare(value, operand(scope), scope.budget)

    def _sum(self) -> Node:
        return self._chain(SUMS, lambda: self._chain(PRODUCTS, self._power))

    def _chain(self, operators: dict[str, Operator], operand: Callable[[], Node]) -> Node:
        """Read operands with operators of one precedence between them, from left to right."""
        first = operand()
        rest: list[tuple[Operator, Node]] = []
        while (sign := self.tokens.accept(*operators)) is not None:
            rest.append((operators[sign], operand()))
        if not rest:
            return first
        if len(rest) == 1:
            return binary(rest[0][0], first, rest[0][1])
        return chain(first, tuple(rest))

    def _power(self) -> Node:
        base = self._unary()
        steps: list[Node] = []
        while self.tokens.accept("**"):
            steps.append(self._unary())
        return raise_to(base, tuple(steps)) if steps else base

    def _unary(self) -> Node:
        if not self.tokens.accept("-"):
            return self._postfix()
        self.tokens.enter()
        operand = self._unary()
        self.tokens.leave()
        return lambda scope: negate(operand(scope))

    def _postfix(self) -> Node:
        node = self._primary()
        steps: list[Step] = []
        while self.tokens.kind == "operator" and self.tokens.text in (
            {"."} if self._is_bound else {".", "["}
        ):
            steps.append(entry(self._name()) if self.tokens.accept(".") else self._filter())
        return follow_path(node, steps)

    def _filter(self) -> Step:
        self.tokens.advance()
        before = self.tokens.count
        self._local.append("item")
        condition = self.expression()
        self._local.pop()
        weight = weigh(self.tokens.count - before)
        self.tokens.expect("]")
        return lambda value, scope: select_items(value, condition, weight, scope)

    def _name(self) -> str:
        if self.tokens.kind != "name":
            raise self.tokens.error(f"expected a name instead of {self.tokens.found()}")
        name = self.tokens.text.strip("`")
        self.tokens.advance()
        return name

    def _primary(self) -> Node:  # noqa: PLR0911 - one return a kind of value
        tokens = self.tokens
        if tokens.kind == "number":
            return constant(self._number())
        if tokens.kind == "string":
            return constant(self._string())
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
        return constant(value)

    def _named(self) -> Node:
        tokens, start = self.tokens, self.tokens.start
        call = _CALL.match(tokens.source, start)
        if call is not None:
            tokens.position = call.end()
            tokens.advance()
            return self._call(" ".join(call.group()[:-1].split()), start)
        if tokens.text in _CONSTANTS:
            return constant(_CONSTANTS[self._name()])
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
        return variable(name)

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
            return read_now_of if name == "now" else read_today_of
        return call_function(function.call, tuple(arguments))

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
        return make_range(start, end, has_start=has_start, has_end=closing == "]")

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

        return build_context(tuple(entries))
