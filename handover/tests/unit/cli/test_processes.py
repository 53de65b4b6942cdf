"""Processes of the launcher are forked where that is possible, and started as programs where it is not."""

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator, Sequence
from pathlib import Path

import psutil
import pytest
from structlog.testing import capture_logs

from handover.runtime.python_processes import module_command
from handover_cell.launching import fork_server
from handover_cell.launching.processes import ForkedProcess, Process, ProcessStarter
from tests.kit.namesakes import leave_namesakes_in
from tests.kit.processes import clean_environment
from tests.kit.waiting import scaled, until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux only")

SCRIPT = """
import os, sys
print(sys.argv[1:], os.environ.get("GIVEN"), os.getsid(0) == os.getpid(), __name__, flush=True)
if sys.argv[1:] == ["stay"]:
    sys.stdin.read()
    sys.exit("the parent has ended")
sys.exit(7)
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory of a user: a module in `modules`, and files with the names of ours."""
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "some_service.py").write_text(SCRIPT)
    leave_namesakes_in(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
async def starter(folder: Path) -> AsyncIterator[ProcessStarter]:
    starter = ProcessStarter()
    starter.open()
    yield starter
    await starter.close()


async def start(starter: ProcessStarter, *words: str, folder: Path) -> Process:
    environment = {
        **clean_environment(),
        "GIVEN": "a setting",
        "PYTHONUNBUFFERED": "1",
        "PYTHONPATH": str(folder / "modules"),
    }
    with (folder / "log").open("ab") as log:
        return await starter.start(module_command("some_service", *words), environment, log)


async def wait(process: Process) -> int:
    async with asyncio.timeout(scaled(60)):
        return await process.wait()


async def wait_for_words(log: Path, words: str) -> None:
    async with asyncio.timeout(scaled(60)):
        while words not in log.read_text():
            await asyncio.sleep(0.01)


async def require_ended(process: int) -> None:
    async with asyncio.timeout(scaled(60)):
        while psutil.pid_exists(process):
            await asyncio.sleep(0.01)


def fork_servers() -> set[int]:
    """The fork servers of this process: that of the launcher under test, and that of the tests."""
    return {one.pid for one in psutil.Process().children() if fork_server.__name__ in one.cmdline()}


def shown(process: Process) -> Sequence[str]:
    return " ".join(psutil.Process(process.pid).cmdline()).split()


async def test_a_module_gets_its_arguments_environment_session_and_name(
    starter: ProcessStarter, folder: Path
) -> None:
    process = await start(starter, "stay", folder=folder)
    assert isinstance(process, ForkedProcess)
    await wait_for_words(folder / "log", "__main__")
    assert (folder / "log").read_text() == "['stay'] a setting True __main__\n"
    assert shown(process) == module_command("some_service", "stay")
    assert psutil.Process(process.pid).name() == "some_service"
    assert process.returncode is None
    process.terminate()
    assert await wait(process) == process.returncode == -signal.SIGTERM
    with pytest.raises(ProcessLookupError):
        process.kill()


async def test_the_exit_status_is_that_of_the_module(starter: ProcessStarter, folder: Path) -> None:
    assert await wait(await start(starter, folder=folder)) == 7
    missing = module_command("there_is_no_such_module")
    with (folder / "log").open("ab") as log:
        assert await wait(await starter.start(missing, clean_environment(), log)) == 1
    assert "No module named there_is_no_such_module" in (folder / "log").read_text()


@pytest.mark.nightly
async def test_a_killed_server_ends_its_processes_and_later_ones_are_programs(
    folder: Path,
) -> None:
    before, starter = fork_servers(), ProcessStarter()
    starter.open()
    (server,) = await until(lambda: fork_servers() - before, why="the fork server has its name")
    first = await start(starter, "stay", folder=folder)
    await wait_for_words(folder / "log", "__main__")
    os.kill(server, signal.SIGKILL)
    assert await wait(first) == -signal.SIGTERM
    await require_ended(first.pid)
    second = await start(starter, "again", folder=folder)
    assert not isinstance(second, ForkedProcess)
    assert await wait(second) == 7
    assert "['again'] a setting True __main__" in (folder / "log").read_text()
    await starter.close()


async def test_another_program_is_started_as_it_is(starter: ProcessStarter, folder: Path) -> None:
    with (folder / "log").open("ab") as log:
        process = await starter.start(["/bin/sh", "-c", "exit 3"], clean_environment(), log)
    assert not isinstance(process, ForkedProcess)
    assert await wait(process) == 3


async def test_a_server_that_has_ended_is_reported_and_programs_are_started(folder: Path) -> None:
    starter = ProcessStarter()
    starter.open()
    assert starter._server is not None
    os.kill(starter._server.pid, signal.SIGKILL)
    starter._server.wait()
    with capture_logs() as logs:
        assert await wait(await start(starter, folder=folder)) == 7
    assert any("fork server has ended" in line["event"] for line in logs)
    await starter.close()
