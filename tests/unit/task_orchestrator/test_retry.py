"""Retry: a process that a failed Task has ended goes on, with new Tasks, and nothing is done twice."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datamodels.entities import TaskStatus
from handover.errors import Problem
from services.task_orchestrator.process import Process
from services.task_orchestrator.records import Act, ActKind, MessageKind, ProcessRecord, Step, TaskRecord
from tests.unit.task_orchestrator.drawing import (
    ONE_STEP,
    activity,
    boundary,
    end,
    flow,
    gateway,
    path,
    start,
    timer,
)
from tests.unit.task_orchestrator.process_driver import ProcessDriver, alerts, created, processes, task_id

BRANCHES = (
    start()
    + gateway("fork", "parallel")
    + activity("a")
    + activity("b")
    + gateway("join", "parallel")
    + activity("last")
    + end()
    + path("start", "fork", "a", "join", "last", "end")
    + path("fork", "b", "join")
)


def retry(driver: ProcessDriver, name: str, by: str = "Ann") -> None:
    driver.after(seconds=1)
    driver.process.retry(task_id(name), by, driver.next_step(), driver.now)


def cleared(step: Step) -> list[str]:
    return [message.body["key"] for message in step.messages if message.kind is MessageKind.CLEAR]


def test_a_retried_task_is_a_new_one_and_the_process_goes_on() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "failed", reason="the part slipped")
    assert driver.process.record.failed_by == task_id("work-1")
    (alert,) = alerts(driver.step)
    retry(driver, "work-1")
    assert created(driver.step) == [task_id("work-2")]
    assert cleared(driver.step) == [alert["key"]]
    record = driver.process.record
    assert (record.status, record.reason, record.ended_at, record.failed_by) == (
        TaskStatus.IN_PROGRESS,
        None,
        None,
        None,
    )
    assert record.acts == (Act(driver.now, ActKind.RETRY, "Ann", task_id("work-1")),)
    reported = processes(driver.step)[-1]
    assert reported["status"]["value"] == "inProgress"
    assert reported["outputParameters"]["value"] == {}
    assert [link["object"] for link in reported["isComposedOf"]["value"]] == [
        task_id("work-1"),
        task_id("work-2"),
    ]
    driver.after(seconds=1)
    assert not driver.receive("work-1", "completed")
    assert driver.receive("work-2", "completed")
    assert driver.process.record.status is TaskStatus.COMPLETED
    assert driver.process.record.state is None


def test_it_can_fail_and_be_retried_again_and_again() -> None:
    driver = ProcessDriver(ONE_STEP)
    for n in range(1, 4):
        driver.after(seconds=1)
        driver.receive(f"work-{n}", "failed", reason="no")
        assert [alert["sub_category"] for alert in alerts(driver.step)] == ["processFailed"]
        retry(driver, f"work-{n}")
    assert driver.open == ["work-4"]
    assert len(driver.process.record.acts) == 3


def test_a_cancelled_task_is_posted_again_once_it_has_ended() -> None:
    driver = ProcessDriver(BRANCHES)
    driver.receive("b-1", "inProgress")
    driver.receive("a-1", "failed", reason="no")
    retry(driver, "a-1")
    assert created(driver.step) == [task_id("a-2")]
    assert driver.open == ["a-2", "b-1"]
    driver.receive("b-1", "failed", reason="cancelled")
    assert created(driver.step) == [task_id("b-2")]
    driver.receive("a-2", "completed")
    driver.receive("b-2", "completed")
    assert driver.open == ["last-1"]


def test_a_cancelled_task_that_has_ended_is_posted_again_at_once() -> None:
    driver = ProcessDriver(BRANCHES)
    driver.receive("a-1", "failed", reason="no")
    driver.after(seconds=6)
    driver.tick()
    assert driver.process.over
    retry(driver, "a-1")
    assert created(driver.step) == [task_id("a-2"), task_id("b-2")]


@pytest.mark.parametrize("when", ["before the retry", "after the retry"])
def test_what_was_completed_though_called_back_is_not_done_twice(when: str) -> None:
    driver = ProcessDriver(BRANCHES)
    driver.receive("b-1", "inProgress")
    driver.receive("a-1", "failed", reason="no")
    if when == "before the retry":
        driver.receive("b-1", "completed", weight=3)
    retry(driver, "a-1")
    if when == "after the retry":
        driver.receive("b-1", "completed", weight=3)
    assert driver.open == ["a-2"]
    driver.receive("a-2", "completed")
    assert driver.open == ["last-1"]
    assert driver.process.record.variables["b"] == {"weight": 3}


def test_a_branch_that_failed_after_the_process_is_posted_again_too() -> None:
    driver = ProcessDriver(BRANCHES)
    driver.receive("b-1", "inProgress")
    driver.receive("a-1", "failed", reason="no")
    driver.receive("b-1", "failed", reason="the part slipped")
    retry(driver, "a-1")
    assert driver.open == ["a-2", "b-2"]


def test_a_boundary_timer_restarts_with_its_activity() -> None:
    late = boundary("late", "work", timer("PT1M")) + activity("other") + path("late", "other", "end")
    driver = ProcessDriver(ONE_STEP + late)
    driver.after(seconds=50)
    driver.receive("work-1", "failed", reason="no")
    driver.after(hours=1)
    retry(driver, "work-1")
    assert driver.open == ["work-2"]
    driver.after(seconds=59)
    driver.tick()
    assert driver.open == ["work-2"]
    driver.after(seconds=1)
    driver.tick()
    assert "other-1" in driver.open


def test_a_timer_elsewhere_has_gone_on_meanwhile() -> None:
    wait = f'<bpmn:intermediateCatchEvent id="wait">{timer("PT1H")}</bpmn:intermediateCatchEvent>'
    body = start() + gateway("fork", "parallel") + activity("a") + activity("b") + wait + end()
    body += path("start", "fork", "a", "end") + path("fork", "wait", "b", "end")
    driver = ProcessDriver(body)
    driver.receive("a-1", "failed", reason="no")
    driver.after(hours=2)
    retry(driver, "a-1")
    assert driver.open == ["a-2", "b-1"]


def refusal(driver: ProcessDriver, name: str) -> Problem:
    before = driver.process.record
    with pytest.raises(Problem) as refused:
        retry(driver, name)
    assert not driver.step
    assert not driver.step.touched
    assert driver.process.record is before
    return refused.value


def test_a_task_of_another_process_cannot_be_retried() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "failed", reason="no")
    assert refusal(driver, "nothing-1").status == 404


def test_a_process_that_runs_or_completed_cannot_be_retried() -> None:
    driver = ProcessDriver(ONE_STEP)
    assert "p-1 is inProgress" in refusal(driver, "work-1").detail
    driver.receive("work-1", "completed")
    assert "p-1 is completed" in refusal(driver, "work-1").detail


def test_a_cancelled_process_cannot_be_retried() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.process.cancel("Ann", driver.next_step(), driver.now)
    assert driver.process.record.acts == (Act(driver.now, ActKind.CANCEL, "Ann"),)
    refused = refusal(driver, "work-1")
    assert (refused.status, "(cancelled by Ann)" in refused.detail) == (409, True)
    assert driver.process.record.state is None


def test_what_failed_by_an_expression_cannot_be_retried() -> None:
    body = start() + activity("work") + gateway("which", default="which_end") + activity("more") + end()
    body += path("start", "work", "which", "end") + flow("which", "more", "nothing") + path("more", "end")
    driver = ProcessDriver(body)
    driver.receive("work-1", "completed")
    assert driver.process.record.status is TaskStatus.FAILED
    assert "nothing" in refusal(driver, "work-1").detail
    assert driver.process.record.state is None


def test_only_the_task_that_ended_the_process_can_be_retried() -> None:
    driver = ProcessDriver(BRANCHES)
    driver.receive("a-1", "failed", reason="no")
    assert task_id("a-1") in refusal(driver, "b-1").detail


def test_a_state_that_this_release_cannot_read_is_refused() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "failed", reason="no")
    driver.process._revise(state=b'{"version":99}')
    assert "format 99" in refusal(driver, "work-1").detail


class Long:
    """A driver whose process may be restored from its records at any time, as after a crash."""

    def __init__(self, body: str) -> None:
        self.driver = ProcessDriver(body)
        self.tasks: dict[str, TaskRecord] = {}
        self.record: ProcessRecord | None = None
        self.write()

    def write(self) -> None:
        self.tasks.update(self.driver.step.tasks)
        self.record = self.driver.step.processes.get("p-1", self.record)

    def crash(self) -> None:
        assert self.record is not None
        before = self.driver.process
        self.driver.process = Process.resume(before.settings, before.plan, self.record, self.tasks.values())


@settings(max_examples=3 * settings.default.max_examples)
@given(choices=st.data())
def test_whatever_fails_and_is_retried_everything_is_done_once(choices: st.DataObject) -> None:
    long = Long(BRANCHES)
    driver = long.driver
    done: list[str] = []
    for _ in range(60):
        driver.after(seconds=1)
        if choices.draw(st.integers(0, 4)) == 0:
            long.crash()
        record: Any = driver.process.record
        if record.status is TaskStatus.COMPLETED:
            break
        acts = [(name, status) for name in driver.open for status in ("completed", "failed")]
        if record.failed_by is not None:
            acts.append(("retry", ""))
        name, status = choices.draw(st.sampled_from(acts))
        if name == "retry":
            retry(driver, record.failed_by.removeprefix(task_id("")))
        else:
            assert driver.receive(name, status, n=name)
            done += [name.rsplit("-", 1)[0]] * (status == "completed")
        long.write()
        assert len(done) == len(set(done)), "done twice"
        wanted = [t for t in driver.process.tasks.values() if t.cancelled_at is None]
        assert len({task.element for task in wanted}) == len(wanted)
        assert (record.status is TaskStatus.FAILED) <= (record.failed_by is not None)
    if driver.process.record.status is TaskStatus.COMPLETED:
        assert sorted(done) == ["a", "b", "last"]
        assert set(driver.process.record.variables) == {"a", "b", "last"}
