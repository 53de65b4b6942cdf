"""JUEL, the expressions of Camunda 7: `${…}` and `#{…}`. docs/reference/expressions.md lists the subset.

An expression is parsed once into nested functions (closures) of the variables. There are no loops and no user
functions, so the time of an evaluation is bounded by the length of the expression.
"""

import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, TypeAlias

from handover_bpmn.languages.base import (
    MAX_NUMBER,
    ExpressionError,
    Json,
    Variables,
    evaluation_error,
    quote_names,
    within_limits,
)
from handover_bpmn.languages.juel_methods import (
    EXECUTION_PROPERTIES,
    FUNCTIONS,
    VARIABLE_FUNCTIONS,
    bind_method,
)
from handover_bpmn.languages.juel_values import (
    add,
    check_string,
    coerce_to_boolean,
    coerce_to_string,
    compare,
    concatenate,
    divide,
    is_empty,
    is_equal,
    multiply,
    read_property,
    remainder,
    subtract,
)
from handover_bpmn.languages.tokens import Tokens, excerpt, unquote

Node: TypeAlias = Callable[[Variables], Json]

_PATTERN = re.compile(
    r"""(?P<skip>\s+)
    |(?P<number>(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+)(?:[eE][+-]?[0-9]+)?)
    |(?P<name>[^\W\d][\w$]*|\$[\w$]*)
    |(?P<string>"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')
    |(?P<operator>&&|\|\||==|!=|<=|>=|\+=|[-+*/%<>!?:.,()\[\]{}])""",
    re.VERBOSE | re.DOTALL,
)
_START = re.compile(r"\\?[$#]\{")
VARIABLE_PREFIXES = frozenset({"variables", "vars", "var"})
_PREFIXED = re.compile(rf":\s*(?:{'|'.join(VARIABLE_FUNCTIONS)})\s*\(")

Operators: TypeAlias = tuple[dict[str, Callable[[Json, Json], Json]], ...]

BINARY: Operators = (
    {
        "==": is_equal,
        "eq": is_equal,
        "!=": lambda a, b: not is_equal(a, b),
        "ne": lambda a, b: not is_equal(a, b),
    },
    {
        **dict.fromkeys(("<", "lt"), lambda a, b: compare("<", operator.lt, a, b)),
        **dict.fromkeys(("<=", "le"), lambda a, b: compare("<=", operator.le, a, b)),
        **dict.fromkeys((">", "gt"), lambda a, b: compare(">", operator.gt, a, b)),
        **dict.fromkeys((">=", "ge"), lambda a, b: compare(">=", operator.ge, a, b)),
    },
    {"+=": concatenate},
    {"+": add, "-": subtract},
    {"*": multiply, "/": divide, "div": divide, "%": remainder, "mod": remainder},
)
"""The binary operators by precedence, those that bind least first."""

_WORDS = frozenset(
    {"and", "or", "not", "eq", "ne", "lt", "gt", "le", "ge", "div", "mod", "empty", "instanceof"}
)
_CONSTANTS: dict[str, Json] = {"true": True, "false": False, "null": None}


@dataclass(frozen=True, slots=True)
class JuelExpression:
    """A JUEL expression, or a text with JUEL expressions in it, which yields a text."""

    text: str
    _node: Node
    _names: frozenset[str]

    def value(self, variables: Variables) -> Json:
        """Return the value; raise `ExpressionError` if a variable is missing or has the wrong type."""
        try:
            value = self._node(variables)
            return value if value is None or value is True or value is False else within_limits(value)
        except Exception as error:  # noqa: BLE001 - every failure is one of the expression
            raise evaluation_error(excerpt(self.text), error) from None

    def names(self) -> frozenset[str]:
        """Return the names of the variables that the expression reads."""
        return self._names


@lru_cache(maxsize=4096)
def read_juel(text: str) -> JuelExpression:
    """Return the expression `text`, which has at least one `${…}` or `#{…}`, without outer white space.

    A text that is one expression yields its value; one with characters around expressions yields a text.
    Raises `ExpressionError` if it is invalid.
    """
    stripped = text.strip()
    expression = parse(stripped)
    if expression is None:
        raise ExpressionError(
            f"{excerpt(stripped)} is no JUEL expression; write it between ${{ and }}, as in ${{approved}}"
        )
    return expression


@lru_cache(maxsize=4096)
def read_template(text: str) -> JuelExpression:
    """Return `text` as `read_juel`; a text without `${…}` and `#{…}` yields itself."""
    expression = parse(text.strip())
    if expression is None:
        literal = text.replace("\\${", "${").replace("\\#{", "#{")
        return JuelExpression(text, lambda _: literal, frozenset())
    return expression


