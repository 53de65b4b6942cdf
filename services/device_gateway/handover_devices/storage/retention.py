"""Retention: values become minutes, minutes become hours, hours are deleted; old messages are deleted.

A value is summarized when it is deleted, and summaries of the same interval are merged. So a value that
arrives late is either still within the time of full rate, or is merged into the summary that exists: nothing
is counted twice, and no position in the history has to be remembered. Each series is one short transaction.

On PostgreSQL values are partitioned by day, and a day is summarized and dropped as a whole (`partitions`).
"""

from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, Table, delete, func, select
from sqlalchemy.dialects import postgresql, sqlite

from handover_devices.settings import GatewaySettings
from handover_devices.storage import partitions, tables
from handover_devices.storage.partitions import MINUTE_US, Partition

HOUR_US: Final = 3_600_000_000
MAX_ROWS: Final = 20_000
"""Messages deleted in one transaction."""


@dataclass(frozen=True, slots=True)
class RetentionRule:
    """How long each form of the history is kept, in hours."""

    messages_h: float
    telemetry_h: float
    values_h: float
    minutes_h: float
    hours_h: float


def rule_of(settings: GatewaySettings) -> RetentionRule:
    """Return the rule of the settings; values are kept for as long as a device may send them late."""
    return RetentionRule(
        messages_h=settings.device_keep_messages_h,
        telemetry_h=settings.device_keep_telemetry_h,
        values_h=max(
            settings.device_keep_values_h, settings.device_max_age_h, settings.device_edge_max_age_h
        ),
        minutes_h=settings.device_keep_minutes_h,
        hours_h=settings.device_keep_hours_h,
    )


def all_series(connection: Connection) -> list[int]:
    """Return the numbers of all series."""
    return list(connection.execute(select(tables.series.c.id).order_by(tables.series.c.id)).scalars())


def summarize(connection: Connection, series: int, rule: RetentionRule, now_us: int) -> None:
    """Apply `rule` to the values of one series."""
    value = tables.values
    if not partitions.has_partitions(connection):
        _move(
            connection,
            value,
            tables.minutes,
            series,
            _before(now_us, rule.values_h, MINUTE_US),
            MINUTE_US,
            (func.count(), func.avg(value.c.value), func.min(value.c.value), func.max(value.c.value)),
        )
    minute = tables.minutes
    total = func.sum(minute.c.n)
    mean = func.sum(minute.c.mean * minute.c.n) / total
    _move(
        connection,
        minute,
        tables.hours,
        series,
        _before(now_us, rule.minutes_h, HOUR_US),
        HOUR_US,
        (total, mean, func.min(minute.c.min), func.max(minute.c.max)),
    )
    hour = tables.hours
    old = hour.c.t_us < _before(now_us, rule.hours_h, HOUR_US)
    connection.execute(delete(hour).where((hour.c.series == series) & old))


def old_partitions(connection: Connection, rule: RetentionRule, now_us: int) -> list[Partition]:
    """Return the partitions with values that are all older than `rule` keeps, oldest first."""
    before_us = _before(now_us, rule.values_h)
    return [partition for partition in partitions.partitions(connection) if partition.end_us <= before_us]


def delete_messages(connection: Connection, rule: RetentionRule, now_us: int) -> bool:
    """Delete some old messages; return whether there may be more."""
    message = tables.messages
    telemetry = (message.c.type == "telemetry") & (message.c.at_us < _before(now_us, rule.telemetry_h))
    others = message.c.at_us < _before(now_us, rule.messages_h)
    old = select(message.c.id).where(telemetry | others).order_by(message.c.id).limit(MAX_ROWS)
    return connection.execute(delete(message).where(message.c.id.in_(old))).rowcount >= MAX_ROWS


def _before(now_us: int, hours: float, unit_us: int = 1) -> int:
    """Return the begin of the unit in which the time `hours` ago is."""
    return (now_us - int(hours * HOUR_US)) // unit_us * unit_us


def _move(  # noqa: PLR0917 - one statement with these parts
    connection: Connection,
    source: Table,
    target: Table,
    series: int,
    before_us: int,
    unit_us: int,
    aggregates: tuple[Any, ...],
) -> None:
    """Summarize the rows of `source` before a time, merge them into `target`, and delete them."""
    old = (source.c.series == series) & (source.c.t_us < before_us)
    begin = (source.c.t_us // unit_us * unit_us).label("begin")
    rows = connection.execute(select(begin, *aggregates).where(old).group_by(begin)).all()
    if not rows:
        return
    insert = (postgresql if connection.dialect.name == "postgresql" else sqlite).insert(target)
    new, kept = insert.excluded, target.c
    merged = insert.on_conflict_do_update(
        index_elements=["series", "t_us"],
        set_={
            "n": kept.n + new.n,
            "mean": (kept.mean * kept.n + new.mean * new.n) / (kept.n + new.n),
            "min": _chosen(connection, "min", kept.min, new.min),
            "max": _chosen(connection, "max", kept.max, new.max),
        },
    )
    names = ("series", "t_us", "n", "mean", "min", "max")
    connection.execute(merged, [dict(zip(names, (series, *row), strict=True)) for row in rows])
    connection.execute(delete(source).where(old))


def _chosen(connection: Connection, which: str, expression: Any, other: Any) -> Any:
    """Return the smaller or larger of two columns: SQLite calls that function min, PostgreSQL least."""
    if connection.dialect.name == "sqlite":
        return getattr(func, which)(expression, other)
    return func.least(expression, other) if which == "min" else func.greatest(expression, other)
