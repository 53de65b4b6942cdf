"""Fields: what the page shows of any kind of form, and the rules for the value of one field."""

import math
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import date, datetime, time
from enum import StrEnum
from typing import Any

from handover.messages import Message, message
from handover_bpmn.languages.base import ExpressionError, Json
from handover_bpmn.languages.patterns import is_match

MAX_FIELDS = 1000
MAX_DEPTH = 12
MAX_LIST_ITEMS = 500

_EMAIL = re.compile(r"[^@\s]{1,64}@[^@\s]{1,255}", re.ASCII)
_PHONE = re.compile(r"\+?[0-9()./ -]{3,40}", re.ASCII)


class FieldKind(StrEnum):
    """The kind of a field; those from `GROUP` on have no value of their own."""

    TEXT = "text"
    MULTILINE = "multiline"
    NUMBER = "number"
    INTEGER = "integer"
    BOOLEAN = "boolean"
    DATE = "date"
    TIME = "time"
    DATETIME = "datetime"
    CHOICE = "choice"
    CHOICES = "choices"
    JSON = "json"
    LIST = "list"
    COMPUTED = "computed"
    GROUP = "group"
    NOTE = "note"
    IMAGE = "image"
    LINK = "link"
    TABLE = "table"
    SEPARATOR = "separator"


WITHOUT_VALUE = frozenset(
    {
        *(FieldKind.GROUP, FieldKind.NOTE, FieldKind.IMAGE, FieldKind.LINK, FieldKind.TABLE),
        FieldKind.SEPARATOR,
    }
)


