"""Retries of failed Tasks: which failures, how often, after which delays."""

from datetime import timedelta
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.formats.durations import Duration, parse_duration
from handover.messages import with_code
from handover.tasks.outcomes import is_outcome_unknown, outcome_unknown
from handover_bpmn.model import RetryPolicy, Value
from handover_processes.process import interventions
from handover_processes.process.process import Process
from handover_processes.records.processes import Act, ActKind
from handover_processes.timing.retries import MAX_DELAY_S, retry_at
from services.task_orchestrator.tests.unit.drawing import (
    NOW,
    ONE_STEP,
    activity,
    boundary,
    end,
    path,
    start,
    timer,
)
from services.task_orchestrator.tests.unit.process_driver import ProcessDriver, alerts, created, task_id

CAUGHT = "<bpmn:errorEventDefinition errorRef='e'/>"
ERROR = '<bpmn:error id="e" errorCode="slipped"/>'


def retrying(attributes: str = 'attempts="3" delay="PT10S" factor="2"') -> str:
    retried = activity("work").replace(
        "<bpmn:extensionElements>", f"<bpmn:extensionElements><handover:retry {attributes}/>"
    )
    return start() + retried + end() + path("start", "work", "end")


def fail(driver: ProcessDriver, name: str, **outputs: Any) -> None:
    assert driver.receive(name, "failed", **{"reason": "it slipped", **outputs})


def wait(driver: ProcessDriver, **time: float) -> None:
    driver.after(**time)
    driver.tick()


def test_a_failed_task_is_posted_again_after_the_delay_and_then_is_an_incident() -> None:
    driver = ProcessDriver(retrying())
    fail(driver, "work-1")
    assert alerts(driver.step) == []
    (waiting,) = driver.process.record.retries
    assert (waiting.failed, waiting.attempts, waiting.reason) == (1, 3, "it slipped")
    assert waiting.due == NOW + timedelta(seconds=10)
    assert driver.process.next_due() == waiting.due
    wait(driver, seconds=9)
    assert created(driver.step) == []
    wait(driver, seconds=1)
    assert created(driver.step) == [task_id("work-2")]
    fail(driver, "work-2")
    wait(driver, seconds=19)
    assert driver.open == []
    wait(driver, seconds=1)
    assert driver.open == ["work-3"]
    fail(driver, "work-3")
    (incident,) = driver.process.record.incidents
    assert incident.task == task_id("work-3")
    assert driver.process.record.retries == ()
    assert len(alerts(driver.step)) == 1


def test_an_attempt_that_succeeds_continues_the_process() -> None:
    driver = ProcessDriver(retrying())
    fail(driver, "work-1")
    wait(driver, seconds=10)
    driver.receive("work-2", "completed")
    assert driver.process.over
    assert driver.process.record.retries == ()


def test_a_restored_process_retries_at_the_same_time() -> None:
    driver = ProcessDriver(retrying())
    fail(driver, "work-1")
    before = driver.process
    driver.process = Process.resume(
        before.settings, before.plan, before.record, driver.step.tasks.values(), before.library
    )
    assert driver.process.next_due() == NOW + timedelta(seconds=10)
    wait(driver, seconds=10)
    assert driver.open == ["work-2"]
    fail(driver, "work-2")
    assert driver.process.record.retries[0].failed == 2


@pytest.mark.parametrize(
    "outputs",
    [
        with_code("reason", outcome_unknown("the controller was restarted while the gripper closed")),
        {"reason": "Outcome unknown: power was lost"},
        {"reason": "cancelled"},
    ],
)
def test_an_act_that_may_have_been_done_is_never_repeated(outputs: dict[str, Any]) -> None:
    driver = ProcessDriver(retrying())
    fail(driver, "work-1", **outputs)
    assert driver.process.record.retries == ()
    assert len(driver.process.record.incidents) == 1


def test_an_unknown_outcome_is_recognized_by_its_code() -> None:
    assert is_outcome_unknown({"reason": "unbekannt", "reasonCode": "task.outcome_unknown"})
    assert not is_outcome_unknown({"reason": "the outcome is bad"})
    assert not is_outcome_unknown({})


@pytest.mark.parametrize(("act", "left_min"), [(ActKind.RETRY, 30), (ActKind.MOVE, 60)])
def test_boundary_timers_continue_after_a_retry_and_begin_again_after_a_move(
    act: ActKind, left_min: int
) -> None:
    driver = ProcessDriver(ONE_STEP + boundary("late", "work", timer("PT1H")) + path("late", "end"))
    wait(driver, minutes=30)
    fail(driver, "work-1")
    (incident,) = driver.process.record.incidents
    decided = Act(driver.now, act, "Eva", to="work" if act is ActKind.MOVE else None)
    interventions.mend(driver.process, decided, incident.token, driver.next_step(), driver.now)
    assert driver.open == ["work-2"]
    wait(driver, minutes=left_min - 1)
    assert driver.process.run is not None
    wait(driver, minutes=1)
    assert driver.process.run is None


