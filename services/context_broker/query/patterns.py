"""Patterns that askers send, compiled with care: none may keep the broker busy for longer than a blink.

Python's `re` is quick, but tries one way after the other; a pattern with many ways can take years. Only plain
patterns are left to it, the others to a machine that goes all ways at once (`automaton`). What that cannot do
is refused with the reason.
"""

import re
from collections.abc import Iterable
from functools import lru_cache
from re import _constants as code  # type: ignore[attr-defined]  # the parse tree is not typed
from re import _parser as syntax  # type: ignore[attr-defined]
from typing import Any, Final

from services.context_broker.model.problems import bad_request_data
from services.context_broker.model.validation import shown
from services.context_broker.query.automaton import Automaton, Unsupported

LONGEST: Final = 512
LONGEST_TEXT: Final = 512
"""Characters of a text that a pattern is tried on."""

_STARTS: Final = frozenset({code.AT_BEGINNING, code.AT_BEGINNING_STRING})
_OPEN: Final = frozenset({code.MAX_REPEAT, code.MIN_REPEAT, code.BRANCH})
_NEVER_BACK: Final = frozenset(
    {code.LITERAL, code.NOT_LITERAL, code.ANY, code.IN, code.NEGATE, code.RANGE, code.CATEGORY, code.AT,
     code.SUBPATTERN, *_OPEN}
)  # fmt: skip


@lru_cache(maxsize=1024)
def pattern(text: str) -> re.Pattern[str]:
    """Return the compiled pattern, to be used with `fits`; raise a problem (400) when it cannot be used."""
    if len(text) > LONGEST:
        raise bad_request_data(f"a pattern has at most {LONGEST} characters, this one {len(text)}")
    try:
        compiled = re.compile(text)
        _machine(text)
    except (re.error, OverflowError, RecursionError) as error:
        raise bad_request_data(f"the pattern {shown(text)} cannot be used: {error}") from None
    except Unsupported as fault:
        raise bad_request_data(f"the pattern {shown(text)} could take very long: {fault}") from None
    return compiled


def fits(expected: re.Pattern[str], text: str) -> bool:
    """Say whether the pattern is found in `text`."""
    machine = _machine(expected.pattern)
    if machine is None:
        return expected.search(text[:LONGEST_TEXT]) is not None
    return machine.found_in(text[:LONGEST_TEXT])


@lru_cache(maxsize=2048)
def _machine(text: str) -> Automaton | None:
    """Return the machine for a pattern; None for one so plain that `re` has no choice of ways."""
    parsed = list(syntax.parse(text))
    is_anchored = bool(parsed) and parsed[0][0] is code.AT and parsed[0][1] in _STARTS
    found = list(_walk(parsed))
    choices = [one for one in found if one[0] in _OPEN and not _is_fixed(one)]
    is_plain = all(one[0] in _NEVER_BACK for one in found) and not any(
        one[0] in _OPEN and _holds_choices(one) for one in found
    )
    # Each choice multiplies the ways by the length of the text; so does each place to begin at.
    if is_plain and len(choices) + (not is_anchored) <= 2:
        return None
    return Automaton(text)


def _is_fixed(one: tuple[Any, Any]) -> bool:
    return one[0] is not code.BRANCH and one[1][0] == one[1][1]


def _holds_choices(one: tuple[Any, Any]) -> bool:
    inner = (below for part in _inside(one[1]) for below in _walk(part))
    return any(below[0] in _OPEN and not _is_fixed(below) for below in inner)


def _walk(parsed: Any) -> Iterable[tuple[Any, Any]]:
    for operation, argument in parsed:
        yield operation, argument
        for inner in _inside(argument):
            yield from _walk(inner)


def _inside(argument: Any) -> Iterable[Any]:
    if isinstance(argument, syntax.SubPattern):
        yield argument
    elif isinstance(argument, tuple | list):
        for part in argument:
            yield from _inside(part)
