"""Checkpoints: the tables are as if each commit had been written alone."""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_broker.storage.check import faults_in
from handover_broker.storage.database import NotStored, SqliteDatabase
from handover_broker.storage.entries import DocumentKind, EntityRow, Entries, PendingNotification
from handover_broker.storage.history_archive import HistoryRow, TemporalOnlyRow
from handover_broker.storage.journal import SCRIPT, Journal, total_of
from handover_broker.storage.write_ahead_log import frames
from handover_broker.storage.write_ahead_log.checkpoint import merge_commits
from handover_broker.storage.write_ahead_log.frames import FILE_BYTES
from handover_broker.storage.write_ahead_log.inspection import changes, describe
from handover_broker.storage.write_ahead_log.records import decode, encode

TABLES = {
    "entities": "SELECT seq, tenant, body FROM entities",
    "documents": "SELECT kind, tenant, id, body FROM documents",
    "outbox": "SELECT seq, tenant, subscription, entity, at, body, headers FROM outbox",
    "history": "SELECT entity, seq, observed_from, observed_to, rewritten, body FROM history",
    "temporal_only_entities": "SELECT seq, tenant, id, body FROM temporal_only_entities",
}

bodies = st.binary(max_size=40)
bodies_or_none = st.none() | bodies
places = st.integers(1, 4)
tenants = st.sampled_from(["", "clinic"])
names = st.sampled_from(["urn:a", "urn:ä\n"])
times = st.none() | st.floats(0, 2e9)

entity_rows = st.builds(EntityRow, tenants, names, bodies_or_none)
history_rows = st.builds(
    HistoryRow, places, st.integers(1, 5), times, times, st.integers(0, 1), bodies_or_none
)
temporal_only_rows = st.builds(TemporalOnlyRow, tenants, names, bodies_or_none)
notices = st.builds(
    PendingNotification, tenants, names, names, st.floats(0, 2e9), bodies_or_none, st.just(0), bodies_or_none
)
document_keys = st.tuples(
    st.sampled_from(
        [
            DocumentKind.SUBSCRIPTION,
            DocumentKind.SOURCE_SUBSCRIPTION,
            DocumentKind.COUNTS,
            DocumentKind.CONTEXT,
        ]
    ),
    tenants,
    names,
)
commits = st.builds(
    Entries,
    entities=st.dictionaries(places, entity_rows, max_size=3),
    documents=st.dictionaries(document_keys, bodies_or_none, max_size=3),
    pending=st.lists(notices, max_size=3),
    settled=st.lists(st.integers(1, 9), max_size=3, unique=True),
    # One commit names a row of history once, and clears nothing that it writes: so does the broker.
    history=st.lists(history_rows, max_size=3, unique_by=lambda row: row[:2]),
    temporal_only=st.dictionaries(places, temporal_only_rows, max_size=2),
) | st.builds(Entries, cleared=st.lists(st.tuples(places, st.integers(1, 6)), max_size=2))


def tables(file: Path) -> dict[str, Any]:
    with closing(sqlite3.connect(file)) as database:
        return {name: sorted(database.execute(asked), key=repr) for name, asked in TABLES.items()}


def opened(file: Path) -> Journal:
    journal = Journal(SqliteDatabase(file))
    journal.open()
    return journal


def tenant_of(place: int) -> str:
    return "clinic" if place % 2 else ""


def in_turn(made: list[Entries]) -> list[Entries]:
    """Return commits of which none settles what is not pending yet; a place belongs to one tenant."""
    pending = 0
    for entries in made:
        for place, row in entries.entities.items():
            entries.entities[place] = EntityRow(tenant_of(place), f"urn:{place}", row.body)
        for place, gone in entries.temporal_only.items():
            entries.temporal_only[place] = TemporalOnlyRow(tenant_of(place), f"urn:{place}", gone.body)
        entries.settled = [seq for seq in entries.settled if seq <= pending]
        pending += len(entries.pending)
    return made


@given(commits)
def test_a_record_decodes_to_the_encoded_entries(entries: Entries) -> None:
    for number, notice in enumerate(entries.pending, 7):
        notice.seq = number
    again = decode(encode(entries))
    assert (again.entities, again.documents, again.settled) == (
        entries.entities,
        entries.documents,
        entries.settled,
    )
    assert (again.history, again.cleared, again.temporal_only) == (
        entries.history,
        entries.cleared,
        entries.temporal_only,
    )
    assert [result(notice) for notice in again.pending] == [result(notice) for notice in entries.pending]


