"""A commandId that a broker would change is refused in a specification, and left out of a TaskDefinition."""

import pytest

from handover.settings import Settings
from handover.tasks.specification import MAX_COMMAND_ID, Specification
from handover_bpmn.notation.file import read_bpmn
from handover_processes.records.entities import definition_entities
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start


@pytest.mark.parametrize("given", [MAX_COMMAND_ID + 1, str(MAX_COMMAND_ID + 1), -1])
def test_a_specification_names_the_limit(given: int | str) -> None:
    with pytest.raises(ValueError, match="2147483647"):
        Specification.of({"description": "look", "commandId": given})


@pytest.mark.parametrize(("number", "is_kept"), [(MAX_COMMAND_ID, True), (MAX_COMMAND_ID + 1, False)])
def test_a_task_definition_has_no_number_that_a_broker_would_change(number: int, is_kept: bool) -> None:
    inner = f'<handover:parameter name="commandId" value="{number}"/>'
    xml = drawing(start() + activity("work", inner) + end() + path("start", "work", "end"))
    found = read_bpmn(xml).definitions[0]
    entities = definition_entities(Settings(_env_file=None), found, 1, "http://x")
    work = next(each for each in entities if each["type"] == "TaskDefinition")
    assert ("commandId" in work) is is_kept
