"""Operators and coercions of JUEL, after the Expression Language 2.1 specification (1.5 to 1.9, 1.18)."""

import json
import math
import re
from collections.abc import Callable
from typing import Any

from handover_bpmn.languages.base import MAX_ITEMS, MAX_NUMBER, ExpressionError, Json, describe

MAX_STRING = 64 * MAX_ITEMS
"""Characters of a text that an expression may create."""

_NUMBER = re.compile(r"[+-]?(\d{1,400}\.?\d{0,400}|\.\d{1,400})([eE][+-]?\d{1,4})?", re.ASCII)
_INTEGER = re.compile(r"[+-]?\d{1,18}", re.ASCII)


def coerce_to_boolean(value: Json) -> bool:
    """Return `value` as a condition: null and texts other than "true" are false; numbers are refused."""
    if value is True or value is False:
        return bool(value)
    if value is None:
        return False
    if isinstance(value, str):
        return value.lower() == "true"
    raise ExpressionError(f"a condition needs true or false, not {describe(value)}")


def coerce_to_number(value: Json) -> int | float:
    """Return `value` for arithmetic: null and "" are 0, a text is the number that it spells."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value
    if value is None or value == "":
        return 0
    if isinstance(value, str) and _NUMBER.fullmatch(value):
        return check_number(int(value) if _INTEGER.fullmatch(value) else float(value))
    shown = f'the text "{value[:40]}"' if isinstance(value, str) else describe(value)
    raise ExpressionError(f"a number is needed, not {shown}; `+=` or .concat() joins texts")


def coerce_to_string(value: Json) -> str:
    """Return `value` as text: null is empty, lists and objects are JSON."""
    if isinstance(value, str):
        return value
    if value is None:
        return ""
    try:
        return json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        raise ExpressionError(f"{type(value).__name__} is no JSON value") from None


def check_number(number: float) -> int | float:
    """Return `number`; raise `ExpressionError` if JSON would lose it."""
    if isinstance(number, int):
        if -MAX_NUMBER <= number <= MAX_NUMBER:
            return number
        raise ExpressionError("a number grew too large")
    if not math.isfinite(number):
        raise ExpressionError("a number must be finite")
    return number


def check_string(text: str) -> str:
    """Return `text`; raise `ExpressionError` if it is too long."""
    if len(text) > MAX_STRING:
        raise ExpressionError(f"a text has at most {MAX_STRING} characters")
    return text


def is_equal(left: Json, right: Json) -> bool:
    """Return `left == right`: numbers, then booleans, then texts decide how the other side is coerced."""
    kind = type(left)
    if kind is type(right) and kind in {str, int, float, bool}:
        return bool(left == right)
    if left is None or right is None:
        return left is right
    if _is_number(left) or _is_number(right):
        return coerce_to_number(left) == coerce_to_number(right)
    if isinstance(left, bool) or isinstance(right, bool):
        return coerce_to_boolean(left) is coerce_to_boolean(right)
    if isinstance(left, str) or isinstance(right, str):
        return coerce_to_string(left) == coerce_to_string(right)
    return bool(left == right)


def compare(sign: str, holds: Callable[[Any, Any], bool], left: Json, right: Json) -> bool:
    """Return whether `left` and `right` are in order; null is in order with nothing but null (`<=`, `>=`)."""
    if type(left) is int and type(right) is int:
        return holds(left, right)
    if left is None or right is None:
        return left is right and sign in {"<=", ">="}
    if _is_number(left) or _is_number(right):
        return holds(coerce_to_number(left), coerce_to_number(right))
    if isinstance(left, str) or isinstance(right, str):
        return holds(coerce_to_string(left), coerce_to_string(right))
    raise ExpressionError(f"`{sign}` cannot order {describe(left)} and {describe(right)}")


def add(left: Json, right: Json) -> Json:
    """Return the sum of two numbers; texts are never joined."""
    return check_number(coerce_to_number(left) + coerce_to_number(right))


def subtract(left: Json, right: Json) -> Json:
    """Return the difference of two numbers."""
    return check_number(coerce_to_number(left) - coerce_to_number(right))


def multiply(left: Json, right: Json) -> Json:
    """Return the product of two numbers."""
    return check_number(coerce_to_number(left) * coerce_to_number(right))


def divide(left: Json, right: Json) -> Json:
    """Return the quotient, which is never rounded to an integer."""
    divisor = coerce_to_number(right)
    if divisor == 0:
        raise ExpressionError("division by zero")
    try:
        return check_number(coerce_to_number(left) / divisor)
    except OverflowError:
        raise ExpressionError("a number grew too large") from None


def remainder(left: Json, right: Json) -> Json:
    """Return the remainder with the sign of `left`, as in Java."""
    dividend, divisor = coerce_to_number(left), coerce_to_number(right)
    if divisor == 0:
        raise ExpressionError("division by zero")
    if isinstance(dividend, int) and isinstance(divisor, int):
        rest = abs(dividend) % abs(divisor)
        return -rest if dividend < 0 else rest
    try:
        return check_number(math.fmod(dividend, divisor))
    except OverflowError:
        raise ExpressionError("a number grew too large") from None


def concatenate(left: Json, right: Json) -> Json:
    """Return both as one text."""
    return check_string(coerce_to_string(left) + coerce_to_string(right))


def is_empty(value: Json) -> bool:
    """Return whether `value` is null, or a text, list or object without content."""
    return value is None or (isinstance(value, str | list | dict) and not value)


def read_property(value: Json, key: Json) -> Json:
    """Return a part of an object or list; null if it has none, or if `value` is null."""
    if value is None or key is None:
        return None
    if isinstance(value, dict):
        return value.get(coerce_to_string(key))
    if isinstance(value, list):
        index = coerce_to_number(key)
        if not isinstance(index, int):
            raise ExpressionError("the index of a list is a whole number")
        return value[index] if 0 <= index < len(value) else None
    raise ExpressionError(f'{describe(value)} has no property "{coerce_to_string(key)[:40]}"')


def _is_number(value: Json) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
