"""Methods and functions of JUEL: those of Java texts, lists and maps, of dates (Joda-Time), and of Spin.

A date is its ISO 8601 text, so the methods of dates are methods of texts that are one.
"""

import json
import math
import operator
from collections.abc import Callable, Iterable, Mapping
from datetime import timedelta
from typing import Any, NamedTuple

from handover.formats.durations import Duration
from handover_bpmn.languages.base import ExpressionError, Json, describe, quote_names, within_limits
from handover_bpmn.languages.juel.values import (
    MAX_STRING,
    check_number,
    check_string,
    coerce_to_number,
    coerce_to_string,
    compare,
    is_empty,
    is_equal,
    read_property,
)
from handover_bpmn.languages.patterns import is_match
from handover_bpmn.languages.times import read_datetime, read_now, shift, write_moment

EXECUTION_PROPERTIES = frozenset(
    {
        *("id", "processInstanceId", "processBusinessKey", "businessKey", "processDefinitionId"),
        *("currentActivityId", "currentActivityName", "activityInstanceId", "tenantId"),
    }
)
"""The properties of `execution`; the engine gives their values as the variable `execution`, an object."""


def _read_json(value: Json) -> Json:
    if not isinstance(value, str):
        return value
    try:
        return within_limits(json.loads(value, parse_constant=lambda _: None))
    except (ValueError, RecursionError):
        raise ExpressionError("the text is no JSON") from None


FUNCTIONS: Mapping[str, Callable[[Any], Json]] = {
    "now": lambda variables: write_moment(read_now(variables)),
    "dateTime": lambda variables: write_moment(read_now(variables)),
    "S": _read_json,
    "JSON": _read_json,
}
"""`S` and `JSON` have one argument; the others get the variables."""


def _is_comparison(sign: str, holds: Callable[[Any, Any], bool]) -> Callable[..., Json]:
    return lambda _, value, other: compare(sign, holds, value, other)


def _has_parts(quantifier: Callable[[Iterable[bool]], bool]) -> Callable[..., Json]:
    def contains(_: bool, value: Json, *parts: Json) -> bool:
        if isinstance(value, str):
            return quantifier(coerce_to_string(part) in value for part in parts)
        return isinstance(value, list) and quantifier(_index_of(value, part) >= 0 for part in parts)

    return contains


_ONE, _NONE, _ANY = range(1, 2), range(1), range(1, 100)

VARIABLE_FUNCTIONS: Mapping[str, tuple[Callable[..., Json], range]] = {
    "get": (lambda _, value: value, _NONE),
    "getOrDefault": (lambda _, value, default: default if value is None else value, _ONE),
    "exists": (lambda is_set, value: is_set and value is not None, _NONE),
    **dict.fromkeys(("isEmpty", "empty"), (lambda _, value: is_empty(value), _NONE)),
    **dict.fromkeys(("isNotEmpty", "notEmpty"), (lambda _, value: not is_empty(value), _NONE)),
    **dict.fromkeys(("equals", "eq"), (lambda _, value, other: is_equal(value, other), _ONE)),
    **dict.fromkeys(("notEquals", "ne"), (lambda _, value, other: not is_equal(value, other), _ONE)),
    **dict.fromkeys(("lowerThan", "lessThan", "lt"), (_is_comparison("<", operator.lt), _ONE)),
    **dict.fromkeys(
        ("lowerThanOrEquals", "lessThanOrEquals", "lte"), (_is_comparison("<=", operator.le), _ONE)
    ),
    **dict.fromkeys(("greaterThan", "gt"), (_is_comparison(">", operator.gt), _ONE)),
    **dict.fromkeys(("greaterThanOrEquals", "gte"), (_is_comparison(">=", operator.ge), _ONE)),
    "contains": (_has_parts(all), _ANY),
    "containsAny": (_has_parts(any), _ANY),
}
"""The functions of Flowable with the prefix `variables`, `vars` or `var`, and how many values they compare.

They get whether the variable is set, and its value.
"""


class _Method(NamedTuple):
    call: Callable[..., Json]
    least: int = 0
    most: int = 0


def _text(argument: Json) -> str:
    if not isinstance(argument, str):
        raise ExpressionError(f"the argument is a text, not {describe(argument)}")
    return argument


def _position(argument: Json, text: str) -> int:
    index = coerce_to_number(argument)
    if not isinstance(index, int) or not 0 <= index <= len(text):
        raise ExpressionError(
            f"position {coerce_to_string(argument)[:40]} is outside the text of {len(text)} characters"
        )
    return index


def _substring(text: str, start: Json, *end: Json) -> str:
    first = _position(start, text)
    last = _position(end[0], text) if end else len(text)
    if last < first:
        raise ExpressionError(f"substring({first}, {last}) ends before it starts")
    return text[first:last]


def _character(text: str, index: Json) -> str:
    position = _position(index, text)
    if position == len(text):
        raise ExpressionError(f"position {position} is outside the text of {len(text)} characters")
    return text[position]


