"""The demonstration: `handover demo` in a terminal."""

import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from tests.kit.cell import MODULES
from tests.kit.namesakes import leave_namesakes_in
from tests.kit.ports import next_free_port
from tests.kit.sockets import listening_sockets
from tests.kit.waiting import scaled

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

SERVICES = {
    "context_broker",
    "task_orchestrator",
    "gesture_controller",
    "trajectory_tool",
    "device_gateway",
    "alert_router",
    "study",
    "human_state",
    "accounts",
    "webui",
}
SERVICE_OF = {module: service for service, module in MODULES.items()}

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def handover(cell: Any) -> Iterator[Start]:
    """Start the command line as a person would, in a folder of theirs; what still runs is stopped."""
    started: list[subprocess.Popen[str]] = []
    leave_namesakes_in(cell.data_dir)

    def start(*words: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [Path(sys.executable).with_name("handover"), *words],
            env=cell.environment,
            cwd=cell.data_dir,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.terminate()
        process.communicate(timeout=scaled(120))


def read_until_ready(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    assert any(line.startswith("ready") for line in process.stdout)


def services_of(process: subprocess.Popen[str]) -> dict[str, psutil.Process]:
    """The processes that a running command has started, by the folder of the service."""
    found = {}
    for child in psutil.Process(process.pid).children(recursive=True):
        words = " ".join(child.cmdline()).split()
        module = words[words.index("-m") + 1]
        found[SERVICE_OF.get(module, module)] = child
    found.pop("handover_cell.launching.fork_server", None)
    return found


TASK_BY_TASK = (
    ("scan", "trajectory_tool"),
    ("is asked", "task_orchestrator"),
    ("pick", "context_broker"),
    ("place", "gesture_controller"),
    ("home", "context_broker"),
)
TWICE_IN_A_TASK = (
    ("pick", "task_orchestrator"),
    ("pick", "trajectory_tool"),
    ("place", "trajectory_tool"),
    ("place", "webui"),
)
"""Services that are killed when the next line of the demo has these words."""


def run_with_kills(
    handover: Start, data_dir: Path | None, killed: tuple[tuple[str, str], ...]
) -> tuple[int, str]:
    """Return status and output of a demo in which services are killed."""
    folder = ("--data-dir", str(data_dir)) if data_dir else ()
    process = handover("demo", "--once", "--timeout", "150", *folder)
    assert process.stdout is not None
    output = []
    left = list(killed)
    for line in process.stdout:
        output.append(line)
        if left and left[0][0] in line:
            services_of(process)[left.pop(0)[1]].kill()
    return process.wait(timeout=scaled(180)), "".join(output)


def require_completed_once(status: int, output: str, kills: int) -> None:
    assert status == 0, output
    assert output.count("SIGKILL") == kills, output
    assert "process   completed" in output
    assert output.count("pick done") == 1, output
    assert output.count("place done") == 1, output


@pytest.mark.nightly
def test_the_demo_completes_and_runs_again_on_the_same_data_while_services_are_killed(
    handover: Start, cell: Any
) -> None:
    data_dir = cell.data_dir / "data"
    process = handover("demo", "--once", "--data-dir", str(data_dir))
    output, _ = process.communicate(timeout=scaled(180))
    require_completed_once(process.returncode, output, 0)
    assert "no part found" in output
    assert ", part found" in output
    gestures = set(re.findall(r"showed ([A-Z].*?) for", output))
    assert len(gestures) >= 4, output
    require_completed_once(*run_with_kills(handover, data_dir, TASK_BY_TASK), len(TASK_BY_TASK))


@pytest.mark.nightly
def test_the_demo_ends_at_once_if_an_incident_of_an_earlier_process_holds_the_robot(
    handover: Start, cell: Any, eventually: Callable[..., None]
) -> None:
    first = handover("demo")
    assert first.stdout is not None
    assert any("Everything keeps running" in line for line in first.stdout)
    started = handover("process", "start", "bin-picking", "--set", "bin=bin-9")
    output, _ = started.communicate(timeout=scaled(60))
    assert started.returncode == 0, output
    with httpx.Client(
        base_url=f"http://127.0.0.1:{cell.ports['task_orchestrator']}", trust_env=False
    ) as http:

        def has_incident() -> bool:
            return any(each["incidents"] for each in http.get("/processes").json())

        eventually(has_incident, 60)
    first.send_signal(signal.SIGINT)
    assert first.wait(timeout=scaled(60)) == 0
    process = handover("demo", "--once")
    output, _ = process.communicate(timeout=scaled(120))
    assert process.returncode == 2, output
    assert "there is no bin" in output
    assert re.search(r"process retry bin-picking-\w+ \d+ --by YOU", output), output


@pytest.mark.nightly
def test_with_a_broker_of_somewhere_else_none_is_started(handover: Start, cell: Any) -> None:
    cell.start("context_broker")
    cell.extra = {"HANDOVER_BROKER_PORT": str(next_free_port())}
    process = handover("demo", "--once", "--timeout", "150")
    output, _ = process.communicate(timeout=scaled(200))
    assert process.returncode == 0, output
    assert "context-broker" not in output
    assert "context-broker" not in {one.stem for one in (cell.data_dir / "logs").iterdir()}


@pytest.mark.nightly
def test_services_that_are_killed_twice_in_a_task_are_restarted(handover: Start) -> None:
    require_completed_once(*run_with_kills(handover, None, TWICE_IN_A_TASK), len(TWICE_IN_A_TASK))


def test_ctrl_c_stops_everything(handover: Start, cell: Any) -> None:
    process = handover("up")
    read_until_ready(process)
    services = services_of(process)
    assert services.keys() == SERVICES
    listening = listening_sockets([process.pid])
    assert [one for one in listening if one.address != "127.0.0.1"] == []
    assert {one.port for one in listening} == {cell.ports[name] for name in (*SERVICES, "glove", "devices")}
    children = list(services.values())
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=120) == 0
    assert not any(child.is_running() for child in children)


@pytest.mark.nightly
def test_no_service_outlives_a_killed_launcher(handover: Start, eventually: Callable[..., None]) -> None:
    process = handover("up")
    read_until_ready(process)
    children = list(services_of(process).values())
    process.kill()
    process.wait(timeout=120)
    eventually(lambda: not any(child.is_running() for child in children), 15)


@pytest.mark.parametrize(
    ("taken", "setting"),
    [("gesture_controller", "HANDOVER_CONTROLLER_PORT"), ("glove", "HANDOVER_GLOVE_PORT")],
)
def test_a_port_in_use_is_reported_in_one_line(handover: Start, cell: Any, taken: str, setting: str) -> None:
    with socket.create_server(("127.0.0.1", cell.ports[taken])):
        process = handover("demo", "--once")
        said, _ = process.communicate(timeout=scaled(120))
    assert process.returncode == 2
    complaint = said.strip().splitlines()[-1]
    assert str(cell.ports[taken]) in complaint
    assert setting in complaint
    assert "Traceback" not in said


def test_an_unusable_data_directory_is_reported_in_one_line(handover: Start, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a directory")
    process = handover("up", "--data-dir", str(tmp_path / "file"))
    said, _ = process.communicate(timeout=scaled(120))
    assert process.returncode == 2
    assert len(said.strip().splitlines()) == 1
    assert "--data-dir" in said
