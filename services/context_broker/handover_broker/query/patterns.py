"""Regular expressions in requests (`idPattern`, `~=` in q), matched in time linear in the text.

Python's `re` backtracks: some short patterns would block the event loop for days. RE2 has no backtracking, a
bound on memory, and refuses what needs backtracking (references, look-around). A `Set` of one pattern is used
instead of a compiled pattern, since it reports only whether there is a match: 0.5 us a text, where a match
object costs 1 to 9 us (docs/adr/0006-regular-expressions.md).
"""

from functools import lru_cache
from typing import Any, Final

from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import shown

MAX_LENGTH: Final = 512
"""Characters of a pattern."""
MAX_PROGRAM_SIZE: Final = 5000
"""Instructions of a compiled pattern with its repetitions written out: far below what RE2 has memory for."""


class Pattern:
    """A compiled pattern; `text` is its source."""

    __slots__ = ("_set", "text")

    def __init__(self, text: str) -> None:
        re2, options = _engine()
        size = re2.compile(text, options).programsize
        if size > MAX_PROGRAM_SIZE:
            raise OverflowError(
                f"its repetitions written out have {size} steps, {MAX_PROGRAM_SIZE} are allowed"
            )
        self.text = text
        self._set = re2.Set.SearchSet(options)
        self._set.Add(text)
        self._set.Compile()

    def is_found_in(self, text: str) -> bool:
        """Return whether the pattern matches anywhere in `text`."""
        return bool(self._set.Match(text))


@lru_cache(maxsize=1)
def _engine() -> tuple[Any, Any]:
    import re2  # noqa: PLC0415 - 10 ms of the start, which a broker without patterns does not need

    options = re2.Options()
    options.log_errors = False
    options.never_capture = True
    return re2, options


@lru_cache(maxsize=1024)
def pattern(text: str) -> Pattern:
    """Return the compiled pattern; raise a problem (400) when it cannot be used."""
    if len(text) > MAX_LENGTH:
        raise bad_request_data(f"a pattern has at most {MAX_LENGTH} characters, this one {len(text)}")
    re2, _ = _engine()
    try:
        return Pattern(text)
    except re2.error as error:
        reason = error.args[0]
        reason = reason.decode(errors="replace") if isinstance(reason, bytes) else str(reason)
    except (OverflowError, UnicodeEncodeError) as error:
        reason = str(error)
    raise bad_request_data(
        f"the pattern {shown(text)} cannot be used: {reason}; patterns have the syntax of RE2, which has no "
        "references and no look-around"
    )


def fits(expected: Pattern, text: str) -> bool:
    """Return whether the pattern matches anywhere in `text`."""
    return expected.is_found_in(text)
