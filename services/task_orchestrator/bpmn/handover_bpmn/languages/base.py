"""Parts common to the expression languages: the protocol, the error, and the limits of values."""

import math
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any, Protocol, TypeAlias

import structlog

from handover.errors import HandoverError

log = structlog.stdlib.get_logger(__name__)

Json: TypeAlias = Any
Variables: TypeAlias = Mapping[str, Json]

MAX_CHARACTERS = 1000
"""Of the text of an expression."""

MAX_NODES = 200
MAX_DEPTH = 30
"""Of the syntax tree, and of a value."""

MAX_ITEMS = 10_000
"""Items and characters of a value that an expression may create."""

MAX_NUMBER = 2**53
"""Larger JSON numbers lose integer precision."""


MAX_LISTED = 20
"""Names that an error lists."""
MAX_NEAR = 5
"""Names that an error lists if it is known which of them are meant."""


class ExpressionError(HandoverError):
    """An expression is invalid, or cannot be evaluated with the present variables."""


NOW = "now()"
"""The key under which `variables` may have the present time (ISO 8601); no variable can have that name.

Without it, `now()` of JUEL and FEEL reads the clock of the system.
"""
EXECUTION = "execution"
"""The key under which `variables` may have the properties of `execution` in JUEL."""


class Expression(Protocol):
    """An expression that was read and checked; it has no side effects and its values are JSON."""

    @property
    def text(self) -> str:
        """Return the expression as the file has it."""
        ...

    def value(self, variables: Variables) -> Json:
        """Return the value; raise `ExpressionError` if a variable is missing or has the wrong type."""
        ...

    def names(self) -> frozenset[str]:
        """Return the names of the variables that the expression reads."""
        ...


def evaluation_error(expression: str, error: Exception) -> ExpressionError:
    """Return what the evaluation of `expression` fails with; whatever Python raises is an `ExpressionError`.

    An unexpected exception is a defect of a function or operator, and is logged as one. It fails the
    expression only: the process has an incident, and everything else about it continues to work.
    """
    if isinstance(error, ExpressionError):
        reason = str(error)
    elif isinstance(error, RecursionError):
        reason = "a value is nested too deeply"
    elif isinstance(error, OverflowError):
        reason = "a number grew too large"
    else:
        log.error("expression failed unexpectedly", expression=expression, exc_info=error)
        reason = f"it cannot be evaluated with these values ({type(error).__name__}: {error})"
    return ExpressionError(f"{expression}: {reason}")


def within_limits(value: Json) -> Json:
    """Return `value` if it is JSON within the limits; raise `ExpressionError` if not."""
    left = MAX_ITEMS
    heap = [(value, 0)]
    while heap:
        item, depth = heap.pop()
        if depth > MAX_DEPTH:
            raise ExpressionError(f"a value is nested at most {MAX_DEPTH} deep")
        if isinstance(item, str):
            left -= len(item) // 64
            check_text(item)
        elif isinstance(item, dict):
            for key in item:
                check_text(key)
            heap.extend((part, depth + 1) for part in item.values())
        elif isinstance(item, list):
            heap.extend((part, depth + 1) for part in item)
        elif isinstance(item, float) and not math.isfinite(item):
            raise ExpressionError("a number must be finite")
        elif isinstance(item, int) and abs(item) > MAX_NUMBER:
            raise ExpressionError("a number is too large")
        elif not (item is None or isinstance(item, bool | int | float)):
            raise ExpressionError(f"{type(item).__name__} is no JSON value")
        left -= 1
        if left - len(heap) < 0:
            raise ExpressionError(f"a value holds at most {MAX_ITEMS} items")
    return value


def check_text(text: str) -> None:
    """Raise `ExpressionError` if `text` cannot be encoded, as half of a surrogate pair cannot."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ExpressionError("a text has a lone surrogate") from None


def describe(value: Json) -> str:
    """Return the type of `value` as errors name it."""
    if value is None:
        return "null"
    kinds = {
        bool: "a yes or no",
        int: "a number",
        float: "a number",
        str: "a text",
        list: "a list",
        dict: "an object",
    }
    return kinds.get(type(value), type(value).__name__)


def quote_names(names: Iterable[Any], *, near: str | None = None) -> str:
    """Return some of `names` in order, as errors list what can be used instead; those `near` a name first."""
    ordered = sorted(map(str, names))
    if near is not None:
        close = get_close_matches(near, ordered, n=MAX_NEAR)
        ordered = [*close, *(name for name in ordered if name not in close)]
    shown = MAX_LISTED if near is None else MAX_NEAR
    rest = len(ordered) - shown
    return ", ".join(ordered[:shown]) + (f" and {rest} more" if rest > 0 else "") or "none"
