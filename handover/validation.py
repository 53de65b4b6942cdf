"""What is wrong with a document, in words for people: each fault with its place."""

from collections.abc import Sequence
from typing import Any, Final, Protocol

MAX_FAULTS: Final = 5
MAX_CHARS: Final = 1_000
"""Of a line, since a place has names that a client chose."""
_PREFIXES: Final = ("Value error, ", "Assertion failed, ")
"""What pydantic writes before the text of an error that a validator of ours raised."""


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
        f"{'.'.join([*outer, *map(str, one['loc'])]) or whole}: {_rule(str(one['msg']))}"[:MAX_CHARS]
        for one in error.errors()
    ]


def fault_text(error: Faulty, whole: str = "message", *, most: int = MAX_FAULTS) -> str:
    """Return the first `most` faults in one line, and how many more there are."""
    lines = fault_lines(error, whole)
    more = [f"and {len(lines) - most} more"] if len(lines) > most else []
    return "; ".join([*lines[:most], *more])


def _rule(text: str) -> str:
    for prefix in _PREFIXES:
        text = text.removeprefix(prefix)
    return text
