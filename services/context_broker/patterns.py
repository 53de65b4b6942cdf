"""Patterns that askers send, compiled with care: none may keep the broker busy for longer than a blink.

Python's `re` backtracks; a pattern whose repetitions are nested, or hold alternatives, can take years. Such
patterns are refused with the reason (there is nearly always a plain way to write them).
"""

import re
from collections.abc import Iterable
from functools import lru_cache
from re import _constants as code  # type: ignore[attr-defined]  # the parse tree is not typed
from re import _parser as syntax  # type: ignore[attr-defined]
from typing import Any, Final

from services.context_broker.problems import bad_request_data
from services.context_broker.words import shown

LONGEST: Final = 512
MOST_REPETITIONS: Final = 3
"""Open repetitions (`*`, `+`) side by side: each multiplies the time a text may take by its length."""
LONGEST_TEXT: Final = 512
"""Characters of a text that a pattern is tried on."""
FEW: Final = 8
"""A repetition up to this often is taken as written out."""


@lru_cache(maxsize=1024)
def pattern(text: str) -> re.Pattern[str]:
    """Return the compiled pattern; raise a problem when it is broken or could take very long."""
    if len(text) > LONGEST:
        raise bad_request_data(f"a pattern has at most {LONGEST} characters, this one {len(text)}")
    try:
        parsed = syntax.parse(text)
        compiled = re.compile(text)
    except (re.error, OverflowError, RecursionError) as error:
        raise bad_request_data(f"the pattern {shown(text)} cannot be used: {error}") from None
    fault = _fault(parsed)
    if fault:
        raise bad_request_data(f"the pattern {shown(text)} could take very long: {fault}")
    return compiled


def fits(expected: re.Pattern[str], text: str) -> bool:
    """Say whether the pattern is found in `text`."""
    return expected.search(text[:LONGEST_TEXT]) is not None


def _fault(parsed: Iterable[Any]) -> str | None:
    repetitions = 0
    for operation, argument in _walk(parsed):
        if operation in {code.GROUPREF, code.GROUPREF_EXISTS, code.ASSERT, code.ASSERT_NOT}:
            return "it looks back or ahead; leave references and assertions out"
        if operation in {code.MAX_REPEAT, code.MIN_REPEAT}:
            _, most, inner = argument
            if most > FEW:
                repetitions += 1
                if any(_branches(below) for below in _walk(inner)):
                    return "a repetition holds another repetition or alternatives; write it out"
    if repetitions > MOST_REPETITIONS:
        return f"it has {repetitions} repetitions side by side, {MOST_REPETITIONS} are allowed"
    return None


def _branches(operation: tuple[Any, Any]) -> bool:
    return operation[0] in {code.BRANCH, code.MAX_REPEAT, code.MIN_REPEAT}


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
