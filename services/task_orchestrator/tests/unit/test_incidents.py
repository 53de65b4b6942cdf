"""Incidents: what cannot continue is retried, skipped, moved or cancelled, and nothing is done twice."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.alerts import unshown_key
from handover.errors import Problem
from handover_datamodels.entities import TaskStatus
from handover_processes.process import interventions
from handover_processes.process.process import Process
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import Act, ActKind, ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskRecord
from services.task_orchestrator.tests.unit.drawing import (
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
from services.task_orchestrator.tests.unit.process_driver import (
    ProcessDriver,
    alerts,
    created,
    processes,
    task_id,
)

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
    token = interventions.incident_of(driver.process, task_id(name))
    act = Act(driver.now, ActKind.RETRY, by, task_id(name))
    interventions.mend(driver.process, act, token, driver.next_step(), driver.now)


def mend(driver: ProcessDriver, kind: ActKind, element: str, **details: Any) -> None:
    driver.after(seconds=1)
    token = next(each.token for each in driver.process.record.incidents if each.element == element)
    interventions.mend(
        driver.process, Act(driver.now, kind, "Ann", **details), token, driver.next_step(), driver.now
    )


def cleared(step: Step) -> list[str]:
    return [message.body["key"] for message in step.messages if message.kind is MessageKind.CLEAR]


def test_a_retried_task_is_a_new_one_and_the_process_goes_on() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "failed", reason="the part slipped")
    (alert,) = alerts(driver.step)
    retry(driver, "work-1")
    assert created(driver.step) == [task_id("work-2")]
    assert alert["key"] in cleared(driver.step)
    record = driver.process.record
    assert (record.status, record.incidents) == (TaskStatus.IN_PROGRESS, ())
    assert record.acts == (Act(driver.now, ActKind.RETRY, "Ann", task_id("work-1"), "work"),)
    reported = processes(driver.step)[-1]
    assert reported["status"]["value"] == "inProgress"
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
        assert [alert["sub_category"] for alert in alerts(driver.step)] == ["processIncident"]
        retry(driver, f"work-{n}")
    assert driver.open == ["work-4"]
    assert len(driver.process.record.acts) == 3


def test_a_branch_that_failed_too_is_an_incident_of_its_own() -> None:
    driver = ProcessDriver(BRANCHES)
    driver.receive("a-1", "failed", reason="no")
    driver.receive("b-1", "failed", reason="the part slipped")
    retry(driver, "a-1")
    assert driver.open == ["a-2"]
    assert [incident.element for incident in driver.process.record.incidents] == ["b"]
    retry(driver, "b-1")
    assert driver.open == ["a-2", "b-2"]


def test_a_boundary_timer_goes_on_while_its_activity_has_an_incident() -> None:
    late = boundary("late", "work", timer("PT1M")) + activity("other") + path("late", "other", "end")
    driver = ProcessDriver(ONE_STEP + late)
    driver.receive("work-1", "failed", reason="no")
    driver.after(seconds=60)
    driver.tick()
    assert driver.open == ["other-1"]
    assert driver.process.record.incidents == ()


def test_a_timer_elsewhere_goes_on_meanwhile() -> None:
    wait = f'<bpmn:intermediateCatchEvent id="wait">{timer("PT1H")}</bpmn:intermediateCatchEvent>'
    body = start() + gateway("fork", "parallel") + activity("a") + activity("b") + wait + end()
    body += path("start", "fork", "a", "end") + path("fork", "wait", "b", "end")
    driver = ProcessDriver(body)
    driver.receive("a-1", "failed", reason="no")
    driver.after(hours=2)
    driver.tick()
    assert driver.open == ["b-1"]


def test_an_activity_is_skipped_with_results() -> None:
    driver = ProcessDriver(BRANCHES)
    driver.receive("a-1", "failed", reason="no")
    mend(driver, ActKind.SKIP, "a", values={"weight": 3}, why="weighed by hand")
    driver.receive("b-1", "completed")
    assert driver.open == ["last-1"]
    assert driver.process.record.variables["weight"] == 3
    (act,) = driver.process.record.acts
    assert (act.element, act.why, act.by) == ("a", "weighed by hand", "Ann")


def test_a_token_is_moved_to_another_element() -> None:
    driver = ProcessDriver(BRANCHES)
    driver.receive("a-1", "failed", reason="no")
    mend(driver, ActKind.MOVE, "a", to="join")
    driver.receive("b-1", "completed")
    assert driver.open == ["last-1"]


def test_a_move_to_nowhere_is_refused_and_changes_nothing() -> None:
    driver = ProcessDriver(BRANCHES)
    driver.receive("a-1", "failed", reason="no")
    before = driver.process.record
    with pytest.raises(Problem, match="nowhere"):
        mend(driver, ActKind.MOVE, "a", to="nowhere")
    assert driver.process.record is before


def test_variables_are_mended_and_a_gateway_tries_again() -> None:
    body = start() + activity("work") + gateway("which") + activity("more") + end()
    body += path("start", "work", "which") + path("more", "end")
    body += flow("which", "more", "work.n == 2") + flow("which", "end", "work.n == 3")
    driver = ProcessDriver(body)
    driver.receive("work-1", "completed", n=7)
    (incident,) = driver.process.record.incidents
    assert "work.n == 2" in incident.reason
    assert driver.process.record.variables["work"] == {"n": 7}
    mend(driver, ActKind.RETRY, "which", values={"work": {"n": 2}})
    assert driver.open == ["more-1"]


def test_results_beyond_measure_are_an_incident_and_change_nothing() -> None:
    driver = ProcessDriver(BRANCHES)
    driver.receive("a-1", "completed", picture="x" * 5_000_000)
    (incident,) = driver.process.record.incidents
    assert "4194304 bytes" in incident.reason
    assert driver.open == ["b-1"]
    assert "a" not in driver.process.record.variables


def refusal(driver: ProcessDriver, name: str) -> Problem:
    before = driver.process.record
    driver.next_step()
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


def test_a_task_that_has_not_failed_cannot_be_retried() -> None:
    driver = ProcessDriver(BRANCHES)
    assert refusal(driver, "a-1").status == 409
    driver.receive("a-1", "failed", reason="no")
    assert task_id("a-1") in refusal(driver, "b-1").detail


def test_an_ended_process_cannot_be_mended() -> None:
    driver = ProcessDriver(ONE_STEP)
    interventions.cancel(driver.process, "Ann", driver.next_step(), driver.now)
    assert driver.process.record.acts == (Act(driver.now, ActKind.CANCEL, "Ann"),)
    assert refusal(driver, "work-1").status == 409
    with pytest.raises(Problem, match="already"):
        interventions.mend(
            driver.process, Act(driver.now, ActKind.SET_VARIABLES), None, driver.next_step(), driver.now
        )


def test_the_alert_of_an_incident_ends_with_the_process() -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "failed", reason="no")
    (alert,) = alerts(driver.step)
    interventions.cancel(driver.process, "Ann", driver.next_step(), driver.now)
    assert alert["key"] in cleared(driver.step)


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
        tasks = self.tasks.values()
        self.driver.process = Process.resume(before.settings, before.plan, self.record, tasks, before.library)


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
        acts += [(incident.task.removeprefix(task_id("")), "retry") for incident in record.incidents]
        name, status = choices.draw(st.sampled_from(acts))
        if status == "retry":
            retry(driver, name)
        else:
            assert driver.receive(name, status, n=name)
            done += [name.rsplit("-", 1)[0]] * (status == "completed")
        long.write()
        assert len(done) == len(set(done)), "done twice"
        wanted = [t for t in driver.process.tasks.values() if t.cancelled_at is None]
        assert len({task.element for task in wanted}) == len(wanted)
        assert record.status is not TaskStatus.FAILED
    if driver.process.record.status is TaskStatus.COMPLETED:
        assert sorted(done) == ["a", "b", "last"]
        assert set(driver.process.record.variables) == {"a", "b", "last"}


@pytest.mark.parametrize("way", ["retried", "skipped", "cancelled"])
def test_the_alert_of_a_task_that_could_not_be_shown_ends_when_a_person_has_dealt_with_it(way: str) -> None:
    driver = ProcessDriver(ONE_STEP)
    driver.receive("work-1", "failed", reason='there is no gesture "Wave"')
    key = unshown_key(task_id("work-1"))
    assert key not in cleared(driver.step)
    if way == "retried":
        retry(driver, "work-1")
    elif way == "skipped":
        mend(driver, ActKind.SKIP, "work")
    else:
        interventions.cancel(driver.process, "Ann", driver.next_step(), driver.now)
    assert key in cleared(driver.step)


@pytest.mark.parametrize("way", ["caught", "cancelled"])
def test_the_alert_of_a_task_that_could_not_be_shown_ends_with_a_task_that_leaves_no_incident(
    way: str,
) -> None:
    caught = (
        boundary("any", "work", "<bpmn:errorEventDefinition/>")
        + activity("help")
        + path("any", "help", "work")
    )
    driver = ProcessDriver(ONE_STEP + (caught if way == "caught" else ""))
    if way == "cancelled":
        interventions.cancel(driver.process, "Ann", driver.next_step(), driver.now)
    driver.receive("work-1", "failed", reason='there is no gesture "Wave"')
    assert driver.process.record.incidents == ()
    assert unshown_key(task_id("work-1")) in cleared(driver.step)
