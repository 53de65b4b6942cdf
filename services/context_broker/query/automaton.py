"""A pattern as a machine that reads a text once, sign by sign, and never looks back.

Python's `re` tries one way after the other, and some patterns have more ways than there is time. This machine
goes all ways at once: what it takes grows with the text, and with nothing else. It only says whether there
is a match.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from re import _constants as code  # type: ignore[attr-defined]  # the parse tree is not typed
from re import _parser as syntax  # type: ignore[attr-defined]
from typing import Any, Final

MOST_NODES: Final = 5000
"""Nodes of a machine; repetitions are written out, so that nested ones may need many."""
MOST_STATES: Final = 500
"""Sets of nodes that a machine remembers; then it begins to learn anew."""

Test = Callable[[str], bool]
"""Says whether a node takes a sign."""

_CATEGORIES: Final[dict[Any, Test]] = {
    code.CATEGORY_DIGIT: str.isdecimal,
    code.CATEGORY_NOT_DIGIT: lambda sign: not sign.isdecimal(),
    code.CATEGORY_SPACE: str.isspace,
    code.CATEGORY_NOT_SPACE: lambda sign: not sign.isspace(),
    code.CATEGORY_WORD: lambda sign: sign.isalnum() or sign == "_",
    code.CATEGORY_NOT_WORD: lambda sign: not (sign.isalnum() or sign == "_"),
}
_AT_START: Final = frozenset({code.AT_BEGINNING, code.AT_BEGINNING_STRING})
_MATCH: Final = 0
"""The node at which the pattern is found."""


class Unsupported(Exception):
    """The pattern needs what the machine cannot do; the message names it."""


@dataclass(slots=True)
class _Node:
    """A node takes a sign (`test`), holds at the start or the end (`at`), or leads on to others."""

    following: tuple[int, ...]
    test: Test | None = None
    at: str = ""


@dataclass(slots=True, eq=False)
class _State:
    """The nodes that the machine is at, whether the pattern is found there, and where a sign leads."""

    nodes: tuple[int, ...]
    is_found: bool
    is_found_at_end: bool
    after: dict[str, "_State"] = field(default_factory=dict)


class Automaton:
    """The machine for one pattern. Raises `Unsupported` and `re.error` for what it cannot be made of."""

    def __init__(self, pattern: str) -> None:
        parsed = syntax.parse(pattern)
        flags = parsed.state.flags & ~re.UNICODE
        if flags:
            raise Unsupported(f"{re.RegexFlag(flags)!r} is set")
        self._nodes = [_Node(())]
        self._start = self._sequence(list(parsed), _MATCH)
        self._states: dict[tuple[frozenset[int], bool], _State] = {}

    def found_in(self, text: str) -> bool:
        """Say whether the pattern is found anywhere in `text`."""
        state = self._state(frozenset((self._start,)), is_start=True)
        last = len(text) - 1
        for place, sign in enumerate(text):
            if state.is_found or (place == last and sign == "\n" and state.is_found_at_end):
                return True
            following = state.after.get(sign)
            if following is None:
                following = state.after[sign] = self._step(state, sign)
            state = following
        return state.is_found or state.is_found_at_end

    def _step(self, state: _State, sign: str) -> _State:
        reached = {self._start}
        for number in state.nodes:
            node = self._nodes[number]
            if node.test is not None and node.test(sign):
                reached.update(node.following)
        return self._state(frozenset(reached), is_start=False)

    def _state(self, reached: frozenset[int], *, is_start: bool) -> _State:
        key = reached, is_start
        state = self._states.get(key)
        if state is None:
            if len(self._states) >= MOST_STATES:
                for known in self._states.values():
                    known.after.clear()
                self._states.clear()
            nodes = self._closure(reached, {"start"} if is_start else set())
            at_end = self._closure(reached, {"start", "end"} if is_start else {"end"})
            takers = tuple(number for number in nodes if self._nodes[number].test is not None)
            state = self._states[key] = _State(takers, _MATCH in nodes, _MATCH in at_end)
        return state

    def _closure(self, reached: Iterable[int], here: set[str]) -> set[int]:
        """Return all nodes that are reached without taking a sign, at the start or the end of the text."""
        seen: set[int] = set()
        waiting = list(reached)
        while waiting:
            number = waiting.pop()
            if number in seen:
                continue
            seen.add(number)
            node = self._nodes[number]
            if node.test is None and (not node.at or node.at in here):
                waiting.extend(node.following)
        return seen

    # Making the nodes, from the end of the pattern to its start

    def _add(self, following: tuple[int, ...], test: Test | None = None, at: str = "") -> int:
        if len(self._nodes) >= MOST_NODES:
            raise Unsupported(f"its repetitions written out are longer than {MOST_NODES} signs")
        self._nodes.append(_Node(following, test, at))
        return len(self._nodes) - 1

    def _sequence(self, items: Iterable[tuple[Any, Any]], after: int) -> int:
        for operation, argument in reversed(list(items)):
            after = self._one(operation, argument, after)
        return after

    def _one(self, operation: Any, argument: Any, after: int) -> int:
        if operation is code.BRANCH:
            return self._add(tuple(self._sequence(list(way), after) for way in argument[1]))
        if operation is code.SUBPATTERN:
            _, added, removed, inner = argument
            if added or removed:
                raise Unsupported("a group sets flags of its own")
            return self._sequence(list(inner), after)
        if operation in {code.MAX_REPEAT, code.MIN_REPEAT}:
            least, most, inner = argument
            return self._repeated(least, most, inner, after)
        if operation is code.AT:
            if argument in _AT_START:
                return self._add((after,), at="start")
            if argument in {code.AT_END, code.AT_END_STRING}:
                return self._add((after,), at="end")
            raise Unsupported("it asks for the borders of words")
        return self._add((after,), _test(operation, argument))

    def _repeated(self, least: int, most: int, inner: Any, after: int) -> int:
        items = list(inner)
        if most == code.MAXREPEAT:
            loop = self._add(())
            self._nodes[loop].following = (self._sequence(items, loop), after)
            after = loop
        else:
            end = after
            for _ in range(most - least):
                after = self._add((self._sequence(items, after), end))
        for _ in range(least):
            after = self._sequence(items, after)
        return after


def _test(operation: Any, argument: Any) -> Test:
    if operation is code.LITERAL:
        wanted = chr(argument)
        return lambda sign: sign == wanted
    if operation is code.NOT_LITERAL:
        unwanted = chr(argument)
        return lambda sign: sign != unwanted
    if operation is code.ANY:
        return lambda sign: sign != "\n"
    if operation is code.IN:
        return _class(argument)
    raise Unsupported("it looks back or ahead; leave references and assertions out")


def _class(parts: list[tuple[Any, Any]]) -> Test:
    negated = parts[0][0] is code.NEGATE
    tests = [_part(operation, argument) for operation, argument in parts[negated:]]
    return lambda sign: any(test(sign) for test in tests) is not negated


def _part(operation: Any, argument: Any) -> Test:
    if operation is code.RANGE:
        low, high = map(chr, argument)
        return lambda sign: low <= sign <= high
    if operation is code.CATEGORY:
        return _CATEGORIES[argument]
    return _test(operation, argument)
