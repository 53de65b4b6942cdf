"""Reads temporal evolutions from the history (clauses 5.7.3 and 5.7.4 of ETSI GS CIM 009).

How it works: rows are read from the database in the order of sequence number and seq, and one evolution at a
time is assembled from them. Each attribute and datasetId has a `Series`, which keeps the first (or the last
N) instances within a limit. Where a series exceeds its limit, its edge is the time of the last instance kept;
the earliest edge of all series is the end of the whole response, so that the response is complete up to one
time. The client continues from there (206 with Content-Range).

Invariants: memory is bounded by the limits below, however long the history is; instances of one time are all
kept or all dropped. Everything runs in a thread, on connections of its own, so that a long read delays no
other request.

Example: the limit is 3, a has instances at 1, 2, 3, 4 and b at 2, 5. The edge of a is 3, so the response has
a at 1, 2, 3 and b at 2, and ends at 3.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Any, Final

from handover_broker.model.entity import VALUE_MEMBER, Entity, Instance
from handover_broker.model.problems import too_many_results
from handover_broker.model.validation import has_expired
from handover_broker.query.scope_query import ScopeQuery
from handover_broker.storage.history_archive import Archive
from handover_broker.temporal.aggregation import Aggregation, Total, periods, totals
from handover_broker.temporal.history import SCOPE, RowContent, instance_id, micros_of
from handover_broker.temporal.query import TemporalQuery
from handover_broker.temporal.subjects import Subject

MAX_INSTANCES_PER_ATTRIBUTE: Final = 1000
"""Instances of one attribute (with one datasetId) in a response; the next request continues."""
MAX_INSTANCES_PER_ANSWER: Final = 20_000
"""Instances in a response."""
MAX_COMPARED_INSTANCES: Final = 50_000
"""Instances of one attribute that a query by values compares; so many fit into memory."""
MAX_AGGREGATED_VALUES: Final = 2_000_000
"""Values of one attribute that are aggregated at once."""
ENTITIES_PER_READ: Final = 100
"""Entities whose history is read with one database query."""

Predicate = Callable[[Entity], bool]
Scopes = Sequence[str]
Point = tuple[int, int, Any]
"""A time in microseconds since 1970, the seq of the change, and an instance or its value."""


class Series:
    """The instances of one attribute with one datasetId: the first ones, or the `latest`."""

    __slots__ = ("dataset", "edge", "kind", "latest", "most", "points", "totals")

    def __init__(self, kind: str, dataset: str | None, most: int, *, latest: bool) -> None:
        self.kind = kind
        self.dataset = dataset
        self.points: list[Point] = []
        self.most = most
        self.latest = latest
        self.edge: int | None = None
        """The time of the last point kept, if there were more."""
        self.totals: list[Total] = []
        """The aggregated values by period if requested; then the points are dropped."""

    def takes(self, at: int) -> bool:
        """Return whether a point of that time is within the edge."""
        return self.edge is None or (at >= self.edge if self.latest else at <= self.edge)

    def add(self, point: Point) -> None:
        """Add a point."""
        self.points.append(point)
        if len(self.points) > 2 * self.most:
            self.trim()

    def trim(self) -> None:
        """Sort by time and keep `most` points, and those with the same time as the last of them."""
        points = self.points
        points.sort(key=_by_time)
        if len(points) <= self.most:
            return
        edge = points[-self.most][0] if self.latest else points[self.most - 1][0]
        before = len(points)
        self.keep_to(edge)
        if len(self.points) < before:
            self.edge = edge

    def keep_to(self, edge: int) -> None:
        """Keep the points that are not beyond `edge`."""
        latest = self.latest
        self.points = [point for point in self.points if (point[0] >= edge if latest else point[0] <= edge)]


@dataclass(slots=True)
class Evolution:
    """The evolution of a subject: by attribute (IRI, or `SCOPE`) a series for each datasetId."""

    subject: Subject
    series: dict[str, dict[str | None, Series]] = field(default_factory=dict)
    is_hit: bool = False
    """Whether there are instances of a required attribute within the time range."""

    def all(self) -> Iterator[Series]:
        """Yield every series."""
        for named in self.series.values():
            yield from named.values()

    def as_entity(self) -> Entity:
        """Return an entity with all instances at once, to which filters can be applied."""
        attributes: dict[str, list[Instance]] = {
            name: [
                instance
                for series in named.values()
                for _, _, instance in series.points
                if "deletedAt" not in instance
            ]
            for name, named in self.series.items()
            if name != SCOPE
        }
        return replace(self.subject.as_entity(), attributes=attributes)


@dataclass(frozen=True, slots=True)
class HistoryRequest:
    """A query of the history. `wants` filters entities with all their instances; None accepts all that have
    any.

    `shows` selects attributes (IRIs, or `SCOPE`); `requires` are attributes of which one must be present
    (None for any); `datasets` selects instances by datasetId (None for all).
    """

    query: TemporalQuery
    shows: Callable[[str], bool]
    requires: frozenset[str] | None = None
    datasets: frozenset[str | None] | None = None
    wants: Predicate | None = None
    scopes: ScopeQuery | None = None
    """Scopes that a subject must have had at some time of the range."""


@dataclass(slots=True)
class EvolutionPage:
    """A page of evolutions; they are complete up to (or from) the time `edge`."""

    evolutions: list[Evolution] = field(default_factory=list)
    more: bool = False
    total: int = 0
    edge: int | None = None


def read_evolution(archive: Archive, subject: Subject, history_request: HistoryRequest) -> EvolutionPage:
    """Return the evolution of one subject. Raises `NotStored` when the disk cannot be read."""
    (evolution,) = _read(archive, [subject], history_request)
    page = EvolutionPage([evolution], total=1)
    _finish(page, history_request)
    return page


def read_evolutions(
    archive: Archive,
    subjects: Sequence[Subject],
    history_request: HistoryRequest,
    offset: int,
    limit: int,
    *,
    count: bool,
) -> EvolutionPage:
    """Return a page of the evolutions that match the request.

    Raises `NotStored` when the disk cannot be read.
    """
    page = EvolutionPage()
    for subjects_of_run in _runs(subjects):
        run = _in_scope(archive, subjects_of_run, history_request)
        if not run:
            continue
        for evolution in _read(archive, run, history_request):
            if not evolution.is_hit or not (
                history_request.wants is None or history_request.wants(evolution.as_entity())
            ):
                continue
            page.total += 1
            if offset < page.total <= offset + limit:
                page.evolutions.append(evolution)
                _finish(page, history_request)
            elif page.total > offset + limit:
                page.more = True
                if not count:
                    return page
    return page


def _in_scope(archive: Archive, run: list[Subject], history_request: HistoryRequest) -> list[Subject]:
    """Return the subjects of a run that had the requested scopes at some time of the range (4.19)."""
    wanted = history_request.scopes
    if wanted is None:
        return run
    # Provided scopes without a time hold for all the time.
    timeless = {
        entity_seq for subject in run if subject.was_never_current for entity_seq in subject.entity_seqs
    }
    changes: dict[int, list[tuple[int, Scopes]]] = {}
    for entity_seq, seq, _, body in archive.history(
        [entity_seq for subject in run for entity_seq in subject.entity_seqs]
    ):
        if not RowContent.may_set_scopes(body):
            continue
        for name, _, instance in RowContent.restored(body).instances(seq):
            if name == SCOPE:
                observed, value = instance.get("observedAt"), instance["value"]
                at = micros_of(observed) if observed is not None else 0 if entity_seq in timeless else seq
                changes.setdefault(entity_seq, []).append((at, (value,) if isinstance(value, str) else value))
    return [
        subject
        for subject in run
        if any(
            wanted.wants(scopes)
            for scopes in _scopes_of_window(
                [change for entity_seq in subject.entity_seqs for change in changes.get(entity_seq, ())],
                subject.scopes,
                history_request.query,
            )
        )
    ]


def _scopes_of_window(
    changes: list[tuple[int, Scopes]], present: Scopes, query: TemporalQuery
) -> Iterator[Scopes]:
    """Yield the scopes at the start of the range, and after each change within it.

    Without a recorded change the scopes have always been `present`: retention may have deleted older rows.
    """
    current: Scopes = () if changes else present
    changes.sort(key=itemgetter(0))
    for at, scopes in changes:
        if query.end is not None and at >= query.end:
            break
        if query.start is not None and at <= query.start:
            current = scopes
        else:
            yield scopes
    yield current


def _runs(subjects: Sequence[Subject]) -> Iterator[list[Subject]]:
    """Yield the subjects in runs for one database query: many with ascending sequence numbers, or one with
    several."""
    run: list[Subject] = []
    for subject in subjects:
        alone = len(subject.entity_seqs) > 1
        if run and (
            alone or len(run) >= ENTITIES_PER_READ or subject.entity_seqs[0] < run[-1].entity_seqs[0]
        ):
            yield run
            run = []
        if alone:
            yield [subject]
        else:
            run.append(subject)
    if run:
        yield run


def _read(archive: Archive, run: Sequence[Subject], history_request: HistoryRequest) -> Iterator[Evolution]:
    """Yield the evolution of each subject as soon as its rows are read: only one is in memory at a time."""
    rest = iter(run)
    query = history_request.query
    evolution = Evolution(next(rest))
    entity_seqs = [entity_seq for subject in run for entity_seq in subject.entity_seqs]
    condition, values = query.condition()
    bare = query.aggregation is not None and history_request.wants is None
    now_s = time.time()
    # The latest rows first for lastN: older ones can then be skipped by their time. With several
    # sequence numbers the database would have to sort them.
    rows = archive.history(
        entity_seqs, condition, values, latest_first=query.last is not None and len(entity_seqs) == 1
    )
    ends_early = query.last is None and history_request.wants is None and query.aggregation is None
    edge: int | None = None
    for entity_seq, seq, observed_from, body in rows:
        while entity_seq not in evolution.subject.entity_seqs:
            yield _sorted(evolution)
            evolution, edge = Evolution(next(rest)), None
        if edge is not None and query.is_later(edge, seq, observed_from):
            continue  # a response ends at the same time for all attributes
        for name, position, instance in RowContent.restored(body).instances(seq):
            at = query.time_of(instance, is_scope=name == SCOPE)
            # An expired attribute of a current entity ends, but its history stays (clause 4.22).
            if evolution.subject.was_never_current and has_expired(instance.get("expiresAt"), now_s):
                continue
            if at is None or (series := _series_for(evolution, name, instance, history_request)) is None:
                continue
            if series.takes(at):
                instance["instanceId"] = instance_id(entity_seq, seq, position)
                series.add((at, seq, instance[VALUE_MEMBER[instance["type"]]] if bare else instance))
                if ends_early and series.edge is not None:
                    edge = series.edge if edge is None else min(edge, series.edge)
    yield _sorted(evolution)
    for subject in rest:
        yield Evolution(subject)


def _series_for(
    evolution: Evolution, name: str, instance: Instance, history_request: HistoryRequest
) -> Series | None:
    """Return the series of an instance, None if it is not requested."""
    dataset: str | None = instance.get("datasetId")
    if history_request.datasets is not None and name != SCOPE and dataset not in history_request.datasets:
        return None
    if history_request.query.aggregation is not None and "deletedAt" in instance:
        return None
    if history_request.requires is None or name in history_request.requires:
        evolution.is_hit = True
    if history_request.wants is None and not history_request.shows(name):
        return None
    named = evolution.series.get(name)
    if named is None:
        named = evolution.series[name] = {}
    series = named.get(dataset)
    if series is None:
        most, latest = _bound(history_request)
        series = named[dataset] = Series(instance["type"], dataset, most, latest=latest)
    elif history_request.query.last is None:
        series.kind = instance["type"]  # the type of the latest instance
    return series


def _sorted(evolution: Evolution) -> Evolution:
    for series in evolution.all():
        series.trim()
    return evolution


def _bound(history_request: HistoryRequest) -> tuple[int, bool]:
    """Return how many points of a series are read, and whether they are the latest ones."""
    query = history_request.query
    latest = query.last is not None
    if query.aggregation is not None:
        most = MAX_AGGREGATED_VALUES if history_request.wants is None else MAX_COMPARED_INSTANCES
    else:
        most = MAX_INSTANCES_PER_ATTRIBUTE if history_request.wants is None else MAX_COMPARED_INSTANCES
    return (min(most, query.last), True) if query.last is not None else (most, latest)


def _finish(page: EvolutionPage, history_request: HistoryRequest) -> None:
    """Limit the last evolution to the requested attributes, and all of them to the size of a response."""
    evolution = page.evolutions[-1]
    evolution.series = {
        name: named for name, named in evolution.series.items() if history_request.shows(name)
    }
    last = history_request.query.last
    latest = last is not None
    if history_request.query.aggregation is not None:
        _aggregate(page, evolution, history_request, history_request.query.aggregation)
        return
    for series in evolution.all():
        series.most = min(MAX_INSTANCES_PER_ATTRIBUTE, last or MAX_INSTANCES_PER_ATTRIBUTE)
        series.trim()
        if last is not None and last <= MAX_INSTANCES_PER_ATTRIBUTE:
            series.points = series.points[-last:]
        elif series.edge is not None:
            _narrow(page, series.edge, latest=latest)
    all_series = [series for other in page.evolutions for series in other.all()]
    _keep(all_series, page.edge)
    if sum(len(series.points) for series in all_series) > MAX_INSTANCES_PER_ANSWER:
        times = sorted(at for series in all_series for at, _, _ in series.points)
        _narrow(
            page,
            times[-MAX_INSTANCES_PER_ANSWER] if latest else times[MAX_INSTANCES_PER_ANSWER - 1],
            latest=latest,
        )
        _keep(all_series, page.edge)


def _aggregate(
    page: EvolutionPage, evolution: Evolution, history_request: HistoryRequest, wanted: Aggregation
) -> None:
    """Replace each series by its aggregation, in periods from the requested time, or the first point, on.

    There are at most `MAX_INSTANCES_PER_ATTRIBUTE` periods in a response; the edge is the start of the first
    one that is left out.
    """
    evolution.series.pop(SCOPE, None)
    query, last = history_request.query, history_request.query.last
    _require_all(evolution, history_request)
    times = [series.points[end][0] for series in evolution.all() if series.points for end in (0, -1)]
    if not times:
        return
    origin = min(times) if query.start is None else query.start
    until = max(times) if query.end is None else query.end
    for series in evolution.all():
        points = series.points if last is None else series.points[-last:]
        values = [
            (at, instance[VALUE_MEMBER[instance["type"]]] if history_request.wants is not None else instance)
            for at, _, instance in points
        ]
        series.points = []
        found_periods = periods(values, wanted.period, origin, until)
        if len(found_periods) > MAX_INSTANCES_PER_ATTRIBUTE:
            _narrow(page, found_periods[MAX_INSTANCES_PER_ATTRIBUTE].start, latest=False)
        series.totals = totals(found_periods[:MAX_INSTANCES_PER_ATTRIBUTE], series.kind, wanted.methods)
    for other in page.evolutions:
        for series in other.all():
            if page.edge is not None:
                series.totals = [total for total in series.totals if total.start < page.edge]


def _narrow(page: EvolutionPage, edge: int, *, latest: bool) -> None:
    if page.edge is None:
        page.edge = edge
    else:
        page.edge = max(page.edge, edge) if latest else min(page.edge, edge)


def _keep(all_series: Iterable[Series], edge: int | None) -> None:
    if edge is not None:
        for series in all_series:
            series.keep_to(edge)


def _require_all(evolution: Evolution, history_request: HistoryRequest) -> None:
    last = history_request.query.last
    for series in evolution.all():
        if series.edge is not None and (last is None or series.most < last):
            raise too_many_results(
                f"there are more than {series.most} instances of an attribute of {evolution.subject.id} to "
                "aggregate; ask for a shorter time with timerel, timeAt and endTimeAt"
            )


_by_time = itemgetter(0, 1)
