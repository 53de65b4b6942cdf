"""Expressions: the language of conditions, parameters and scripts in a BPMN file.

It is a small subset of Python: process variables, access by `.` and `[]`, comparisons, `and`, `or`, `not`,
arithmetic, `in`, `a if b else c`, literals and a few pure functions. It has nothing else, so an untrusted
BPMN file is harmless. Values are those of JSON.
"""

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from handover_bpmn.languages.base import (
    MAX_NUMBER,
    ExpressionError,
    Json,
    Variables,
    describe,
    evaluation_error,
    quote_names,
    within_limits,
)
from handover_bpmn.languages.native_grammar import CONSTANTS, in_words, is_name, is_variable_name, parse

__all__ = [
    "ExpressionError",
    "Json",
    "NativeExpression",
    "Variables",
    "is_name",
    "is_variable_name",
    "read",
    "read_script",
]


@dataclass(frozen=True, slots=True)
class NativeExpression:
    """An expression that was parsed and validated."""

    text: str
    _tree: ast.expr

    def value(self, variables: Variables) -> Json:
        """Return its value; raise `ExpressionError` if a variable is missing or has the wrong type."""
        try:
            return within_limits(_evaluate(self._tree, variables))
        except Exception as error:  # noqa: BLE001 - every failure is one of the expression
            raise evaluation_error(f"`{self.text}`", error) from None

    def names(self) -> frozenset[str]:
        """Return the names of the variables that it reads."""
        return frozenset(
            node.id
            for node in ast.walk(self._tree)
            if isinstance(node, ast.Name) and node.id not in CONSTANTS and node.id not in _CALLABLE
        )


@lru_cache(maxsize=4096)
def read(text: str) -> NativeExpression:
    """Return the expression `text`; raise `ExpressionError` if it is invalid."""
    stripped = text.strip()
    return NativeExpression(stripped, parse(stripped))


def read_script(text: str) -> tuple[tuple[str, NativeExpression], ...]:
    """Return the assignments of a script: lines `name = expression`; raise `ExpressionError` for others."""
    steps = []
    for line in (line.strip() for line in text.splitlines()):
        if not line or line.startswith("#"):
            continue
        name, equals, expression = line.partition("=")
        name = name.strip()
        if not equals or expression.startswith("=") or not is_variable_name(name):
            raise ExpressionError(f"`{line}`: a script has lines like `name = expression` and nothing else")
        steps.append((name, read(expression)))
    return tuple(steps)


def _number(value: Json, doing: str) -> int | float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ExpressionError(f"{doing} needs a number, not {describe(value)}")
    return value


def _length(value: Json) -> int:
    if isinstance(value, str | list | dict):
        return len(value)
    raise ExpressionError(f"len() needs a text, a list or an object, not {describe(value)}")


def _rounded(value: Json, digits: Json = 0) -> int | float:
    places = _number(digits, "round()")
    if not isinstance(places, int) or not -15 <= places <= 15:
        raise ExpressionError("round() keeps a whole number of digits from -15 to 15")
    return round(_number(value, "round()"), places) if places else round(_number(value, "round()"))


def _extreme(name: str, choose: Callable[[list[Any]], Any]) -> Callable[..., Json]:
    def function(*values: Json) -> Json:
        items = values[0] if len(values) == 1 and isinstance(values[0], list) else list(values)
        if not items:
            raise ExpressionError(f"{name}() of nothing")
        return choose([_number(item, f"{name}()") for item in items])

    return function


FUNCTIONS: Mapping[str, Callable[..., Json]] = {
    "len": _length,
    "abs": lambda value: abs(_number(value, "abs()")),
    "round": _rounded,
    "min": _extreme("min", min),
    "max": _extreme("max", max),
}

_CALLABLE = frozenset({*FUNCTIONS, "defined"})