def _replace(text: str, old: Json, new: Json) -> str:
    old, new = _text(old), _text(new)
    if len(text) + text.count(old) * len(new) > MAX_STRING:
        raise ExpressionError(f"a text has at most {MAX_STRING} characters")
    return text.replace(old, new)


_SPECIAL = frozenset("\\^$.|?*+()[]{}")


def _split(text: str, separator: Json) -> Json:
    pattern = _text(separator)
    literal = pattern[1:] if len(pattern) == 2 and pattern[0] == "\\" and pattern[1] in _SPECIAL else pattern
    if not literal or (literal is pattern and _SPECIAL & set(pattern)):
        raise ExpressionError("split() takes a separator, not a regular expression")
    return within_limits(text.split(literal))


def _integer(value: Json) -> int:
    number = math.trunc(coerce_to_number(value))
    return int(check_number(number))


def _shifted(unit: Callable[[int], Duration], sign: int) -> Callable[..., Json]:
    def shifted(text: str, count: Json) -> str:
        moment, steps = read_datetime(text), coerce_to_number(count)
        if moment is None:
            raise ExpressionError(f'"{text[:40]}" is no ISO 8601 date')
        if not isinstance(steps, int) or abs(steps) > 10**10:
            raise ExpressionError("a date is moved by a whole number of units")
        return write_moment(shift(moment, unit(steps), sign))

    return shifted


def _start_of_day(text: str) -> str:
    moment = read_datetime(text)
    if moment is None:
        raise ExpressionError(f'"{text[:40]}" is no ISO 8601 date')
    return write_moment(moment.replace(hour=0, minute=0, second=0, microsecond=0))


def _epoch_ms(text: str) -> int:
    moment = read_datetime(text)
    if moment is None or moment.tzinfo is None:
        raise ExpressionError(f'"{text[:40]}" is no ISO 8601 moment with a time zone')
    return int(check_number(math.floor(moment.timestamp() * 1000)))


def _item(items: list[Json], index: Json) -> Json:
    position = coerce_to_number(index)
    if not isinstance(position, int) or not 0 <= position < len(items):
        raise ExpressionError(f"a list of {len(items)} has no item {coerce_to_string(index)[:40]}")
    return items[position]


def _index_of(items: list[Json], value: Json) -> int:
    return next((index for index, item in enumerate(items) if _is_same(item, value)), -1)


def _is_same(left: Json, right: Json) -> bool:
    """Return Java's `equals`: no coercion except among numbers."""
    if isinstance(left, bool) or isinstance(right, bool):
        return left is right
    return bool(left == right)


def _prop(value: Mapping[str, Json], name: Json) -> Json:
    if name not in value:
        raise ExpressionError(
            f'there is no "{coerce_to_string(name)[:40]}" in the object; it has: {quote_names(value)}'
        )
    return value[name]


def _of_type(kind: type | tuple[type, ...]) -> Callable[[Json], Json]:
    def checked(value: Json) -> Json:
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise ExpressionError(f"the JSON value is {describe(value)}")
        return value

    return checked


def _fixed(unit: timedelta) -> Callable[[int], Duration]:
    microseconds = unit // timedelta(microseconds=1)
    return lambda count: Duration(0, count * microseconds)


_UNITS: Mapping[str, Callable[[int], Duration]] = {
    "Years": lambda count: Duration(12 * count, 0),
    "Months": lambda count: Duration(count, 0),
    "Weeks": _fixed(timedelta(weeks=1)),
    "Days": _fixed(timedelta(days=1)),
    "Hours": _fixed(timedelta(hours=1)),
    "Minutes": _fixed(timedelta(minutes=1)),
    "Seconds": _fixed(timedelta(seconds=1)),
    "Millis": _fixed(timedelta(milliseconds=1)),
}

