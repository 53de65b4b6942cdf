"""The audit chain: any change, removal or insertion is found; a deleted person leaves it verifiable."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import Engine, MetaData, create_engine, delete, insert, select, text, update

from handover.database import connect
from handover.security.audit import AuditFilter, AuditLog, AuditTables
from tests.kit.waiting import wait_for

METADATA = MetaData()
TABLES = AuditTables(METADATA, "test")
LOG = AuditLog(TABLES)


def database(url: str = "sqlite://") -> Engine:
    engine = create_engine(url)
    METADATA.create_all(engine)
    return engine


def with_records(count: int) -> Engine:
    engine = database()
    with engine.begin() as connection:
        for number in range(count):
            LOG.append(
                connection,
                f"subject-{number % 3}",
                "grant.added",
                resource=f"subject-{(number + 1) % 3}",
                text=f"operator for cell {number}",
            )
    return engine


def fault(engine: Engine) -> str | None:
    with engine.begin() as connection:
        return LOG.verify(connection).fault


def test_an_empty_and_an_untouched_chain_are_intact() -> None:
    assert fault(database()) is None
    engine = with_records(20)
    assert fault(engine) is None
    with engine.begin() as connection:
        assert LOG.verify(connection).records == 20
        assert LOG.head(connection)[0] == 20


@given(st.data())
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_every_change_of_a_record_is_found(data: st.DataObject) -> None:
    engine = with_records(8)
    seq = data.draw(st.integers(1, 8))
    column = data.draw(st.sampled_from([c.name for c in TABLES.records.columns]))
    with engine.begin() as connection:
        row: dict[str, Any] = dict(
            connection.execute(select(TABLES.records).where(TABLES.records.c.seq == seq)).mappings().one()
        )
        new = row[column] + 100 if isinstance(row[column], int) else f"{row[column]}x"
        connection.execute(update(TABLES.records).where(TABLES.records.c.seq == seq).values({column: new}))
    assert fault(engine) is not None


@pytest.mark.parametrize("seq", [1, 4, 8])
def test_a_removed_record_is_found(seq: int) -> None:
    engine = with_records(8)
    with engine.begin() as connection:
        connection.execute(delete(TABLES.records).where(TABLES.records.c.seq == seq))
    assert fault(engine) is not None


def test_a_changed_text_is_found_and_a_deleted_one_is_no_fault() -> None:
    engine = with_records(8)
    with engine.begin() as connection:
        assert LOG.forget(connection, "subject-1") > 0
    assert fault(engine) is None
    with engine.begin() as connection:
        kept = [record.text for record in LOG.read(connection) if record.text is not None]
        assert kept
        assert not any(
            record.text for record in LOG.read(connection) if "subject-1" in {record.subject, record.resource}
        )
        connection.execute(update(TABLES.texts).values(text="nothing happened"))
    assert fault(engine) is not None


def test_a_record_appended_by_hand_is_found() -> None:
    engine = with_records(3)
    with engine.begin() as connection:
        last = dict(
            connection.execute(select(TABLES.records).where(TABLES.records.c.seq == 3)).mappings().one()
        )
        connection.execute(insert(TABLES.records).values({**last, "seq": 4, "previous_hash": last["hash"]}))
    assert fault(engine) is not None


def test_what_is_rolled_back_leaves_no_record() -> None:
    engine = with_records(3)
    with engine.connect() as connection:
        LOG.append(connection, "subject-1", "user.deleted")
        connection.rollback()
    assert fault(engine) is None
    with engine.begin() as connection:
        assert LOG.head(connection)[0] == 3
        assert LOG.append(connection, "subject-1", "user.deleted") == 4
    assert fault(engine) is None


def test_old_records_expire_from_the_start_and_the_rest_stays_verifiable() -> None:
    engine = with_records(6)
    with engine.begin() as connection:
        newest = LOG.read(connection, newest_first=True, limit=1)[0]
        assert LOG.expire(connection, newest.at_ms + 1) == 6
    assert fault(engine) is None
    with engine.begin() as connection:
        assert LOG.append(connection, "subject-1", "user.deleted") == 7
    assert fault(engine) is None


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_concurrent_appends_are_ordered(kind: str, new_database: Callable[[], str], tmp_path: Path) -> None:
    """From the first record on: several connections find an empty log."""
    engine = connect(new_database() if kind == "postgresql" else f"sqlite:///{tmp_path / 'audit.db'}")
    METADATA.create_all(engine)
    waiting = text("SELECT count(*) FROM pg_locks WHERE NOT granted")

    def append_many() -> None:
        for _ in range(20):
            with engine.begin() as connection:
                LOG.append(connection, "subject-1", "user.changed")

    with ThreadPoolExecutor(3) as threads:
        with engine.begin() as connection:
            LOG.append(connection, "subject-0", "start")
            appending = [threads.submit(append_many) for _ in range(3)]
            if kind == "postgresql":
                wait_for(lambda: connection.execute(waiting).scalar() == 3, why="the others do not wait")
        for each in appending:
            each.result()
    with engine.begin() as connection:
        checked = LOG.verify(connection)
    assert (checked.records, checked.fault) == (61, None)
    engine.dispose()


def test_filters_select_records() -> None:
    engine = with_records(9)
    with engine.begin() as connection:
        assert [record.seq for record in LOG.read(connection, chosen=AuditFilter(subject="subject-0"))] == [
            1,
            4,
            7,
        ]
        assert [record.seq for record in LOG.read(connection, after=7)] == [8, 9]
        newest = LOG.read(connection, newest_first=True, limit=2)
        assert [record.seq for record in newest] == [9, 8]
        assert [record.seq for record in LOG.read(connection, newest_first=True, after=8, limit=1)] == [7]
        assert LOG.read(connection, chosen=AuditFilter(action="user.deleted")) == []


def test_names_of_subjects_are_kept_while_a_record_is_about_a_person() -> None:
    metadata = MetaData()
    log = AuditLog(AuditTables(metadata, "named", has_aliases=True, has_names=True))
    engine = create_engine("sqlite://")
    metadata.create_all(engine)
    anna, bert = "urn:ngsi-ld:Person:demo:anna", "urn:ngsi-ld:Person:demo:bert"
    with engine.begin() as connection:
        for subject, name, person in (("s1", "Rosa", anna), ("s2", "Vera", bert), ("s1", "Rosa B.", anna)):
            log.append(connection, subject, "GET /people/{person}", resource=person, name=name)
        log.append(connection, "s3", "PUT /settings", resource="settings")
        assert log.names(connection, ("s1", "s2", "s3")) == {"s1": "Rosa B.", "s2": "Vera"}
        log.forget(connection, anna)
        assert log.names(connection, ("s1", "s2")) == {"s2": "Vera"}, "nobody needs the name of Rosa"
        assert log.verify(connection).fault is None
        log.expire(connection, 2**60)
        assert log.names(connection, ("s2",)) == {}
    with engine.begin() as connection:
        assert LOG.names(database().connect(), ("s2",)) == {}, "a log without names keeps none"
