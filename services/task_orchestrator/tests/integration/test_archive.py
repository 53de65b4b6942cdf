"""Ended processes leave the broker, and stay in the history, whatever is killed, restored or posted again."""

import random
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text

from handover.database import connect
from services.task_orchestrator.tests.integration.cell import Cell, Member, cell, eventually
from services.task_orchestrator.tests.integration.test_retry import deploy, play, retry, steps
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, activity, end, path, start
from tests.kit.ports import next_free_port

pytestmark = pytest.mark.slow

BROKER_IN_FILES = {"HANDOVER_BROKER_DATABASE_URL": ""}
"""The backup of the broker is a copy of its files, whatever the default database of the tests."""
SHORT = {"HANDOVER_RETENTION_H": "0.0001"}
TWO_STEPS = start() + activity("first") + activity("second") + end() + path("start", "first", "second", "end")


@pytest.fixture(scope="module")
def short_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell(tmp_path_factory.mktemp("cell"), next_free_port, extra=SHORT) as running:
        yield running


@pytest.fixture
def archiving(short_cell: Cell) -> Cell:
    """A cell in which an ended process leaves the broker at once; everybody is up."""
    short_cell.script_file.write_text("{}")
    for member in short_cell.members:
        member.run()
    return short_cell


def urn(process: str) -> str:
    return f"urn:ngsi-ld:Process:demo:{process}"


def gone(running: Cell, *processes: str) -> None:
    """Wait until the broker has neither these processes nor their Tasks, and the orchestrator says so."""

    def is_gone() -> bool:
        return all(
            running.look(process)["archivedAt"]
            and running.entity(urn(process)) is None
            and not running.tasks(process)
            for process in processes
        )

    eventually(is_gone, f"{processes} having left the broker")


def settled(running: Cell, *processes: str) -> None:
    """Wait until nothing about these processes is on its way to the broker."""

    def nothing_waits() -> bool:
        engine = connect(running.database, is_own=False)
        with engine.begin() as database:
            waiting = set(database.scalars(text("SELECT stream FROM orchestrator_outbox")))
        engine.dispose()
        return waiting.isdisjoint(processes)

    eventually(nothing_waits, f"the outbox of {processes} being empty")


def posted(running: Cell, task: dict[str, Any]) -> None:
    assert running.entities.post("", json=task).status_code == 201


@contextmanager
def without_leases(performer: Member) -> Iterator[None]:
    """Let a performer that is started meanwhile act without a lease: no orchestrator could grant one."""
    leased = performer.environment
    performer.environment = {**leased, "HANDOVER_DEVICE_LEASES": "off"}
    try:
        yield
    finally:
        performer.environment = leased


@pytest.mark.nightly
def test_a_finished_process_leaves_the_broker_and_its_history_is_served(archiving: Cell) -> None:
    play(archiving, work_1={"grip": 3})
    deploy(archiving, ONE_STEP)
    process = archiving.start("p", order="A-7")
    before = archiving.ended(process)
    gone(archiving, process)
    after = archiving.look(process)
    assert {**after, "archivedAt": None} == {**before, "archivedAt": None}
    (task,) = after["tasks"]
    assert task["status"] == "completed"
    assert task["outputParameters"] == {"grip": 3}
    assert task["involves"] == ["urn:ngsi-ld:Device:demo:glove-1"]
    assert [move["status"] for move in task["history"]][-1] == "completed"
    listed = archiving.api.get("/processes", params={"status": "completed"}).json()
    assert process in {row["id"] for row in listed}
    assert archiving.api.get("/definitions/p/statistics").json()["elements"]["work"]["completed"] >= 1


def test_a_process_with_an_incident_stays_in_the_broker(archiving: Cell) -> None:
    play(archiving, work_1={"fails": "the part slipped"})
    deploy(archiving, ONE_STEP)
    stuck, other = archiving.start("p"), archiving.start("p")
    seen = archiving.stuck(stuck)
    archiving.stuck(other)
    archiving.api.post(f"/processes/{other}/cancel").raise_for_status()
    gone(archiving, other)
    assert archiving.entity(seen["entity"]) is not None
    retry(archiving, seen)
    archiving.ended(stuck)
    gone(archiving, stuck)


@pytest.mark.nightly
def test_what_was_to_be_deleted_when_the_orchestrator_was_killed_is_deleted_after_it(archiving: Cell) -> None:
    deploy(archiving, ONE_STEP)
    process = archiving.ended(archiving.start("p"))["id"]
    settled(archiving, process)
    archiving.broker.kill()
    eventually(lambda: archiving.look(process)["archivedAt"], "the decision to delete")
    archiving.orchestrator.kill()
    archiving.broker.start()
    archiving.orchestrator.start()
    gone(archiving, process)
    assert steps(archiving, process) == ["work-1"]


