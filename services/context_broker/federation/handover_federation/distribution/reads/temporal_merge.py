"""Merges temporal evolutions from several sources (clauses 4.5.5, 4.5.19, 5.7.3.4 and 5.7.4.4).

Evolutions are merged as documents, in the requested representation: instances, or pairs of value and time, in
the order of time. If two sources have an instance of the same time, the one with the higher priority counts
(the broker's own, then exclusive, redirect, inclusive, auxiliary). Aggregations are computed from the merged
values.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Final

import orjson

from handover_broker.model.context import Context
from handover_broker.model.entity import VALUE_MEMBER
from handover_broker.model.problems import too_many_results
from handover_broker.model.validation import MICROS, moment, written_time
from handover_broker.temporal.aggregation import periods, totals, written_totals
from handover_broker.temporal.history_reader import MAX_INSTANCES_PER_ATTRIBUTE
from handover_broker.temporal.query import TemporalQuery, TemporalView
from handover_federation.registrations.registration import Registration

MEMBERS: Final = frozenset(
    {"id", "type", "@context", "scope", "createdAt", "modifiedAt", "deletedAt", "expiresAt"}
)
"""Members of an evolution that are no attributes."""
_TIMES: Final = ("observedAt", "modifiedAt", "createdAt")
_SERIES: Final = frozenset(
    {"values", "objects", "languageMaps", "jsons", "vocabs", "valueLists", "objectLists"}
)
_RANGE: Final = re.compile(r"date-time\s+(\d{4}-\d\d-\d\dT[^/\s]*?)-(\d{4}-\d\d-\d\dT[^/\s]*)/")

Evolution = dict[str, Any]
"""The evolution of one entity, as a document in the names of the client."""
SourceEvolution = tuple[Registration | None, Evolution]
"""An evolution and its source; None is the broker itself."""


def merge_evolutions(parts: Iterable[SourceEvolution], context: Context, last: int | None) -> Evolution:
    """Return the merged evolution, with the `last` instances of each attribute."""
    ranked = sorted(
        parts, key=lambda part: (0, "") if part[0] is None else (int(part[0].mode) + 1, part[0].id)
    )
    proxied = [member for member, _ in ranked if member is not None and member.mode.is_proxied]
    result: Evolution = {}
    for registration, document in ranked:
        gone = _claimed(proxied, registration, context)
        for name, value in document.items():
            if name in MEMBERS:
                result.setdefault(name, value)
            elif gone is not None and name not in gone:
                result[name] = _joined(result[name], value) if name in result else value
    ends = [document.get("expiresAt") for _, document in ranked]
    if "expiresAt" in result:  # it expires with the last of its parts, if all of them expire (clause 4.5.5.3)
        result["expiresAt"] = max(ends, key=_seconds)
        if None in ends:
            del result["expiresAt"]
    if last is not None:
        for name in result.keys() - MEMBERS:
            result[name] = _newest(result[name], last)
    return result


def shown(document: Evolution, view: TemporalView, context: Context) -> Evolution:
    """Return an evolution with the requested attributes only."""
    return {
        name: value
        for name, value in document.items()
        if name in MEMBERS or view.wants(context.terms.expand(name))
    }


def with_members(document: Evolution, query: TemporalQuery, view: TemporalView) -> Evolution:
    """Return an evolution with the requested members only."""
    projection, sys_attrs = view.view.projection, view.view.sys_attrs
    gone = set() if sys_attrs else {"createdAt", "modifiedAt", "expiresAt"}
    if not sys_attrs and query.time_property != "deletedAt":
        gone.add("deletedAt")
    if projection is not None:
        gone |= {name for name in MEMBERS - {"@context"} if not projection.wants(name)}
    return {name: value for name, value in document.items() if name not in gone}


def aggregated(document: Evolution, query: TemporalQuery) -> Evolution:
    """Return the aggregation of an evolution (normalized, with its times) by period.

    Raises a problem (403) when there are more periods than fit into a response.
    """
    wanted = query.aggregation
    assert wanted is not None  # noqa: S101 - asked for with this form
    points: dict[str, dict[str | None, list[tuple[int, str, Any]]]] = {}
    for name in document.keys() - MEMBERS:
        attribute = document[name]
        for instance in attribute if isinstance(attribute, list) else [attribute]:
            kind = instance.get("type") if isinstance(instance, dict) else None
            if (
                isinstance(kind, str)
                and kind in VALUE_MEMBER
                and VALUE_MEMBER[kind] in instance
                and (at := query.time_of(instance)) is not None
            ):
                point = (at, kind, instance[VALUE_MEMBER[kind]])
                points.setdefault(name, {}).setdefault(instance.get("datasetId"), []).append(point)
    result = {name: value for name, value in document.items() if name in MEMBERS and name != "scope"}
    times = [at for named in points.values() for series in named.values() for at, _, _ in series]
    if not times:
        return result
    origin = min(times) if query.start is None else query.start
    until = max(times) if query.end is None else query.end
    for name in document:
        many = []
        for dataset, unsorted in points.get(name, {}).items():
            series = sorted(unsorted, key=lambda point: point[0])
            spans = periods([(at, value) for at, _, value in series], wanted.period, origin, until)
            if len(spans) > MAX_INSTANCES_PER_ATTRIBUTE:
                raise too_many_results(
                    f"there are more than {MAX_INSTANCES_PER_ATTRIBUTE} periods of {name} of "
                    f"{document['id']}; ask for a shorter time with timerel, timeAt and "
                    "endTimeAt, or a longer aggrPeriodDuration"
                )
            kind = series[-1][1]
            head = {"type": kind} if dataset is None else {"type": kind, "datasetId": dataset}
            many.append(head | written_totals(totals(spans, kind, wanted.methods), wanted.methods))
        if many:
            result[name] = many[0] if len(many) == 1 else many
    return result


def edge_in(content_range: str | None) -> int | None:
    """Return where a partial response ends (microseconds since 1970); None for a complete one."""
    match = _RANGE.search(content_range or "")
    at_s = None if match is None else moment(match[2])
    return None if at_s is None else round(at_s * MICROS)


def common_edge(edges: Iterable[int | None], query: TemporalQuery) -> int | None:
    """Return up to when all responses are complete; from when on, if the last instances were requested."""
    certain = [edge for edge in edges if edge is not None]
    if not certain:
        return None
    return min(certain) if query.last is None else max(certain)


def kept_to(document: Evolution, edge: int, query: TemporalQuery) -> Evolution:
    """Return an evolution without what lies beyond the edge."""
    edge_s, latest = edge / MICROS, query.last is not None

    def is_within(instance: Any) -> bool:
        return _time_of(instance) >= edge_s if latest else _time_of(instance) <= edge_s

    members = {
        name: value
        if name in MEMBERS
        else _each(value, lambda some: [instance for instance in some if is_within(instance)])
        for name, value in document.items()
    }
    return {name: value for name, value in members.items() if value != []}


def content_range_of(documents: Iterable[Evolution], edge: int, query: TemporalQuery) -> bytes:
    """Return the Content-Range of a response that ends at the edge (clause 6.3.10)."""
    start, size = query.start, "*"
    if query.last is not None:
        start, size = query.end, str(query.last)
    if start is None:
        times = [at for document in documents for at in _times_of(document)] or [edge / MICROS]
        start = round((min(times) if query.last is None else max(times)) * MICROS)
    return f"date-time {written_time(start)}-{written_time(edge)}/{size}".encode()


def _seconds(text: Any) -> float:
    return (moment(text) if isinstance(text, str) else None) or 0.0


def _claimed(
    proxied: list[Registration], registration: Registration | None, context: Context
) -> frozenset[str] | None:
    """Return the names of attributes that only proxied sources may have; None if they have all."""
    names: set[str] = set()
    for source in proxied:
        if registration is not None and registration.mode <= source.mode:
            continue
        for piece in source.information:
            if piece.attributes is None:
                return None
            names |= {context.terms.compact(name) for name in piece.attributes}
    return frozenset(names)


def _joined(own: Any, other: Any) -> Any:
    """Return two series of one attribute merged; for one time the first series counts."""
    if _has_pairs(own) and _has_pairs(other):
        many = {_dataset_of(member): member for member in _listed(own)}
        for instance in _listed(other):
            same = many.get(_dataset_of(instance))
            many[_dataset_of(instance)] = instance if same is None else _joined_pairs(same, instance)
        series = list(many.values())
        return series[0] if len(series) == 1 else series
    ours = _listed(own)
    taken = {_slot_of(instance) for instance in ours}
    return sorted(
        [*ours, *(member for member in _listed(other) if _slot_of(member) not in taken)], key=_time_of
    )


def _joined_pairs(own: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    result = dict(own)
    for member in _SERIES & own.keys() & other.keys():
        pairs, more = own[member], other[member]
        if isinstance(pairs, list) and isinstance(more, list):
            taken = {_time_of(pair) for pair in pairs}
            result[member] = sorted(
                [*pairs, *(pair for pair in more if _time_of(pair) not in taken)], key=_time_of
            )
    return result


def _newest(series: Any, count: int) -> Any:
    if _has_pairs(series) or not all(isinstance(instance, dict) for instance in _listed(series)):
        return _each(series, lambda pairs: pairs[-count:])
    latest: list[Any] = []
    for dataset in dict.fromkeys(map(_dataset_of, _listed(series))):
        latest += [instance for instance in _listed(series) if _dataset_of(instance) == dataset][-count:]
    return latest


def _each(series: Any, narrow: Callable[[list[Any]], list[Any]]) -> Any:
    """Return a series with its instances, or its pairs of value and time, filtered."""
    if not _has_pairs(series):
        return narrow(series) if isinstance(series, list) else series
    many = [
        {
            name: narrow(value) if name in _SERIES and isinstance(value, list) else value
            for name, value in instance.items()
        }
        for instance in _listed(series)
    ]
    return many if isinstance(series, list) else many[0]


def _has_pairs(series: Any) -> bool:
    listed = _listed(series)
    return bool(listed) and all(
        isinstance(instance, dict) and not _SERIES.isdisjoint(instance) for instance in listed
    )


def _listed(series: Any) -> list[Any]:
    return series if isinstance(series, list) else [series]


def _dataset_of(instance: Any) -> str | None:
    dataset = instance.get("datasetId") if isinstance(instance, dict) else None
    return dataset if isinstance(dataset, str) else None


def _slot_of(instance: Any) -> Any:
    """Return the identity of an instance: its dataset and time, or all of its content if it has no time."""
    if isinstance(instance, dict) and isinstance(instance.get("observedAt"), str):
        return _dataset_of(instance), _time_of(instance)
    comparable = instance
    if isinstance(instance, dict):
        comparable = {name: value for name, value in instance.items() if name != "instanceId"}
    return orjson.dumps(comparable, option=orjson.OPT_SORT_KEYS)


def _times_of(document: Evolution) -> Iterator[float]:
    for name in document.keys() - MEMBERS:
        for instance in _listed(document[name]):
            some = (
                [pair for member in _SERIES & instance.keys() for pair in instance[member]]
                if _has_pairs(instance)
                else [instance]
            )
            yield from (at for at in map(_time_of, some) if at > float("-inf"))


def _time_of(instance: Any) -> float:
    """Return the time of an instance, or of a pair of value and time, in seconds since 1970."""
    text: Any = None
    if isinstance(instance, dict):
        text = next((instance[name] for name in _TIMES if name in instance), None)
    elif isinstance(instance, list) and len(instance) > 1:
        text = instance[1]
    at = moment(text) if isinstance(text, str) else None
    return float("-inf") if at is None else at
