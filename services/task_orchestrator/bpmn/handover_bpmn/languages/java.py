"""Conditions and values of Java, MVEL, JavaScript and Groovy, as far as they have the form of JUEL.

They are read by the parser of JUEL with three differences: `+` joins texts, some static methods of Java and
the `KieFunctions` of jBPM are functions, and `.length` and `.size` are the length of a text or list. Casts
and the suffixes of numbers are dropped. Anything else is no expression.
"""

import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import ClassVar

from handover_bpmn.languages.base import ExpressionError, Json, Variables
from handover_bpmn.languages.juel import JuelExpression, parse, read_set_variable
from handover_bpmn.languages.juel.methods import VARIABLE_FUNCTIONS, bind_method
from handover_bpmn.languages.juel.nodes import Node
from handover_bpmn.languages.juel.parser import BINARY, JuelParser, Operators
from handover_bpmn.languages.juel.values import (
    add,
    coerce_to_boolean,
    coerce_to_number,
    coerce_to_string,
    concatenate,
    is_empty,
    is_equal,
    read_property,
)

_RETURN = re.compile(r"return\b\s*(.*?);?\s*", re.DOTALL)
_RULE = re.compile(r"eval\s*\((.*)\)", re.DOTALL)
_PARTS = re.compile(r"""("(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')""", re.DOTALL)
"""Texts in quotes, within which nothing is rewritten."""
_TYPES = (
    r"(?:java\.(?:lang|util|math)\.)?"
    r"(?:Integer|Long|Short|Double|Float|BigDecimal|Number|String|Boolean|Object|List|Map|Collection"
    r"|int|long|short|double|float|boolean)"
)
_REWRITTEN: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(rf"\(\s*{_TYPES}(?:<[\w., <>]*>)?\s*\)\s*(?=[\w(!]|$)"), ""),  # a cast
    (re.compile(r"(?<![\w.])(\d+(?:\.\d+)?)[LlFfDd]\b"), r"\1"),  # 5L, 2.0f
    (re.compile(r"(?<![\w$])\$(\w+)"), r"\1"),  # an older form of variables
    (re.compile(r"\b(?:java\.lang\.)?Boolean\.TRUE\b"), "true"),
    (re.compile(r"\b(?:java\.lang\.)?Boolean\.FALSE\b"), "false"),
    (re.compile(r"\b(?:java\.(?:lang|util)\.)(?=[A-Z]\w*\.)"), ""),
    (re.compile(r"([=!]=)="), r"\1"),
    (re.compile(r"#\{\s*(\w+)\s*\}"), r"\1"),
    (re.compile(r"\b(?:kcontext|context)\.(?=[gs]etVariable\b)"), "execution."),
)


def _plus(left: Json, right: Json) -> Json:
    if isinstance(left, str) or isinstance(right, str):
        return concatenate(_shown(left), _shown(right))
    return add(left, right)


def _shown(value: Json) -> Json:
    return "null" if value is None else value


def _number(value: Json) -> Json:
    return coerce_to_number(value)


def _whole(value: Json) -> Json:
    number = coerce_to_number(value)
    if not isinstance(number, int):
        raise ExpressionError(f'"{value!s:.40}" is no whole number')
    return number


def _ordered(name: str) -> Callable[..., Json]:
    return lambda value, other: value is not None and VARIABLE_FUNCTIONS[name][0](True, value, other)