@pytest.mark.nightly
def test_killed_at_any_moment_everything_leaves_and_nothing_is_done_twice(archiving: Cell) -> None:
    moments = random.Random(7)
    deploy(archiving, TWO_STEPS)
    processes = []
    for _ in range(5):
        processes += [archiving.start("p") for _ in range(3)]
        victim = moments.choice((archiving.orchestrator, archiving.orchestrator, archiving.broker))
        time.sleep(moments.uniform(0, 1.5))  # not a wait: the moment of the power cut
        victim.kill()
        victim.start()
    for process in processes:
        assert archiving.ended(process)["status"] == "completed"
    gone(archiving, *processes)
    for process in processes:
        assert steps(archiving, process) == ["first-1", "second-1"]


@pytest.mark.nightly
def test_a_task_that_is_posted_again_is_not_performed_and_is_deleted(archiving: Cell) -> None:
    play(archiving, work_1={"grip": 3, "after_s": 1.0})
    deploy(archiving, ONE_STEP)
    process = archiving.start("p")
    (task,) = eventually(lambda: archiving.tasks(process), "the Task")
    archiving.ended(process)
    gone(archiving, process)
    pending = {
        **task,
        "status": {"type": "Property", "value": "pending", "observedAt": "2030-01-01T00:00:00Z"},
    }
    pending.pop("outputParameters", None)
    archiving.orchestrator.kill()  # so that the performer is alone with it
    archiving.performer.kill()
    with without_leases(archiving.performer):
        archiving.performer.start()  # and remembers it only by its records
        posted(archiving, pending)

        def again() -> dict[str, Any] | None:
            seen = archiving.entity(task["id"])
            return seen if seen and seen["status"]["value"] == "completed" else None

        assert eventually(again, "its recorded end")["outputParameters"]["value"] == {"grip": 3}
        assert steps(archiving, process) == ["work-1"]
        archiving.performer.kill()
    archiving.orchestrator.start()  # now it is alone with it
    gone(archiving, process)
    posted(archiving, pending)
    gone(archiving, process)
    archiving.performer.start()
    archiving.orchestrator.kill()  # then whichever of them is faster: the lease is its own until it ends
    posted(archiving, pending)
    archiving.orchestrator.start()
    gone(archiving, process)
    assert archiving.look(process)["status"] == "completed"
    assert steps(archiving, process) == ["work-1"]


@pytest.mark.nightly
@pytest.mark.parametrize("retention", ["gone", "kept"])
def test_a_broker_restored_from_an_old_backup_gets_what_the_orchestrator_has_recorded(
    tmp_path: Path, retention: str
) -> None:
    """The backup holds a pending Task of a process that has ended since."""
    backup = tmp_path / "backup"
    cell_dir = tmp_path / "cell"
    backup.mkdir()
    cell_dir.mkdir()
    extra = BROKER_IN_FILES | (SHORT if retention == "gone" else {})
    with cell(cell_dir, next_free_port, extra=extra) as running:
        play(running, first_1={"grip": 3})
        deploy(running, TWO_STEPS)
        running.performer.kill()
        process = running.start("p")
        eventually(lambda: running.tasks(process), "the first Task")
        settled(running, process)
        running.broker.stop()
        files = [file for file in cell_dir.glob("*broker*") if not file.name.endswith(".log")]
        assert files
        for file in files:
            keep(file, backup / file.name)
        running.broker.start()
        running.performer.start()
        assert running.ended(process)["status"] == "completed"
        settled(running, process)
        if retention == "gone":
            gone(running, process)
        running.performer.kill()
        running.orchestrator.kill()
        for record in cell_dir.glob("scripted.finished.db*"):
            record.unlink()  # not even the performer's records help
        running.broker.stop()
        for file in cell_dir.glob("*broker*"):
            if not file.name.endswith(".log"):
                shutil.rmtree(file) if file.is_dir() else file.unlink()
        for file in backup.iterdir():
            keep(file, cell_dir / file.name)
        running.broker.start()
        assert [task["status"]["value"] for task in running.tasks(process)] == ["pending"]
        running.orchestrator.start()

        def agrees() -> bool:
            if retention == "gone":
                return running.entity(urn(process)) is None and not running.tasks(process)
            entity, tasks = running.entity(urn(process)), running.tasks(process)
            return (
                entity is not None
                and entity["status"]["value"] == "completed"
                and [task["status"]["value"] for task in tasks] == ["completed"]
                and tasks[0]["outputParameters"]["value"] == {"grip": 3}
            )

        eventually(agrees, "the broker showing what the orchestrator has recorded")
        running.performer.start()
        assert steps(running, process) == ["first-1", "second-1"]


def keep(source: Path, target: Path) -> None:
    if source.is_dir():
        shutil.copytree(source, target)
    else:
        shutil.copy2(source, target)
