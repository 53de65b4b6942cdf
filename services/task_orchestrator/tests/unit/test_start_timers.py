"""Timer start events: when they are due, and what happens to the moments that were missed."""

from datetime import timedelta

from handover_processes.definitions.start_timers import next_timer, start_timers
from services.task_orchestrator.tests.unit.drawing import NOW, activity, drawing, end, path
from services.task_orchestrator.tests.unit.process_driver import only_process


def starting(timer: str) -> bytes:
    event = f"<bpmn:timerEventDefinition>{timer}</bpmn:timerEventDefinition>"
    body = f'<bpmn:startEvent id="s">{event}</bpmn:startEvent>'
    return drawing(body + activity("work") + end() + path("s", "work", "end"))


def test_a_duration_counts_from_the_deployment_and_once() -> None:
    (timer,) = start_timers(only_process(starting("<bpmn:timeDuration>PT5M</bpmn:timeDuration>")), NOW)
    assert timer.due == NOW + timedelta(minutes=5)
    assert next_timer(timer, timer.due) is None


def test_a_counted_cycle_makes_up_for_every_moment_that_was_missed() -> None:
    (timer,) = start_timers(only_process(starting("<bpmn:timeCycle>R2/PT1M</bpmn:timeCycle>")), NOW)
    late = NOW + timedelta(hours=1)
    second = next_timer(timer, late)
    assert second is not None
    assert second.due == NOW + timedelta(minutes=2)
    assert next_timer(second, late) is None


def test_an_endless_cycle_skips_the_moments_that_were_missed() -> None:
    (timer,) = start_timers(only_process(starting("<bpmn:timeCycle>R/PT1M</bpmn:timeCycle>")), NOW)
    following = next_timer(timer, NOW + timedelta(hours=1, seconds=1))
    assert following is not None
    assert following.due == NOW + timedelta(hours=1, minutes=1)


def test_a_timer_over_a_variable_starts_nothing() -> None:
    assert start_timers(only_process(starting("<bpmn:timeDuration>pause</bpmn:timeDuration>")), NOW) == ()
