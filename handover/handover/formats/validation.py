"""What is wrong with a document, in words for people: each fault with its place.

`json_fault` refuses what Python reads as JSON and no other part can store or send: UTF-8 has no lone
surrogates (RFC 3629), JSON no NaN (RFC 8259), and databases and orjson no integers of more than 64 bits.
"""

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Final, Protocol

from pydantic import AfterValidator, AwareDatetime, BaseModel, BeforeValidator, ConfigDict

from handover.formats.strict_json import TIME_TEXT

MAX_INTEGER: Final = 2**63 - 1
"""Of 64 bits with a sign, as a database stores it."""
_FIRST_MOMENT: Final = datetime(1900, 1, 1, tzinfo=UTC)
_LAST_MOMENT: Final = datetime(3000, 1, 1, tzinfo=UTC)
_SUSPICIOUS: Final = re.compile(rb"NaN|Infinity|[eE]\+?[0-9]{3}|[0-9]{19}|\\u[dD][89a-fA-F]")
"""What every JSON text contains that has a fault."""
_MAX_PLACE_CHARS: Final = 200
MAX_FAULTS: Final = 5
MAX_CHARS: Final = 1_000
"""Of a line, since a place has names that a client chose."""
_PREFIXES: Final = ("Value error, ", "Assertion failed, ")
"""What pydantic writes before the text of an error that a validator of ours raised."""


class ClosedModel(BaseModel):
    """A frozen model without further fields: of a file that people write, of the options of a driver."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Faulty(Protocol):
    """A `ValidationError` of pydantic or a `RequestValidationError` of FastAPI."""

    def errors(self) -> Sequence[Any]:
        """Return the faults."""


def fault_lines(error: Faulty, whole: str = "message", *, within: str | None = None) -> list[str]:
    """Return a line for each fault, `joints.0: Input should be a valid number`.

    `whole` stands for the document in a fault that concerns all of it; `within` is the place of the document
    in a larger one.
    """
    outer = [] if within is None else [within]
    return [
        f"{'.'.join([*outer, *map(str, fault['loc'])]) or whole}: {_rule(str(fault['msg']))}"[:MAX_CHARS]
        for fault in error.errors()
    ]


def fault_text(error: Faulty, whole: str = "message", *, most: int = MAX_FAULTS) -> str:
    """Return the first `most` faults in one line, and how many more there are."""
    lines = fault_lines(error, whole)
    more = [f"and {len(lines) - most} more"] if len(lines) > most else []
    return "; ".join([*lines[:most], *more])


def _moment(moment: datetime) -> datetime:
    if not _FIRST_MOMENT <= moment < _LAST_MOMENT:
        raise ValueError(f"must be a time from the years {_FIRST_MOMENT.year} to {_LAST_MOMENT.year - 1}")
    return moment.astimezone(UTC)


Moment = Annotated[AwareDatetime, BeforeValidator(TIME_TEXT), AfterValidator(_moment)]
"""A time that a request names, in UTC: arithmetic and time zones need years around it."""
LocalMoment = Annotated[datetime, BeforeValidator(TIME_TEXT)]
"""A time that a request names; without a time zone it is in that of this computer."""


def json_fault(text: bytes, value: Any, whole: str = "body") -> str | None:
    """Return the first fault of `value`, which was read from the JSON `text`; None if there is none."""
    return _value_fault(value, whole) if _SUSPICIOUS.search(text) is not None else None


def _value_fault(value: Any, place: str) -> str | None:
    fault, shown = None, place[:_MAX_PLACE_CHARS]
    if isinstance(value, dict):
        for name, inner in value.items():
            fault = _text_fault(name, f"a name in {place}") or _value_fault(inner, f"{place}.{name}")
            if fault is not None:
                break
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            if (fault := _value_fault(inner, f"{place}.{index}")) is not None:
                break
    elif isinstance(value, str):
        fault = _text_fault(value, place)
    elif isinstance(value, float) and not math.isfinite(value):
        fault = f"{shown}: JSON has no NaN and no infinite numbers; leave the value out or send null"
    elif isinstance(value, int) and not -MAX_INTEGER - 1 <= value <= MAX_INTEGER:
        fault = f"{shown}: a whole number has at most 64 bits; send a larger one as text"
    return fault


def _text_fault(text: str, place: str) -> str | None:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        code = ord(text[error.start])
        return (
            f"{place[:_MAX_PLACE_CHARS]}: the text has half of a surrogate pair, \\u{code:04x}, which is no "
            "character; send both halves or leave it out"
        )
    return None


def _rule(text: str) -> str:
    for prefix in _PREFIXES:
        text = text.removeprefix(prefix)
    return text