_ARITHMETIC: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}
_ORDER: Mapping[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


def _evaluate(node: ast.expr, variables: Variables) -> Json:  # noqa: PLR0911 - one return a kind of node
    match node:
        case ast.Constant():
            return node.value
        case ast.Name():
            return _variable(node.id, variables)
        case ast.Attribute():
            return _part(_evaluate(node.value, variables), node.attr)
        case ast.Subscript():
            return _part(_evaluate(node.value, variables), _evaluate(node.slice, variables))
        case ast.BoolOp():
            return _either(node, variables)
        case ast.UnaryOp():
            return _signed(node.op, _evaluate(node.operand, variables))
        case ast.BinOp():
            return _calculate(node.op, _evaluate(node.left, variables), _evaluate(node.right, variables))
        case ast.Compare():
            return _compare(node, variables)
        case ast.IfExp():
            return _evaluate(node.body if _evaluate(node.test, variables) else node.orelse, variables)
        case ast.List():
            return [_evaluate(item, variables) for item in node.elts]
        case ast.Dict():
            return _object(node, variables)
        case ast.Call(func=ast.Name(id=name)):
            return _call(name, node.args, variables)
    raise ExpressionError(f"{in_words(node)} is not part of the language")


def _variable(name: str, variables: Variables) -> Json:
    if name in variables:
        return variables[name]
    if name in CONSTANTS:
        return CONSTANTS[name]
    names = quote_names(variables) if variables else "none yet"
    raise ExpressionError(f'there is no variable "{name}"; those there are: {names}')


def _part(whole: Json, key: Json) -> Json:
    if isinstance(whole, dict):
        if isinstance(key, str) and key in whole:
            return whole[key]
        raise ExpressionError(
            f'there is no "{key}" in the object; it has: {", ".join(map(str, whole)) or "nothing"}'
        )
    if isinstance(whole, list):
        if isinstance(key, bool) or not isinstance(key, int):
            raise ExpressionError(f"a list is asked for a whole number, not {describe(key)}")
        if not -len(whole) <= key < len(whole):
            raise ExpressionError(f"a list of {len(whole)} has no item {key}")
        return whole[key]
    raise ExpressionError(f'{describe(whole)} has no parts, so none is "{key}"')


def _either(node: ast.BoolOp, variables: Variables) -> Json:
    value: Json = None
    for operand in node.values:
        value = _evaluate(operand, variables)
        if bool(value) is isinstance(node.op, ast.Or):
            break
    return value


def _signed(sign: ast.unaryop, value: Json) -> Json:
    if isinstance(sign, ast.Not):
        return not value
    number = _number(value, "a sign")
    return -number if isinstance(sign, ast.USub) else number


def _calculate(kind: ast.operator, left: Json, right: Json) -> Json:
    if isinstance(kind, ast.Add):
        if isinstance(left, str) and isinstance(right, str):
            return within_limits(left + right)
        if isinstance(left, list) and isinstance(right, list):
            return within_limits(left + right)
    try:
        result = _ARITHMETIC[type(kind)](_number(left, "arithmetic"), _number(right, "arithmetic"))
    except ZeroDivisionError:
        raise ExpressionError("division by zero") from None
    except OverflowError:
        raise ExpressionError("a number grew too large") from None
    if isinstance(result, int) and abs(result) > MAX_NUMBER:
        raise ExpressionError("a number grew too large")
    return result


def _compare(node: ast.Compare, variables: Variables) -> bool:
    left = _evaluate(node.left, variables)
    for kind, operand in zip(node.ops, node.comparators, strict=True):
        right = _evaluate(operand, variables)
        if not _holds(kind, left, right):
            return False
        left = right
    return True


def _holds(kind: ast.cmpop, left: Json, right: Json) -> bool:
    if isinstance(kind, ast.Eq | ast.Is):
        return _equal(left, right)
    if isinstance(kind, ast.NotEq | ast.IsNot):
        return not _equal(left, right)
    if isinstance(kind, ast.In | ast.NotIn):
        return _contains(right, left) is isinstance(kind, ast.In)
    if isinstance(left, str) and isinstance(right, str):
        return _ORDER[type(kind)](left, right)
    return _ORDER[type(kind)](_number(left, "a comparison"), _number(right, "a comparison"))


def _equal(left: Json, right: Json) -> bool:
    if isinstance(left, bool) is not isinstance(right, bool):
        return False
    return bool(left == right)


def _contains(whole: Json, part: Json) -> bool:
    if isinstance(whole, list):
        return any(_equal(item, part) for item in whole)
    if isinstance(whole, str | dict) and isinstance(part, str):
        return part in whole
    raise ExpressionError(f"{describe(part)} cannot be looked for in {describe(whole)}")


def _object(node: ast.Dict, variables: Variables) -> Json:
    pairs: dict[str, Json] = {}
    for key_node, value_node in zip(node.keys, node.values, strict=True):
        key = None if key_node is None else _evaluate(key_node, variables)
        if not isinstance(key, str):
            raise ExpressionError("the keys of an object are texts")
        pairs[key] = _evaluate(value_node, variables)
    return pairs


def _call(name: str, arguments: list[ast.expr], variables: Variables) -> Json:
    if name == "defined":
        return isinstance(arguments[0], ast.Name) and arguments[0].id in variables
    return FUNCTIONS[name](*(_evaluate(argument, variables) for argument in arguments))