@dataclass(frozen=True, slots=True)
class Option:
    """A value that can be chosen."""

    value: Json
    label: str


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a form, or a part that is only shown.

    `path` is the place of its value in the result: names joined by dots; within a list it starts at the item.
    """

    path: str
    kind: FieldKind
    label: str = ""
    hint: str | None = None
    is_required: bool = False
    is_read_only: bool = False
    initial: Json = None
    options: tuple[Option, ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    min_length: int | None = None
    max_length: int | None = None
    pattern: str | None = None
    text_format: str | None = None
    """`email` or `phone`."""
    decimals: int | None = None
    unit: str | None = None
    is_text: bool = False
    """Whether a number is written as text."""
    fields: tuple["Field", ...] = ()
    """The fields of a group, or of each item of a list."""
    columns: tuple[tuple[str, str], ...] = ()
    """Keys and labels of the columns of a table, whose rows are `initial`."""


@dataclass(frozen=True, slots=True)
class FieldFault:
    """Why the value of a field is refused."""

    path: str
    reason: Message


def value_fault(field: Field, value: Json) -> Message | None:
    """Return why `value` is refused for `field`; None if it is accepted."""
    is_unchecked = field.kind is FieldKind.BOOLEAN and value is False
    if value is None or value in ("", []) or is_unchecked:
        return message("form.required", "a value is required") if field.is_required else None
    rule = _RULES.get(field.kind)
    return None if rule is None else rule(field, value)


def _boolean_fault(_: Field, value: Json) -> Message | None:
    return None if isinstance(value, bool) else wrong_type("boolean")


def _number_fault(field: Field, value: Json) -> Message | None:
    if field.is_text and isinstance(value, str):
        with suppress(ValueError):
            value = float(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return wrong_type("number")
    if field.kind is FieldKind.INTEGER and value != int(value):
        return wrong_type("integer")
    if field.minimum is not None and value < field.minimum:
        return too_small(field.minimum)
    if field.maximum is not None and value > field.maximum:
        return too_large(field.maximum)
    if field.decimals is not None and not math.isclose(value, round(value, field.decimals), rel_tol=1e-12):
        return message("form.decimals", "at most {decimals} decimal places", decimals=field.decimals)
    return None


def _time_fault(field: Field, value: Json) -> Message | None:
    if isinstance(value, str) and len(value) <= 64:
        with suppress(ValueError):
            _READERS[field.kind](value)
            return None
    return wrong_type(field.kind.value)


def _choice_fault(field: Field, value: Json) -> Message | None:
    chosen = value if field.kind is FieldKind.CHOICES else [value]
    if not isinstance(chosen, list):
        return wrong_type("array")
    allowed = [option.value for option in field.options]
    if all(any(type(choice) is type(option) and choice == option for option in allowed) for choice in chosen):
        return None
    return not_allowed()


def _text_fault(field: Field, value: Json) -> Message | None:
    if not isinstance(value, str):
        return wrong_type("string")
    if field.min_length is not None and len(value) < field.min_length:
        return message("form.too_short", "at least {limit} characters", limit=field.min_length)
    if field.max_length is not None and len(value) > field.max_length:
        return message("form.too_long", "at most {limit} characters", limit=field.max_length)
    if field.pattern is not None and not matches(value, field.pattern):
        return bad_format()
    pattern = {"email": _EMAIL, "phone": _PHONE}.get(field.text_format or "")
    return bad_format() if pattern is not None and pattern.fullmatch(value) is None else None


_READERS: Mapping[FieldKind, Callable[[str], object]] = {
    FieldKind.DATE: date.fromisoformat,
    FieldKind.TIME: time.fromisoformat,
    FieldKind.DATETIME: datetime.fromisoformat,
}
_RULES: Mapping[FieldKind, Callable[[Field, Json], Message | None]] = {
    FieldKind.NUMBER: _number_fault,
    FieldKind.INTEGER: _number_fault,
    FieldKind.BOOLEAN: _boolean_fault,
    **dict.fromkeys(_READERS, _time_fault),
    FieldKind.CHOICE: _choice_fault,
    FieldKind.CHOICES: _choice_fault,
    FieldKind.TEXT: _text_fault,
    FieldKind.MULTILINE: _text_fault,
}


def matches(text: str, pattern: str) -> bool:
    """Return whether a part of `text` matches; a pattern that RE2 cannot read accepts every text."""
    try:
        return is_match(text, pattern, is_whole=False)
    except ExpressionError:
        return True


def too_small(limit: float) -> Message:
    """Return the reason for a number below the minimum."""
    return message("form.too_small", "at least {limit}", limit=_plain(limit))


def too_large(limit: float) -> Message:
    """Return the reason for a number above the maximum."""
    return message("form.too_large", "at most {limit}", limit=_plain(limit))


def not_allowed() -> Message:
    """Return the reason for a value that is none of the options."""
    return message("form.not_allowed", "the value is none of the options")


def bad_format() -> Message:
    """Return the reason for a text that does not match the required form."""
    return message("form.format", "the text does not have the required format")


_WRONG_TYPES: Mapping[str, Message] = {
    "string": message("form.not_text", "this is no text"),
    "number": message("form.not_a_number", "this is no number"),
    "integer": message("form.not_whole", "this is no whole number"),
    "boolean": message("form.not_boolean", "this is neither true nor false"),
    "array": message("form.not_a_list", "this is no list"),
    "date": message("form.not_a_date", "this is no date"),
    "time": message("form.not_a_time", "this is no time"),
    "datetime": message("form.not_a_datetime", "this is no date with a time"),
}


def wrong_type(expected: str) -> Message:
    """Return the reason for a value of another type than `expected`, a type of JSON Schema or a kind."""
    fault = _WRONG_TYPES.get(expected)
    return fault or message("form.type", "this is not of the type {expected}", expected=expected)


def _plain(number: float) -> float | int:
    return int(number) if number == int(number) else number


def value_at(data: Mapping[str, Any], path: str) -> Json:
    """Return the value at a dotted path; None if there is none."""
    value: Any = data
    for name in path.split("."):
        if not isinstance(value, Mapping) or name not in value:
            return None
        value = value[name]
    return value


def has_value(data: Mapping[str, Any], path: str) -> bool:
    """Return whether there is a value at a dotted path, even null."""
    *outer, last = path.split(".")
    value: Any = data
    for name in outer:
        value = value.get(name) if isinstance(value, Mapping) else None
    return isinstance(value, Mapping) and last in value


def put_at(data: dict[str, Any], path: str, value: Json) -> None:
    """Set the value at a dotted path."""
    *outer, last = path.split(".")
    place = data
    for name in outer:
        inner = place.get(name)
        if not isinstance(inner, dict):
            inner = place[name] = {}
        place = inner
    place[last] = value
