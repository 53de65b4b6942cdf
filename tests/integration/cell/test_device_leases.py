"""One process acts for a Device: real performers, on two data directories, killed and paused."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.tasks.outcomes import is_outcome_unknown
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start
from tests.kit import processes
from tests.kit.cell import Cell
from tests.kit.databases import DATABASE
from tests.kit.other_broker.running import context_link
from tests.kit.ports import next_free_port
from tests.kit.waiting import scaled, wait_for

pytestmark = pytest.mark.slow

MOTOR = "urn:ngsi-ld:Device:demo:motor-1"
HERE = Path(__file__).parent
LONG = 100_000


class Motor:
    """A process that performs the Tasks of the motor, with a data directory of its own unless given."""

    def __init__(self, cell: Cell, name: str, folder: Path | None = None, **settings: str) -> None:
        self.cell = cell
        self.port = next_free_port()
        self.folder = folder or cell.data_dir / name
        self.folder.mkdir(exist_ok=True)
        self.log_file = cell.data_dir / f"{name}.log"
        self.log_file.touch()
        environment = {
            **cell.environment,
            "HANDOVER_DATA_DIR": str(self.folder),
            "HANDOVER_DEVICE_LEASES": "required",
            "MOTOR_PORT": str(self.port),
            "MOTOR_COMMANDS": str(cell.data_dir / "commands"),
            **settings,
        }
        command = [sys.executable, str(HERE / "motor.py")]
        self.process = processes.spawn(command, environment, self.log_file, self.folder)
        cell.processes[name] = self.process

    @property
    def pid(self) -> int:
        return self.process.pid

    def log(self) -> str:
        return self.log_file.read_text()

    def ready(self) -> httpx.Response | None:
        return processes.answer(self.process, f"http://127.0.0.1:{self.port}/readyz", self.log)

    def wait_ready(self) -> "Motor":
        processes.wait_ready(self.process, f"http://127.0.0.1:{self.port}/readyz", self.log, 60)
        return self

    def wait_standby(self, holder: "Motor") -> "Motor":
        """Wait until it says who holds the motor."""

        def stands_by() -> bool:
            answer = self.ready()
            return answer is not None and f"process {holder.pid} on " in answer.text

        wait_for(stands_by, 60, self.log)
        answer = self.ready()
        assert answer is not None
        assert answer.status_code == 503
        assert "standby: motor" in answer.text
        assert f"process {holder.pid} on " in self.log()
        return self

    def commands(self) -> list[str]:
        """Return the commands that this process has sent."""
        return [line for line in commands(self.cell) if line.startswith(f"{self.pid} ")]

    def wait_moving(self) -> None:
        before = len(self.commands())
        wait_for(lambda: len(self.commands()) > before + 3, 60, self.log)


def commands(cell: Cell) -> list[str]:
    file = cell.data_dir / "commands"
    return file.read_text().splitlines() if file.exists() else []


def post(cell: Cell, name: str, steps: int = 20) -> str:
    task = f"urn:ngsi-ld:Task:demo:{name}"
    body = {
        "id": task,
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:turn"},
        "status": {"type": "Property", "value": "pending"},
        "involves": {"type": "Property", "value": [{"type": "Relationship", "object": MOTOR}]},
        "workParameters": {"type": "Property", "value": {"steps": steps}},
    }
    reply = httpx.post(f"{cell.url('context_broker')}/ngsi-ld/v1/entities", json=body, trust_env=False)
    assert reply.status_code == 201, reply.text
    return task


def read(cell: Cell, task: str) -> dict[str, Any]:
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entities/{task}"
    return httpx.get(url, params={"options": "keyValues"}, trust_env=False).json()  # type: ignore[no-any-return]


def comes_to(cell: Cell, task: str, status: str, why: Callable[[], str] = lambda: "") -> dict[str, Any]:
    wait_for(lambda: read(cell, task)["status"] == status, 60, lambda: f"{read(cell, task)} {why()}")
    return read(cell, task)


@pytest.fixture(params=["sqlite", "postgresql"])
def shop(request: pytest.FixtureRequest, cell: Cell) -> Iterator[Cell]:
    """A broker and an orchestrator, whose database is a file or on a server."""
    if request.param == "postgresql":
        cell.extra["HANDOVER_DATABASE_URL"] = request.getfixturevalue("new_database")()
    elif DATABASE != "sqlite":
        pytest.skip("the other parameter is the database of this run")
    cell.start("context_broker", "task_orchestrator")
    yield cell
    for process in cell.processes.values():
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)


@pytest.mark.nightly
def test_a_second_performer_says_who_holds_the_device_and_takes_over_from_a_killed_one(shop: Cell) -> None:
    first = Motor(shop, "first").wait_ready()
    second = Motor(shop, "second").wait_standby(first)
    comes_to(shop, post(shop, "one"), "completed", first.log)
    assert len(commands(shop)) == len(first.commands()) == 20
    processes.kill(first.process)
    killed_s = time.monotonic()
    second.wait_ready()
    print(f"a killed holder was replaced after {time.monotonic() - killed_s:.1f} s")
    comes_to(shop, post(shop, "two"), "completed", second.log)
    assert len(second.commands()) == 20
    leases = httpx.get(f"{shop.url('task_orchestrator')}/device-leases", trust_env=False).json()
    (lease,) = [one for one in leases if one["device"] == MOTOR]
    assert lease["holder"]["pid"] == second.pid
    assert lease["number"] > 1


@pytest.mark.nightly
def test_a_paused_holder_sends_nothing_after_it_was_replaced(shop: Cell) -> None:
    """And it does not report over the end that the new holder has written."""
    first = Motor(shop, "first").wait_ready()
    second = Motor(shop, "second").wait_standby(first)
    interrupted = post(shop, "interrupted", LONG)
    first.wait_moving()
    os.kill(first.pid, signal.SIGSTOP)
    ended = comes_to(shop, interrupted, "failed", second.log)
    assert is_outcome_unknown(ended["outputParameters"])
    comes_to(shop, post(shop, "next", 10), "completed", second.log)
    before = len(first.commands())
    os.kill(first.pid, signal.SIGCONT)
    first.wait_standby(second)
    comes_to(shop, post(shop, "last", 10), "completed", second.log)
    assert len(first.commands()) - before <= 1, "more than the command that was on its way"
    assert read(shop, interrupted)["outputParameters"] == ended["outputParameters"]
    assert len(second.commands()) == 20, "nothing of the interrupted Task was executed again"


@pytest.mark.nightly
def test_a_short_outage_of_the_orchestrator_stops_nothing_and_a_long_one_pauses(cell: Cell) -> None:
    cell.start("context_broker", "task_orchestrator")
    motor = Motor(cell, "first").wait_ready()
    task = post(cell, "long", LONG)
    motor.wait_moving()
    cell.restart("task_orchestrator")
    motor.wait_moving()
    assert "paused" not in motor.log()
    cell.kill("task_orchestrator")
    comes_to(cell, task, "paused", motor.log)
    count = len(motor.commands())
    cell.start("task_orchestrator")
    comes_to(cell, task, "inProgress", motor.log)
    motor.wait_moving()
    assert len({line.split()[2] for line in motor.commands()}) == len(motor.commands()) > count


@pytest.mark.nightly
def test_a_restarted_performer_has_its_lease_at_once(cell: Cell) -> None:
    """It replaces the process before it: the folder proves that it has ended."""
    cell.start("context_broker", "task_orchestrator")
    first = Motor(cell, "first").wait_ready()
    processes.kill(first.process)
    again = Motor(cell, "again", first.folder)
    again.wait_ready()
    assert "standby" not in again.log()
    comes_to(cell, post(cell, "one"), "completed", again.log)


@pytest.mark.nightly
def test_a_second_performer_on_the_same_folder_names_the_first(cell: Cell) -> None:
    cell.start("context_broker", "task_orchestrator")
    first = Motor(cell, "first").wait_ready()
    second = Motor(cell, "second", first.folder)
    assert second.process.wait(scaled(60)) == 2
    assert f"process {first.pid} on " in second.log()


@pytest.mark.nightly
@pytest.mark.parametrize("repeats", ["no", "yes"])
def test_a_started_task_is_executed_again_only_where_its_performer_permits(cell: Cell, repeats: str) -> None:
    """After kill -9, with the same folder; the default of a stranger's performer is never."""
    cell.start("context_broker", "task_orchestrator")
    first = Motor(cell, "first", MOTOR_REPEATS=repeats).wait_ready()
    task = post(cell, "one", 200)
    first.wait_moving()
    processes.kill(first.process)
    again = Motor(cell, "again", first.folder, MOTOR_REPEATS=repeats).wait_ready()
    if repeats == "yes":
        comes_to(cell, task, "completed", again.log)
        assert len(again.commands()) == 200
    else:
        ended = comes_to(cell, task, "failed", again.log)
        assert is_outcome_unknown(ended["outputParameters"])
        assert not again.commands()


