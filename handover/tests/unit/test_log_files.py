"""Log files: a full one is replaced without the loss of a line, by all processes that write to it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from handover.logs.log_files import LOG_FILE, older, open_log

WRITER = """
import logging, os, subprocess, sys
from pathlib import Path
from handover.logs.log_files import LogFileHandler

name, count, most = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
logger = logging.getLogger("writer")
logger.addHandler(LogFileHandler(Path(os.environ["HANDOVER_LOG_FILE"]), most))
for number in range(count):
    logger.warning("%s %s %s", name, number, "x" * 80)
    os.write(1, f"{name} out {number}\\n".encode())  # as a native library prints
"""


def start(log: Path, name: str, count: int, max_bytes: int) -> "subprocess.Popen[bytes]":
    descriptor = open_log(log)
    try:
        return subprocess.Popen(
            [sys.executable, "-c", WRITER, name, str(count), str(max_bytes)],
            env={**os.environ, LOG_FILE: str(log)},
            stdout=descriptor,
            stderr=descriptor,
        )
    finally:
        os.close(descriptor)


def lines_of(log: Path) -> list[str]:
    parts = [path.read_text() for path in (older(log), log) if path.exists()]
    return "".join(parts).splitlines()


@pytest.mark.parametrize("processes", [1, 3])
def test_a_full_file_is_replaced_and_no_line_is_lost(tmp_path: Path, processes: int) -> None:
    log = tmp_path / "logs" / "lamp.log"
    count, bytes_each = 300, 100 + 12
    # Full after about half of what is written, so that it is replaced once.
    writers = [start(log, f"w{n}", count, processes * count * bytes_each * 6 // 10) for n in range(processes)]
    assert [writer.wait() for writer in writers] == [0] * processes
    assert older(log).exists()
    said = sorted(line.rstrip("x ") for line in lines_of(log))
    expected = [f"w{n} {how}{i}" for n in range(processes) for i in range(count) for how in ("", "out ")]
    assert said == sorted(expected)


def test_only_the_last_two_files_are_kept_and_others_cannot_read_them(tmp_path: Path) -> None:
    log = tmp_path / "lamp.log"
    assert start(log, "w", 1000, 5_000).wait() == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lamp.log", "lamp.log.1"]
    for path in tmp_path.iterdir():
        assert path.stat().st_size < 5_000 + 300
        assert path.stat().st_mode & 0o077 == 0
    assert "w out 999" in log.read_text()


def test_a_child_that_logs_elsewhere_has_no_log_file(tmp_path: Path) -> None:
    log, elsewhere = tmp_path / "lamp.log", tmp_path / "child.log"
    ask = "from handover.logs.log_files import own_log; print(own_log())"
    environment = {**os.environ, LOG_FILE: str(log)}
    for file, said in ((log, str(log)), (older(log), str(log)), (elsewhere, "None")):
        descriptor = open_log(file)
        found = subprocess.run(
            [sys.executable, "-c", ask],
            env=environment,
            stderr=descriptor,
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        os.close(descriptor)
        assert found.stdout.strip() == said
