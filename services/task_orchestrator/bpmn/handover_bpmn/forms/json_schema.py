"""JSON Schema as a form: its fields, and the check of a result against it.

References to other documents are never loaded, and patterns are matched by RE2.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import orjson
from jsonschema import Draft202012Validator, FormatChecker
from jsonschema.exceptions import SchemaError, ValidationError
from jsonschema.validators import extend
from referencing import Registry
from referencing.exceptions import Unresolvable

from handover.messages import Message, message
from handover_bpmn.forms.fields import (
    MAX_DEPTH,
    MAX_FIELDS,
    Field,
    FieldFault,
    FieldKind,
    Option,
    bad_format,
    has_value,
    matches,
    not_allowed,
    put_at,
    too_large,
    too_small,
    value_at,
    value_fault,
    wrong_type,
)
from handover_bpmn.languages.base import Json

MAX_FAULTS = 100

_FORMATS = FormatChecker(formats=())
_BY_TYPE = {
    "number": FieldKind.NUMBER,
    "integer": FieldKind.INTEGER,
    "boolean": FieldKind.BOOLEAN,
    "array": FieldKind.JSON,
    "object": FieldKind.JSON,
}
_BY_FORMAT = {"date": FieldKind.DATE, "time": FieldKind.TIME, "date-time": FieldKind.DATETIME}


def _check_time(kind: FieldKind) -> Any:
    return lambda value: value_fault(Field("", kind), value) is None if isinstance(value, str) else True


for _name, _its_kind in _BY_FORMAT.items():
    _FORMATS.checks(_name)(_check_time(_its_kind))
_FORMATS.checks("email")(
    lambda value: (
        value_fault(Field("", FieldKind.TEXT, text_format="email"), value) is None
        if isinstance(value, str)
        else True
    )
)


def _check_pattern(_: Any, pattern: str, instance: Any, __: Any) -> Iterator[ValidationError]:
    if isinstance(instance, str) and not matches(instance, pattern):
        yield ValidationError(f"does not match {pattern!r}")


_Validator: Any = extend(Draft202012Validator, {"pattern": _check_pattern})  # type: ignore[no-untyped-call]


def schema_fault(schema: Mapping[str, Any]) -> str | None:
    """Return why this is no JSON Schema; None if it is one."""
    try:
        Draft202012Validator.check_schema(schema)
    except SchemaError as error:
        return str(error.message)[:500]
    return None


def fields_of(schema: Mapping[str, Any], data: Mapping[str, Any]) -> tuple[Field, ...]:
    """Return the fields of the properties of a schema; `data` are the values known before."""
    return tuple(_fields(schema, data, "", 0))


def _fields(
    schema: Mapping[str, Any], data: Mapping[str, Any], prefix: str, depth: int, *, locked: bool = False
) -> Iterator[Field]:
    required = schema.get("required")
    names = required if isinstance(required, list) else []
    for name, part in list(_record(schema.get("properties")).items())[:MAX_FIELDS]:
        field = _field(_record(part), f"{prefix}{name}", data, depth, locked=locked)
        yield field if name not in names else _required(field)


def _required(field: Field) -> Field:
    return replace(field, is_required=field.kind is not FieldKind.GROUP)


def _field(
    schema: Mapping[str, Any], path: str, data: Mapping[str, Any], depth: int, *, locked: bool = False
) -> Field:
    options = _options(schema)
    label = _text(schema.get("title")) or path.rpartition(".")[2]
    is_read_only = locked or schema.get("readOnly") is True
    initial = value_at(data, path) if has_value(data, path) else schema.get("default")
    items = _record(schema.get("items"))
    kind = FieldKind.CHOICE if options else _kind(schema)
    fields: tuple[Field, ...] = ()
    if kind is FieldKind.JSON and "." not in label and depth < MAX_DEPTH:
        if _record(schema.get("properties")) and "items" not in schema:
            kind = FieldKind.GROUP
            fields = tuple(_fields(schema, data, f"{path}.", depth + 1, locked=is_read_only))
        elif _options(items):
            kind, options = FieldKind.CHOICES, _options(items)
        elif _record(items.get("properties")):
            kind, fields = FieldKind.LIST, tuple(_fields(items, {}, "", depth + 1))
        elif schema.get("type") == "array" and items and _kind(items) is not FieldKind.JSON:
            kind, fields = FieldKind.LIST, (_field({"title": label, **items}, "", {}, depth + 1),)
    return Field(
        path,
        kind,
        label,
        _text(schema.get("description")),
        is_read_only=is_read_only,
        initial=initial,
        options=options,
        minimum=_number(schema.get("minimum")),
        maximum=_number(schema.get("maximum")),
        min_length=_count(schema.get("minLength")),
        max_length=_count(schema.get("maxLength")),
        pattern=_text(schema.get("pattern")),
        text_format="email" if schema.get("format") == "email" else None,
        unit=_text(schema.get("unit")),
        fields=fields,
    )


def _kind(schema: Mapping[str, Any]) -> FieldKind:
    type_ = schema.get("type")
    if isinstance(type_, list):
        type_ = next((name for name in type_ if name != "null"), None)
    if type_ is None and isinstance(schema.get("properties"), Mapping):
        return FieldKind.JSON
    if type_ in _BY_TYPE:
        return _BY_TYPE[type_]
    if schema.get("format") in _BY_FORMAT:
        return _BY_FORMAT[schema["format"]]
    return FieldKind.MULTILINE if (_count(schema.get("maxLength")) or 0) > 200 else FieldKind.TEXT


def _options(schema: Mapping[str, Any]) -> tuple[Option, ...]:
    titled = schema.get("oneOf")
    if isinstance(titled, list) and titled and all("const" in _record(option) for option in titled):
        return tuple(
            Option(option["const"], _text(option.get("title")) or str(option["const"])) for option in titled
        )
    listed = schema.get("enum")
    return tuple(Option(value, str(value)) for value in listed) if isinstance(listed, list) else ()


def check(
    schema: Mapping[str, Any], data: Mapping[str, Any], outputs: Mapping[str, Any]
) -> tuple[dict[str, Any], list[FieldFault]]:
    """Return the result with the values of read-only fields, and the faults by field."""
    values = dict(outputs)
    for field in _flat(fields_of(schema, data)):
        if field.is_read_only and field.initial is not None:
            put_at(values, field.path, field.initial)
    try:
        return values, violations(schema, values)
    except (SchemaError, Unresolvable, RecursionError):
        return values, []  # a schema that cannot be used must not prevent the completion


def violations(schema: Mapping[str, Any], values: Mapping[str, Any]) -> list[FieldFault]:
    """Return the faults of `values`, one a field.

    Raises `SchemaError`, `Unresolvable` or `RecursionError` if the schema cannot be used.
    """
    faults: dict[str, FieldFault] = {}
    for error in _validator(orjson.dumps(schema)).iter_errors(values):
        path, reason = _explained(error)
        faults.setdefault(path, FieldFault(path, reason))
        if len(faults) == MAX_FAULTS:
            break
    return list(faults.values())


def _flat(fields: tuple[Field, ...]) -> Iterator[Field]:
    for field in fields:
        if field.kind is FieldKind.GROUP:
            yield from _flat(field.fields)
        else:
            yield field


@lru_cache(maxsize=256)
def _validator(schema: bytes) -> Any:
    read = orjson.loads(schema)
    Draft202012Validator.check_schema(read)
    return _Validator(read, registry=Registry(), format_checker=_FORMATS)


def _explained(error: ValidationError) -> tuple[str, Message]:
    path = ".".join(str(part) for part in error.absolute_path)
    limit: Any = error.validator_value
    if error.validator == "required":
        instance: Any = error.instance
        missing = [name for name in limit if name not in instance]
        name = next(
            (missing_name for missing_name in missing if error.message.startswith(repr(missing_name))),
            missing[0],
        )
        return f"{path}.{name}" if path else str(name), message("form.required", "a value is required")
    reason = _REASONS.get(str(error.validator))
    if reason is not None:
        return path, reason(limit)
    return path, message("form.schema", "the form does not allow this: {why}", why=error.message[:300])


_REASONS: Mapping[str, Callable[[Any], Message]] = {
    "minimum": too_small,
    "exclusiveMinimum": too_small,
    "maximum": too_large,
    "exclusiveMaximum": too_large,
    "minLength": lambda limit: message("form.too_short", "at least {limit} characters", limit=limit),
    "maxLength": lambda limit: message("form.too_long", "at most {limit} characters", limit=limit),
    "pattern": lambda _: bad_format(),
    "format": lambda _: bad_format(),
    "enum": lambda _: not_allowed(),
    "const": lambda _: not_allowed(),
    "oneOf": lambda _: not_allowed(),
    "type": lambda limit: wrong_type(limit if isinstance(limit, str) else ", ".join(limit)),
}


def _record(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _text(value: Json) -> str | None:
    return value if isinstance(value, str) and value else None


def _number(value: Json) -> float | None:
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def _count(value: Json) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None