def result(one: PendingNotification) -> tuple[Any, ...]:
    return one.tenant, one.subscription, one.entity, one.at, one.body, one.seq, one.headers


@pytest.mark.nightly
@settings(deadline=None, max_examples=20)
@given(made=st.lists(commits, max_size=8))
def test_many_commits_in_one_transaction_leave_what_each_alone_would(
    tmp_path_factory: pytest.TempPathFactory, made: list[Entries]
) -> None:
    folder = tmp_path_factory.mktemp("filing")
    alone, together = opened(folder / "alone.db"), opened(folder / "together.db")
    for entries in in_turn(made):
        alone.commit(entries)
        alone.settle()
    for entries in made:
        together.commit(entries)
    together.settle()
    alone.close()
    together.close()
    assert tables(folder / "together.db") == tables(folder / "alone.db")


@pytest.mark.nightly
@settings(deadline=None, max_examples=15)
@given(made=st.lists(commits, min_size=1, max_size=8))
def test_the_log_of_a_killed_broker_is_written_to_the_tables_at_the_next_start(
    tmp_path_factory: pytest.TempPathFactory, made: list[Entries]
) -> None:
    folder = tmp_path_factory.mktemp("killed")
    (folder / "copy").mkdir()
    journal = opened(folder / "broker.db")
    with journal._database.transaction() as writer:  # so that nothing is filed meanwhile
        for entries in in_turn(made):
            journal.commit(entries)
        for file in folder.glob("broker.*"):  # what is on the disk if it is killed now
            if file.suffix != ".lock":
                (folder / "copy" / file.name).write_bytes(file.read_bytes())
        del writer
    journal.close()
    opened(folder / "copy" / "broker.db").close()
    opened(folder / "broker.db").close()  # which also deletes notifications without a subscription
    assert tables(folder / "copy" / "broker.db") == tables(folder / "broker.db")


def test_delivered_notifications_are_not_written_to_the_tables() -> None:
    first, second = Entries(), Entries()
    first.pending = [PendingNotification("", "urn:s", "urn:e", 1.0, b"{}", seq) for seq in (1, 2)]
    second.settled = [1, 8]
    (merged,) = merge_commits([first, second])
    assert [notice.seq for notice in merged.pending] == [2]
    assert merged.settled == [8]


def test_a_commit_too_long_for_the_log_is_written_at_once_and_in_its_turn(tmp_path: Path) -> None:
    journal = opened(tmp_path / "broker.db")
    for body in (b"small", bytes(2 * FILE_BYTES), b"smaller"):
        journal.commit(Entries(entities={1: EntityRow("", "urn:e", body)}))
    assert list(journal.entities()) == [("", b"smaller")]
    journal.close()


@pytest.mark.nightly
def test_a_reader_sees_what_was_committed(tmp_path: Path) -> None:
    journal = opened(tmp_path / "broker.db")
    for place in range(1, 3000):
        journal.commit(Entries(entities={place: EntityRow("", f"urn:{place}", b"x" * 1500)}))
        if place % 700 == 0:
            assert journal.last_sequence() == place
    assert len(list(journal.entities())) == 2999
    journal.close()


def test_commits_continue_without_checkpoints_until_the_log_is_full(tmp_path: Path) -> None:
    journal = opened(tmp_path / "broker.db")
    committed = 0

    def commit() -> None:
        nonlocal committed
        journal.commit(Entries(entities={committed + 1: EntityRow("", "urn:e", bytes(100_000))}))
        committed += 1

    def commit_on_and_on() -> None:
        for _ in range(100):
            commit()

    with closing(sqlite3.connect(tmp_path / "broker.db", isolation_level=None)) as other:
        other.execute("ALTER TABLE entities RENAME TO out_of_reach")
        with pytest.raises(NotStored, match="no such table"):
            commit_on_and_on()
        assert committed * 100_000 > FILE_BYTES
        with pytest.raises(NotStored):
            journal.last_sequence()
        other.execute("ALTER TABLE out_of_reach RENAME TO entities")
    assert journal.last_sequence() == committed
    commit()
    assert journal.last_sequence() == committed
    journal.close()


