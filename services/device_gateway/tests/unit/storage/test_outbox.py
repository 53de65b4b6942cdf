"""The outbox of an edge: bounded, numbered once, and the same after a restart."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sqlalchemy import Engine

from handover.database import connect
from handover_devices.storage import schema
from handover_devices.storage.outbox import ROW_BYTES, Outbox, RelayRow
from tests.kit import databases

BODY = "x" * (1000 - ROW_BYTES)


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    made = connect(databases.default_url(tmp_path) or f"sqlite:///{tmp_path / 'edge.db'}")
    schema.prepare(made)
    yield made
    made.dispose()


def put(engine: Engine, outbox: Outbox, *bodies: str) -> None:
    with engine.begin() as connection:
        outbox.append(connection, [RelayRow("d", 1, body) for body in bodies])
    outbox.committed()


def acknowledge(engine: Engine, outbox: Outbox, seq: int) -> None:
    with engine.begin() as connection:
        outbox.acknowledge(connection, seq)


def numbers(outbox: Outbox) -> list[int]:
    return [row.seq for row in outbox.read(0, 10_000)]


def test_a_full_outbox_drops_the_oldest_and_counts_them(engine: Engine) -> None:
    outbox = Outbox(engine, max_bytes=10_000)
    outbox.load()
    put(engine, outbox, *[BODY] * 10)
    assert (outbox.rows, outbox.bytes, outbox.dropped) == (10, 10_000, 0)
    put(engine, outbox, BODY, BODY)
    assert numbers(outbox) == list(range(4, 13))  # a little more than necessary
    again = Outbox(engine, max_bytes=10_000)
    again.load()
    for one in (outbox, again):
        assert (one.rows, one.bytes, one.dropped, one.stream) == (9, 9_000, 3, outbox.stream)


def test_a_number_is_never_given_twice_and_a_stream_can_begin_again(engine: Engine) -> None:
    outbox = Outbox(engine, max_bytes=10_000)
    outbox.load()
    assert outbox.last() == 0
    put(engine, outbox, BODY, BODY)
    acknowledge(engine, outbox, 2)
    assert (outbox.rows, outbox.bytes, outbox.last()) == (0, 0, 2)
    again = Outbox(engine, max_bytes=10_000)
    again.load()
    put(engine, again, BODY)
    assert numbers(again) == [3]
    with engine.begin() as connection:
        again.begin_stream(connection)
        again.note_refused(connection, 2)
    reloaded = Outbox(engine, max_bytes=10_000)
    reloaded.load()
    assert reloaded.stream == again.stream != outbox.stream
    assert reloaded.refused == 2


@given(st.lists(st.one_of(st.integers(1, 6), st.floats(0, 1)), max_size=25))
@settings(max_examples=15)
def test_the_newest_messages_are_there_whatever_is_put_and_acknowledged(
    tmp_path_factory: pytest.TempPathFactory, steps: list[int | float]
) -> None:
    engine = connect(f"sqlite:///{tmp_path_factory.mktemp('db') / 'edge.db'}")
    schema.prepare(engine)
    outbox = Outbox(engine, max_bytes=10_000)
    outbox.load()
    put_in_all, acknowledged = 0, 0
    for step in steps:
        if isinstance(step, int):
            put(engine, outbox, *[BODY] * step)
            put_in_all += step
        else:
            acknowledged = max(acknowledged, int(step * put_in_all))
            acknowledge(engine, outbox, acknowledged)
        found = numbers(outbox)
        assert found == list(range(put_in_all - len(found) + 1, put_in_all + 1))
        assert (outbox.rows, outbox.bytes) == (len(found), 1000 * len(found))
        assert outbox.bytes <= outbox.max_bytes
        assert len(found) + outbox.dropped + acknowledged >= put_in_all
    engine.dispose()
