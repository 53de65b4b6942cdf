"""Ports: whole values or none, one writer, and a writer that is killed leaves nothing that blocks."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from handover.errors import UsageError
from handover_humanoid.cycle.ports import VALUES_AT, PortReader, PortWriter
from handover_humanoid.cycle.timing import CAUSES, Timing

NAMES = ("first", "second", "third")
WRITE_FOREVER = """
import sys
from pathlib import Path
import numpy as np
from handover_humanoid.cycle.ports import PortWriter
port = PortWriter(Path(sys.argv[1]), ["first", "second", "third"])
number = 0
while True:
    number += 1
    port.write(np.full(3, number))
    if number == 100:
        print("writing", flush=True)
"""


def test_a_reader_gets_what_was_written_last_with_its_time(tmp_path: Path) -> None:
    writer = PortWriter(tmp_path / "port", NAMES)
    reader = PortReader(tmp_path / "port")
    assert reader.names == NAMES
    assert reader.read()
    assert reader.age_s() == float("inf")
    writer.write(np.array([1.0, 2.0, 3.0]), 5_000_000_000)
    assert reader.read()
    assert reader.value("second") == 2.0
    assert reader.age_s(7_000_000_000) == pytest.approx(2.0)


def test_values_are_never_mixed_and_a_killed_writer_blocks_nobody(tmp_path: Path) -> None:
    path = tmp_path / "port"
    child = subprocess.Popen(
        [sys.executable, "-c", WRITE_FOREVER, str(path)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == "writing\n"
        with pytest.raises(UsageError, match="already has a writer"):
            PortWriter(path, NAMES)
        reader = PortReader(path)
        seen: set[float] = set()
        while len(seen) < 50:
            if reader.read():
                assert np.ptp(reader.values) == 0.0
                seen.add(float(reader.values[0]))
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.communicate()
    before = reader.time_ns
    reader.read()  # whole, or torn by the kill; neither blocks
    assert reader.time_ns >= before
    again = PortWriter(path, NAMES)
    again.write(np.array([7.0, 7.0, 7.0]))
    assert reader.read()
    assert reader.value("first") == 7.0


def test_a_torn_write_is_not_read_and_the_next_writer_mends_it(tmp_path: Path) -> None:
    path = tmp_path / "port"
    writer = PortWriter(path, NAMES)
    writer.write(np.array([1.0, 2.0, 3.0]))
    writer.close()
    whole = path.read_bytes()
    reader = PortReader(path)
    with path.open("r+b") as file:  # the values changed, the checksum did not yet
        file.seek(VALUES_AT)
        file.write(np.array([9.0]).tobytes())
    assert not reader.read()
    with path.open("r+b") as file:  # the sequence is odd
        file.write(whole)
        file.seek(8)
        file.write(np.array([int.from_bytes(whole[8:16], "little") | 1], dtype=np.uint64).tobytes())
    assert not reader.read()
    PortWriter(path, NAMES).write(np.array([4.0, 5.0, 6.0]))
    assert reader.read()
    assert reader.values.tolist() == [4.0, 5.0, 6.0]


def test_a_file_that_is_no_port_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text").write_bytes(b"hello" * 100)
    with pytest.raises(UsageError, match="no port"):
        PortReader(tmp_path / "text")
    with pytest.raises(UsageError, match="start its writer first"):
        PortReader(tmp_path / "missing")


class Clock:
    """Time and CPU time that a test moves."""

    def __init__(self) -> None:
        self.now, self.cpu, self.oversleep = 0, 0, 0

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9) + self.oversleep

    def pass_ms(self, wall: float, cpu: float) -> None:
        self.now += round(wall * 1e6)
        self.cpu += round(cpu * 1e6)


@pytest.mark.parametrize(
    ("wall_ms", "cpu_ms", "oversleep_ms", "cause", "lost"),
    [
        (2.0, 2.0, 0.0, None, 0),
        (6.0, 6.0, 0.0, "computing", 0),
        (6.0, 1.0, 0.0, "preempted", 0),
        (2.0, 2.0, 3.0, "woken late", 0),
        (23.0, 1.0, 0.0, "preempted", 4),
    ],
)
def test_a_late_cycle_is_counted_with_its_cause(
    wall_ms: float, cpu_ms: float, oversleep_ms: float, cause: str | None, lost: int
) -> None:
    clock = Clock()
    timing = Timing(0.004, lambda: clock.now, lambda: clock.cpu, clock.sleep)
    clock.oversleep = round(oversleep_ms * 1e6)
    clock.pass_ms(wall_ms, cpu_ms)
    timing.wait()
    counts = dict(zip(CAUSES, timing.causes.tolist(), strict=True))
    assert counts == {name: int(name == cause) for name in CAUSES}
    assert (timing.late, timing.lost) == (int(cause is not None), lost)
    clock.oversleep = 0
    clock.pass_ms(0.5, 0.5)
    timing.wait()
