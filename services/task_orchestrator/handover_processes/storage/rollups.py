"""Rollups: the tables of counts by hour, by day and by 30 days. A step adds to them; reports read them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Column, ColumnElement, Connection, Row, Select, Table, delete, func, select, union_all
from sqlalchemy.dialects import postgresql, sqlite

from handover_processes.storage.schema import definitions, resource_work, statistics
from handover_processes.tally import SPANS_H, WHOLE_PROCESS, Counted, Period, Sums, Tally

_SUMS: Final = ("counted", "duration_ms", "working_ms", "paused_ms")


@dataclass(frozen=True, slots=True)
class ReportScope:
    """What a report is about: a version, all versions of a definition, or everything."""

    definition: str | None = None
    version: int | None = None

    def contains(self, definition: str, version: int) -> bool:
        """Return whether the report is about a version."""
        return self.definition in {None, definition} and self.version in {None, version}

    def conditions(self, table: Table) -> Iterator[ColumnElement[bool]]:
        """Yield the conditions on a table with the columns `definition` and `version`."""
        if self.definition is None:
            return
        yield table.c.definition == self.definition
        if self.version is not None:
            yield table.c.version == self.version
        else:  # named one by one, so that the index over definition, version and time is used
            versions = select(definitions.c.version).where(definitions.c.name == self.definition)
            yield table.c.version.in_(versions)


@dataclass(frozen=True, slots=True)
class Distribution:
    """The durations of what was counted: sums by bin, in the order of the bins."""

    bins: tuple[Sums, ...] = ()

    @property
    def total(self) -> Sums:
        """Return the sums of all bins."""
        total = Sums()
        for sums in self.bins:
            total.add(sums)
        return total

    def percentile_ms(self, share: float) -> int | None:
        """Return the mean of the bin that contains the percentile; None without durations."""
        rank = share * sum(sums.counted for sums in self.bins)
        reached = 0
        for sums in self.bins:
            reached += sums.counted
            if sums.counted and reached >= rank:
                return round(sums.duration_ms / sums.counted)
        return None

    def mean_ms(self) -> int | None:
        """Return the exact mean; None without durations."""
        total = self.total
        return round(total.duration_ms / total.counted) if total.counted else None


Distributions = Mapping[tuple[str, Counted], Distribution]
"""By element, or by definition, and by result."""


def write_tally(connection: Connection, tally: Tally) -> None:
    """Add the counts of a step."""
    rows: dict[tuple[Any, ...], Sums] = {}
    work: dict[tuple[Any, ...], int] = {}
    for key, sums in tally.statistics.items():
        for hours in SPANS_H:
            starts = key.hour // hours * hours
            row = (key.definition, key.version, hours, starts, key.element, key.result.value, key.bin)
            rows.setdefault(row, Sums()).add(sums)
    for of, worked_ms in tally.work.items():
        for hours in SPANS_H:
            place = (hours, of.hour // hours * hours, of.resource, of.definition, of.version)
            work[place] = work.get(place, 0) + worked_ms
    _add(
        connection,
        statistics,
        ((row, {name: getattr(sums, name) for name in _SUMS}) for row, sums in rows.items()),
    )
    _add(connection, resource_work, ((place, {"working_ms": ms}) for place, ms in work.items()))


def delete_rollups(connection: Connection, before_hour: int) -> None:
    """Delete the counts before an hour."""
    for table in (statistics, resource_work):
        connection.execute(delete(table).where(table.c.starts + table.c.hours <= before_hour))


def element_durations(connection: Connection, period: Period, scope: ReportScope) -> Distributions:
    """Return the durations of the Tasks of each element, and of the processes themselves."""
    return _distributions(connection, period, scope, statistics.c.element)


def process_durations(connection: Connection, period: Period, scope: ReportScope) -> Distributions:
    """Return the durations of the processes of each definition."""
    whole = statistics.c.element == WHOLE_PROCESS
    return _distributions(connection, period, scope, statistics.c.definition, whole)


def process_counts(
    connection: Connection, period: Period, scope: ReportScope, hours: int
) -> dict[tuple[int, Counted], int]:
    """Return the number of processes by the begin of each hour or day and by result."""
    columns = (statistics.c.starts, statistics.c.result)
    statement = (
        select(*columns, func.sum(statistics.c.counted).label("counted"))
        .where(
            statistics.c.element == WHOLE_PROCESS,
            statistics.c.hours == hours,
            statistics.c.starts >= period.begins // hours * hours,
            statistics.c.starts < period.ends,
            *scope.conditions(statistics),
        )
        .group_by(*columns)
    )
    rows = connection.execute(statement)
    return {(row.starts, Counted(row.result)): int(row.counted) for row in rows}


def work_by_resource(connection: Connection, period: Period, scope: ReportScope) -> dict[str, int]:
    """Return the working time of resources in ms, as far as it was recorded."""
    columns = (resource_work.c.resource, resource_work.c.working_ms)
    rows = _in_period(resource_work, columns, period, scope).subquery()
    statement = select(rows.c.resource, func.sum(rows.c.working_ms)).group_by(rows.c.resource)
    return {resource: int(worked_ms) for resource, worked_ms in connection.execute(statement)}


def _distributions(
    connection: Connection,
    period: Period,
    scope: ReportScope,
    subject: Column[str],
    *conditions: ColumnElement[bool],
) -> Distributions:
    columns = (subject.label("subject"), statistics.c.result, statistics.c.bin)
    sums = [statistics.c[name] for name in _SUMS]
    rows = _in_period(statistics, (*columns, *sums), period, scope, *conditions).subquery()
    group = (rows.c.subject, rows.c.result, rows.c.bin)
    statement = select(*group, *(func.sum(rows.c[name]).label(name) for name in _SUMS)).group_by(*group)
    durations: dict[tuple[str, Counted], list[Sums]] = {}
    for row in connection.execute(statement.order_by(rows.c.bin)):
        durations.setdefault((row.subject, Counted(row.result)), []).append(_sums(row))
    return {key: Distribution(tuple(bins)) for key, bins in durations.items()}


def _sums(row: Row[Any]) -> Sums:
    return Sums(**{name: int(getattr(row, name)) for name in _SUMS})


def _in_period(
    table: Table,
    columns: Sequence[ColumnElement[Any]],
    period: Period,
    scope: ReportScope,
    *conditions: ColumnElement[bool],
) -> Any:
    """Return the rows of a period, each hour once."""
    parts: list[Select[Any]] = []
    for hours, first, end in period.spans():
        in_span = (table.c.hours == hours, table.c.starts >= first, table.c.starts < end)
        parts.append(select(*columns).where(*in_span, *scope.conditions(table), *conditions))
    return union_all(*parts)


def _add(
    connection: Connection, table: Table, rows: Iterable[tuple[tuple[Any, ...], Mapping[str, int]]]
) -> None:
    """Add numbers to rows, which are identified by their primary key; missing rows are inserted."""
    names = [column.name for column in table.primary_key]
    values = [{**dict(zip(names, key, strict=True)), **sums} for key, sums in rows]
    if values:
        connection.execute(_UPSERTS[table.name, connection.dialect.name], values)


def _upsert(table: Table, dialect: Any) -> Any:
    new = dialect.insert(table)
    keys = list(table.primary_key)
    sums = {column.name: column + new.excluded[column.name] for column in table.c if column not in set(keys)}
    return new.on_conflict_do_update(index_elements=keys, set_=sums)


_UPSERTS: Final = {
    (table.name, dialect.__name__.rpartition(".")[2]): _upsert(table, dialect)
    for table in (statistics, resource_work)
    for dialect in (sqlite, postgresql)
}