def read_set_variable(text: str, parsing: type["Parser"] | None = None) -> tuple[str, JuelExpression] | None:
    """Return name and value of `${execution.setVariable('name', value)}`; None if `text` is something else.

    This is the one call with a side effect that files often have; it equals a script `name = value`.
    """
    text = text.strip()
    if _SET_VARIABLE.match(text) is None:
        return None
    try:
        parser = (parsing or Parser)(text, 2)
        for part in ("execution", ".", "setVariable", "("):
            parser.tokens.expect(part)
        name = parser.string()
        parser.tokens.expect(",")
        node = parser.expression()
        parser.tokens.expect(")")
        if parser.close() != len(text):
            raise parser.tokens.error("nothing can follow execution.setVariable(…)")
    except ExpressionError as error:
        raise ExpressionError(f"{excerpt(text)}: {error}") from None
    return name, JuelExpression(text, node, frozenset(parser.names))


_SET_VARIABLE = re.compile(r"[$#]\{\s*execution\s*\.\s*setVariable\s*\(")


def parse(text: str, parsing: type["Parser"] | None = None) -> JuelExpression | None:
    """Return the expression or mixed text; None if `text` has no `${` or `#{`."""
    parts: list[str | Node] = []
    names: set[str] = set()
    position = 0
    try:
        while (match := _START.search(text, position)) is not None:
            if match.start() > position:
                parts.append(text[position : match.start()])
            if match.group().startswith("\\"):
                parts.append(match.group()[1:])
                position = match.end()
                continue
            parser = (parsing or Parser)(text, match.end())
            parts.append(parser.expression())
            names |= parser.names
            position = parser.close()
    except ExpressionError as error:
        raise ExpressionError(f"{excerpt(text)}: {error}") from None
    except RecursionError:
        raise ExpressionError(f"{excerpt(text)}: an expression is nested too deeply") from None
    if all(isinstance(part, str) for part in parts):
        return None
    if position < len(text):
        parts.append(text[position:])
    first = parts[0]
    if len(parts) == 1 and not isinstance(first, str):
        return JuelExpression(text, first, frozenset(names))
    return JuelExpression(text, _mix(parts), frozenset(names))


def _mix(parts: list[str | Node]) -> Node:
    pieces = tuple(parts)

    def mixed(variables: Variables) -> Json:
        text = ""
        for piece in pieces:
            text = check_string(
                text + (piece if isinstance(piece, str) else coerce_to_string(piece(variables)))
            )
        return text

    return mixed


