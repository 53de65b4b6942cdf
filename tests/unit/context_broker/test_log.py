"""The log in front of an SQLite file: what was appended and not filed is read again, whatever happened."""

import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from services.context_broker.storage.log import PAGE, SIZE, Damaged, Log

OPENING = b"opening1"


def begun(folder: Path) -> Log:
    log = Log(folder / "broker.db")
    log.begin(OPENING)
    return log


def read(folder: Path, filed: int = 0, opening: bytes = OPENING) -> list[bytes]:
    return Log(folder / "broker.db").read(opening, filed)


class Writing(RuleBasedStateMachine):
    """A log that is appended to and filed from; after every step it is read as if it had been killed."""

    folder: Path

    def __init__(self) -> None:
        super().__init__()
        shutil.rmtree(self.folder)
        self.folder.mkdir()
        self.log = begun(self.folder)
        self.records: list[bytes] = []
        self.filed = 0

    @rule(
        length=st.one_of(
            st.integers(0, 3 * PAGE),
            st.integers(SIZE // 3, SIZE - 100),
            st.sampled_from([PAGE - 32, PAGE - 31]),
        ),
        filler=st.binary(min_size=1, max_size=3),
    )
    def append(self, length: int, filler: bytes) -> None:
        record = (filler * (length // len(filler) + 1))[:length]
        assert not self.log.never_fits(record)
        if not self.log.has_room(record):
            self.file(1.0)
            assert self.log.has_room(record)
        self.log.append(record)
        self.records.append(record)
        assert self.log.number == len(self.records)

    @precondition(lambda self: self.filed < len(self.records))
    @rule(share=st.floats(0, 1))
    def file(self, share: float) -> None:
        self.filed += round((len(self.records) - self.filed) * share)
        self.log.filed(self.filed)

    @invariant()
    def what_is_not_filed_is_read_again(self) -> None:
        assert read(self.folder, self.filed) == self.records[self.filed :]

    @invariant()
    def it_stays_small(self) -> None:
        assert sum(file.stat().st_size for file in self.folder.iterdir()) <= 2 * SIZE

    def teardown(self) -> None:
        self.log.close()


def test_whatever_is_written_is_read_again(tmp_path: Path) -> None:
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
    file = tmp_path / "broker.log-1"
    content = bytearray(file.read_bytes())
    content[2 * PAGE + 35] ^= 1
    file.write_bytes(content)
    with pytest.raises(Damaged, match=r"change 3 cannot be read, and 4 is there; .*broker\.log-1"):
        read(tmp_path)
    assert read(tmp_path, 3) == [b"change 3"]


def test_the_log_of_another_opening_is_passed_over(tmp_path: Path) -> None:
    log = begun(tmp_path)
    log.append(b"of another time")
    log.close()
    assert read(tmp_path, opening=b"opening2") == []
    again = Log(tmp_path / "broker.db")
    again.begin(b"opening2")
    again.append(b"of this time")
    again.close()
    assert read(tmp_path, opening=b"opening2") == [b"of this time"]


def test_where_there_is_no_log_there_is_nothing_to_read(tmp_path: Path) -> None:
    assert read(tmp_path) == []


def test_what_is_longer_than_a_file_never_fits(tmp_path: Path) -> None:
    log = begun(tmp_path)
    assert log.never_fits(bytes(SIZE))
    assert not log.has_room(bytes(SIZE))
    assert not log.never_fits(bytes(SIZE - 100))
    log.close()


@pytest.mark.skipif(
    not hasattr(os, "O_DSYNC"), reason="the disk is made to refuse by a limit that only Unix has"
)
def test_a_record_that_the_disk_refused_is_not_there_later(tmp_path: Path) -> None:
    import resource

    log = begun(tmp_path)
    log.append(b"first")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3 * PAGE, hard))
    try:
        with pytest.raises(OSError, match="File too large"):
            log.append(bytes(4 * PAGE))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert read(tmp_path) == [b"first"]
    log.append(b"second")
    log.close()
    assert read(tmp_path) == [b"first", b"second"]