@pytest.mark.nightly
@pytest.mark.parametrize(("mode", "acts"), [("auto", True), ("off", True), ("required", False)])
def test_the_setting_decides_in_a_cell_without_an_orchestrator(cell: Cell, mode: str, acts: bool) -> None:
    cell.start("context_broker")
    motor = Motor(cell, "first", HANDOVER_DEVICE_LEASES=mode)
    task = post(cell, "one")
    if acts:
        comes_to(cell, task, "completed", motor.log)
        return

    def is_refused() -> bool:
        answer = motor.ready()
        return answer is not None and "no lease of" in answer.text

    wait_for(is_refused, 60, motor.log)
    assert read(cell, task)["status"] == "pending"
    cell.start("task_orchestrator")
    comes_to(cell, task, "completed", motor.log)


@pytest.mark.nightly
def test_a_performer_that_once_had_a_lease_does_not_act_without_the_orchestrator(cell: Cell) -> None:
    """In the mode `auto`, also after a restart: another performer may hold the Device."""
    cell.start("context_broker", "task_orchestrator")
    first = Motor(cell, "first", HANDOVER_DEVICE_LEASES="auto").wait_ready()
    processes.kill(first.process)
    cell.kill("task_orchestrator")
    again = Motor(cell, "again", first.folder, HANDOVER_DEVICE_LEASES="auto")

    def is_refused() -> bool:
        answer = again.ready()
        return answer is not None and "no lease of" in answer.text

    wait_for(is_refused, 60, again.log)
    task = post(cell, "one")
    cell.start("task_orchestrator")
    comes_to(cell, task, "completed", again.log)


