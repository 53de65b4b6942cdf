"""Searches for registrations (clause 5.10.2.4).

Entities and attributes are compared with the information of a registration; filters (csf, q) with its own
properties, locations and scopes with the registered ones, and a time with its intervals.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from handover_broker.model.context import Context
from handover_broker.model.entity_parser import expand
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import require_name, require_uri, shown
from handover_broker.query import geo_query
from handover_broker.query.geo_query import GeoQuery
from handover_broker.query.parameters import Use, names_for
from handover_broker.query.patterns import pattern
from handover_broker.query.scope_query import ScopeQuery, scope_query
from handover_broker.query.selection import Selection, compiled
from handover_broker.query.type_selection import type_selection
from handover_federation.registrations.coverage import TimeRange, has_matching_place, period_of
from handover_federation.registrations.registration import EntityTarget, Registration

SEARCH_PARAMETERS: Final = names_for(Use.SEARCH)
_ENOUGH: Final = names_for(Use.SEARCH_CRITERION)


@dataclass(frozen=True, slots=True)
class Search:
    """A search for registrations that match any of the `targets` and all other conditions."""

    targets: tuple[EntityTarget, ...]
    filters: tuple[Selection, ...] = ()
    period: TimeRange | None = None
    place: GeoQuery | None = None
    scope: ScopeQuery | None = None

    def wants(self, registration: Registration) -> bool:
        """Return whether a registration that matches a target also meets the other conditions."""
        if self.period is None:
            if registration.is_temporal:  # without a time, current data is meant
                return False
        elif not self.period.meets(registration):
            return False
        return (
            all(condition.wants(registration.described) for condition in self.filters)
            and (self.place is None or has_matching_place(self.place, registration))
            and (self.scope is None or self.scope.wants(registration.scopes))
        )

    def finds(self, registration: Registration) -> bool:
        """Return whether a registration matches the search."""
        return any(registration.parts(target) for target in self.targets) and self.wants(registration)


def search_of(parameters: Mapping[str, str], context: Context) -> Search:
    """Return the search in the parameters of GET csourceRegistrations. Empty parameters are ignored."""
    texts = {name: value for name, value in parameters.items() if value}
    if not any(name in texts for name in _ENOUGH):
        raise bad_request_data(
            f"a search for registrations has at least one of {', '.join(_ENOUGH)}; add one"
        )
    ids = texts.get("id")
    target = target_for(
        None if ids is None else ids.split(","),
        texts.get("idPattern"),
        texts.get("type"),
        context,
    )
    attrs = texts.get("attrs")
    names = None if attrs is None else frozenset(_expanded(attrs.split(","), context))
    return Search(
        (EntityTarget(target.ids, target.id_pattern, target.types, names),),
        tuple(Selection(query=compiled(texts[name], context)) for name in ("csf", "q") if name in texts),
        period_of(texts),
        geo_query.geo_query(texts, context.terms.expand),
        scope_query(texts["scopeQ"]) if "scopeQ" in texts else None,
    )


def target_for(ids: list[str] | None, id_pattern: Any, types: Any, context: Context) -> EntityTarget:
    """Return the target for entities with these ids or a pattern, and of these types."""
    if id_pattern is not None and not isinstance(id_pattern, str):
        raise bad_request_data(f"idPattern is text, not {shown(id_pattern)}")
    chosen = None if types is None else type_selection(types, context.terms.expand)
    return EntityTarget(
        ids=None if ids is None else tuple(require_uri(entity_id, "an id of an entity") for entity_id in ids),
        id_pattern=None if id_pattern is None else pattern(id_pattern),
        types=None if chosen is None or chosen.is_every else frozenset(chosen.names()),
    )


def _expanded(names: list[str], context: Context) -> list[str]:
    return [expand(require_name(name, "a name in attrs"), context.terms) for name in names]
