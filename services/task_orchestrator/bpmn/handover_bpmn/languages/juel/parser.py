"""Parser of JUEL: reads an expression into functions of the variables."""

import math
import operator
import re
from collections.abc import Callable
from typing import ClassVar, TypeAlias

from handover_bpmn.languages.base import MAX_NUMBER, ExpressionError, Json, Variables, quote_names
from handover_bpmn.languages.juel.methods import (
    EXECUTION_PROPERTIES,
    FUNCTIONS,
    VARIABLE_FUNCTIONS,
    bind_method,
)
from handover_bpmn.languages.juel.nodes import (
    Node,
    chain,
    choose,
    connect,
    constant,
    execution_property,
    follow_path,
    index_step,
    property_step,
    variable_node,
)
from handover_bpmn.languages.juel.values import (
    add,
    coerce_to_boolean,
    coerce_to_string,
    compare,
    concatenate,
    divide,
    is_empty,
    is_equal,
    multiply,
    remainder,
    subtract,
)
from handover_bpmn.languages.tokens import Tokens, unquote

_PATTERN = re.compile(
    r"""(?P<skip>\s+)
    |(?P<number>(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+)(?:[eE][+-]?[0-9]+)?)
    |(?P<name>[^\W\d][\w$]*|\$[\w$]*)
    |(?P<string>"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')
    |(?P<operator>&&|\|\||==|!=|<=|>=|\+=|[-+*/%<>!?:.,()\[\]{}])""",
    re.VERBOSE | re.DOTALL,
)
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


class JuelParser:
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
            condition = choose(condition, yes, no)
        self.tokens.leave()
        return condition

    def _or(self) -> Node:
        operands = [self._and()]
        while self.tokens.accept("||", "or"):
            operands.append(self._and())
        return operands[0] if len(operands) == 1 else connect(tuple(operands), until=True)

    def _and(self) -> Node:
        operands = [self._binary(0)]
        while self.tokens.accept("&&", "and"):
            operands.append(self._binary(0))
        return operands[0] if len(operands) == 1 else connect(tuple(operands), until=False)

    def _binary(self, level: int) -> Node:
        if level == len(self.operators):
            return self._unary()
        first = self._binary(level + 1)
        operators = self.operators[level]
        rest: list[tuple[Callable[[Json, Json], Json], Node]] = []
        while (sign := self.tokens.accept(*operators)) is not None:
            rest.append((operators[sign], self._binary(level + 1)))
        return chain(first, rest)

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
                steps.append(index_step(key))
                continue
            self.tokens.advance()
            start, name = self.tokens.start, self._name()
            if self.tokens.accept("("):
                steps.append(self._method(name, start))
            else:
                steps.append(self._property(name))
        return follow_path(node, steps)

    def _property(self, name: str) -> Callable[[Json, Variables], Json]:
        return property_step(name)

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
            return constant(self.string())
        if tokens.kind == "number":
            return constant(self._number())
        if tokens.kind == "name" and tokens.text not in _WORDS:
            return self._named()
        raise tokens.error(f"expected a value instead of {tokens.found()}")

    def _named(self) -> Node:
        """Read a constant, function, variable or a part of `execution`."""
        tokens, is_lenient = self.tokens, self._is_lenient
        self._is_lenient = False
        start, name = tokens.start, self._name()
        if name in _CONSTANTS:
            return constant(_CONSTANTS[name])
        if tokens.text == "(" and tokens.kind == "operator":
            return self._function(name, start)
        if name == "execution":
            return self._execution(start)
        if name in VARIABLE_PREFIXES and _PREFIXED.match(tokens.source, tokens.start):
            return self._variable_function(start)
        self.names.add(name)
        return variable_node(name, is_lenient)

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
        return execution_property(name)

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
            return execution_property(property_)
        raise self.tokens.error(
            f"execution.{name}() is not supported; methods are getVariable('name'), hasVariable('name') and "
            f"the getters of {quote_names(EXECUTION_PROPERTIES)}",
            start,
        )
