"""Process filter: the conditions of a list of processes, as SQL for SQLite and PostgreSQL."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

import orjson
from sqlalchemy import (
    JSON,
    Column,
    ColumnElement,
    Connection,
    Float,
    Select,
    Text,
    and_,
    case,
    cast,
    func,
    literal,
    not_,
    or_,
    select,
    text,
    tuple_,
)

from handover.errors import Problem
from handover.messages import message
from handover_processes.storage.schema import process_resources, processes

MAX_CONDITION_LENGTH: Final = 500
_CONDITION = re.compile(
    r"\s*([A-Za-z_][\w-]*(?:\.[A-Za-z_][\w-]*)*)\s*(?:(==?|!=|<=?|>=?|~)(.*))?", re.DOTALL | re.ASCII
)
_NUMBER = re.compile(r"[1-9][0-9]{0,8}", re.ASCII)
_NUL_ESCAPE: Final = "\\u0000"
_NUL_OF_JSON: Final = r"(?<!\\)((?:\\\\)*)\\u0000"
"""The escape of NUL, which follows an even number of backslashes."""
_MARK: Final = "\ufdd0"
"""Stands for NUL while PostgreSQL reads JSON; no text has this code point, which is no character."""


@dataclass(frozen=True, slots=True)
class VariableCondition:
    """A condition on a process variable: `path` leads to a member of an object.

    The operators are those of the text form; without one the variable must exist. A number is compared with
    numbers only and a text with texts only; `!=` holds for a value of another type, not for a missing one.
    """

    path: tuple[str, ...]
    operator: str | None = None
    value: str | float | bool | None = None


@dataclass(frozen=True, slots=True)
class ProcessFilter:
    """What the processes of a list have in common; a member that is None has no effect."""

    status: str | None = None
    definition: str | None = None
    version: int | None = None
    key: str | None = None
    search: str | None = None
    """A part of the business key, the id or the title, case-insensitive; or the number."""
    resource: str | None = None
    """The URN of a person or a resource that a Task of the process involves."""
    variables: Sequence[VariableCondition] = ()
    started_since: datetime | None = None
    started_until: datetime | None = None
    ended_since: datetime | None = None
    ended_until: datetime | None = None
    has_incident: bool | None = None
    is_unallocated: bool | None = None
    """Whether an activity waits for a performer."""
    element: str | None = None
    """An element at which it waits or, with `has_incident`, has an incident."""


EVERY_PROCESS: Final = ProcessFilter()


def read_condition(written: str) -> VariableCondition:
    """Read `order.total>=100`, `customer=Acme`, `name~part` or `name`; raise `Problem` 422 for other texts.

    A value that is JSON (a number, `true`, `false`, `null`, a quoted text) has its type; any other is a text.
    """
    matched = _CONDITION.fullmatch(written)
    if matched is None or len(written) > MAX_CONDITION_LENGTH or "\0" in written:
        raise _refused(
            message(
                "processes.bad_condition",
                '"{condition}" is no condition; write a variable, an operator (= != < <= > >= ~) and '
                "a value, such as order.total>=100",
                condition=written[:100],
            )
        )
    path, operator, raw = matched.groups()
    if operator is None:
        return VariableCondition(tuple(path.split(".")))
    value = _literal(raw.strip())
    is_ordered = operator not in {"=", "==", "!="}
    if is_ordered and (isinstance(value, bool) or value is None):
        raise _refused(
            message(
                "processes.unordered_value",
                '"{condition}" compares with true, false or null; use = or != for these',
                condition=written[:100],
            )
        )
    operator = "=" if operator == "==" else operator
    return VariableCondition(tuple(path.split(".")), operator, str(value) if operator == "~" else value)


def processes_page(
    connection: Connection,
    columns: Sequence[Column[Any]],
    wanted: ProcessFilter,
    *,
    before: str | None,
    limit: int | None,
) -> Select[Any]:
    """Return the statement of a page of processes, the latest first.

    `before` is the id of a process: only those that started before it are selected; raises `Problem` 404 for
    an unknown one. The order of processes never changes, so pages neither repeat nor omit one.
    """
    table = processes.c
    started, name = table.started_at, table.id
    statement = select(*columns)
    if wanted.resource is not None:
        # The table of resources is in the order of the list: a page reads as many rows as it shows.
        involved = process_resources.c
        statement = statement.join(process_resources, involved.process == table.id)
        statement = statement.where(involved.resource == wanted.resource)
        started, name = involved.started_at, involved.process
    statement = statement.where(*_conditions(wanted, connection.dialect.name))
    if before is not None:
        began = connection.scalar(select(table.started_at).where(table.id == before))
        if began is None:
            raise Problem.translated(
                404,
                "No such process",
                "process.unknown_mark",
                'there is no process "{before}" to come before',
                before=before,
            )
        statement = statement.where(tuple_(started, name) < tuple_(began, before))
    return statement.order_by(started.desc(), name.desc()).limit(limit)


def _conditions(wanted: ProcessFilter, dialect: str) -> Iterator[ColumnElement[bool]]:
    table = processes.c
    for column, value in (
        (table.status, wanted.status),
        (table.definition, wanted.definition),
        (table.version, wanted.version),
        (table.key, wanted.key),
    ):
        if value is not None:
            yield column == value
    if wanted.search:
        yield or_(
            table.key.icontains(wanted.search, autoescape=True),
            table.id.icontains(wanted.search, autoescape=True),
            table.title.icontains(wanted.search, autoescape=True),
            *([table.number == int(wanted.search)] if _NUMBER.fullmatch(wanted.search) else ()),
        )
    for moment, column, is_begin in (
        (wanted.started_since, table.started_at, True),
        (wanted.started_until, table.started_at, False),
        (wanted.ended_since, table.ended_at, True),
        (wanted.ended_until, table.ended_at, False),
    ):
        if moment is not None:
            written = moment.isoformat(timespec="microseconds")
            yield column >= written if is_begin else column < written
    if wanted.has_incident is not None:
        # As texts, so that the partial indexes are used.
        yield and_(text("incidents <> '[]'" if wanted.has_incident else "incidents = '[]'"))
    if wanted.is_unallocated is not None:
        yield and_(text("unallocated <> '[]'" if wanted.is_unallocated else "unallocated = '[]'"))
    if wanted.element is not None:
        column = table.incidents if wanted.has_incident else table.waiting
        begins = ('"element":' if wanted.has_incident else "") + orjson.dumps(wanted.element).decode()[:-1]
        # An element of a called process is the path `call.element`.
        yield table.ended_at.is_(None)
        yield or_(*(column.contains(begins + ends, autoescape=True) for ends in ('"', ".")))
    for condition in wanted.variables:
        yield _of_sqlite(condition) if dialect == "sqlite" else _of_postgresql(condition)


def _of_sqlite(condition: VariableCondition) -> ColumnElement[bool]:
    path = "$" + "".join(f'."{part}"' for part in condition.path)
    variables = processes.c.variables
    types = {"number": ("integer", "real"), "string": ("text",), "boolean": ("true", "false")}
    type_ = func.json_type(variables, path)
    # SQLite cuts a text at the character NUL; the array of two values is JSON, in which it is escaped.
    escapes = func.replace(func.json_extract(variables, path, path), "\\\\", "")
    value = case((func.instr(escapes, _NUL_ESCAPE) > 0, None), else_=func.json_extract(variables, path))
    return _compared(condition, lambda name: type_.in_(types[name]), type_, value, value)


def _of_postgresql(condition: VariableCondition) -> ColumnElement[bool]:
    written = processes.c.variables
    # PostgreSQL reads no JSON with the character NUL, wherever it stands.
    marked = func.regexp_replace(written, _NUL_OF_JSON, rf"\1{_MARK}", "g")
    readable = case((written.contains(_NUL_ESCAPE, autoescape=True), marked), else_=written)
    variables = cast(readable, JSON)
    extracted = func.json_extract_path(variables, *condition.path)
    type_ = func.json_typeof(extracted)
    has_nul = cast(extracted, Text).contains(_MARK)
    plain = case((has_nul, None), else_=func.json_extract_path_text(variables, *condition.path))
    number = case((type_ == "number", cast(plain, Float(53))))
    return _compared(condition, lambda name: type_ == name, type_, plain, number)


def _compared(
    condition: VariableCondition, is_type: Any, type_: Any, plain: Any, number: Any
) -> ColumnElement[bool]:
    """Return a comparison; `is_type` tests the JSON type of the value, `type_` is null without a value."""
    value = condition.value
    if condition.operator is None:
        return and_(type_.is_not(None))
    equal: ColumnElement[bool]
    if condition.operator == "~":
        return and_(is_type("string"), plain.cast(Text).icontains(str(value), autoescape=True))
    if value is None:
        equal = and_(type_ == "null")
    elif isinstance(value, bool):
        # SQLite shows true as 1, PostgreSQL as "true".
        equal = and_(is_type("boolean"), cast(plain, Text).in_(("1", "true") if value else ("0", "false")))
    elif isinstance(value, str):
        equal = and_(is_type("string"), _ordered(plain, condition.operator, literal(value, Text)))
    else:
        equal = and_(is_type("number"), _ordered(number, condition.operator, literal(value, Float(53))))
    if condition.operator == "!=":
        return and_(type_.is_not(None), not_(func.coalesce(equal, text("false"))))
    return equal


def _ordered(extracted: Any, operator: str, value: ColumnElement[Any]) -> ColumnElement[bool]:
    match operator:
        case "<":
            compared = extracted < value
        case "<=":
            compared = extracted <= value
        case ">":
            compared = extracted > value
        case ">=":
            compared = extracted >= value
        case _:
            compared = extracted == value
    return and_(compared)


def _literal(raw: str) -> str | float | bool | None:
    try:
        value = orjson.loads(raw)
    except orjson.JSONDecodeError:
        return raw
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value if isinstance(value, str | float | bool | None) else raw


def _refused(why: str) -> Problem:
    return Problem(422, "Bad filter", why)
