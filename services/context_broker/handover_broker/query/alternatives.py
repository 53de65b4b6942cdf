"""Expressions such as `A,(B;C)`: alternatives, each of which requires one or more names.

Used for types (clause 4.17) and scopes (clause 4.19). `,` and `|` are or, `;` is and; and binds tighter. The
standard requires brackets around and; here they are optional, and may be nested.
"""

from collections.abc import Callable
from typing import Final, Generic, NoReturn, TypeVar

from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import shown

LONGEST: Final = 20_000
"""Maximum length of an expression."""
DEEPEST: Final = 20
"""Maximum nesting of brackets."""
MOST: Final = 1000
"""Maximum number of alternatives after resolving the brackets."""

_SIGNS: Final = ",|;()"

Leaf = TypeVar("Leaf")
Alternatives = tuple[tuple[Leaf, ...], ...]


def alternatives(text: str, what: str, leaf: Callable[[str], Leaf]) -> Alternatives[Leaf]:
    """Return the alternatives of an expression; `leaf` converts each name, `what` is its name in errors.

    Raises a problem (400) with the position of a syntax error.
    """
    if len(text) > LONGEST:
        raise bad_request_data(f"{what} has {len(text)} characters; {LONGEST} are allowed")
    reader = _Reader(text, what, leaf)
    result = reader.either(0)
    if reader.at < len(text):
        reader.fail("expected , or ; or the end")
    return tuple(tuple(dict.fromkeys(names)) for names in dict.fromkeys(result))


class _Reader(Generic[Leaf]):
    def __init__(self, text: str, what: str, leaf: Callable[[str], Leaf]) -> None:
        self.text = text
        self.what = what
        self.leaf = leaf
        self.at = 0

    def either(self, depth: int) -> list[tuple[Leaf, ...]]:
        result = self.all_of(depth)
        while self.take(",") or self.take("|"):
            result += self.all_of(depth)
            self.check(len(result))
        return result

    def all_of(self, depth: int) -> list[tuple[Leaf, ...]]:
        result = self.one(depth)
        while self.take(";"):
            more = self.one(depth)
            self.check(len(result) * len(more))
            result = [left + right for left in result for right in more]
        return result

    def one(self, depth: int) -> list[tuple[Leaf, ...]]:
        if not self.take("("):
            return [(self.name(),)]
        if depth >= DEEPEST:
            self.fail(f"brackets are nested deeper than {DEEPEST}")
        result = self.either(depth + 1)
        if not self.take(")"):
            self.fail("expected )")
        return result

    def name(self) -> Leaf:
        start = self.at
        while self.at < len(self.text) and self.text[self.at] not in _SIGNS:
            self.at += 1
        if self.at == start:
            self.fail("expected a name")
        return self.leaf(self.text[start : self.at])

    def take(self, sign: str) -> bool:
        if self.text.startswith(sign, self.at):
            self.at += 1
            return True
        return False

    def check(self, count: int) -> None:
        if count > MOST:
            self.fail(f"it expands to more than {MOST} alternatives; send several requests")

    def fail(self, why: str) -> NoReturn:
        raise bad_request_data(
            f"{self.what} has an error at character {self.at + 1} of {shown(self.text)}: {why}"
        )
