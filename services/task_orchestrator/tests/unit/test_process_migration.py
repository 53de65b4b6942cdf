"""Migration of a process: its Tasks, its incidents and its history."""

import pytest

from handover.errors import Problem
from handover_bpmn.execution.graph import Plan
from handover_processes.process import interventions
from handover_processes.process.interventions import MigrationReport
from handover_processes.process.process import Process
from handover_processes.records.processes import Act, ActKind
from services.task_orchestrator.tests.unit.drawing import (
    ONE_STEP,
    activity,
    boundary,
    drawing,
    end,
    path,
    start,
    timer,
)
from services.task_orchestrator.tests.unit.process_driver import (
    OneDefinition,
    ProcessDriver,
    alerts,
    created,
    only_process,
    task_id,
)

TWO_STEPS = start() + activity("work") + activity("check") + end() + path("start", "work", "check", "end")
RENAMED = start() + activity("weld") + end() + path("start", "weld", "end")


def migrate(
    driver: ProcessDriver,
    body: str,
    version: int = 2,
    *,
    mapping: dict[str, str] | None = None,
    dry: bool = False,
) -> MigrationReport:
    plan = Plan(only_process(drawing(body)), version)
    act = Act(driver.now, ActKind.MIGRATE, "Ann", why="a check is missing", mapping=mapping)
    return interventions.migrate(driver.process, plan, act, driver.next_step(), driver.now, dry=dry)


def test_an_open_task_stays_and_its_performer_gets_no_message() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "inProgress")
    report = migrate(driver, TWO_STEPS)
    assert report.is_possible
    assert driver.step.messages == []
    assert driver.open == ["work-1"]
    assert driver.process.record.version == 2
    assert driver.process.record.acts == (
        Act(driver.now, ActKind.MIGRATE, "Ann", to="2", why="a check is missing"),
    )
    driver.receive("work-1", "completed")
    assert driver.open == ["check-1"]


def test_a_check_changes_nothing() -> None:
    driver = ProcessDriver(ONE_STEP)
    before = driver.process.record
    report = migrate(driver, RENAMED, dry=True)
    assert not report.is_possible
    (finding,) = report.findings
    assert report.tasks[finding.token or ""] == task_id("work-1")
    assert migrate(driver, RENAMED, mapping={"work": "weld"}, dry=True).is_possible
    assert driver.process.record is before
    assert not driver.step


def test_a_process_that_cannot_be_migrated_stays_as_it_is() -> None:
    driver = ProcessDriver(ONE_STEP)
    before = driver.process.record
    assert not migrate(driver, RENAMED).is_possible
    assert driver.process.record is before
    assert not driver.step.touched
    driver.receive("work-1", "completed")
    assert driver.open == []


def test_a_renamed_task_keeps_its_id_and_an_incident_knows_it() -> None:
    driver = ProcessDriver(ONE_STEP)
    migrate(driver, RENAMED, mapping={"work": "weld"})
    assert driver.process.tasks[task_id("work-1")].element == "weld"
    driver.receive("work-1", "failed", reason="no")
    (incident,) = driver.process.record.incidents
    assert (incident.element, incident.task) == ("weld", task_id("work-1"))
    token = interventions.incident_of(driver.process, task_id("work-1"))
    interventions.mend(
        driver.process, Act(driver.now, ActKind.RETRY, "Ann"), token, driver.next_step(), driver.now
    )
    assert created(driver.step) == [task_id("weld-2")]


def test_an_incident_stays_the_same_and_raises_no_second_alert() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "failed", reason="no")
    (before,) = driver.process.record.incidents
    migrate(driver, RENAMED, mapping={"work": "weld"})
    (present,) = driver.process.record.incidents
    assert (present.element, present.name, present.since) == ("weld", "weld", before.since)
    assert present.task == task_id("work-1")
    assert alerts(driver.step) == []


def test_a_timer_of_the_new_version_starts_at_the_migration() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.after(minutes=5)
    late = boundary("late", "work", timer("PT1M")) + path("late", "end")
    (finding,) = migrate(driver, ONE_STEP + late).findings
    assert finding.element == "late"
    assert driver.process.run is not None
    assert driver.process.run.next_due() == driver.after(minutes=1)


def test_a_restored_process_continues_in_its_new_version() -> None:
    driver = ProcessDriver(ONE_STEP)
    migrate(driver, TWO_STEPS)
    record, tasks = driver.process.record, tuple(driver.process.tasks.values())
    plan = driver.process.plan
    driver.process = Process.resume(driver.process.settings, plan, record, tasks, OneDefinition(plan))
    driver.receive("work-1", "completed")
    assert driver.open == ["check-1"]


def test_an_ended_process_and_the_same_version_are_refused() -> None:
    driver = ProcessDriver(ONE_STEP)
    with pytest.raises(Problem, match="version 1 already"):
        migrate(driver, ONE_STEP, 1)
    interventions.cancel(driver.process, "Ann", driver.next_step(), driver.now)
    with pytest.raises(Problem, match="failed already"):
        migrate(driver, TWO_STEPS)
