"""Documents: the JSON objects of the REST interface, each described once, by a TypedDict.

A field says where its value comes from, so that a new field of a document is one line:

    class CommentView(TypedDict):
        id: str                                           # comment.id
        isRead: bool                                      # comment.is_read
        createdAt: Moment                                 # iso(comment.created_at)
        persons: list[str]                                # list(comment.persons)
        answers: list[AnswerView]                         # an AnswerView for each of comment.answers
        title: Annotated[str, From(title_of)]             # title_of(comment)
        reason: Annotated[str | None, Coded()]            # with reasonCode and reasonParameters, if any

    document(CommentView, comment)

The values of fields that need more than the record are given as keywords: `document(CommentView, comment,
title=…)`. A field that is `NotRequired` is left out, unless it is given or is a `From`.

The page's TypeScript types are generated from the documents. The routes return them without a validation by
their types, which would cost time in long lists; the integration tests validate every response.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from operator import attrgetter
from types import NoneType
from typing import Annotated, Any, NotRequired, TypeAlias, TypeVar, cast, get_args, get_origin

from pydantic_core import to_json
from starlette.responses import Response
from typing_extensions import get_type_hints, is_typeddict

from handover.messages import with_code
from handover_datamodels.times import iso

Document = TypeVar("Document")
Read: TypeAlias = Callable[[Any], Any]


def json_response(content: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> Response:
    """Return `content` as JSON."""
    return Response(to_json(content, inf_nan_mode="null"), media_type="application/json")


@dataclass(frozen=True, slots=True)
class From:
    """The value of a field is what `read` returns for the record."""

    read: Read


@dataclass(frozen=True, slots=True)
class Coded:
    """The field is a text for people, with its code and parameters in two more fields, if it has them."""


def moment(value: datetime | None) -> str | None:
    """Return a moment as documents have it."""
    return None if value is None else iso(value)


@dataclass(frozen=True, slots=True)
class _Iso:
    """The value is a moment."""


Moment: TypeAlias = Annotated[str, _Iso()]
OptionalMoment: TypeAlias = Annotated[str | None, _Iso()]


@dataclass(frozen=True, slots=True)
class _Field:
    name: str
    read: Read
    is_coded: bool


def document(type_: type[Document], record: object, **values: Any) -> Document:
    """Return a record as a document, with `values` in place of its own."""
    content: dict[str, Any] = {}
    for field in _fields(cast("Any", type_)):
        if field.name in values:
            continue
        if field.is_coded:
            content |= coded(field.name, field.read(record))
        else:
            content[field.name] = field.read(record)
    return cast("Document", content | values)


def documents(type_: type[Document], records: Iterable[object]) -> list[Document]:
    """Return records as documents."""
    return [document(type_, record) for record in records]


def coded(name: str, text: str | None) -> dict[str, Any]:
    """Return a text for people as a field, with its code and parameters."""
    return {name: None} if text is None else with_code(name, text)


@cache
def _fields(type_: type) -> tuple[_Field, ...]:
    """Return the fields of a document that have a value for each record."""
    fields = []
    for name, hint in get_type_hints(type_, include_extras=True).items():
        origin: Any = get_origin(hint)
        is_optional = origin is NotRequired
        inner = get_args(hint)[0] if is_optional else hint
        marks = inner.__metadata__ if get_origin(inner) is Annotated else ()
        bare = get_args(inner)[0] if marks else inner
        source = next((mark for mark in marks if isinstance(mark, From)), None)
        if is_optional and source is None:
            continue
        read = attrgetter(_snake_case(name)) if source is None else source.read
        convert = moment if any(isinstance(mark, _Iso) for mark in marks) else _conversion(bare)
        is_coded = any(isinstance(mark, Coded) for mark in marks)
        fields.append(_Field(name, _composed(read, convert), is_coded))
    return tuple(fields)


def _snake_case(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def _composed(read: Read, convert: Read | None) -> Read:
    return read if convert is None else lambda record: convert(read(record))


def _conversion(hint: Any) -> Read | None:
    """Return how the value of a record becomes one of the type `hint`; None if it stays as it is."""
    if is_typeddict(hint):
        return lambda value: document(hint, value)
    origin: Any = get_origin(hint)
    arguments = get_args(hint)
    if origin is list:
        item = arguments[0]
        return (lambda values: documents(item, values)) if is_typeddict(item) else list
    if origin is dict and is_typeddict(arguments[1]):
        return lambda values: {key: document(arguments[1], value) for key, value in values.items()}
    if NoneType in arguments:
        (present, *others) = (argument for argument in arguments if argument is not NoneType)
        convert = None if others else _conversion(present)
        return None if convert is None else lambda value: None if value is None else convert(value)
    return None
