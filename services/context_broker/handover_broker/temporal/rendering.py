"""Renders temporal evolutions: with every instance, as pairs of value and time, or aggregated.

Clauses 4.5.6 to 4.5.9 (normalized, concise and temporalValues) and 4.5.19 (aggregatedValues).
"""

from typing import Any, Final

from handover_broker.model.entity import Terms
from handover_broker.model.representation.language import in_language
from handover_broker.model.representation.rendering import Form, written
from handover_broker.model.validation import is_time, written_time
from handover_broker.temporal.aggregation import written_totals
from handover_broker.temporal.history import SCOPE
from handover_broker.temporal.history_reader import Evolution, EvolutionPage, Point, Series
from handover_broker.temporal.query import Representation, TemporalQuery, TemporalView

_SAYS_MANY: Final = {
    "Property": "values",
    "GeoProperty": "values",
    "Relationship": "objects",
    "LanguageProperty": "languageMaps",
    "JsonProperty": "jsons",
    "VocabProperty": "vocabs",
    "ListProperty": "valueLists",
    "ListRelationship": "objectLists",
}
"""The member with the pairs of value and time, by type of attribute."""


def render_evolution(
    evolution: Evolution, query: TemporalQuery, view: TemporalView, terms: Terms
) -> dict[str, Any]:
    """Return the evolution of an entity as a JSON object."""
    subject, projection = evolution.subject, view.view.projection
    types = [terms.compact(kind) for kind in subject.types]
    result: dict[str, Any] = {"id": subject.id, "type": types[0] if len(types) == 1 else types}
    if view.view.sys_attrs:
        result |= {"createdAt": subject.created_at, "modifiedAt": subject.modified_at}
        if subject.expires_at is not None:
            result["expiresAt"] = subject.expires_at
    if subject.deleted_at is not None and (view.view.sys_attrs or query.time_property == "deletedAt"):
        result["deletedAt"] = subject.deleted_at
    if projection is not None:
        result = {member: value for member, value in result.items() if projection.wants(member)}
    for name, named in evolution.series.items():
        key = name if name == SCOPE else terms.compact(name)
        many = [series for series in named.values() if series.points or series.totals]
        if not many:
            continue
        if view.representation in {Representation.NORMALIZED, Representation.CONCISE}:
            result[key] = [_instance(point, query, view, terms) for series in many for point in series.points]
            if (
                name == SCOPE
            ):  # scopes have no observedAt (clause 4.18), so that modifiedAt is their only time
                points = (point for series in many for point in series.points)
                for shown, point in zip(result[key], points, strict=True):
                    if "observedAt" not in shown and "modifiedAt" in point[-1]:
                        shown["modifiedAt"] = point[-1]["modifiedAt"]
        else:
            pairs = [_pairs(series, query, view, terms, is_scope=name == SCOPE) for series in many]
            result[key] = pairs[0] if len(pairs) == 1 else pairs
    return result


def _instance(point: Point, query: TemporalQuery, view: TemporalView, terms: Terms) -> dict[str, Any]:
    instance: dict[str, Any] = point[-1]
    if view.view.languages is not None:
        instance = in_language(instance, view.view.languages)
    result: dict[str, Any] = written(instance, terms, view.view.form, sys_attrs=view.view.sys_attrs)
    name = query.time_property
    if name is not None and name in instance:
        result[name] = instance[name]  # the time property of the query
    return result


def _pairs(
    series: Series, query: TemporalQuery, view: TemporalView, terms: Terms, *, is_scope: bool
) -> dict[str, Any]:
    kind = series.kind
    if view.representation is Representation.AGGREGATED:
        result: dict[str, Any] = {"type": kind}
        if series.dataset is not None:
            result["datasetId"] = series.dataset
        assert query.aggregation is not None  # noqa: S101 - asked for with this form
        return result | written_totals(series.totals, query.aggregation.methods)
    pairs: list[list[Any]] = []
    for at, _, instance in series.points:
        shown = instance if view.view.languages is None else in_language(instance, view.view.languages)
        kind = shown["type"]
        time_text = query.time_text(instance, is_scope=is_scope)
        value = written(shown, terms, Form.KEY_VALUES, sys_attrs=False)
        # The text of the other representations; one without a zone was stored before these were refused.
        pairs.append([value, time_text if is_time(time_text) else written_time(at)])
    result = {"type": kind}
    if series.dataset is not None:
        result["datasetId"] = series.dataset
    result[_SAYS_MANY[kind]] = pairs
    return result


def content_range(page: EvolutionPage, query: TemporalQuery) -> bytes | None:
    """Return the Content-Range of a partial response, None for a complete one.

    Clause 6.3.10: start and end of the response, backwards for the last instances. The next request starts at
    its end. Because a range includes its start, instances of that instant come again with the same
    instanceId.
    """
    if page.edge is None:
        return None
    times = [at for evolution in page.evolutions for series in evolution.all() for at, _, _ in series.points]
    if query.last is None:
        start = query.start if query.start is not None else min(times, default=page.edge)
        size = "*"
    else:
        start = query.end if query.end is not None else max(times, default=page.edge)
        size = str(query.last)
    end = page.edge
    if query.aggregation is None and end == start and query.last is None:
        end += 1  # all instances of this instant are in the response: the next request starts after it
    return f"date-time {written_time(start)}-{written_time(end)}/{size}".encode()
