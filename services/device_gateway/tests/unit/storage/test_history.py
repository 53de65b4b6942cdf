"""The history: values and messages are durable, stored once, and summarized without loss."""

import asyncio
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sqlalchemy import Engine, func, select

from handover.database import connect
from handover.errors import Problem
from handover_devices.storage import history, parquet, schema, tables
from handover_devices.storage.history_writer import CommandRow, HistoryWriter, MessageRow
from handover_devices.storage.retention import HOUR_US, MINUTE_US, RetentionRule, summarize
from handover_devices.upkeep import apply_retention
from tests.kit import databases

T0_US = 1_767_225_600_000_000
RULE = RetentionRule(messages_h=2, telemetry_h=1, values_h=1, minutes_h=24, hours_h=24 * 365)


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    made = connect(databases.default_url(tmp_path) or f"sqlite:///{tmp_path / 'devices.db'}")
    schema.prepare(made)
    yield made
    made.dispose()


def message(at_us: int, kind: str = "telemetry") -> MessageRow:
    return MessageRow("d", at_us, "in", kind, "{}", None)


async def test_what_was_acknowledged_is_in_the_database_once(engine: Engine) -> None:
    writer = HistoryWriter(engine)
    writing = asyncio.create_task(writer.run())
    values = [("d", "a", T0_US + n, float(n)) for n in range(100)]
    await writer.add(messages=[message(T0_US)], values=values)
    await writer.add(values=[*values[50:], ("d", "b", T0_US, 5.0)])  # sent again after a broken connection
    writing.cancel()
    assert history.series_of(engine, "d").keys() == {"a", "b"}
    assert history.latest(engine, "d") == {"a": (T0_US + 99, 99.0), "b": (T0_US, 5.0)}
    with engine.connect() as connection:
        assert connection.execute(select(func.count()).select_from(tables.values)).scalar() == 101
    assert len(history.messages(engine, "d")) == 1
    again = HistoryWriter(engine)  # another run of the gateway finds the numbers of the series
    again.add(values=[("d", "a", T0_US + 1000, 1.0)])
    await again.close()
    assert history.latest(engine, "d")["a"] == (T0_US + 1000, 1.0)


async def test_the_latest_state_of_a_command_is_stored(engine: Engine) -> None:
    writer = HistoryWriter(engine)
    row = CommandRow("d", "c", "act", "action", "{}", 1, 2, "queued", None, None, None, None)
    writer.add(commands=[row])
    writer.add(commands=[row._replace(state="done", result="{}")])
    await writer.close()
    with engine.connect() as connection:
        assert connection.execute(select(tables.commands.c.state)).scalars().all() == ["done"]


@given(
    st.lists(
        st.tuples(st.integers(0, 5 * HOUR_US), st.floats(-1e6, 1e6)),
        min_size=1,
        max_size=60,
        unique_by=lambda one: one[0],
    ),
    st.lists(st.integers(0, 60), max_size=4),
)
@settings(max_examples=15)
def test_summaries_keep_count_mean_and_range_however_often_they_are_made(
    tmp_path_factory: pytest.TempPathFactory, samples: list[tuple[int, float]], hours: list[int]
) -> None:
    engine = connect(f"sqlite:///{tmp_path_factory.mktemp('db') / 'devices.db'}")
    schema.prepare(engine)
    split = len(samples) // 2
    for part, now_h in ((samples[:split], [*sorted(hours)]), (samples[split:], [61])):
        with engine.begin() as connection:
            if part:
                rows = [{"series": 1, "t_us": T0_US + t, "value": value} for t, value in part]
                connection.execute(tables.values.insert(), rows)
            for hour in now_h:
                summarize(connection, 1, RULE, T0_US + hour * HOUR_US)
    (whole,) = history.points(engine, 1, T0_US, T0_US + 10 * HOUR_US, 1)
    values = [value for _, value in samples]
    assert whole.n == len(values)
    assert whole.mean == pytest.approx(sum(values) / len(values), rel=1e-9, abs=1e-6)
    assert (whole.min, whole.max) == (min(values), max(values))
    engine.dispose()


async def test_old_values_become_minutes_then_hours_and_old_messages_go(engine: Engine) -> None:
    writer = HistoryWriter(engine)
    writer.add(values=[("d", "a", T0_US + n * 1_000_000, float(n)) for n in range(7200)])
    for hours in (0, 1, 2):
        writer.add(messages=[message(T0_US + hours * HOUR_US, kind) for kind in ("telemetry", "event")])
    writing = asyncio.create_task(writer.run())
    await writer.add()
    await apply_retention(writer, RULE, T0_US + 2 * HOUR_US + MINUTE_US // 2)
    series = history.series_of(engine, "d")["a"]

    def rows(table: tables.Table) -> int:
        with engine.connect() as connection:
            return connection.execute(select(func.count()).select_from(table)).scalar() or 0

    # PostgreSQL keeps the values of a day until its last one is old enough.
    whole_day = engine.dialect.name == "postgresql"
    kept_rows = (7200, 0, 0) if whole_day else (3600, 60, 0)
    assert (rows(tables.values), rows(tables.minutes), rows(tables.hours)) == kept_rows
    kept = [row["type"] for row in history.messages(engine, "d")]
    assert kept.count("telemetry") == 1  # one of the last hour
    assert kept.count("event") == 2
    points = history.points(engine, series, T0_US, T0_US + 2 * HOUR_US, 8)
    assert [point.n for point in points] == [900] * 8
    assert points[0].mean == pytest.approx(449.5)
    await apply_retention(writer, RULE, T0_US + 30 * HOUR_US)
    assert (rows(tables.values), rows(tables.minutes), rows(tables.hours)) == (0, 0, 2)
    exported = list(history.every_value(engine, {"a": series}, T0_US, T0_US + 10 * HOUR_US))
    assert [(name, point.n, point.max) for name, point in exported] == [
        ("a", 3600, 3599.0),
        ("a", 3600, 7199.0),
    ]
    writing.cancel()


async def test_the_history_is_exported_as_parquet_in_several_groups(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    pq = pytest.importorskip("pyarrow.parquet", reason="the extra parquet is not installed")
    writer = HistoryWriter(engine)
    writer.add(values=[("d", name, T0_US + n, n + 0.5) for name in ("a", "b") for n in range(70)])
    await writer.close()
    monkeypatch.setattr(parquet, "GROUP_ROWS", 50)
    path = parquet.write_parquet(engine, history.series_of(engine, "d"), T0_US + 10, T0_US + 1000)
    copy = path.with_suffix(".copy")
    copy.write_bytes(b"".join(parquet.read_and_delete(path)))
    table = pq.read_table(copy)
    copy.unlink()
    assert not path.exists()
    assert table.column("name").to_pylist() == ["a"] * 60 + ["b"] * 60
    assert table.column("value").to_pylist() == [n + 0.5 for n in range(10, 70)] * 2
    assert table.column("time").cast("int64").to_pylist()[0] == T0_US + 10
    assert str(table.schema.field("time").type) == "timestamp[us, tz=UTC]"


async def test_parquet_without_pyarrow_names_the_extra(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(Problem, match=r"the extra parquet"):
        parquet.write_parquet(engine, {}, 0, 1)
