"""The entities, attributes and filters of a request, in the terms in which registrations are matched."""

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import orjson

from handover_broker.model.context import Context
from handover_broker.model.entity_parser import expand
from handover_broker.model.problems import bad_request_data
from handover_broker.query import geo_query
from handover_broker.query.parameters import FILTERS
from handover_broker.query.patterns import pattern
from handover_broker.query.scope_query import scope_query
from handover_broker.query.selection import compiled
from handover_broker.request.query_parameters import datasets_of
from handover_federation.registrations.coverage import CoverageQuery, period_of
from handover_federation.registrations.registration import EntityTarget, Match, SourceFilter

_NEEDS_MORE: Final = (*FILTERS, "join")
"""Parameters that need attributes beyond those in the response."""
_TYPE_SIGNS: Final = re.compile(r"[,;|()]+")


def selector_parameters(
    document: Mapping[str, Any], parameters: Mapping[str, str]
) -> Iterable[dict[str, str]]:
    """Yield the parameters that a GET for the same, or for one of its selectors, would have."""
    common = {name: value for name, value in {**parameters, **document}.items() if isinstance(value, str)}
    for name in ("attrs", "pick", "omit", "datasetId", "expandValues", "jsonKeys"):
        if isinstance(document.get(name), list):
            common[name] = ",".join(str(part) for part in document[name])
    geo = document.get("geoQ")
    if isinstance(geo, dict):
        for name in ("georel", "geometry", "geoproperty", "coordinates"):
            if name in geo:
                value = geo[name]
                common[name] = value if isinstance(value, str) else orjson.dumps(value).decode()
    if isinstance(document.get("ordering"), dict):
        common["orderBy"] = ",".join(str(part) for part in document["ordering"].get("orderBy") or ())
    common.pop("type", None)  # the type of the document, "Query"
    selectors = document.get("entities")
    if not isinstance(selectors, list) or not selectors:
        yield common
        return
    for selector in selectors:
        if isinstance(selector, dict):
            yield {
                **common,
                **{
                    name: value if isinstance(value, str) else ",".join(str(part) for part in value)
                    for name, value in selector.items()
                    if isinstance(value, str | list)
                },
            }


def refuse_order(parameters: Mapping[str, str], matches: Iterable[Match]) -> None:
    """Raise a problem (400) for an ordered query that matches a registration (4.23.1)."""
    if "orderBy" in parameters and (match := next(iter(matches), None)) is not None:
        raise bad_request_data(
            "results of context sources cannot be ordered, and registration "
            f"{match.registration.id} matches this query; "
            "leave orderBy out, or query this broker only with local=true"
        )


def target_of(
    parameters: Mapping[str, str], context: Context, names: frozenset[str] | None
) -> tuple[EntityTarget, SourceFilter | None]:
    """Return the target of query parameters with the attributes `names` (None for all), and a source
    filter."""
    ids, wanted, csf = parameters.get("id"), parameters.get("idPattern"), parameters.get("csf")
    target = EntityTarget(
        tuple(dict.fromkeys(ids.split(","))) if ids else None,
        pattern(wanted) if wanted else None,
        types_of(parameters.get("type"), context),
        names,
    )
    return target, source_filter(csf, context, coverage_of(parameters, context.terms.expand))


def coverage_of(parameters: Mapping[str, str], expand: Callable[[str], str]) -> CoverageQuery:
    """Return the coverage that query parameters need; raises a problem (400) if they are invalid."""
    scope, datasets = parameters.get("scopeQ"), parameters.get("datasetId")
    return CoverageQuery(
        geo_query.geo_query(parameters, expand) if "georel" in parameters else None,
        scope_query(scope) if scope else None,
        period_of(parameters),
        datasets_of(datasets) if datasets else None,
    )


def source_filter(csf: str | None, context: Context, coverage: CoverageQuery) -> SourceFilter | None:
    """Return a filter for sources that cover the query and match a context source filter; None for all."""
    holds = compiled(csf, context).holds if csf else None
    if holds is None:
        return None if coverage.is_unrestricted else coverage.may_match
    return lambda registration: holds(registration.described) and coverage.may_match(registration)


def types_of(text: str | None, context: Context) -> frozenset[str] | None:
    """Return all types (IRIs) in a type selection, None if there is none."""
    names = [name.strip() for name in _TYPE_SIGNS.split(text or "") if name.strip()]
    return frozenset(context.terms.expand(name) for name in names) if names else None


def names_of(parameters: Mapping[str, str], context: Context) -> frozenset[str] | None:
    """Return the attributes that the response needs, None if it may need all."""
    text = parameters.get("attrs") or parameters.get("pick")
    if not text or any(name in parameters for name in _NEEDS_MORE) or not _PLAIN_NAMES.fullmatch(text):
        return None
    names = [name for name in text.split(",") if name not in {"id", "type", "scope"}]
    return frozenset(expand(name, context.terms) for name in names) or None


_PLAIN_NAMES: Final = re.compile(r"[^{}()\[\].|;]+")


def may_be_split(parameters: Mapping[str, str], matches: Iterable[Match]) -> bool:
    """Return whether an entity may be split over several sources, so that filters apply after the merge.

    The standard leaves this to the deployment if splitEntities is absent (clause 5.7.2.4). Here entities
    count as split if a registration names attributes: then its source has a part of them.
    """
    text = parameters.get("splitEntities")
    if text is not None:
        return text == "true"
    return any(piece.attributes is not None for match in matches for piece in match.registration.information)