def start_process(cell: Cell, choice: str, steps: int) -> str:
    """Start a process whose only activity turns the motor; return its id."""
    task = activity(
        "turn",
        f'<handover:parameter name="steps" value="{steps}"/>',
        attributes=f'onPerformerLost="{choice}"',
    ).replace("Device:glove-1", "Device:motor-1")
    file = drawing(start() + task + end() + path("start", "turn", "end"))
    with httpx.Client(base_url=cell.url("task_orchestrator"), trust_env=False) as api:
        headers = {"Content-Type": "application/xml"}
        assert api.post("/definitions", content=file, headers=headers).status_code == 201
        started = api.post("/processes", json={"definition": "p"})
        assert started.status_code == 201, started.text
        return str(started.json()["id"])


def alerts_of(cell: Cell, kind: str) -> list[dict[str, Any]]:
    """Return the Alerts of a subcategory that are not cleared."""
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
    parameters = {"type": "Alert", "options": "keyValues"}
    found = httpx.get(url, params=parameters, headers={"Link": context_link()}, trust_env=False).json()
    return [
        one for one in found if one.get("subCategory") == kind and one.get("alertState") != "returnedToNormal"
    ]


@pytest.mark.nightly
@pytest.mark.parametrize("choice", ["ask", "retry", "wait"])
def test_a_performer_that_dies_in_progress_is_an_alert_and_then_what_the_definition_says(
    cell: Cell, choice: str
) -> None:
    cell.extra["HANDOVER_PERFORMER_GRACE_S"] = "1"
    cell.start("context_broker", "task_orchestrator")
    first = Motor(cell, "first").wait_ready()
    process = start_process(cell, choice, 150)
    first.wait_moving()
    processes.kill(first.process)
    wait_for(lambda: alerts_of(cell, "taskPerformerLost"), 60, lambda: cell.log("task_orchestrator"))

    def shown() -> dict[str, Any]:
        url = f"{cell.url('task_orchestrator')}/processes/{process}"
        return httpx.get(url, trust_env=False).json()  # type: ignore[no-any-return]

    if choice == "ask":
        wait_for(lambda: shown()["incidents"], 60, lambda: str(shown()))
        wait_for(lambda: alerts_of(cell, "processIncident"), 60)
        wait_for(lambda: not alerts_of(cell, "taskPerformerLost"), 60)
    if choice == "retry":  # a performer that is back before the grace period is over decides by itself
        wait_for(lambda: len(shown()["tasks"]) == 2, 60, lambda: str(shown()))
    again = Motor(cell, "again", first.folder, MOTOR_REPEATS="yes" if choice == "wait" else "no").wait_ready()
    if choice == "ask":
        assert shown()["incidents"]
        assert not again.commands(), "a person decides first"
        return
    wait_for(lambda: shown()["status"] == "completed", 60, lambda: str(shown()))
    assert len(again.commands()) == 150
    wait_for(lambda: not alerts_of(cell, "taskPerformerLost"), 60)