@pytest.mark.parametrize(("event", "is_caught"), [("<bpmn:errorEventDefinition/>", False), (CAUGHT, True)])
def test_an_unknown_outcome_is_caught_only_by_an_event_that_names_it(event: str, is_caught: bool) -> None:
    body = ONE_STEP + boundary("caught", "work", event) + path("caught", "end")
    driver = ProcessDriver(body, beside=ERROR.replace("slipped", "outcomeUnknown"))
    fail(driver, "work-1", **with_code("reason", outcome_unknown("power was lost")))
    assert driver.process.over is is_caught
    assert len(driver.process.record.incidents) == (0 if is_caught else 1)


def test_a_caught_error_is_caught_at_once_and_others_are_retried() -> None:
    body = retrying() + boundary("caught", "work", CAUGHT) + path("caught", "end")
    driver = ProcessDriver(body, beside=ERROR)
    fail(driver, "work-1", errorCode="slipped")
    assert driver.process.over
    driver = ProcessDriver(body, beside=ERROR)
    fail(driver, "work-1", errorCode="other")
    assert len(driver.process.record.retries) == 1


def test_named_codes_are_retried_before_they_are_caught() -> None:
    body = (
        retrying('attempts="2" codes="slipped"') + boundary("caught", "work", CAUGHT) + path("caught", "end")
    )
    driver = ProcessDriver(body, beside=ERROR)
    fail(driver, "work-1", errorCode="slipped")
    wait(driver, seconds=0)
    assert driver.open == ["work-2"]
    fail(driver, "work-2", errorCode="slipped")
    assert driver.process.over
    driver = ProcessDriver(body, beside=ERROR)
    fail(driver, "work-1", errorCode="other")
    assert driver.process.record.retries == ()


def test_a_catch_all_event_catches_the_last_failure_only() -> None:
    body = retrying('attempts="2"') + boundary("caught", "work", "<bpmn:errorEventDefinition/>")
    driver = ProcessDriver(body + path("caught", "end"))
    fail(driver, "work-1")
    wait(driver, seconds=0)
    fail(driver, "work-2")
    assert driver.process.over


def test_a_person_may_retry_skip_or_pause_while_the_delay_runs() -> None:
    def decide(kind: ActKind) -> ProcessDriver:
        driver = ProcessDriver(retrying())
        fail(driver, "work-1")
        (waiting,) = driver.process.record.retries
        interventions.mend(
            driver.process, Act(driver.now, kind, "Ann"), waiting.token, driver.next_step(), driver.now
        )
        return driver

    retried = decide(ActKind.RETRY)
    assert retried.open == ["work-2"]
    assert retried.process.record.retries[0].due is None
    assert decide(ActKind.SKIP).process.over
    driver = ProcessDriver(retrying())
    fail(driver, "work-1")
    interventions.pause(driver.process, Act(driver.now, ActKind.PAUSE, "Ann"), driver.next_step(), driver.now)
    wait(driver, hours=1)
    assert driver.open == []
    interventions.resume_work(
        driver.process, Act(driver.now, ActKind.RESUME, "Ann"), driver.next_step(), driver.now
    )
    driver.tick()
    assert driver.open == ["work-2"]


def test_without_a_policy_a_failure_is_an_incident() -> None:
    driver = ProcessDriver(ONE_STEP)
    fail(driver, "work-1")
    assert len(driver.process.record.incidents) == 1


DELAYS = st.lists(st.builds(Duration, st.just(0), st.integers(0, 10**13)), max_size=4)


@given(DELAYS, st.floats(1, 100), st.one_of(st.none(), st.integers(0, 10**13)), st.integers(1, 1000))
def test_a_delay_never_shrinks_and_has_a_limit(
    delays: list[Duration], factor: float, limit: int | None, failed: int
) -> None:
    ordered = tuple(sorted(delays, key=lambda each: each.microseconds))
    longest = None if limit is None else Duration(0, limit)
    policy = RetryPolicy(Value(1000), ordered, factor, longest)
    delay = retry_at(policy, failed, NOW) - NOW
    assert delay <= retry_at(policy, failed + 1, NOW) - NOW
    assert delay.total_seconds() <= MAX_DELAY_S
    if longest is not None:
        assert delay.total_seconds() <= longest.nominal_s + 1e-6


def test_a_list_of_delays_is_followed_and_the_last_one_grows() -> None:
    policy = RetryPolicy(
        Value(9), (parse_duration("PT1M"), parse_duration("PT5M")), 2.0, parse_duration("PT15M")
    )
    delays = [(retry_at(policy, failed, NOW) - NOW).total_seconds() / 60 for failed in (1, 2, 3, 4, 5)]
    assert delays == [1, 5, 10, 15, 15]
