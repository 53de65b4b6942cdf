"""With a full disk a refused act has changed nothing, and what only lowers is carried out all the same."""

from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient
from services.gesture_controller.tests.integration.conftest import Bench
from services.task_orchestrator.tests.integration.cell import Cell as OrchestratorCell
from services.task_orchestrator.tests.integration.cell import cell as orchestrator_cell
from services.task_orchestrator.tests.integration.rest import XML
from services.task_orchestrator.tests.unit.drawing import activity, drawing, path
from tests.kit.cell import Cell, new_cell
from tests.kit.ports import next_free_port
from tests.kit.small_disk import SmallDisk, small_disk
from tests.kit.waiting import until, wait_for

MAX_TRIES = 5_000
MAX_ACTS = 8
"""Requests until a database has used what it had reserved."""


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[SmallDisk]:
    with small_disk(tmp_path / "disk") as made:
        yield made


@pytest.fixture
def at_glove(tmp_path: Path, disk: SmallDisk) -> Iterator[Cell]:
    """A cell whose gesture controller has a disk of its own."""
    with new_cell(tmp_path) as made:
        made.start("context_broker")
        made.extra |= {"HANDOVER_DATA_DIR": str(disk.folder), "HANDOVER_SILENCE_S": "600"}
        made.start("gesture_controller")
        yield made


@pytest.fixture
async def bench(at_glove: Cell) -> AsyncIterator[Bench]:
    async with BrokerClient(at_glove.settings) as broker:
        made = Bench(at_glove, broker)
        yield made
        made.screen.close()


def fill(disk: SmallDisk, bench: Bench) -> httpx.Response:
    """Fill the disk until a change is refused; return the refusal."""
    for _ in range(MAX_TRIES):
        disk.fill()
        answer = bench.screen.put("/gloves/glove-1/modes", json={"filtering": True})
        if answer.status_code != 200:
            return answer
    raise AssertionError("the disk is never full")


def outcomes(screen: httpx.Client, action: str) -> list[str]:
    records = screen.get("/audit", params={"action": action, "limit": 500}).raise_for_status().json()
    return [record["outcome"] for record in records]


@pytest.mark.nightly
async def test_a_refused_confirmation_does_not_count_and_a_pause_does(bench: Bench, disk: SmallDisk) -> None:
    bench.screen.put("/gloves/glove-1", json={"hand": "right"}).raise_for_status()
    task = await bench.put("confirm", description="Confirm that the part lies free", commandId=3)

    async def is_asked() -> bool:
        return await bench.status(task) == "inProgress"

    await until(is_asked, why="the Task is not asked")
    assert fill(disk, bench).json()["title"] == "Not recorded"

    for outcome in ("ok", "notGood", "problem"):
        refused = bench.press("complete", by="Anna", outcome=outcome)
        assert (refused.status_code, refused.json()["title"]) == (503, "Not recorded")
        assert bench.view()["task"] is not None, "it is still asked"
    assert await bench.status(task) == "inProgress"

    paused = bench.press("pause")
    assert (paused.status_code, paused.json()["recorded"]) == (200, False)
    assert paused.headers["Handover-Recorded"] == "false"
    assert bench.view()["paused"] is True

    async def is_paused() -> bool:
        return await bench.status(task) == "paused"

    await until(is_paused, why="the Task is not paused")
    assert bench.press("resume").status_code == 503, "what does not lower is refused"
    assert await bench.status(task) == "paused"

    disk.free()
    wait_for(lambda: outcomes(bench.screen, "/pause") == ["done"], why="the pause is never recorded")
    assert set(outcomes(bench.screen, "/complete")) <= {"failed"}, "a refusal may be recorded, too"
    resumed = bench.press("resume")
    assert (resumed.status_code, resumed.json().get("recorded")) == (200, None)
    await until(is_asked, why="the Task does not continue")
    assert bench.press("complete", by="Anna").status_code == 200

    async def is_completed() -> bool:
        return await bench.status(task) == "completed"

    await until(is_completed, why="the Task is not completed")
    assert (await bench.outputs(task))["outcome"] == "ok"
    assert outcomes(bench.screen, "/complete")[0] == "done"
    verified = bench.screen.get("/audit/verification").json()
    assert (verified["fault"], verified["withoutOutcome"]) == (None, [])


WORK = drawing(
    '<bpmn:startEvent id="start"/>'
    + activity("work")
    + '<bpmn:endEvent id="end"/>'
    + path("start", "work", "end")
)


@pytest.fixture
def at_orchestrator(tmp_path: Path, disk: SmallDisk) -> Iterator[OrchestratorCell]:
    """A cell whose orchestrator has its database on a disk of its own."""
    database = f"sqlite:///{disk.folder / 'orchestrator.db'}"
    with orchestrator_cell(tmp_path, next_free_port, database) as made:
        yield made


def fill_until_refused(api: httpx.Client, disk: SmallDisk) -> int:
    """Fill the disk until no process can be started; return how many were started meanwhile."""
    for started in range(MAX_TRIES):
        disk.fill()
        answer = api.post("/processes", json={"definition": "p"})
        if answer.status_code != 201:
            assert (answer.status_code, answer.json()["title"]) == (503, "Not written")
            return started
    raise AssertionError("the disk is never full")


def requested(cell: OrchestratorCell, process: str) -> list[Any]:
    """Return what the open Tasks of a process are asked to do."""
    return [task.get("requestedStatus", {}).get("value") for task in cell.tasks(process)]


@pytest.mark.nightly
@pytest.mark.parametrize(("act", "wanted"), [("pause", "paused"), ("cancel", "cancelled")])
def test_a_process_is_paused_and_cancelled_on_a_full_disk_and_continued_by_nothing(
    at_orchestrator: OrchestratorCell, disk: SmallDisk, act: str, wanted: str
) -> None:
    cell, api = at_orchestrator, at_orchestrator.api
    cell.script_file.write_text('{"work-1": {"after_s": 3600}}')
    deployed = api.post("/definitions", content=WORK, headers=XML)
    assert deployed.status_code == 201, deployed.text
    acts, count = 0, 0
    recorded: bool | None = None
    while recorded is not False:
        # What is smaller than a new process may still have room in the log of the database: once more then.
        disk.free()
        process = cell.start("p")
        wait_for(lambda process=process: len(cell.tasks(process)) == 1, why="no Task is posted")
        count += 1 + fill_until_refused(api, disk)
        assert len(api.get("/processes", params={"limit": 1000}).json()) == count
        lowered = api.post(f"/processes/{process}/{act}", json={"by": "Anna"})
        assert lowered.status_code == 200, lowered.text
        recorded, acts = lowered.json().get("recorded"), acts + 1
        assert acts < MAX_ACTS, "every act was written"
    wait_for(lambda: requested(cell, process) == [wanted], why="the Task is not asked to stop")
    again = api.post(f"/processes/{process}/resume", json={"by": "Anna"})
    assert again.status_code == 503, "what does not lower is refused"
    assert requested(cell, process) == [wanted]

    disk.free()
    ended = {"paused": "paused", "cancelled": "failed"}[wanted]
    wait_for(lambda: cell.look(process)["status"] == ended, why="the act is never written")
    actions = {"action": f"/{act}", "limit": 500}
    wait_for(
        lambda: [one["outcome"] for one in api.get("/audit", params=actions).json()] == ["done"] * acts,
        why="each act is not recorded once",
    )
    assert requested(cell, process) == [wanted]
    assert api.get("/audit/verification").json()["fault"] is None
