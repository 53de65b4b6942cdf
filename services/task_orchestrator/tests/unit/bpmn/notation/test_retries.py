"""Retry policies: ours, that of Camunda 7 and that of Camunda 8."""

import pytest

from handover.formats.durations import parse_duration
from handover_bpmn.model import RetryPolicy, Value
from services.task_orchestrator.tests.unit.bpmn.notation.reading import (
    between,
    extended,
    faults,
    node,
    warnings,
)


def policy(extension: str, *, kind: str = "serviceTask") -> RetryPolicy | None:
    activity = node(extended(kind, extension)).activity
    assert activity is not None
    return activity.retry


def test_ours_has_attempts_delay_factor_and_codes() -> None:
    ours = '<handover:retry attempts="5" delay="PT10S" factor="2" maxDelay="PT5M" codes="slipped notGood"/>'
    assert policy(ours) == RetryPolicy(
        Value(5),
        (parse_duration("PT10S"),),
        2.0,
        parse_duration("PT5M"),
        frozenset({"slipped", "notGood"}),
    )
    assert policy("<handover:retry/>") == RetryPolicy(Value(3), (parse_duration("PT0S"),))
    assert policy("", kind="userTask") is None


@pytest.mark.parametrize(
    ("cycle", "attempts", "delays"),
    [
        ("R3/PT10M", 3, ["PT10M"]),
        ("PT5M", 2, ["PT5M"]),
        ("PT1M, PT5M,PT1H", 4, ["PT1M", "PT5M", "PT1H"]),
    ],
)
def test_a_cycle_of_camunda_7_is_a_number_of_attempts_or_a_list_of_delays(
    cycle: str, attempts: int, delays: list[str]
) -> None:
    given = f"<camunda:failedJobRetryTimeCycle>{cycle}</camunda:failedJobRetryTimeCycle>"
    assert policy(given) == RetryPolicy(Value(attempts), tuple(map(parse_duration, delays)))


def test_retries_of_camunda_8_are_attempts_without_a_delay() -> None:
    found = policy('<zeebe:taskDefinition type="grip" retries="3"/>')
    assert found == RetryPolicy(Value(3))
    expression = policy('<zeebe:taskDefinition type="grip" retries="=tries + 1"/>')
    assert expression is not None
    assert expression.attempts.value({"tries": 2}) == 3


@pytest.mark.parametrize(
    ("attributes", "named"),
    [
        ('attempts="0"', "attempts"),
        ('attempts="1.5"', "attempts"),
        ('attempts="many"', "attempts"),
        ('factor="0.5"', "factor"),
        ('delay="10 s"', "10 s"),
        ('maxDelay="soon"', "soon"),
        ('tries="3"', "tries"),
    ],
)
def test_a_wrong_policy_is_a_fault(attributes: str, named: str) -> None:
    (fault,) = faults(between(extended("userTask", f"<handover:retry {attributes}/>")))
    assert named in fault


def test_a_cycle_that_cannot_be_read_is_reported() -> None:
    def cycle(text: str) -> str:
        given = f"<camunda:failedJobRetryTimeCycle>{text}</camunda:failedJobRetryTimeCycle>"
        return between(extended("serviceTask", given, attributes='camunda:topic="t"'))

    assert "failedJobRetryTimeCycle" in warnings(cycle("${cycle}"))[0]
    assert "R/PT1M" in faults(cycle("R/PT1M"))[0]
