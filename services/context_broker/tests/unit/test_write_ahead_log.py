"""The write-ahead log: appended records that are not checkpointed are read again, whatever happened."""

import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from handover_broker.storage.write_ahead_log.frames import FILE_BYTES, PAGE_BYTES
from handover_broker.storage.write_ahead_log.log import WriteAheadLog
from handover_broker.storage.write_ahead_log.log_file import Damaged

DATABASE_ID, LOG_ID = b"database", b"log id 1"


def begun(folder: Path) -> WriteAheadLog:
    log = WriteAheadLog(folder / "broker.db")
    log.begin(DATABASE_ID, LOG_ID)
    return log


def read(folder: Path, checkpointed: int = 0, log_id: bytes = LOG_ID) -> list[bytes]:
    return WriteAheadLog(folder / "broker.db").read(DATABASE_ID, log_id, checkpointed)


class Writing(RuleBasedStateMachine):
    """A log with appends and checkpoints; after every step it is read as after a kill."""

    folder: Path

    def __init__(self) -> None:
        super().__init__()
        shutil.rmtree(self.folder)
        self.folder.mkdir()
        self.log = begun(self.folder)
        self.records: list[bytes] = []
        self.checkpointed = 0

    @rule(
        length=st.one_of(
            st.integers(0, 3 * PAGE_BYTES),
            st.integers(FILE_BYTES // 3, FILE_BYTES - PAGE_BYTES - 45_000),
            st.sampled_from([8 * 502 - 16, 8 * 502 - 15, 502 - 16, 502 - 15]),
        ),
        filler=st.binary(min_size=1, max_size=3),
    )
    def append(self, length: int, filler: bytes) -> None:
        record = (filler * (length // len(filler) + 1))[:length]
        assert not self.log.is_too_large(record)
        if not self.log.has_space(record):
            self.checkpoint(1.0)
            assert self.log.has_space(record)
        self.log.append(record)
        self.records.append(record)
        assert self.log.number == len(self.records)

    @precondition(lambda self: self.checkpointed < len(self.records))
    @rule(share=st.floats(0, 1))
    def checkpoint(self, share: float) -> None:
        self.checkpointed += round((len(self.records) - self.checkpointed) * share)
        self.log.note_checkpoint(self.checkpointed)

    @invariant()
    def records_after_the_checkpoint_are_read_again(self) -> None:
        assert read(self.folder, self.checkpointed) == self.records[self.checkpointed :]

    @invariant()
    def it_stays_small(self) -> None:
        assert sum(file.stat().st_size for file in self.folder.iterdir()) <= 2 * FILE_BYTES

    def teardown(self) -> None:
        self.log.close()


@pytest.mark.nightly
def test_every_written_record_is_read_again(tmp_path: Path) -> None:
    Writing.folder = tmp_path / "log"
    Writing.folder.mkdir()
    machine: Any = Writing.TestCase
    machine.settings = settings(max_examples=15, stateful_step_count=20, deadline=None)
    machine("runTest").runTest()


@settings(deadline=None, max_examples=40)
@given(
    kept=st.lists(st.binary(max_size=6000), max_size=4),
    last=st.binary(min_size=1, max_size=9000),
    share=st.floats(0, 1, exclude_max=True),
)
def test_a_write_cut_short_harms_nothing_before_it(
    tmp_path_factory: pytest.TempPathFactory, kept: list[bytes], last: bytes, share: float
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    log = begun(folder)
    for record in kept:
        log.append(record)
    before = (folder / "broker.log-1").read_bytes()
    log.append(last)
    log.close()
    after = bytearray((folder / "broker.log-1").read_bytes())
    changed = [at for at in range(0, len(after), 512) if after[at : at + 512] != before[at : at + 512]]
    for at in changed[int(len(changed) * share) :]:  # the disk writes sectors, in whatever order
        after[at : at + 512] = before[at : at + 512]
    (folder / "broker.log-1").write_bytes(after)
    assert read(folder) == kept


def test_a_frame_that_was_acknowledged_and_cannot_be_read_is_named(tmp_path: Path) -> None:
    log = begun(tmp_path)
    for number in range(4):
        log.append(b"change %d" % number)
    log.close()
    flip(tmp_path / "broker.log-1", 3 * PAGE_BYTES + 35)
    with pytest.raises(Damaged, match=r"broker\.log-1.*: change 3 cannot be read, and 4 is there"):
        read(tmp_path)
    assert read(tmp_path, 3) == [b"change 3"]


def flip(file: Path, at: int, bit: int = 0) -> None:
    content = bytearray(file.read_bytes())
    content[at] ^= 1 << bit
    file.write_bytes(content)


@settings(deadline=None, max_examples=25)
@given(
    lengths=st.lists(st.integers(0, 9000), min_size=1, max_size=4),
    share=st.floats(0, 1, exclude_max=True),
    bit=st.integers(0, 7),
)
def test_a_bit_that_flips_in_the_last_frame_is_no_write_cut_short(
    tmp_path_factory: pytest.TempPathFactory, lengths: list[int], share: float, bit: int
) -> None:
    """No later frame reveals the damage; the checksums of its sectors do."""
    folder = tmp_path_factory.mktemp("flip")
    log = begun(folder)
    records = [os.urandom(length) for length in lengths]
    for record in records[:-1]:
        log.append(record)
    start = log.files[0].end
    log.append(records[-1])
    sectors = -(-(16 + lengths[-1]) // 502)
    log.close()
    flip(folder / "broker.log-1", start + int(sectors * 512 * share), bit)
    with pytest.raises(Damaged, match=r"broker\.log-1: change \d+, from byte \d+ on, is damaged"):
        read(folder)


def test_damage_of_checkpointed_frames_is_ignored_where_no_frame_can_follow(tmp_path: Path) -> None:
    log = begun(tmp_path)
    for number in range(4):
        log.append(b"change %d" % number)
    log.close()
    flip(tmp_path / "broker.log-1", 2 * PAGE_BYTES + 35)
    assert read(tmp_path, 2) == [b"change 2", b"change 3"]


@pytest.mark.parametrize("name", ["broker.log-1", "broker.log-2"])
@pytest.mark.parametrize("size", [None, 0, 1, PAGE_BYTES, FILE_BYTES // 2, FILE_BYTES - 1, FILE_BYTES + 1])
def test_a_log_that_is_missing_or_cut_is_named(tmp_path: Path, name: str, size: int | None) -> None:
    log = begun(tmp_path)
    log.append(b"change")
    log.close()
    if size is None:
        (tmp_path / name).unlink()
    else:
        os.truncate(tmp_path / name, size)
    with pytest.raises(Damaged, match=name + " (is missing|has)"):
        read(tmp_path)


def test_an_older_copy_of_the_log_is_noticed(tmp_path: Path) -> None:
    log = begun(tmp_path)
    log.append(b"change 1")
    old = (tmp_path / "broker.log-1").read_bytes()
    for number in (2, 3):
        log.append(b"change %d" % number)
    log.note_checkpoint(3)
    log.close()
    (tmp_path / "broker.log-1").write_bytes(old)
    with pytest.raises(Damaged, match="an older copy"):
        read(tmp_path, 3)


def test_a_log_with_another_id_or_of_another_database_is_refused(tmp_path: Path) -> None:
    log = begun(tmp_path)
    log.append(b"of another time")
    log.close()
    with pytest.raises(Damaged, match="one of the two is older"):
        read(tmp_path, log_id=b"log id 2")
    again = WriteAheadLog(tmp_path / "broker.db")
    with pytest.raises(Damaged, match="another database"):
        again.read(b"stranger", LOG_ID, 0)
    assert "another database" in str(again.describe_foreign(b"stranger", b"log id 2"))
    assert "this database, later" in str(again.describe_foreign(DATABASE_ID, b"log id 2"))
    assert again.describe_foreign(DATABASE_ID, LOG_ID) is None
    again.begin(DATABASE_ID, b"log id 2")
    again.append(b"of this time")
    assert read(tmp_path, log_id=b"log id 2") == [b"of this time"]
    again.close(is_copied=True)
    assert again.describe_foreign(DATABASE_ID, b"log id 3") is None, (
        "the tables have everything of a closed log"
    )


def test_a_write_that_the_disk_refuses_leaves_no_trace(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = begun(tmp_path)
    log.append(b"kept")
    write, refuses = log.files[0].write, True

    def fails_half_way(at: int, frame: bytes) -> None:
        nonlocal refuses
        if not refuses:
            write(at, frame)
            return
        refuses = False
        write(at, frame)
        raise OSError("no space left on device")

    monkeypatch.setattr(log.files[0], "write", fails_half_way)
    with pytest.raises(OSError, match="no space"):
        log.append(os.urandom(9000))
    assert read(tmp_path) == [b"kept"]
    assert read(tmp_path, 1) == []
    log.append(b"after it")
    assert read(tmp_path) == [b"kept", b"after it"]
    log.close()


def test_a_record_larger_than_a_file_is_too_large(tmp_path: Path) -> None:
    log = begun(tmp_path)
    assert log.is_too_large(bytes(FILE_BYTES))
    assert not log.has_space(bytes(FILE_BYTES))
    assert not log.is_too_large(bytes(FILE_BYTES - PAGE_BYTES - 45_000))
    log.close()


@pytest.mark.skipif(
    not hasattr(os, "O_DSYNC"), reason="the disk is made to refuse by a limit that only Unix has"
)
def test_a_record_that_the_disk_refused_is_not_there_later(tmp_path: Path) -> None:
    import resource

    log = begun(tmp_path)
    log.append(b"first")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3 * PAGE_BYTES, hard))
    try:
        with pytest.raises(OSError, match="File too large"):
            log.append(bytes(4 * PAGE_BYTES))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert read(tmp_path) == [b"first"]
    log.append(b"second")
    log.close()
    assert read(tmp_path) == [b"first", b"second"]
