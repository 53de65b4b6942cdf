"""Tokens: what the parsers of JUEL and FEEL share, which is a lazy tokenizer with limits and positions."""

import re
import sys

from handover_bpmn.languages.base import ExpressionError, check_text

MAX_CHARACTERS = 10_000
MAX_TOKENS = 2000
MAX_DEPTH = 30
"""Nested parentheses, brackets, calls and prefix operators."""

MAX_QUOTED = 60
"""Characters of an expression that an error quotes."""

_ESCAPES = {"n": "\n", "t": "\t", "r": "\r", "b": "\b", "f": "\f"}
_LITERAL = frozenset("\"'\\/")
_ESCAPE = re.compile(
    r"\\(u[dD][89abAB][0-9a-fA-F]{2}\\u[dD][c-fC-F][0-9a-fA-F]{2}|u[0-9a-fA-F]{4}|U[0-9a-fA-F]{6}|.)",
    re.DOTALL,
)


def excerpt(text: str) -> str:
    """Return `text` between backticks, shortened to the length that an error may quote."""
    return f"`{text}`" if len(text) <= MAX_QUOTED else f"`{text[: MAX_QUOTED - 1]}…`"


class Tokens:
    """A cursor over a text; `kind`, `text` and `start` are those of the token at the cursor.

    `count` is the number of tokens so far, `position` the end of the token.

    The pattern has a named group for each kind of token; white space and comments are the group `skip`.
    Kinds: `name`, `number`, `string`, `operator`, and `end` behind the last token.
    """

    def __init__(self, source: str, pattern: re.Pattern[str], position: int = 0) -> None:
        if len(source) > MAX_CHARACTERS:
            raise ExpressionError(f"an expression has at most {MAX_CHARACTERS} characters, not {len(source)}")
        self.source = source
        self.kind = ""
        self.text = ""
        self.start = position
        self.position = position
        self._pattern = pattern
        self.count = 0
        self._depth = 0

    def advance(self) -> None:
        """Move to the next token."""
        match = self._pattern.match(self.source, self.position)
        while match is not None and match.lastgroup == "skip":
            self.position = match.end()
            match = self._pattern.match(self.source, self.position)
        self.start = self.position
        self.count += 1
        if self.count > MAX_TOKENS:
            raise self.error(f"an expression has at most {MAX_TOKENS} parts")
        if match is not None:
            self.kind, self.text, self.position = str(match.lastgroup), match.group(), match.end()
        elif self.position >= len(self.source):
            self.kind, self.text = "end", ""
        else:
            character = self.source[self.position]
            if character in "\"'":
                raise self.error(f"the string that starts with {character} has no end")
            raise self.error(f"{character!a} is not part of the language")

    def accept(self, *texts: str) -> str | None:
        """Move past the token if it is an operator or word of `texts`, and return its text."""
        if self.text in texts and self.kind in {"operator", "name"}:
            text = self.text
            self.advance()
            return text
        return None

    def expect(self, text: str) -> None:
        """Move past the operator or word `text`; raise `ExpressionError` if there is something else."""
        if self.accept(text) is None:
            raise self.error(f'expected "{text}" instead of {self.found()}')

    def found(self) -> str:
        """Return the token at the cursor as an error names it."""
        return "the end" if self.kind == "end" else f'"{self.text[:MAX_QUOTED]}"'

    def error(self, reason: str, position: int | None = None) -> ExpressionError:
        """Return the error for the token at the cursor, or at `position`; errors count from 1."""
        place = self.start if position is None else position
        return ExpressionError(f"position {place + 1}: {reason}")

    def enter(self) -> None:
        """Begin a nested part; raise `ExpressionError` if it is nested too deeply."""
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise self.error(f"an expression is nested at most {MAX_DEPTH} deep")

    def leave(self) -> None:
        """End a nested part."""
        self._depth -= 1


def unquote(literal: str, *, keeps_unknown: bool = False) -> str:
    """Return the text of a string literal in single or double quotes with the escapes of JSON.

    With `keeps_unknown` the backslash of any other escape is kept, as FEEL does with `"\\d"`. Raises
    `ExpressionError` for half of a surrogate pair.
    """
    inner = literal[1:-1]
    if "\\" not in inner:
        return inner
    unquoted = _ESCAPE.sub(lambda match: _unescape(match.group(1), keeps_unknown=keeps_unknown), inner)
    check_text(unquoted)
    return unquoted


def _unescape(escape: str, *, keeps_unknown: bool) -> str:
    if len(escape) == 11:
        high, low = int(escape[1:5], 16), int(escape[7:], 16)
        return chr(0x10000 + ((high - 0xD800) << 10) + low - 0xDC00)
    if len(escape) > 1:
        code = int(escape[1:], 16)
        if code > sys.maxunicode:
            raise ExpressionError(f"there is no character \\{escape}")
        return chr(code)
    if keeps_unknown and escape not in _ESCAPES and escape not in _LITERAL:
        return f"\\{escape}"
    return _ESCAPES.get(escape, escape)
