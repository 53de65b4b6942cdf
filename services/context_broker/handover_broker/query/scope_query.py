"""Scope queries: `/Madrid/Gardens`, `/Madrid/+/ParqueNorte`, `/Madrid/#` with all below it.

The scope query language of clause 4.19 of ETSI GS CIM 009. `,` and `|` are or, `(/A;/B)` requires both.
"""

from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import shown
from handover_broker.query.alternatives import Alternatives, alternatives

ANY_LEVEL: Final = "+"
ALL_BELOW: Final = "#"


@dataclass(frozen=True, slots=True)
class ScopePattern:
    """One scope pattern, level by level; `below` includes the whole tree under it."""

    levels: tuple[str, ...]
    below: bool

    def fits(self, scope: str) -> bool:
        """Return whether a scope such as `/Madrid/Gardens` matches."""
        levels = scope.strip("/").split("/")
        if len(levels) != len(self.levels) and not (self.below and len(levels) > len(self.levels)):
            return False
        return all(wanted in (ANY_LEVEL, level) for wanted, level in zip(self.levels, levels, strict=False))


@dataclass(frozen=True, slots=True)
class ScopeQuery:
    """A scope query: the scopes of an entity match all patterns of at least one of the `alternatives`."""

    text: str
    alternatives: Alternatives[ScopePattern]

    def wants(self, scopes: Collection[str]) -> bool:
        """Return whether an entity with `scopes` matches; one without scopes never does."""
        return any(
            all(any(pattern.fits(scope) for scope in scopes) for pattern in patterns)
            for patterns in self.alternatives
        )


def scope_query(text: Any, what: str = "scopeQ") -> ScopeQuery:
    """Return the query in `text`; raise a problem (400) when it is invalid."""
    if not isinstance(text, str) or not text:
        raise bad_request_data(f"{what} is text such as /Madrid/Gardens/#, not {shown(text)}")
    return _scope_query(text, what)


@lru_cache(maxsize=1024)
def _scope_query(text: str, what: str) -> ScopeQuery:
    return ScopeQuery(text, alternatives(text, what, lambda name: _pattern(name, what)))


def _pattern(name: str, what: str) -> ScopePattern:
    levels = name.removeprefix("/").split("/")
    below = levels[-1] == ALL_BELOW
    if below:
        levels.pop()
    # The examples of the standard also have a first level without its slash.
    if not name.strip("/") or not all(levels) or any(_is_unfit(level) for level in levels):
        raise bad_request_data(
            f"{what} has no scope {shown(name)}: write levels such as /Madrid/Gardens, + for any one level "
            "and # at the end for all below"
        )
    return ScopePattern(tuple(levels), below)


def _is_unfit(level: str) -> bool:
    return level != ANY_LEVEL and any(sign in level or level.isspace() for sign in "#+")
