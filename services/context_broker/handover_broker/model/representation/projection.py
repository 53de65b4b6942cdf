"""The requested members of an entity: `pick` selects them, `omit` leaves them out (clause 4.21).

Braces after the name of a relationship select members of the linked entity.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from handover_broker.model.entity import Terms
from handover_broker.model.entity_parser import expand
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import require_name, shown

DEEPEST_LINK: Final = 10
"""Maximum nesting of braces: the maximum depth of linked entities."""
ENTITY_MEMBERS: Final = frozenset(
    {"id", "type", "scope", "createdAt", "modifiedAt", "deletedAt", "expiresAt"}
)
"""Members of an entity that are not attributes; they are not expanded."""

_SIGN = re.compile(r"[{},|]|[^{},|]+")


@dataclass(frozen=True, slots=True)
class Projection:
    """The requested members of an entity: those picked (attributes by IRI; None for all), without those
    omitted.

    `linked` has the projections of linked entities, by relationship (IRI).
    """

    picked: frozenset[str] | None = None
    omitted: frozenset[str] = frozenset()
    linked: tuple[tuple[str, "Projection"], ...] = ()

    def wants(self, member: str) -> bool:
        """Return whether a member, or an attribute by its IRI, is requested."""
        return (self.picked is None or member in self.picked) and member not in self.omitted

    def below(self, relationship: str) -> "Projection | None":
        """Return the projection of entities that a relationship (IRI) links to, None for all members."""
        return next((names for name, names in self.linked if name == relationship), None)


Names = dict[str, "Names | None"]
"""Names, each with the content of its braces; None without braces."""


def read_projection(pick: str | None, omit: str | None, terms: Terms) -> Projection | None:
    """Return the combination of `pick` and `omit`, None for all members.

    Raises a problem (400) for a syntax error, and for a name in both.
    """
    if pick is None and omit is None:
        return None
    picked = None if pick is None else read_names(pick, "pick", terms)
    omitted = {} if omit is None else read_names(omit, "omit", terms)
    return _projection(picked, omitted, terms)


def read_names(text: str, what: str, terms: Terms) -> Names:
    """Return the names of a projection with attributes as IRIs; raise a problem (400) for a syntax error."""
    signs = iter(_SIGN.findall(text))
    names, end = _read_list(signs, text, what, terms, 0)
    if end == "}":
        raise bad_request_data(f"{what}={shown(text)} closes a brace that was not opened; leave it out")
    return names


def _projection(picked: Names | None, omitted: Names, terms: Terms) -> Projection:
    left_out = frozenset(name for name, below in omitted.items() if below is None)
    both = left_out.intersection(picked or ())
    if both:
        name = terms.compact(next(iter(both)))
        raise bad_request_data(f"{shown(name)} is both in pick and in omit; leave it out of one of them")
    links = dict.fromkeys(name for names in (picked or {}, omitted) for name, below in names.items() if below)
    linked = tuple(
        (name, _projection((picked or {}).get(name), omitted.get(name) or {}, terms)) for name in links
    )
    return Projection(None if picked is None else frozenset(picked), left_out, linked)


def _read_list(
    signs: Iterator[str], text: str, what: str, terms: Terms, depth: int
) -> tuple[Names, str | None]:
    """Return the names up to the end or to the closing brace, and which of the two it was."""
    if depth > DEEPEST_LINK:
        raise bad_request_data(f"{what} follows links deeper than {DEEPEST_LINK} entities; ask for less")
    names: Names = {}
    while True:
        sign = next(signs, None)
        if sign is None or sign in "{},|":
            raise bad_request_data(
                f"{what}={shown(text)} lacks a name where there should be one; write names with commas "
                "between them, and those of linked entities in braces: a,b{c,d}"
            )
        name = sign if sign in ENTITY_MEMBERS else expand(require_name(sign, f"a name in {what}"), terms)
        names[name] = None
        sign = next(signs, None)
        if sign == "{":
            if name in ENTITY_MEMBERS:
                raise bad_request_data(
                    f"{what}={shown(text)}: {name} is not a relationship; leave the braces out"
                )
            names[name], end = _read_list(signs, text, what, terms, depth + 1)
            if end is None:
                raise bad_request_data(f"{what}={shown(text)} opens a brace that it does not close")
            sign = next(signs, None)
        if sign is None or sign == "}":
            return names, sign
        if sign not in ",|":
            raise bad_request_data(f"{what}={shown(text)} has {shown(sign)} where a comma belongs")
