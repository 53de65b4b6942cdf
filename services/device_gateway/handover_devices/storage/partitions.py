"""Partitions of the values on PostgreSQL: one table a day (UTC), so that retention drops a table, not rows.

`device_value` is partitioned by time. The partition of a day is `device_value_dYYYYMMDD`; those of the next
days are created ahead, and the history writer creates one for a day that it finds missing (a value that is
late). Tables of an earlier release are attached as they are: `device_value_until_YYYYMMDD` has all values
before that day. SQLite has no partitions: every function here does nothing there, or finds none.

A partition is created as a table of its own and then attached, which blocks neither readers nor the writer.
Once all its values are older than the retention, one transaction summarizes them to minutes and drops it: a
reader finds either the values or the minutes, and `kill -9` leaves either. This transaction has a connection
of its own, since a day may have millions of values, while the history writer continues with other days.
"""

import re
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Final, NamedTuple

from sqlalchemy import Connection

from handover_devices.storage import tables

MINUTE_US: Final = 60_000_000
DAY_US: Final = 86_400_000_000
DAYS_AHEAD: Final = 3
LOCK_TIMEOUT_MS: Final = 5_000
"""A partition whose lock is not free within this time is dropped in the next run of the retention."""
LOCK_NUMBER: Final = 5_401_017_001
"""Of the advisory lock under which partitions are created: two gateways may share a database."""

_SUMMARIZE: Final = """
    INSERT INTO device_value_minute AS kept (series, t_us, n, mean, min, max)
    SELECT series, t_us / {unit} * {unit} AS begin_us, count(*), avg(value), min(value), max(value)
    FROM {partition} GROUP BY series, begin_us
    ON CONFLICT (series, t_us) DO UPDATE SET
        n = kept.n + excluded.n,
        mean = (kept.mean * kept.n + excluded.mean * excluded.n) / (kept.n + excluded.n),
        min = least(kept.min, excluded.min),
        max = greatest(kept.max, excluded.max)
"""
_NAME = re.compile(r"device_value_(d|until_)(\d{8})")


class Partition(NamedTuple):
    """A table of values in `[begin_us, end_us)`; `begin_us` is None for the values of an earlier release."""

    name: str
    begin_us: int | None
    end_us: int


def has_partitions(connection: Connection) -> bool:
    """Return whether the database can partition the values."""
    return connection.dialect.name == "postgresql"


def partitions(connection: Connection) -> list[Partition]:
    """Return the partitions, oldest first; none on SQLite."""
    if not has_partitions(connection):
        return []
    names = connection.exec_driver_sql(
        "SELECT relname FROM pg_inherits JOIN pg_class ON pg_class.oid = inhrelid "
        "WHERE inhparent = to_regclass('device_value')"
    ).scalars()
    present = [partition for name in names if (partition := _partition(name)) is not None]
    return sorted(present, key=lambda partition: partition.end_us)


def ensure(connection: Connection, days: Iterable[int]) -> None:
    """Create the partitions of `days`, numbered since 1970, that are missing."""
    wanted = sorted(set(days))
    if not wanted or not has_partitions(connection):
        return
    connection.exec_driver_sql("SELECT pg_advisory_xact_lock(%s)", (LOCK_NUMBER,))
    present = partitions(connection)
    for day in wanted:
        begin_us = day * DAY_US
        if not any((partition.begin_us or 0) <= begin_us < partition.end_us for partition in present):
            _attach(connection, f"device_value_d{_text(begin_us)}", begin_us, begin_us + DAY_US)


def create_ahead(connection: Connection, now_us: int) -> None:
    """Create the partitions of today and of the next days."""
    today = now_us // DAY_US
    ensure(connection, range(today, today + DAYS_AHEAD + 1))


def drop_summarized(connection: Connection, partition: Partition) -> None:
    """Summarize the values of a partition to minutes and drop it."""
    for statement in (
        f"SET LOCAL lock_timeout = {LOCK_TIMEOUT_MS}",
        f"LOCK TABLE {partition.name} IN SHARE MODE",  # a late value waits, and gets a new partition
        _SUMMARIZE.format(partition=partition.name, unit=MINUTE_US),
        f"DROP TABLE {partition.name}",
    ):
        connection.exec_driver_sql(statement)


def partition_existing(connection: Connection) -> None:
    """Make the table of values of an earlier release the first partition; nothing is copied."""
    if not has_partitions(connection):
        return
    newest_us = connection.exec_driver_sql("SELECT coalesce(max(t_us), 0) FROM device_value").scalar() or 0
    now_us = int(datetime.now(UTC).timestamp() * 1e6)
    end_us = (max(int(newest_us), now_us) // DAY_US + 1) * DAY_US
    name = f"device_value_until_{_text(end_us)}"
    connection.exec_driver_sql(f"ALTER TABLE device_value RENAME TO {name}")
    connection.exec_driver_sql(f"ALTER INDEX IF EXISTS device_value_pkey RENAME TO {name}_pkey")
    tables.values.create(connection)
    connection.exec_driver_sql(
        f"ALTER TABLE device_value ATTACH PARTITION {name} FOR VALUES FROM (MINVALUE) TO ({end_us})"
    )


def _attach(connection: Connection, name: str, begin_us: int, end_us: int) -> None:
    connection.exec_driver_sql(f"CREATE TABLE {name} (LIKE device_value INCLUDING DEFAULTS)")
    connection.exec_driver_sql(
        f"ALTER TABLE device_value ATTACH PARTITION {name} FOR VALUES FROM ({begin_us}) TO ({end_us})"
    )


def _partition(name: str) -> Partition | None:
    match = _NAME.fullmatch(name)
    if match is None:  # a partition that somebody else has attached is left alone
        return None
    day_us = int(datetime.strptime(match[2], "%Y%m%d").replace(tzinfo=UTC).timestamp()) * 1_000_000
    return Partition(name, None, day_us) if match[1] == "until_" else Partition(name, day_us, day_us + DAY_US)


def _text(day_us: int) -> str:
    return datetime.fromtimestamp(day_us // 1_000_000, UTC).strftime("%Y%m%d")
