"""Regular expressions in expressions, matched by RE2 in linear time (docs/adr/0006)."""

from functools import lru_cache
from typing import Any

import re2

from services.task_orchestrator.languages.base import ExpressionError

MAX_PATTERN = 512
MAX_PROGRAM_SIZE = 500
"""Instructions of a compiled pattern."""

MAX_TEXT = 10_000
"""Characters of a text that is matched."""

_OPTIONS = re2.Options()
_OPTIONS.log_errors = False
_OPTIONS.never_capture = True


@lru_cache(maxsize=512)
def _compile(pattern: str) -> Any:
    if len(pattern) > MAX_PATTERN:
        raise ExpressionError(f"a pattern has at most {MAX_PATTERN} characters, not {len(pattern)}")
    try:
        compiled = re2.compile(pattern, _OPTIONS)
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
    if len(text) > MAX_TEXT:
        raise ExpressionError(f"a text that is matched has at most {MAX_TEXT} characters, not {len(text)}")
    try:
        return (compiled.fullmatch(text) if is_whole else compiled.search(text)) is not None
    except UnicodeEncodeError:
        raise ExpressionError("a text has a lone surrogate") from None
