"""Regular expressions in expressions, matched by RE2 in linear time (docs/adr/0006)."""

import re
from functools import lru_cache
from typing import Any

import re2

from handover_bpmn.languages.base import ExpressionError, check_text

MAX_PATTERN = 512
MAX_PROGRAM_SIZE = 500
"""Instructions of a compiled pattern."""

MAX_TEXT = 10_000
"""Characters of a text that is matched."""

FLAGS = "smi"
"""Flags of FEEL that RE2 has: a dot matches line ends, `^` and `$` match at lines, letters of either case."""

_GROUP = re.compile(r"\\(.)|\$(\d)", re.DOTALL)
"""Parts of a replacement: an escaped character, or a group of the pattern."""


@lru_cache(maxsize=512)
def _compile(pattern: str, *, captures: bool = False) -> Any:
    if len(pattern) > MAX_PATTERN:
        raise ExpressionError(f"a pattern has at most {MAX_PATTERN} characters, not {len(pattern)}")
    options = re2.Options()
    options.log_errors = False
    options.never_capture = not captures
    try:
        compiled = re2.compile(pattern, options)
    except (re2.error, UnicodeEncodeError) as error:
        reason = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise ExpressionError(f"the pattern is invalid for RE2: {reason[:100]}") from None
    if compiled.programsize > MAX_PROGRAM_SIZE:
        raise ExpressionError(f"a pattern has at most {MAX_PROGRAM_SIZE} steps, not {compiled.programsize}")
    return compiled


def is_match(text: str, pattern: str, *, is_whole: bool) -> bool:
    """Return whether `pattern` matches the whole of `text`, or any part of it.

    Raises `ExpressionError` if the pattern is invalid, or the pattern or the text is too long.
    """
    compiled = _compile(pattern)
    _check(text)
    return (compiled.fullmatch(text) if is_whole else compiled.search(text)) is not None


def with_flags(pattern: str, flags: str) -> str:
    """Return `pattern` with the flags of FEEL; raise `ExpressionError` for one that RE2 does not have."""
    for flag in flags:
        if flag not in FLAGS:
            raise ExpressionError(
                f'the flag "{flag}" of a regular expression is not supported; flags are: {", ".join(FLAGS)}'
            )
    return f"(?{flags}:{pattern})" if flags else pattern


def replaced(text: str, pattern: str, replacement: str, most: int) -> str:
    """Return `text` with each match of `pattern` replaced; `$1` stands for the first group, `$0` for all.

    A backslash makes the character behind it literal. Raises `ExpressionError` as `is_match`, for a group
    that the pattern does not have, and if the result has more than `most` characters.
    """
    compiled = _compile(pattern, captures=True)
    _check(text)
    for _, group in _GROUP.findall(replacement):
        if group and int(group) > compiled.groups:
            raise ExpressionError(f"the replacement has ${group}, but the pattern has no such group")
    parts: list[str] = []
    position = length = 0
    for match in compiled.finditer(text):
        made = _filled(replacement, match)
        parts += (text[position : match.start()], made)
        position = match.end()
        length += len(made)
        if length > most:
            raise ExpressionError(f"a text has at most {most} characters")
    return "".join((*parts, text[position:]))


def _filled(replacement: str, match: Any) -> str:
    """Return a replacement with the groups of a match."""
    return _GROUP.sub(lambda part: part[1] or match[int(part[2])] or "", replacement)


def split_at(text: str, delimiter: str) -> list[str]:
    """Return the parts of `text` between the matches of the pattern `delimiter`.

    Raises `ExpressionError` as `is_match`, and for a pattern that matches the empty text.
    """
    if is_match("", delimiter, is_whole=True):
        raise ExpressionError(
            f'the delimiter "{delimiter[:40]}" of split() is a regular expression that matches nothing too; '
            'write "\\\\" before a character that is meant itself, such as "\\\\|"'
        )
    _check(text)
    parts: list[str] = []
    position = 0
    for match in _compile(delimiter).finditer(text):
        parts.append(text[position : match.start()])
        position = match.end()
    return [*parts, text[position:]]


def _check(text: str) -> None:
    if len(text) > MAX_TEXT:
        raise ExpressionError(f"a text that is matched has at most {MAX_TEXT} characters, not {len(text)}")
    check_text(text)
