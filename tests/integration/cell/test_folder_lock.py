"""One process of a service works on a data directory: a second one names the holder, or stands by for it."""

import importlib
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from handover.database import connect
from handover.errors import UsageError
from handover.files.folder_lock import hold
from handover.runtime.python_processes import module_command
from handover.settings import Settings
from handover.tasks.finished_tasks import FinishedTasks
from tests.kit import processes
from tests.kit.cell import MODULES, SERVICES, Cell
from tests.kit.databases import DATABASE
from tests.kit.ports import next_free_port
from tests.kit.waiting import scaled, wait_for

NOT_SERVICES = frozenset({"devices", "glove"})

pytestmark = pytest.mark.skipif(DATABASE != "sqlite", reason="with a server the database decides who works")


def second(cell: Cell, service: str, **settings: str) -> tuple[processes.Process, Path]:
    """Start a second process of a service on the folder of `cell`, with ports of its own."""
    other = Cell(cell.data_dir, {name: next_free_port() for name in SERVICES}, {**cell.extra, **settings})
    if service != "context_broker":
        other.ports["context_broker"] = cell.ports["context_broker"]
    log = cell.data_dir / f"second-{service}.log"
    log.touch()
    return processes.spawn_module(MODULES[service], other.environment, log, cell.data_dir), log


@pytest.mark.nightly
@pytest.mark.parametrize("service", sorted(set(SERVICES) - NOT_SERVICES))
def test_each_service_is_refused_in_one_line_while_its_folder_is_held(cell: Cell, service: str) -> None:
    name = importlib.import_module(f"{MODULES[service]}.settings").SERVICE.name
    release = hold(cell.data_dir / name, name)
    try:
        process, log = second(cell, service)
        assert process.wait(scaled(60)) == 2
    finally:
        release()
    lines = log.read_text().splitlines()
    assert len(lines) == 1
    (pid,) = {part.split()[1] for part in lines[0].split(": ") if part.startswith("process ")}
    assert int(pid) > 0
    assert socket.gethostname() in lines[0]
    assert str(cell.data_dir) in lines[0]
    assert "HANDOVER_DATA_DIR" in lines[0]
    assert "HANDOVER_STANDBY" in lines[0]


@pytest.mark.nightly
@pytest.mark.parametrize("service", ["task_orchestrator", "trajectory_tool", "accounts", "webui"])
def test_a_second_service_names_the_first_and_starts_after_its_end(cell: Cell, service: str) -> None:
    cell.start("context_broker", service)
    first = cell.processes[service].pid
    process, log = second(cell, service)
    assert process.wait(scaled(60)) == 2
    assert f"process {first} on {socket.gethostname()}" in log.read_text()
    cell.restart(service)


@pytest.mark.nightly
def test_a_service_that_stands_by_takes_over_from_one_that_was_killed(cell: Cell) -> None:
    cell.start("context_broker", "task_orchestrator")
    first = cell.processes["task_orchestrator"].pid
    cell.extra["HANDOVER_STANDBY"] = "true"
    port = cell.ports["task_orchestrator"]
    standby, log = second(cell, "task_orchestrator", HANDOVER_ORCHESTRATOR_PORT=str(port))
    wait_for(lambda: f"process {first}" in log.read_text(), 60, log.read_text)
    assert "standby: another task-orchestrator runs on" in log.read_text()
    assert standby.poll() is None
    cell.kill("task_orchestrator")
    cell.processes["task_orchestrator"] = standby
    cell.wait_ready("task_orchestrator", 60)


def test_two_services_of_different_names_that_own_one_database_exclude_each_other(cell: Cell) -> None:
    """As a gateway and an edge, whose database is the same file."""
    held = cell.data_dir / "orchestrator.db"
    release = hold(held, "a program")
    try:
        process, log = second(cell, "task_orchestrator")
        assert process.wait(scaled(60)) == 2
    finally:
        release()
    assert f"another a program runs on {held}" in log.read_text()


@pytest.mark.nightly
def test_programs_that_read_work_beside_a_service(cell: Cell) -> None:
    cell.start("context_broker", "task_orchestrator")
    check = subprocess.run(
        [*module_command("handover_cell"), "check"],
        env=cell.environment,
        cwd=cell.data_dir,
        capture_output=True,
        text=True,
        timeout=scaled(120),
        check=False,
    )
    assert check.returncode == 0, check.stdout + check.stderr
    connect(f"sqlite:///{cell.data_dir / 'orchestrator.db'}", is_own=False).dispose()


async def test_the_record_of_a_performer_has_one_process(tmp_path: Path) -> None:
    """Also without `serve`, as in a program of a stranger; a killed one leaves nothing behind."""
    script = (
        "import asyncio, sys\n"
        "from handover.tasks.finished_tasks import FinishedTasks\n"
        "from handover.settings import Settings\n"
        f"records = FinishedTasks(Settings(data_dir={str(tmp_path)!r}), 'lamp')\n"
        "asyncio.run(records.open())\n"
        "print('open', flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"open\n"
        records = FinishedTasks(Settings.load(data_dir=tmp_path), "lamp")
        with pytest.raises(UsageError, match=f"another lamp runs on .*: process {other.pid} on "):
            await records.open()
        processes.kill(other)
    again = FinishedTasks(Settings.load(data_dir=tmp_path), "lamp")
    await again.open()
    await again.close()


def test_a_lock_file_without_content_still_excludes(tmp_path: Path) -> None:
    """As a full disk leaves it."""
    release = hold(tmp_path / "lamp.db", "lamp")
    os.truncate(tmp_path / "lamp.db.lock", 0)  # without a descriptor, whose end would release the lock
    script = (
        "from pathlib import Path; from handover.files.folder_lock import hold\n"
        f"hold(Path({str(tmp_path / 'lamp.db')!r}), 'lamp')"
    )
    try:
        ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    finally:
        release()
    assert "another lamp runs on" in ended.stderr
    assert "does not name" in ended.stderr
