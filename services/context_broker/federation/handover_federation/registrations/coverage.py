"""Coverage of a registration: locations, scopes, times and datasets in which its source may have data.

A registration may restrict them (clause 5.2.9); a source that cannot have matching data is not queried
(clauses 4.3.6.1, 5.10.2.4 and 5.12). Without a restriction the source may have any data. All checks err on
the side of querying a source in vain.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from handover_broker.model.entity import Entity
from handover_broker.model.entity_parser import expand
from handover_broker.model.geometry import fault_of
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import moment, require_time, shown
from handover_broker.query.geo_query import Geometry, GeoQuery
from handover_broker.query.scope_query import ANY_LEVEL, ScopePattern, ScopeQuery
from handover_broker.query.sphere import box_of
from handover_federation.registrations.registration import Interval, Registration, SourceFilter

_MANAGED_TIMES: Final = frozenset({"createdAt", "modifiedAt", "deletedAt"})


@dataclass(frozen=True, slots=True)
class TimeRange:
    """A time range, of the broker's own timestamps (`is_managed`) or of observations."""

    span: Interval
    is_managed: bool

    def meets(self, registration: Registration) -> bool:
        """Return whether the source has data of this time."""
        has = registration.managed if self.is_managed else registration.observed
        return has is not None and has[0] <= self.span[1] and has[1] >= self.span[0]


@dataclass(frozen=True, slots=True)
class CoverageQuery:
    """What a query restricts besides entities and attributes; None for no restriction."""

    place: GeoQuery | None = None
    scope: ScopeQuery | None = None
    period: TimeRange | None = None
    datasets: frozenset[str | None] | None = None

    @property
    def is_unrestricted(self) -> bool:
        """Return whether every source may have matching data."""
        return self.place is None and self.scope is None and self.period is None and self.datasets is None

    def may_match(self, registration: Registration) -> bool:
        """Return whether the source of a registration may have matching data."""
        return (
            (self.period is None or not registration.is_temporal or self.period.meets(registration))
            and (
                self.datasets is None
                or registration.datasets is None
                or not self.datasets.isdisjoint(registration.datasets)
            )
            and (
                self.scope is None
                or not registration.scopes
                or _may_be_in_scopes(self.scope, registration.scopes)
            )
            and (self.place is None or _may_be_there(self.place, registration) is not False)
        )


def period_of(period: Mapping[str, Any]) -> TimeRange | None:
    """Return the time range of a temporal query (clause 4.11); None if it has none."""
    relation = period.get("timerel")
    if relation is None:
        return None
    at_s = moment(require_time(period.get("timeAt"), "timeAt")) or 0.0
    is_managed = period.get("timeproperty") in _MANAGED_TIMES
    if relation == "before":
        return TimeRange((float("-inf"), at_s), is_managed)
    if relation == "after":
        return TimeRange((at_s, float("inf")), is_managed)
    if relation == "between":
        end_s = moment(require_time(period.get("endTimeAt"), "endTimeAt")) or 0.0
        return TimeRange((at_s, end_s), is_managed)
    raise bad_request_data(f"timerel is before, after or between, not {shown(relation)}")


def has_matching_place(query: GeoQuery, registration: Registration) -> bool:
    """Return whether a source has registered locations and one of them may match (clause 5.10.2.4)."""
    return bool(_may_be_there(query, registration))


def placement_filter(document: Mapping[str, Any]) -> SourceFilter | None:
    """Return a filter for sources that may hold a document with its locations and scopes; None for all."""
    places = {name: shapes for name in _PLACES if (shapes := _places_in(document.get(name)))}
    scope = document.get("scope")
    scopes = [text for text in (scope if isinstance(scope, list) else [scope]) if isinstance(text, str)]
    if not places and not scopes:
        return None
    return lambda registration: _may_contain(registration, places, scopes)


def may_hold(registration: Registration, entity: Entity) -> bool:
    """Return whether the source of a registration may hold an entity with its locations and scopes."""
    if not registration.places and not registration.scopes:
        return True
    places = {
        name: shapes
        for name in registration.places
        if (shapes := _places_in(entity.attributes.get(expand(name, registration.context.terms))))
    }
    return _may_contain(registration, places, entity.scopes)


def _may_contain(
    registration: Registration, places: Mapping[str, list[Mapping[str, Any]]], scopes: Iterable[str]
) -> bool:
    """Return whether a source may hold what has these locations and scopes; without any it may be
    anywhere."""
    named = list(scopes)
    if named and registration.scopes and not any(_is_in(scope, registration.scopes) for scope in named):
        return False
    return all(
        any(_touch(area, place) for place in places[name])
        for name, area in registration.places.items()
        if name in places
    )


_PLACES: Final = ("location", "observationSpace", "operationSpace")


def _may_be_there(query: GeoQuery, registration: Registration) -> bool | None:
    """Return whether a registered location may match; None if the registration has no such locations."""
    areas = [
        instance["value"]
        for instance in registration.described.attributes.get(query.attribute, ())
        if instance["type"] == "GeoProperty"
    ]
    return any(_may_be_in(query, area) for area in areas) if areas else None


def _may_be_in(query: GeoQuery, area: Any) -> bool:
    """Return whether any place within an area may match."""
    if query.fits(area):
        return True
    if query.relation == "disjoint":
        return not replace(query, relation="within").fits(area)
    if query.relation == "minDistance":
        return bool(area.get("type") != "Point")
    if query.relation == "maxDistance":
        return False
    return replace(query, relation="intersects").fits(area)


def _touch(area: Geometry, place: Geometry) -> bool:
    return GeoQuery("", "intersects", area, box=box_of(area)).fits(place)


def _places_in(value: Any) -> list[Geometry]:
    if isinstance(value, list):
        return [place for part in value for place in _places_in(part)]
    geometry = value.get("value", value) if isinstance(value, Mapping) else None
    return [geometry] if isinstance(geometry, dict) and fault_of(geometry) is None else []


def _may_be_in_scopes(query: ScopeQuery, scopes: tuple[str, ...]) -> bool:
    return any(
        all(any(_may_fit(pattern, scope) for scope in scopes) for pattern in patterns)
        for patterns in query.alternatives
    )


def _may_fit(pattern: ScopePattern, scope: str) -> bool:
    """Return whether a scope, or one below it, matches."""
    levels = scope.strip("/").split("/")
    if len(levels) > len(pattern.levels) and not pattern.below:
        return False
    return all(wanted in (ANY_LEVEL, level) for wanted, level in zip(pattern.levels, levels, strict=False))


def _is_in(scope: str, scopes: tuple[str, ...]) -> bool:
    inner = scope.strip("/") + "/"
    return any(inner.startswith(outer.strip("/") + "/") for outer in scopes)