_EVERY: Mapping[str, _Method] = {
    "equals": _Method(_is_same, 1, 1),
    "toString": _Method(coerce_to_string),
    "value": _Method(lambda value: value),
    "stringValue": _Method(_of_type(str)),
    "numberValue": _Method(_of_type((int, float))),
    "boolValue": _Method(_of_type(bool)),
    "isNull": _Method(lambda value: value is None),
}
_STRING: Mapping[str, _Method] = {
    "equalsIgnoreCase": _Method(
        lambda text, other: isinstance(other, str) and text.lower() == other.lower(), 1, 1
    ),
    "contains": _Method(lambda text, part: _text(part) in text, 1, 1),
    "startsWith": _Method(lambda text, part: text.startswith(_text(part)), 1, 1),
    "endsWith": _Method(lambda text, part: text.endswith(_text(part)), 1, 1),
    "isEmpty": _Method(lambda text: not text),
    "isBlank": _Method(lambda text: not text.strip()),
    "length": _Method(len),
    "toUpperCase": _Method(lambda text: check_string(text.upper())),
    "toLowerCase": _Method(lambda text: check_string(text.lower())),
    "trim": _Method(str.strip),
    "substring": _Method(_substring, 1, 2),
    "charAt": _Method(_character, 1, 1),
    "matches": _Method(lambda text, pattern: is_match(text, _text(pattern), is_whole=True), 1, 1),
    "indexOf": _Method(lambda text, part: text.find(_text(part)), 1, 1),
    "lastIndexOf": _Method(lambda text, part: text.rfind(_text(part)), 1, 1),
    "concat": _Method(lambda text, part: check_string(text + _text(part)), 1, 1),
    "replace": _Method(_replace, 2, 2),
    "split": _Method(_split, 1, 1),
    "toDate": _Method(lambda text: text),
    "withTimeAtStartOfDay": _Method(_start_of_day),
    "getTime": _Method(_epoch_ms),
    "getMillis": _Method(_epoch_ms),
    **{f"plus{name}": _Method(_shifted(unit, 1), 1, 1) for name, unit in _UNITS.items()},
    **{f"minus{name}": _Method(_shifted(unit, -1), 1, 1) for name, unit in _UNITS.items()},
}
_LIST: Mapping[str, _Method] = {
    "size": _Method(len),
    "isEmpty": _Method(lambda items: not items),
    "contains": _Method(lambda items, value: _index_of(items, value) >= 0, 1, 1),
    "indexOf": _Method(_index_of, 1, 1),
    "get": _Method(_item, 1, 1),
    "elements": _Method(lambda items: items),
}
_OBJECT: Mapping[str, _Method] = {
    "size": _Method(len),
    "isEmpty": _Method(lambda value: not value),
    "get": _Method(read_property, 1, 1),
    "getOrDefault": _Method(lambda value, key, default: value.get(coerce_to_string(key), default), 2, 2),
    "containsKey": _Method(lambda value, key: coerce_to_string(key) in value, 1, 1),
    "containsValue": _Method(lambda value, item: _index_of(list(value.values()), item) >= 0, 1, 1),
    "keySet": _Method(list),
    "values": _Method(lambda value: list(value.values())),
    "prop": _Method(_prop, 1, 1),
    "hasProp": _Method(lambda value, name: name in value, 1, 1),
}
_NUMBER: Mapping[str, _Method] = {
    "intValue": _Method(_integer),
    "longValue": _Method(_integer),
    "doubleValue": _Method(lambda value: float(coerce_to_number(value))),
    "compareTo": _Method(
        lambda value, other: (value > coerce_to_number(other)) - (value < coerce_to_number(other)), 1, 1
    ),
}
_BOOLEAN: Mapping[str, _Method] = {"booleanValue": _Method(lambda value: value)}

_METHODS: Mapping[type, Mapping[str, _Method]] = {
    str: {**_EVERY, **_STRING},
    list: {**_EVERY, **_LIST},
    dict: {**_EVERY, **_OBJECT},
    int: {**_EVERY, **_NUMBER},
    float: {**_EVERY, **_NUMBER},
    bool: {**_EVERY, **_BOOLEAN},
}
METHODS = frozenset(name for methods in _METHODS.values() for name in methods)


def bind_method(name: str, count: int) -> Callable[..., Json]:
    """Return the function of an object and `count` arguments that calls the method `name` of the object.

    A getter `getTotal()` or `isOpen()` of an object without such a method reads `total` or `open`.
    Raises `ExpressionError` if no type has the method.
    """
    getter = _property_of(name) if count == 0 else None
    if name not in METHODS and getter is None:
        raise ExpressionError(
            f"the method .{name}() is not supported (docs/reference/expressions.md lists those that are); "
            "compute the value in a script task or a Task, and use its variable"
        )

    def call(value: Json, *arguments: Json) -> Json:
        method = _METHODS.get(type(value), {}).get(name)
        if method is None:
            return _get(value, name, getter)
        if not method.least <= len(arguments) <= method.most:
            counts = str(method.least) if method.least == method.most else f"{method.least} to {method.most}"
            raise ExpressionError(
                f".{name}() of {describe(value)} has {counts} arguments, not {len(arguments)}"
            )
        try:
            return method.call(value, *arguments)
        except TypeError:
            raise ExpressionError(f".{name}() of {describe(value)} cannot take these arguments") from None

    return call


def _property_of(name: str) -> str | None:
    for prefix in ("get", "is"):
        rest = name.removeprefix(prefix)
        if rest != name and rest[:1].isupper():
            return rest[0].lower() + rest[1:]
    return None


def _get(value: Json, name: str, getter: str | None) -> Json:
    if isinstance(value, dict) and getter is not None:
        return value.get(getter)
    if value is None and name == "isNull":
        return True
    raise ExpressionError(
        f"{describe(value)} has no method .{name}(); it has: {quote_names(_METHODS.get(type(value), ()))}"
    )
