"""A Task in progress whose performer is lost: an Alert, and then what its activity says."""

from typing import Any

import pytest

from handover.tasks.outcomes import is_outcome_unknown
from handover_bpmn.notation.faults import BadBpmn
from handover_processes.process import task_troubles
from handover_processes.records.messages import MessageKind
from services.task_orchestrator.tests.unit.drawing import activity, end, path, start
from services.task_orchestrator.tests.unit.process_driver import ProcessDriver, alerts, created, task_id

HOLDER = "trajectory-tool-ur10-1 on cell-3"


def a_process(choice: str | None) -> ProcessDriver:
    attributes = "" if choice is None else f'onPerformerLost="{choice}"'
    return ProcessDriver(
        start() + activity("work", attributes=attributes) + end() + path("start", "work", "end")
    )


def lose(driver: ProcessDriver, name: str = "work-1") -> None:
    task_troubles.performer_lost(driver.process, task_id(name), HOLDER, driver.next_step())


def end_lost(driver: ProcessDriver, name: str = "work-1") -> None:
    task_troubles.end_lost(driver.process, task_id(name), driver.next_step(), driver.after(seconds=30))


def written(driver: ProcessDriver) -> list[Any]:
    return [each.body for each in driver.step.messages if each.kind is MessageKind.APPEND]


def cleared(driver: ProcessDriver) -> list[str]:
    return [each.body["key"] for each in driver.step.messages if each.kind is MessageKind.CLEAR]


@pytest.mark.parametrize("status", ["assigned", "inProgress", "paused"])
def test_an_alert_is_raised_once_and_cleared_when_a_performer_is_back(status: str) -> None:
    driver = a_process(None)
    driver.receive("work-1", status)
    lose(driver)
    (alert,) = alerts(driver.step)
    assert alert["sub_category"] == "taskPerformerLost"
    assert HOLDER in alert["description"]
    lose(driver)
    assert alerts(driver.step) == []
    task_troubles.performer_found(driver.process, task_id("work-1"), driver.next_step())
    assert cleared(driver) == [alert["key"]]
    lose(driver)
    assert len(alerts(driver.step)) == 1


@pytest.mark.parametrize("choice", [None, "ask", "retry", "wait"])
def test_the_end_of_the_task_clears_the_alert(choice: str | None) -> None:
    driver = a_process(choice)
    driver.receive("work-1", "inProgress")
    lose(driver)
    (alert,) = alerts(driver.step)
    driver.receive("work-1", "completed")
    assert alert["key"] in cleared(driver)
    assert driver.process.run is None


@pytest.mark.parametrize("choice", [None, "ask"])
def test_by_default_a_person_is_asked(choice: str | None) -> None:
    driver = a_process(choice)
    driver.receive("work-1", "inProgress")
    lose(driver)
    end_lost(driver)
    (incident,) = driver.process.record.incidents
    assert incident.task == task_id("work-1")
    (change,) = written(driver)
    assert change["status"]["value"] == "failed"
    assert is_outcome_unknown(change["outputParameters"]["value"])
    assert created(driver.step) == []
    assert "processIncident" in {alert["sub_category"] for alert in alerts(driver.step)}


def test_work_that_may_be_done_twice_is_posted_again_until_it_was_tried_too_often() -> None:
    driver = a_process("retry")
    for visit in (1, 2, 3):
        driver.receive(f"work-{visit}", "inProgress")
        lose(driver, f"work-{visit}")
        end_lost(driver, f"work-{visit}")
        assert written(driver)[0]["status"]["value"] == "failed"
        if visit == 3:
            break
        driver.tick()
        assert created(driver.step) == [task_id(f"work-{visit + 1}")]
        assert not driver.process.record.incidents
    assert len(driver.process.record.incidents) == 1


def test_a_task_that_waits_stays_in_progress() -> None:
    driver = a_process("wait")
    driver.receive("work-1", "inProgress")
    lose(driver)
    end_lost(driver)
    assert driver.open == ["work-1"]
    assert driver.step.messages == []
    driver.receive("work-1", "completed")
    assert driver.process.run is None


@pytest.mark.parametrize("status", [None, "assigned"])
def test_a_task_that_was_not_started_is_not_ended(status: str | None) -> None:
    driver = a_process(None)
    if status is not None:
        driver.receive("work-1", status)
    end_lost(driver)
    assert driver.open == ["work-1"]


def test_another_choice_is_refused_by_name() -> None:
    with pytest.raises(BadBpmn, match='onPerformerLost="again" is none of ask, retry, wait'):
        a_process("again")
