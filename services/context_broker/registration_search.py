"""What askers of the registry look for: registrations by what their sources have (clause 5.10.2.4).

Entities and attributes are compared with the information of a registration; filters (csf, q) with its own
properties, places and scopes with those registered, and a time with its intervals.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from services.context_broker.contexts import Context
from services.context_broker.patterns import pattern
from services.context_broker.problems import bad_request_data
from services.context_broker.reading import names_of
from services.context_broker.registration import Asked, Interval, Registration
from services.context_broker.selection import Query, compiled
from services.context_broker.subscriptions import type_names
from services.context_broker.words import moment, require_time, require_uri, shown

SEARCH_PARAMETERS: Final = frozenset(
    {"id", "type", "idPattern", "attrs", "q", "csf", "georel", "geometry", "coordinates", "geoproperty",
     "timerel", "timeAt", "endTimeAt", "timeproperty", "scopeQ"}
)  # fmt: skip
_ENOUGH: Final = ("id", "type", "idPattern", "attrs", "q", "csf", "georel", "scopeQ")
_MANAGED_TIMES: Final = frozenset({"createdAt", "modifiedAt", "deletedAt"})


@dataclass(frozen=True, slots=True)
class Period:
    """A time that is asked for, and whether the broker's own times are meant, not those of observation."""

    span: Interval
    is_managed: bool

    def meets(self, one: Registration) -> bool:
        """Say whether the source has anything of this time."""
        has = one.managed if self.is_managed else one.observed
        return has is not None and has[0] <= self.span[1] and has[1] >= self.span[0]


@dataclass(frozen=True, slots=True)
class Search:
    """What is looked for; `filters` must all hold of the registration's own properties."""

    asked: Asked
    filters: tuple[Query, ...] = ()
    period: Period | None = None

    def wants(self, one: Registration) -> bool:
        """Say whether a registration that is about the right entities is among those looked for."""
        if self.period is None:
            if one.is_temporal:  # without a time the latest is meant
                return False
        elif not self.period.meets(one):
            return False
        return all(one_filter.holds(one.described) for one_filter in self.filters)


def search_of(parameters: Mapping[str, str], context: Context) -> Search:
    """Return what the parameters of GET csourceRegistrations look for. An empty parameter is none."""
    given = {name: value for name, value in parameters.items() if value}
    if not any(name in given for name in _ENOUGH):
        raise bad_request_data(
            f"a search for registrations has at least one of {', '.join(_ENOUGH)}; add one"
        )
    ids, wanted, types = given.get("id"), given.get("idPattern"), given.get("type")
    asked = Asked(
        ids=None if ids is None else tuple(require_uri(one, "an id in the query") for one in ids.split(",")),
        id_pattern=None if wanted is None else pattern(wanted),
        types=None if types is None else frozenset(type_names(types, context)),
        attributes=names_of(given.get("attrs"), context),
    )
    filters = tuple(compiled(given[name], context) for name in ("csf", "q") if name in given)
    return Search(asked, filters, period_of(given))


def period_of(given: Mapping[str, str]) -> Period | None:
    """Return the time that a temporal query (clause 4.11) asks for; None if it asks for none."""
    relation = given.get("timerel")
    if relation is None:
        return None
    at_s = moment(require_time(given.get("timeAt"), "timeAt")) or 0.0
    is_managed = given.get("timeproperty") in _MANAGED_TIMES
    if relation == "before":
        return Period((float("-inf"), at_s), is_managed)
    if relation == "after":
        return Period((at_s, float("inf")), is_managed)
    if relation == "between":
        end_s = moment(require_time(given.get("endTimeAt"), "endTimeAt")) or 0.0
        return Period((at_s, end_s), is_managed)
    raise bad_request_data(f"timerel is before, after or between, not {shown(relation)}")