_FUNCTIONS: Mapping[str, tuple[Callable[..., Json], int]] = {
    **dict.fromkeys(("Integer.parseInt", "Integer.valueOf", "Long.parseLong", "Long.valueOf"), (_whole, 1)),
    **dict.fromkeys(("Double.parseDouble", "Double.valueOf", "Float.parseFloat", "Number"), (_number, 1)),
    **dict.fromkeys(("Boolean.parseBoolean", "Boolean.valueOf"), (coerce_to_boolean, 1)),
    **dict.fromkeys(
        ("String.valueOf", "Integer.toString", "Long.toString", "Double.toString"),
        (lambda value: coerce_to_string(_shown(value)), 1),
    ),
    "Objects.equals": (is_equal, 2),
    "KieFunctions.isNull": (lambda value: value is None, 1),
    "KieFunctions.isEmpty": (is_empty, 1),
    "KieFunctions.isTrue": (lambda value: value is not None and coerce_to_boolean(value), 1),
    "KieFunctions.isFalse": (lambda value: value is not None and not coerce_to_boolean(value), 1),
    "KieFunctions.equalsTo": (is_equal, 2),
    "KieFunctions.contains": (lambda value, part: _has(value, "contains", part), 2),
    "KieFunctions.startsWith": (lambda value, part: _has(value, "startsWith", part), 2),
    "KieFunctions.endsWith": (lambda value, part: _has(value, "endsWith", part), 2),
    "KieFunctions.greaterThan": (_ordered("gt"), 2),
    "KieFunctions.greaterOrEqualThan": (_ordered("gte"), 2),
    "KieFunctions.lessThan": (_ordered("lt"), 2),
    "KieFunctions.lessOrEqualThan": (_ordered("lte"), 2),
    "KieFunctions.between": (
        lambda value, low, high: _ordered("gte")(value, low) and _ordered("lte")(value, high),
        3,
    ),
}
"""Static methods, and how many arguments they have."""

_CLASSES = frozenset(name.partition(".")[0] for name in _FUNCTIONS)


def _has(value: Json, method: str, part: Json) -> Json:
    return value is not None and bind_method(method, 1)(coerce_to_string(value), coerce_to_string(part))


class _JavaParser(JuelParser):
    """The parser of JUEL with `+` and the static methods of Java."""

    operators: ClassVar[Operators] = tuple(
        {**level, "+": _plus} if "+" in level else level for level in BINARY
    )

    def _named(self) -> Node:
        name, start = self.tokens.text, self.tokens.start
        if name not in _CLASSES:
            return super()._named()
        self._name()
        self.tokens.expect(".")
        name = f"{name}.{self._name()}"
        if name not in _FUNCTIONS:
            raise self.tokens.error(f"{name}() is not supported", start)
        function, count = _FUNCTIONS[name]
        self.tokens.expect("(")
        arguments = self._arguments()
        if len(arguments) != count:
            raise self.tokens.error(f"{name}() has {count} arguments, not {len(arguments)}", start)
        return lambda variables: function(*(argument(variables) for argument in arguments))

    def _property(self, name: str) -> Callable[[Json, Variables], Json]:
        if name not in {"length", "size"}:
            return super()._property(name)
        return lambda value, _: len(value) if isinstance(value, str | list) else read_property(value, name)


@lru_cache(maxsize=4096)
def read_java(text: str) -> JuelExpression:
    """Return a condition or value of Java, MVEL, JavaScript or Groovy; raise `ExpressionError` for others."""
    inner = text.strip().rstrip(";").strip()
    returned = _RETURN.fullmatch(inner)
    if returned is not None:
        inner = returned[1]
    rule = _RULE.fullmatch(inner)
    if rule is not None:
        inner = rule[1]
    expression = parse("${" + rewrite(inner) + "}", _JavaParser)
    assert expression is not None  # noqa: S101 - it begins with ${
    return expression


def read_java_assignment(statement: str) -> tuple[str, JuelExpression] | None:
    """Return name and value of `execution.setVariable("name", value)`; None if it is something else."""
    return read_set_variable("${" + rewrite(statement.strip()) + "}", _JavaParser)


def rewrite(text: str) -> str:
    """Return Java outside of its texts without casts, suffixes of numbers and `$`."""
    parts = _PARTS.split(text)
    for index in range(0, len(parts), 2):
        for pattern, replacement in _REWRITTEN:
            parts[index] = pattern.sub(replacement, parts[index])
    return "".join(parts)