def test_a_damaged_log_is_refused_with_what_to_do(tmp_path: Path) -> None:
    journal = opened(tmp_path / "broker.db")
    with closing(sqlite3.connect(tmp_path / "broker.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        for place in (1, 2, 3):
            journal.commit(Entries(entities={place: EntityRow("", "urn:e", b"body")}))
        copy = tmp_path / "copy"
        copy.mkdir()
        for name in ("broker.db", "broker.log-1", "broker.log-2", "broker.db-wal"):
            (copy / name).write_bytes((tmp_path / name).read_bytes())
        other.execute("ROLLBACK")
    journal.close()
    content = bytearray((copy / "broker.log-1").read_bytes())
    content[2 * 4096 + 50] ^= 1
    (copy / "broker.log-1").write_bytes(content)
    with pytest.raises(
        UsageError, match=r"damaged data: .*broker\.log-1.* change 2 cannot be read, and 3 is there; restore"
    ):
        opened(copy / "broker.db")


def killed_broker(folder: Path) -> Path:
    """Return the database of a broker that was killed with one change in the log only."""
    journal = opened(folder / "broker.db")
    copy = folder / "copy"
    copy.mkdir()
    with closing(sqlite3.connect(folder / "broker.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        journal.commit(Entries(entities={1: EntityRow("", "urn:e", b"body")}))
        for name in ("broker.db", "broker.log-1", "broker.log-2", "broker.db-wal"):
            (copy / name).write_bytes((folder / name).read_bytes())
        other.execute("ROLLBACK")
    journal.close()
    return copy / "broker.db"


def refusal(database: Path) -> str:
    """Return the error of a start, which changes no file."""
    before = {path.name: path.read_bytes() for path in database.parent.glob("broker.log-*")}
    journal = Journal(SqliteDatabase(database))
    with pytest.raises(UsageError) as refused:
        journal.open()
    journal.close()
    assert {path.name: path.read_bytes() for path in database.parent.glob("broker.log-*")} == before
    assert list(faults_in(database)) == [str(refused.value)]
    return str(refused.value)


def test_a_record_of_another_version_is_refused_by_name_with_the_way_out(tmp_path: Path) -> None:
    database = killed_broker(tmp_path)
    file = database.with_suffix(".log-1")
    content = file.read_bytes()
    header = frames.decode_header(content[: frames.SECTOR_BYTES])
    assert header is not None
    seed = frames.checksum_seed(header.log_id)
    later = frames.encode_frame(frames.COMMIT, 2, b'{"entity/2": [{"name": "x"}]}\n', 9, seed)
    second = 2 * frames.PAGE_BYTES
    file.write_bytes(content[:second] + later + content[second + len(later) :])
    text = refusal(database)
    assert 'broker.log-2: change 2 has a record of the type "entity/2"' in text
    assert "start the version that wrote it and stop it" in text
    assert "1 entity/2" in "\n".join(describe(database))
    assert [change["records"][0]["type"] for change in changes(database)] == ["entity/1", "entity/2"]


def test_a_log_of_another_format_is_refused_by_name_with_the_way_out(tmp_path: Path) -> None:
    database = killed_broker(tmp_path)
    file = database.with_suffix(".log-2")
    content = file.read_bytes()
    sector = content[:7] + b"2" + content[8:508]
    file.write_bytes(sector + crc32(sector).to_bytes(4, "little") + content[512:])
    text = refusal(database)
    assert "broker.log-2 is of format 2 of the log, which this version of Handover does not know" in text
    assert "start the version that wrote it and stop it" in text
    assert text in list(describe(database))


@pytest.mark.parametrize(("table", "key"), [("entities", "seq"), ("documents", "kind, tenant, id")])
@pytest.mark.parametrize("count", [1, 2, 256])
def test_totals_are_kept_up_without_reading_the_whole_table(table: str, key: str, count: int) -> None:
    with closing(sqlite3.connect(":memory:")) as database:
        database.executescript(SCRIPT.format(**SqliteDatabase.TYPES))
        keys = [None] * count * (key.count(",") + 1)
        plan = database.execute(f"EXPLAIN QUERY PLAN {total_of(table, key, count)}", keys).fetchall()
    steps = [step for *_, step in plan]
    assert any(step.startswith(f"SEARCH {table} USING") for step in steps), steps
    assert not any(step.startswith(f"SCAN {table}") for step in steps), steps
