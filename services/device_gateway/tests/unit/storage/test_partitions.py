"""On PostgreSQL values are partitioned by day: created ahead, dropped as a whole, and counted once."""

import asyncio
import time
from collections.abc import Callable, Iterator

import pytest
from sqlalchemy import Engine, inspect

from handover.database import connect
from handover_devices.storage import history, partitions, schema, tables
from handover_devices.storage.history_writer import HistoryWriter
from handover_devices.storage.partitions import DAY_US, DAYS_AHEAD, Partition
from handover_devices.storage.retention import RetentionRule, old_partitions
from handover_devices.upkeep import apply_retention

DAY = 20_454
T0_US = DAY * DAY_US  # 2026-01-01
RULE = RetentionRule(messages_h=2, telemetry_h=1, values_h=24, minutes_h=24 * 90, hours_h=24 * 365)


@pytest.fixture
def engine(new_database: Callable[[], str]) -> Iterator[Engine]:
    made = connect(new_database())
    yield made
    made.dispose()


def present(engine: Engine) -> list[Partition]:
    with engine.connect() as connection:
        return partitions.partitions(connection)


async def test_the_partitions_of_the_next_days_exist_and_a_late_value_makes_its_own(engine: Engine) -> None:
    schema.prepare(engine)
    schema.prepare(engine)  # another start
    today = int(time.time() * 1e6) // DAY_US
    ahead = [one.end_us // DAY_US - 1 for one in present(engine)]
    assert ahead[0] in {today, today - 1}  # midnight may have passed
    assert ahead == list(range(ahead[0], ahead[0] + DAYS_AHEAD + 1))
    writer = HistoryWriter(engine)
    writer.add(values=[("d", "a", T0_US - 1, 1.0), ("d", "a", T0_US, 2.0), ("d", "a", T0_US, 9.0)])
    await writer.close()
    made = [one.name for one in present(engine)][:2]
    assert made == ["device_value_d20251231", "device_value_d20260101"]
    assert history.latest(engine, "d") == {"a": (T0_US, 2.0)}


async def test_the_retention_drops_whole_days_and_each_value_is_counted_once(engine: Engine) -> None:
    schema.prepare(engine)
    writer = HistoryWriter(engine)
    writing = asyncio.create_task(writer.run())
    minutes = [(("d", "a", T0_US + n * 30_000_000, float(n))) for n in range(2 * 2880)]
    await writer.add(values=minutes)
    before = {one.name for one in present(engine)}
    assert {"device_value_d20260101", "device_value_d20260102"} <= before
    await apply_retention(writer, RULE, T0_US + 2 * DAY_US - 1)  # the first day is not all 24 h old
    assert {one.name for one in present(engine)} >= before
    await apply_retention(writer, RULE, T0_US + 2 * DAY_US)
    assert "device_value_d20260101" not in {one.name for one in present(engine)}
    await writer.add(values=[("d", "a", T0_US + 1, 100_000.0)])  # too late: its day was dropped already
    await apply_retention(writer, RULE, T0_US + 2 * DAY_US)
    assert "device_value_d20260101" not in {one.name for one in present(engine)}
    series = history.series_of(engine, "d")["a"]
    (first, second) = history.points(engine, series, T0_US, T0_US + 2 * DAY_US, 2)
    assert (first.n, first.min, first.max) == (2881, 0.0, 100_000.0)
    assert (second.n, second.min, second.max) == (2880, 2880.0, 5759.0)
    with engine.connect() as connection:
        kept = connection.execute(tables.minutes.select().order_by(tables.minutes.c.t_us)).all()
    assert (len(kept), kept[0].n, kept[0].max) == (1440, 3, 100_000.0)
    writing.cancel()


async def test_the_table_of_an_earlier_release_becomes_the_first_partition(engine: Engine) -> None:
    with engine.begin() as connection:
        for table in tables.meta.sorted_tables:
            if table is not tables.values:
                table.create(connection)
        connection.exec_driver_sql(
            "CREATE TABLE device_value (series BIGINT NOT NULL, t_us BIGINT NOT NULL, "
            "value DOUBLE PRECISION NOT NULL, PRIMARY KEY (series, t_us))"
        )
        connection.exec_driver_sql("CREATE TABLE device_gateway_version (version INTEGER NOT NULL)")
        connection.exec_driver_sql("INSERT INTO device_gateway_version VALUES (3)")
        connection.execute(tables.series.insert().values(id=1, device="d", name="a"))
        now_us = int(time.time() * 1e6)
        rows = [{"s": 1, "t": now_us - n * 1_000_000} for n in range(100)]
        connection.exec_driver_sql("INSERT INTO device_value VALUES (%(s)s, %(t)s, 1.5)", rows)
    schema.prepare(engine)
    (old, *ahead) = present(engine)
    assert (old.begin_us, ahead[0].begin_us) == (None, old.end_us)
    assert old.end_us > now_us
    writer = HistoryWriter(engine)
    writer.add(values=[("d", "a", now_us, 7.0), ("d", "a", now_us + 1, 2.0), ("d", "a", old.end_us, 3.0)])
    await writer.close()
    (whole,) = history.points(engine, 1, now_us - 200_000_000, old.end_us + DAY_US, 1)
    assert whole.n == 102  # what was there already is not written twice
    with engine.connect() as connection:
        assert old_partitions(connection, RULE, old.end_us + DAY_US) == [old]
        assert inspect(connection).get_pk_constraint(old.name)["constrained_columns"] == ["series", "t_us"]