class Parser:
    """Recursive descent over one `${…}`; each method returns the function that evaluates what it read."""

    operators: ClassVar[Operators] = BINARY

    def __init__(self, text: str, position: int) -> None:
        self.tokens = Tokens(text, _PATTERN, position)
        self.names: set[str] = set()
        self._is_lenient = False
        self.tokens.advance()

    def close(self) -> int:
        """Return the position after the closing brace."""
        if self.tokens.text != "}" or self.tokens.kind != "operator":
            raise self.tokens.error(f'expected an operator or "}}" instead of {self.tokens.found()}')
        return self.tokens.position

    def string(self) -> str:
        """Return the string literal at the cursor."""
        if self.tokens.kind != "string":
            raise self.tokens.error(f"expected a text in quotes instead of {self.tokens.found()}")
        text = unquote(self.tokens.text)
        self.tokens.advance()
        return text

    def expression(self) -> Node:
        """Read an expression up to a token that cannot continue it."""
        self.tokens.enter()
        condition = self._or()
        if self.tokens.accept("?"):
            yes = self.expression()
            self.tokens.expect(":")
            no = self.expression()
            condition = _choose(condition, yes, no)
        self.tokens.leave()
        return condition

    def _or(self) -> Node:
        operands = [self._and()]
        while self.tokens.accept("||", "or"):
            operands.append(self._and())
        return operands[0] if len(operands) == 1 else _connect(tuple(operands), until=True)

    def _and(self) -> Node:
        operands = [self._binary(0)]
        while self.tokens.accept("&&", "and"):
            operands.append(self._binary(0))
        return operands[0] if len(operands) == 1 else _connect(tuple(operands), until=False)

    def _binary(self, level: int) -> Node:
        if level == len(self.operators):
            return self._unary()
        first = self._binary(level + 1)
        operators = self.operators[level]
        rest: list[tuple[Callable[[Json, Json], Json], Node]] = []
        while (sign := self.tokens.accept(*operators)) is not None:
            rest.append((operators[sign], self._binary(level + 1)))
        return _chain(first, rest)

    def _unary(self) -> Node:
        sign = self.tokens.accept("!", "not", "-", "empty")
        if sign is None:
            return self._postfix()
        self.tokens.enter()
        self._is_lenient = sign == "empty"
        operand = self._unary()
        self._is_lenient = False
        self.tokens.leave()
        if sign == "empty":
            return lambda variables: is_empty(operand(variables))
        if sign == "-":
            return lambda variables: subtract(0, operand(variables))
        return lambda variables: not coerce_to_boolean(operand(variables))

    def _postfix(self) -> Node:
        node = self._primary()
        steps: list[Callable[[Json, Variables], Json]] = []
        while self.tokens.text in {".", "["} and self.tokens.kind == "operator":
            if self.tokens.accept("["):
                key = self.expression()
                self.tokens.expect("]")
                steps.append(_index(key))
                continue
            self.tokens.advance()
            start, name = self.tokens.start, self._name()
            if self.tokens.accept("("):
                steps.append(self._method(name, start))
            else:
                steps.append(self._property(name))
        return _path(node, steps)

    def _property(self, name: str) -> Callable[[Json, Variables], Json]:
        return _property(name)

    def _name(self) -> str:
        if self.tokens.kind != "name":
            raise self.tokens.error(f"expected a name instead of {self.tokens.found()}")
        name = self.tokens.text
        self.tokens.advance()
        return name

    def _method(self, name: str, start: int) -> Callable[[Json, Variables], Json]:
        arguments = self._arguments()
        try:
            method = bind_method(name, len(arguments))
        except ExpressionError as error:
            raise self.tokens.error(str(error), start) from None
        if not arguments:
            return lambda value, _: method(value)
        if len(arguments) == 1:
            argument = arguments[0]
            return lambda value, variables: method(value, argument(variables))
        return lambda value, variables: method(value, *(argument(variables) for argument in arguments))

    def _arguments(self) -> tuple[Node, ...]:
        arguments: list[Node] = []
        if not self.tokens.accept(")"):
            arguments.append(self.expression())
            while self.tokens.accept(","):
                arguments.append(self.expression())
            self.tokens.expect(")")
        return tuple(arguments)

    def _primary(self) -> Node:
        tokens = self.tokens
        if tokens.accept("("):
            self._is_lenient = False
            node = self.expression()
            tokens.expect(")")
            return node
        if tokens.kind == "string":
            return _constant(self.string())
        if tokens.kind == "number":
            return _constant(self._number())
        if tokens.kind == "name" and tokens.text not in _WORDS:
            return self._named()
        raise tokens.error(f"expected a value instead of {tokens.found()}")

    def _named(self) -> Node:
        """Read a constant, function, variable or a part of `execution`."""
        tokens, is_lenient = self.tokens, self._is_lenient
        self._is_lenient = False
        start, name = tokens.start, self._name()
        if name in _CONSTANTS:
            return _constant(_CONSTANTS[name])
        if tokens.text == "(" and tokens.kind == "operator":
            return self._function(name, start)
        if name == "execution":
            return self._execution(start)
        if name in VARIABLE_PREFIXES and _PREFIXED.match(tokens.source, tokens.start):
            return self._variable_function(start)
        self.names.add(name)
        return _variable(name, is_lenient)

    def _variable_function(self, start: int) -> Node:
        """Read a function of Flowable: `vars:eq(name, value)`; the variable may be missing."""
        self.tokens.advance()
        function = self._name()
        self.tokens.expect("(")
        name = self.string() if self.tokens.kind == "string" else self._name()
        values: list[Node] = []
        while self.tokens.accept(","):
            values.append(self.expression())
        self.tokens.expect(")")
        call, counts = VARIABLE_FUNCTIONS[function]
        if len(values) not in counts:
            raise self.tokens.error(f"{function}() has {counts.start} values, not {len(values)}", start)
        self.names.add(name)
        arguments = tuple(values)
        return lambda variables: call(
            name in variables, variables.get(name), *(argument(variables) for argument in arguments)
        )

    def _number(self) -> Json:
        text = self.tokens.text
        number = float(text)
        if math.isinf(number) or (text.isdecimal() and number > MAX_NUMBER):
            raise self.tokens.error("a number is too large")
        self.tokens.advance()
        return int(text) if text.isdecimal() else number

    def _function(self, name: str, start: int) -> Node:
        function = FUNCTIONS.get(name)
        if function is None:
            raise self.tokens.error(
                f"the function {name}() is not supported; functions are: {quote_names(FUNCTIONS)}", start
            )
        self.tokens.advance()
        arguments = self._arguments()
        count = 1 if name in {"S", "JSON"} else 0
        if len(arguments) != count:
            raise self.tokens.error(f"{name}() has {count} arguments, not {len(arguments)}", start)
        if not arguments:
            return function
        argument = arguments[0]
        return lambda variables: function(argument(variables))

    def _execution(self, start: int) -> Node:
        """Read a property or method of `execution`."""
        if not self.tokens.accept("."):
            raise self.tokens.error(
                "`execution` itself is no value, and beans that take it cannot be called; "
                "use a property or execution.getVariable('name')",
                start,
            )
        start, name = self.tokens.start, self._name()
        if self.tokens.accept("("):
            return self._execution_method(name, start)
        if name not in EXECUTION_PROPERTIES:
            properties = quote_names(EXECUTION_PROPERTIES)
            raise self.tokens.error(f"execution.{name} is not supported; properties are: {properties}", start)
        return _execution_property(name)

    def _execution_method(self, name: str, start: int) -> Node:
        literal = unquote(self.tokens.text) if self.tokens.kind == "string" else None
        arguments = self._arguments()
        if name in {"getVariable", "getVariableLocal", "hasVariable", "hasVariableLocal"}:
            if len(arguments) != 1:
                raise self.tokens.error(f"execution.{name}() has one argument, the name of a variable", start)
            if literal is not None:
                self.names.add(literal)
            argument = arguments[0]
            if name.startswith("has"):
                return lambda variables: coerce_to_string(argument(variables)) in variables
            return lambda variables: variables.get(coerce_to_string(argument(variables)))
        if name == "setVariable":
            raise self.tokens.error(
                "execution.setVariable(…) has a side effect, so it can only be the whole expression of a "
                "service task or listener; set the variable in a script task",
                start,
            )
        property_ = name[3:4].lower() + name[4:]
        if name.startswith("get") and property_ in EXECUTION_PROPERTIES and not arguments:
            return _execution_property(property_)
        raise self.tokens.error(
            f"execution.{name}() is not supported; methods are getVariable('name'), hasVariable('name') and "
            f"the getters of {quote_names(EXECUTION_PROPERTIES)}",
            start,
        )


