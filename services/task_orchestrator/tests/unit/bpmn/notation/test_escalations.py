"""Escalations of Tasks that have not ended in time."""

from handover.formats.durations import parse_duration
from handover_bpmn.model import Escalation
from services.task_orchestrator.tests.unit.bpmn.notation.reading import between, extended, faults, node


def test_the_levels_of_an_activity_are_read_the_earliest_first() -> None:
    levels = (
        '<handover:escalation after="PT1H" code="late"/><handover:escalation after="PT5M" group="leads"/>'
    )
    activity = node(extended("userTask", levels, attributes='camunda:dueDate="P1D"')).activity
    assert activity is not None
    assert activity.escalations == (
        Escalation(parse_duration("PT5M"), group="leads"),
        Escalation(parse_duration("PT1H"), code="late"),
    )


def test_an_escalation_without_an_effect_or_with_a_wrong_delay_is_a_fault() -> None:
    (neither,) = faults(between(extended("userTask", '<handover:escalation after="PT5M"/>')))
    assert "code of a BPMN escalation, or a group" in neither
    (delay,) = faults(between(extended("userTask", '<handover:escalation after="soon" group="leads"/>')))
    assert "soon" in delay
