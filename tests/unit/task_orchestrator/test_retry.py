"""Retry: a process that a failed Task has ended goes on, with new Tasks, and nothing is done twice."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datamodels.entities import TaskStatus
from handover.errors import Problem
from services.task_orchestrator.process import Process
from services.task_orchestrator.records import Act, ActKind, ProcessRecord, Saying, Step, TaskRecord
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
from tests.unit.task_orchestrator.shop_floor import Floor, alerts, created, processes, task_id

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


def retry(floor: Floor, name: str, by: str = "Ann") -> None:
    floor.after(seconds=1)
    floor.process.retry(task_id(name), by, floor.next_step(), floor.now)


def cleared(step: Step) -> list[str]:
    return [message.body["key"] for message in step.messages if message.saying is Saying.CLEAR]


def test_a_retried_task_is_a_new_one_and_the_process_goes_on() -> None:
    floor = Floor(ONE_STEP)
    floor.hear("work-1", "failed", reason="the part slipped")
    assert floor.process.record.failed_by == task_id("work-1")
    (alert,) = alerts(floor.step)
    retry(floor, "work-1")
    assert created(floor.step) == [task_id("work-2")]
    assert cleared(floor.step) == [alert["key"]]
    record = floor.process.record
    assert (record.status, record.reason, record.ended_at, record.failed_by) == (
        TaskStatus.IN_PROGRESS,
        None,
        None,
        None,
    )
    assert record.acts == (Act(floor.now, ActKind.RETRY, "Ann", task_id("work-1")),)
    told = processes(floor.step)[-1]
    assert told["status"]["value"] == "inProgress"
    assert told["outputParameters"]["value"] == {}
    assert [link["object"] for link in told["isComposedOf"]["value"]] == [
        task_id("work-1"),
        task_id("work-2"),
    ]
    floor.after(seconds=1)
    assert not floor.hear("work-1", "completed")
    assert floor.hear("work-2", "completed")
    assert floor.process.record.status is TaskStatus.COMPLETED
    assert floor.process.record.state is None


def test_it_can_fail_and_be_retried_again_and_again() -> None:
    floor = Floor(ONE_STEP)
    for n in range(1, 4):
        floor.after(seconds=1)
        floor.hear(f"work-{n}", "failed", reason="no")
        assert [alert["category"] for alert in alerts(floor.step)] == ["processFailed"]
        retry(floor, f"work-{n}")
    assert floor.open == ["work-4"]
    assert len(floor.process.record.acts) == 3


def test_what_was_called_back_is_handed_out_anew_once_it_has_ended() -> None:
    floor = Floor(BRANCHES)
    floor.hear("b-1", "inProgress")
    floor.hear("a-1", "failed", reason="no")
    retry(floor, "a-1")
    assert created(floor.step) == [task_id("a-2")]
    assert floor.open == ["a-2", "b-1"]
    floor.hear("b-1", "failed", reason="cancelled")
    assert created(floor.step) == [task_id("b-2")]
    floor.hear("a-2", "completed")
    floor.hear("b-2", "completed")
    assert floor.open == ["last-1"]


def test_what_was_called_back_and_ended_before_is_handed_out_anew_at_once() -> None:
    floor = Floor(BRANCHES)
    floor.hear("a-1", "failed", reason="no")
    floor.after(seconds=6)
    floor.tick()
    assert floor.process.over
    retry(floor, "a-1")
    assert created(floor.step) == [task_id("a-2"), task_id("b-2")]


@pytest.mark.parametrize("when", ["before the retry", "after the retry"])
def test_what_was_completed_though_called_back_is_not_done_twice(when: str) -> None:
    floor = Floor(BRANCHES)
    floor.hear("b-1", "inProgress")
    floor.hear("a-1", "failed", reason="no")
    if when == "before the retry":
        floor.hear("b-1", "completed", weight=3)
    retry(floor, "a-1")
    if when == "after the retry":
        floor.hear("b-1", "completed", weight=3)
    assert floor.open == ["a-2"]
    floor.hear("a-2", "completed")
    assert floor.open == ["last-1"]
    assert floor.process.record.variables["b"] == {"weight": 3}


def test_a_branch_that_failed_after_the_process_had_is_handed_out_anew_too() -> None:
    floor = Floor(BRANCHES)
    floor.hear("b-1", "inProgress")
    floor.hear("a-1", "failed", reason="no")
    floor.hear("b-1", "failed", reason="the part slipped")
    retry(floor, "a-1")
    assert floor.open == ["a-2", "b-2"]


def test_a_timer_at_the_border_starts_anew_with_its_activity() -> None:
    late = boundary("late", "work", timer("PT1M")) + activity("other") + path("late", "other", "end")
    floor = Floor(ONE_STEP + late)
    floor.after(seconds=50)
    floor.hear("work-1", "failed", reason="no")
    floor.after(hours=1)
    retry(floor, "work-1")
    assert floor.open == ["work-2"]
    floor.after(seconds=59)
    floor.tick()
    assert floor.open == ["work-2"]
    floor.after(seconds=1)
    floor.tick()
    assert "other-1" in floor.open


def test_a_timer_elsewhere_has_gone_on_meanwhile() -> None:
    wait = f'<bpmn:intermediateCatchEvent id="wait">{timer("PT1H")}</bpmn:intermediateCatchEvent>'
    body = start() + gateway("fork", "parallel") + activity("a") + activity("b") + wait + end()
    body += path("start", "fork", "a", "end") + path("fork", "wait", "b", "end")
    floor = Floor(body)
    floor.hear("a-1", "failed", reason="no")
    floor.after(hours=2)
    retry(floor, "a-1")
    assert floor.open == ["a-2", "b-1"]


def refusal(floor: Floor, name: str) -> Problem:
    before = floor.process.record
    with pytest.raises(Problem) as refused:
        retry(floor, name)
    assert not floor.step
    assert not floor.step.touched
    assert floor.process.record is before
    return refused.value


def test_a_task_of_another_process_cannot_be_retried() -> None:
    floor = Floor(ONE_STEP)
    floor.hear("work-1", "failed", reason="no")
    assert refusal(floor, "nothing-1").status == 404


def test_a_process_that_runs_or_completed_cannot_be_retried() -> None:
    floor = Floor(ONE_STEP)
    assert "p-1 is inProgress" in refusal(floor, "work-1").detail
    floor.hear("work-1", "completed")
    assert "p-1 is completed" in refusal(floor, "work-1").detail


def test_a_cancelled_process_cannot_be_retried() -> None:
    floor = Floor(ONE_STEP)
    floor.process.cancel("Ann", floor.next_step(), floor.now)
    assert floor.process.record.acts == (Act(floor.now, ActKind.CANCEL, "Ann"),)
    refused = refusal(floor, "work-1")
    assert (refused.status, "(cancelled by Ann)" in refused.detail) == (409, True)
    assert floor.process.record.state is None


def test_what_failed_by_an_expression_cannot_be_retried() -> None:
    body = start() + activity("work") + gateway("which", default="which_end") + activity("more") + end()
    body += path("start", "work", "which", "end") + flow("which", "more", "nothing") + path("more", "end")
    floor = Floor(body)
    floor.hear("work-1", "completed")
    assert floor.process.record.status is TaskStatus.FAILED
    assert "nothing" in refusal(floor, "work-1").detail
    assert floor.process.record.state is None


def test_only_the_task_that_ended_the_process_can_be_retried() -> None:
    floor = Floor(BRANCHES)
    floor.hear("a-1", "failed", reason="no")
    assert task_id("a-1") in refusal(floor, "b-1").detail


def test_a_state_that_this_release_cannot_read_is_said() -> None:
    floor = Floor(ONE_STEP)
    floor.hear("work-1", "failed", reason="no")
    floor.process._revise(state=b'{"version":99}')
    assert "version 99" in refusal(floor, "work-1").detail


class Long:
    """A floor whose process may be taken anew from what was written at any time, as after a crash."""

    def __init__(self, body: str) -> None:
        self.floor = Floor(body)
        self.tasks: dict[str, TaskRecord] = {}
        self.record: ProcessRecord | None = None
        self.write()

    def write(self) -> None:
        self.tasks.update(self.floor.step.tasks)
        self.record = self.floor.step.processes.get("p-1", self.record)

    def crash(self) -> None:
        assert self.record is not None
        before = self.floor.process
        self.floor.process = Process.resume(before.settings, before.plan, self.record, self.tasks.values())


@settings(max_examples=3 * settings.default.max_examples)
@given(choices=st.data())
def test_whatever_fails_and_is_retried_everything_is_done_once(choices: st.DataObject) -> None:
    long = Long(BRANCHES)
    floor = long.floor
    done: list[str] = []
    for _ in range(60):
        floor.after(seconds=1)
        if choices.draw(st.integers(0, 4)) == 0:
            long.crash()
        record: Any = floor.process.record
        if record.status is TaskStatus.COMPLETED:
            break
        acts = [(name, status) for name in floor.open for status in ("completed", "failed")]
        if record.failed_by is not None:
            acts.append(("retry", ""))
        name, status = choices.draw(st.sampled_from(acts))
        if name == "retry":
            retry(floor, record.failed_by.removeprefix(task_id("")))
        else:
            assert floor.hear(name, status, n=name)
            done += [name.rsplit("-", 1)[0]] * (status == "completed")
        long.write()
        assert len(done) == len(set(done)), "done twice"
        wanted = [t for t in floor.process.tasks.values() if t.cancelled_at is None]
        assert len({task.element for task in wanted}) == len(wanted)
        assert (record.status is TaskStatus.FAILED) <= (record.failed_by is not None)
    if floor.process.record.status is TaskStatus.COMPLETED:
        assert sorted(done) == ["a", "b", "last"]
        assert set(floor.process.record.variables) == {"a", "b", "last"}
