"""Hints: due dates, follow-up dates and priorities of Tasks, as they stand in the entity."""

from typing import Any

import pytest

from services.task_orchestrator.tests.unit.drawing import end, path, start
from services.task_orchestrator.tests.unit.process_driver import ProcessDriver, created

BODY = (
    start()
    + '<bpmn:userTask id="pack" name="Pack"><bpmn:extensionElements>'
    + '<handover:task definition="pack" {hints}/></bpmn:extensionElements></bpmn:userTask>'
    + end()
    + path("start", "pack", "end")
)


def posted(hints: str) -> dict[str, Any]:
    driver = ProcessDriver(BODY.replace("{hints}", hints))
    assert len(created(driver.step)) == 1
    return next(message.body for message in driver.step.messages if message.body and "status" in message.body)


@pytest.mark.parametrize(
    ("given", "moment"),
    [
        ("2026-05-01T08:00:00Z", "2026-05-01T08:00:00"),
        ("2026-05-01T08:00:00+02:00", "2026-05-01T06:00:00"),
        ("P1D", "2026-05-05T08:00:00"),
        ("${dateTime().plusDays(1)}", "2026-05-05T08:00:00"),
        ("soon", ""),
    ],
)
def test_a_due_date_is_a_moment_or_a_duration_from_now(given: str, moment: str) -> None:
    entity = posted(f'dueDate="{given}" followUpDate="{given}" priority="70"')
    assert entity["priority"]["value"] == 70
    for name in ("dueDate", "followUpDate"):
        value = entity[name]["value"]["@value"] if name in entity else ""
        assert value.startswith(moment)
        assert bool(value) is bool(moment)


@pytest.mark.parametrize(
    ("given", "written"), [("2147483647", 2**31 - 1), ("3000000000", 2**31 - 1), ("-3000000000", -(2**31))]
)
def test_a_priority_keeps_its_rank_in_a_broker_with_integers_of_32_bits(given: str, written: int) -> None:
    assert posted(f'priority="{given}"')["priority"]["value"] == written
