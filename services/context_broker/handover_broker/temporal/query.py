"""Temporal queries: time range, time property, number of instances and representation.

Clauses 4.11, 5.2.21 and 6.3.7 of ETSI GS CIM 009.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from handover_broker.model.context import Context
from handover_broker.model.entity import Instance
from handover_broker.model.problems import bad_request_data, invalid_request
from handover_broker.model.representation.language import preferences
from handover_broker.model.representation.projection import read_projection
from handover_broker.model.representation.rendering import Form, View
from handover_broker.model.validation import MICROS, moment, require_time, shown
from handover_broker.query.pages import Window
from handover_broker.query.parameters import Use, names_for
from handover_broker.request.query_parameters import datasets_of, names_of, options_of, window_of
from handover_broker.request.request_context import RequestContext
from handover_broker.temporal.aggregation import METHODS, Aggregation
from handover_broker.temporal.durations import read_duration
from handover_broker.temporal.history import DRIFT_S, micros_of

OBSERVED: Final = "observedAt"
TIME_PROPERTIES: Final = (OBSERVED, "createdAt", "modifiedAt", "deletedAt")
TIME_PARAMETERS: Final = names_for(Use.TIME)
AGGREGATION_PARAMETERS: Final = names_for(Use.AGGREGATION)
MAX_LAST_N: Final = 10**9


_DRIFT: Final = int(DRIFT_S * MICROS)


class Representation(StrEnum):
    """Temporal representations of an entity."""

    NORMALIZED = "normalized"
    CONCISE = "concise"
    VALUES = "temporalValues"
    AGGREGATED = "aggregatedValues"


_REPRESENTATIONS: Final = {
    **{representation.value: representation for representation in Representation},
    "simplified": Representation.VALUES,
}
_OPTIONS: Final = frozenset({*_REPRESENTATIONS, "sysAttrs", "count"})


@dataclass(frozen=True, slots=True)
class TemporalQuery:
    """A time range, from `start` on and before `end`, in microseconds since 1970.

    `time_property` is None if neither a range nor a property is given: each instance then counts with its
    observedAt, or with its modifiedAt if it has none.

    `after` and `between` include their start (clause 4.11 as of 1.9.1; up to 1.8.1 `after` excluded it).
    Where the standard leaves it open: `between` excludes its end, so that adjacent ranges contain everything
    once; deletions count by deletedAt only; the `last` instances come oldest first, too.
    """

    relation: str | None = None
    start: int | None = None
    end: int | None = None
    time_property: str | None = None
    last: int | None = None
    aggregation: Aggregation | None = None

    def time_text(self, instance: Instance, *, is_scope: bool = False) -> Any:
        """Return the time of an instance as it is stored, None if it has none.

        Scopes are not observed (clause 4.18): in place of observedAt their modifiedAt counts.
        """
        name = self.time_property
        if name is None:
            if "deletedAt" in instance and OBSERVED not in instance:
                return None
            return instance.get(OBSERVED) or instance.get("modifiedAt")
        text = instance.get(name)
        return instance.get("modifiedAt") if text is None and is_scope and name == OBSERVED else text

    def time_of(self, instance: Instance, *, is_scope: bool = False) -> int | None:
        """Return the time of an instance, None if it is outside of the range."""
        text = self.time_text(instance, is_scope=is_scope)
        if text is None:
            return None
        try:
            at = micros_of(text)
        except (TypeError, ValueError):  # a time without a zone, stored before these were refused
            at_s = moment(text)
            if at_s is None:
                return None
            at = round(at_s * MICROS)
        if self.start is not None and at < self.start:
            return None
        return None if self.end is not None and at >= self.end else at

    def is_later(self, edge: int, seq: int, observed_from: float | None) -> bool:
        """Return whether all times in a row are after `edge`."""
        name = self.time_property
        if name in {"modifiedAt", "deletedAt"}:
            return seq > edge + _DRIFT
        if name == OBSERVED:
            return observed_from is not None and observed_from * MICROS > edge + 1
        if name is None:
            return seq > edge + _DRIFT and (observed_from is None or observed_from * MICROS > edge + 1)
        return False

    def condition(self) -> tuple[str, tuple[float, ...]]:
        """Return the SQL condition for rows that may have instances in the range, and its parameters."""
        name, start, end = self.time_property, self.start, self.end
        terms: list[str] = []
        values: list[float] = []
        if name == OBSERVED:
            terms.append("observed_from IS NOT NULL")
            if start is not None:
                terms.append("observed_to >= ?")
                values.append((start - 1) / MICROS)
            if end is not None:
                terms.append("observed_from <= ?")
                values.append((end + 1) / MICROS)
        elif name is not None:
            if start is not None:
                terms.append("seq >= ?" if name != "modifiedAt" else "(seq >= ? OR rewritten > 0)")
                values.append(start - _DRIFT)
            if end is not None and name != "createdAt":
                terms.append("seq <= ?")
                values.append(end + _DRIFT)
        return " AND ".join(terms), tuple(values)


@dataclass(frozen=True, slots=True)
class TemporalView:
    """The requested representation."""

    representation: Representation
    view: View

    def wants(self, attribute: str) -> bool:
        """Return whether an attribute (IRI), or `SCOPE`, is requested."""
        view = self.view
        return (view.attributes is None or attribute in view.attributes) and (
            view.projection is None or view.projection.wants(attribute)
        )


def temporal_query(parameters: Mapping[str, str], *, aggregates: bool) -> TemporalQuery:
    """Return the temporal query in query parameters; raise a problem (400) if it is invalid."""
    relation, start, end = _window(parameters)
    name = parameters.get("timeproperty")
    if name is not None and name not in TIME_PROPERTIES:
        raise bad_request_data(f"timeproperty is one of {', '.join(TIME_PROPERTIES)}, not {shown(name)}")
    if name is None and relation is not None:
        name = OBSERVED
    last = parameters.get("lastN")
    if last is not None and not (
        last.isascii() and last.isdigit() and len(last) <= 10 and 0 < int(last) <= MAX_LAST_N
    ):
        raise bad_request_data(f"lastN is a whole number from 1 on, not {shown(last)}")
    return TemporalQuery(
        relation,
        start,
        end,
        name,
        None if last is None else int(last),
        _aggregation(parameters) if aggregates else None,
    )


def temporal_view(request: RequestContext, context: Context) -> TemporalView:
    """Return the requested representation; raise a problem (400) for contradictions."""
    parameters = request.parameters
    options = options_of(request, _OPTIONS)
    representations = {_REPRESENTATIONS[option] for option in options if option in _REPRESENTATIONS}
    wanted = parameters.get("format")
    if wanted is not None:
        if wanted not in _REPRESENTATIONS:
            raise invalid_request(f"format is one of {', '.join(_REPRESENTATIONS)}, not {shown(wanted)}")
        representations = {_REPRESENTATIONS[wanted]}  # it takes precedence over options (clause 6.3.12)
    if len(representations) > 1:
        raise invalid_request(
            f"more than one representation is requested ({', '.join(sorted(representations))}); choose one"
        )
    representation = representations.pop() if representations else Representation.NORMALIZED
    if "aggrMethods" in parameters:
        if representations or representation not in {Representation.NORMALIZED, Representation.AGGREGATED}:
            raise bad_request_data("aggrMethods needs format=aggregatedValues; choose one representation")
        representation = Representation.AGGREGATED
    projection = read_projection(parameters.get("pick"), parameters.get("omit"), context.terms)
    if projection is not None and projection.linked:
        raise bad_request_data("temporal queries do not join linked entities; leave the braces out")
    attrs, languages = parameters.get("attrs"), parameters.get("lang")
    if attrs is not None and projection is not None:
        raise bad_request_data("attrs cannot be combined with pick or omit; name attributes in one of them")
    form = Form.CONCISE if representation is Representation.CONCISE else Form.NORMALIZED
    view = View(
        form,
        "sysAttrs" in options,
        names_of(attrs, context),
        projection,
        None if languages is None else preferences(languages),
        datasets_of(parameters.get("datasetId")),
    )
    return TemporalView(representation, view)


def temporal_window(request: RequestContext) -> Window:
    """Return the requested page of entities."""
    return window_of(request, _OPTIONS)


def _window(parameters: Mapping[str, str]) -> tuple[str | None, int | None, int | None]:
    relation = parameters.get("timerel")
    at, until = (_time(parameters, name) for name in ("timeAt", "endTimeAt"))
    if relation is None:
        if at is not None or until is not None:
            raise bad_request_data("timeAt and endTimeAt need a timerel: before, after or between; add it")
        return None, None, None
    if relation not in {"before", "after", "between"}:
        raise bad_request_data(f"timerel is before, after or between, not {shown(relation)}")
    if at is None:
        raise bad_request_data(f"timerel={relation} needs a timeAt such as 2024-05-01T12:00:00Z; add it")
    if relation == "between":
        if until is None:
            raise bad_request_data("timerel=between needs an endTimeAt, where the time ends; add it")
        if until <= at:
            raise bad_request_data("endTimeAt is not later than timeAt; swap them")
        return relation, at, until
    if until is not None:
        raise bad_request_data(f"timerel={relation} has no endTimeAt; leave it out, or ask between")
    return (relation, at, None) if relation == "after" else (relation, None, at)


def _time(parameters: Mapping[str, str], name: str) -> int | None:
    text = parameters.get(name)
    if text is None:
        return None
    at_s = moment(require_time(text, name))
    assert at_s is not None  # noqa: S101 - require_time has seen to it
    return round(at_s * MICROS)


def _aggregation(parameters: Mapping[str, str]) -> Aggregation:
    text = parameters.get("aggrMethods")
    if not text:
        raise bad_request_data(
            f"aggregatedValues needs aggrMethods, a list of {', '.join(METHODS)}; add it to the request"
        )
    methods = tuple(dict.fromkeys(text.split(",")))
    if unknown := next((method for method in methods if method not in METHODS), None):
        raise bad_request_data(f"aggrMethods has {shown(unknown)}; it takes {', '.join(METHODS)}")
    return Aggregation(
        methods, read_duration(parameters.get("aggrPeriodDuration", "PT0S"), "aggrPeriodDuration")
    )