def _constant(value: Json) -> Node:
    return lambda _: value


def _variable(name: str, is_lenient: bool) -> Node:
    if is_lenient:
        return lambda variables: variables.get(name)

    def variable(variables: Variables) -> Json:
        try:
            return variables[name]
        except KeyError:
            names = quote_names(key for key in variables if str(key).isidentifier())
            raise ExpressionError(f'there is no variable "{name}"; variables are: {names}') from None

    return variable


def _execution_property(name: str) -> Node:
    def read(variables: Variables) -> Json:
        execution = variables.get("execution")
        return execution.get(name) if isinstance(execution, dict) else None

    return read


def _choose(condition: Node, yes: Node, no: Node) -> Node:
    return lambda variables: yes(variables) if coerce_to_boolean(condition(variables)) else no(variables)


def _connect(operands: tuple[Node, ...], *, until: bool) -> Node:
    """Return the function that is `until` as soon as an operand is: `or` for True, `and` for False."""

    def connected(variables: Variables) -> Json:
        for operand in operands:
            value = operand(variables)
            if (value if value is True or value is False else coerce_to_boolean(value)) is until:
                return until
        return not until

    return connected


def _chain(first: Node, rest: list[tuple[Callable[[Json, Json], Json], Node]]) -> Node:
    """Return the function of operators of one precedence, from left to right."""
    if not rest:
        return first
    if len(rest) == 1:
        calculate, right = rest[0]
        return lambda variables: calculate(first(variables), right(variables))
    steps = tuple(rest)

    def chained(variables: Variables) -> Json:
        value = first(variables)
        for calculate, operand in steps:
            value = calculate(value, operand(variables))
        return value

    return chained


def _property(name: str) -> Callable[[Json, Variables], Json]:
    return lambda value, _: value.get(name) if type(value) is dict else read_property(value, name)


def _index(key: Node) -> Callable[[Json, Variables], Json]:
    return lambda value, variables: read_property(value, key(variables))


def _path(node: Node, steps: list[Callable[[Any, Variables], Json]]) -> Node:
    if not steps:
        return node
    if len(steps) == 1:
        step = steps[0]
        return lambda variables: step(node(variables), variables)
    path = tuple(steps)

    def follow(variables: Variables) -> Json:
        value = node(variables)
        for step in path:
            value = step(value, variables)
        return value

    return follow
