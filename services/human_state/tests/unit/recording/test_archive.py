import hashlib
import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap", reason="the extra [human-state] is not installed")

from handover_body.exchange.mcap import read_stream
from handover_body.formats.json_messages import Marker, Recorded
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import Samples, SignalInfo, SignalKind
from handover_body.recording.archive import JOURNAL, SUFFIX, Archive
from handover_body.recording.sealed import SealError

KEY = bytes(range(32))
ECG = SignalInfo(SignalKind.ECG, "D82", 130.0)
NAME = "R-0123456789abcdef"
START_S = 1_770_000_000.0


def items(count: int) -> list[Recorded]:
    found: list[Recorded] = []
    for number in range(count):
        at_s = START_S + number * 0.1
        found += [
            Samples("strap", ECG, at_s, np.full((13, 1), float(number))),
            Feature(FeatureName.HEART_RATE, "strap", 60.0 + number, at_s + 0.1, 0.9),
        ]
    return [*found, Marker(START_S + count, "lift", "the box")]


def read(archive: Archive) -> list[Recorded]:
    return list(read_stream(io.BytesIO(b"".join(archive.read(NAME))), NAME))


@pytest.fixture
def archive(tmp_path: Path) -> Archive:
    return Archive(tmp_path / "recordings", KEY)


def test_a_recording_is_written_and_read(archive: Archive, tmp_path: Path) -> None:
    journal = archive.begin(NAME, "P-1", "a lift")
    journal.write(items(20))
    journal.close()
    done = archive.finish(NAME)
    assert not done.is_cut
    assert (done.messages, done.last_s) == (41, START_S + 20)
    content = b"".join(archive.read(NAME))
    assert (hashlib.sha256(content).hexdigest(), len(content)) == (done.sha256, done.size)
    assert len(read(archive)) == 41
    file = tmp_path / "recordings" / f"{NAME}{SUFFIX}"
    assert b"strap" not in file.read_bytes()
    assert file.stat().st_mode & 0o077 == 0
    archive.drop_journal(NAME)
    archive.delete(NAME)
    assert list((tmp_path / "recordings").iterdir()) == []


@pytest.mark.parametrize("lost", [1, 20, 300])
def test_a_journal_that_was_cut_off_is_finished_as_often_as_needed(
    archive: Archive, tmp_path: Path, lost: int
) -> None:
    journal = archive.begin(NAME, "P-1", "")
    for _ in range(3):
        journal.write(items(5))
    file = tmp_path / "recordings" / f"{NAME}{JOURNAL}"
    kept = file.read_bytes()[:-lost]
    journal.close()
    file.write_bytes(kept)
    for _ in range(2):
        done = archive.finish(NAME)
        assert done.is_cut
        assert done.messages == 22
        assert len(read(archive)) == 22


def test_nothing_that_was_sealed_is_lost_when_the_process_is_killed(archive: Archive, tmp_path: Path) -> None:
    program = (
        "import sys; from pathlib import Path\n"
        "from test_archive import *\n"
        "journal = Archive(Path(sys.argv[1]), KEY).begin(NAME, 'P-1', '')\n"
        "journal.write(items(10)); print('written', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path / "recordings")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"written\n"
        process.send_signal(signal.SIGKILL)
    done = archive.finish(NAME)
    assert (done.messages, done.is_cut) == (21, True)
    assert len(read(archive)) == 21


def test_without_the_key_nothing_is_read_and_everything_can_be_deleted(
    archive: Archive, tmp_path: Path
) -> None:
    archive.begin(NAME, "P-1", "").close()
    locked = Archive(tmp_path / "recordings", None)
    with pytest.raises(SealError, match="HANDOVER_HEALTH_RECORDING_KEY"):
        locked.finish(NAME)
    with pytest.raises(SealError, match="another key"):
        Archive(tmp_path / "recordings", bytes(32)).finish(NAME)
    assert locked.has_journal(NAME)
    locked.delete_others([NAME])
    assert locked.has_journal(NAME)
    locked.delete_others([])
    assert list((tmp_path / "recordings").iterdir()) == []


def test_a_second_recording_of_the_same_name_is_refused(archive: Archive) -> None:
    archive.begin(NAME, "P-1", "").close()
    with pytest.raises(FileExistsError):
        archive.begin(NAME, "P-1", "")
    assert archive.has_journal(NAME)
