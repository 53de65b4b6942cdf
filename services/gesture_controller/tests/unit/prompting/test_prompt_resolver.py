"""What a Task asks is found in its parameters, its definition, the person's own gestures and the map."""

from typing import Any

import pytest

from handover.job import TaskFailed
from handover_datamodels.entities import Task
from handover_datamodels.states import Outcome
from handover_gloves.prompting.prompt_resolver import resolve_prompt
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Gestures, default_commands
from handover_gloves.specifications.definition import Definition, needs_definition

GESTURES = Gestures(M2O2P_GESTURES)
COMMANDS = default_commands(GESTURES)
TASK = Task(
    id="urn:ngsi-ld:Task:demo:t1",
    is_defined_by="urn:ngsi-ld:TaskDefinition:demo:confirm-part",
    status="pending",
)


def asked(parameters: dict[str, Any], definition: Definition | None = None, own: Any = None) -> Any:
    commands = COMMANDS.with_own(own) if own else COMMANDS
    return resolve_prompt(TASK, parameters, definition or Definition(), GESTURES, commands)


def test_a_gesture_that_is_named_is_asked_for() -> None:
    one = asked({"description": "Confirm", "commandId": 12, "gesture": "thumbs up"})
    assert (one.gesture, one.code, one.command_id, one.description) == ("Thumbs up", "02222", 12, "Confirm")


def test_a_gesture_without_a_command_has_that_of_the_map() -> None:
    assert asked({"gesture": "Thumbs up"}).command_id == 3


def test_a_command_is_shown_with_the_gesture_of_the_map() -> None:
    assert asked({"commandId": 3}).gesture == "Thumbs up"
    assert asked({"commandId": "3"}).gesture == "Thumbs up"


def test_a_persons_own_gesture_for_a_command_goes_before_the_map() -> None:
    assert asked({"commandId": 3}, own={3: "Horns"}).gesture == "Horns"
    assert asked({"commandId": 3, "gesture": "Thumbs up"}, own={3: "Horns"}).gesture == "Thumbs up"


def test_the_definition_says_what_the_task_leaves_out() -> None:
    definition = Definition("Part lies free", "Look into the bin", "Horns", 8)
    one = asked({}, definition)
    assert (one.gesture, one.command_id, one.description) == ("Horns", 8, "Look into the bin")
    assert asked({"commandId": 3}, definition).gesture == "Thumbs up"
    assert asked({"gesture": "Ring straight"}, definition).gesture == "Ring straight"
    assert asked({"description": "Mine"}, definition).description == "Mine"
    assert asked({}, Definition("Part lies free", None, "Horns")).description == "Part lies free"
    assert asked({"commandId": 3}).description == "confirm-part"


def test_the_definition_is_read_only_where_it_is_needed() -> None:
    assert not needs_definition({"description": "Confirm", "gesture": "Horns"})
    assert not needs_definition({"description": "Confirm", "commandId": 3})
    assert needs_definition({"description": "Confirm"})
    assert needs_definition({"gesture": "Horns"})
    assert needs_definition({"description": 7, "gesture": "Horns"})


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"gesture": "Vulcan salute"}, 'the unknown gesture "Vulcan salute"; the gestures are Horns'),
        ({"gesture": "Thumb up"}, 'did you mean "Thumbs up"'),
        ({"gesture": ["Horns"]}, "the unknown gesture"),
        ({"commandId": 99}, "the command 99, which has no gesture"),
        ({"commandId": "three"}, 'a whole number such as 3, not "three"'),
        ({"commandId": True}, 'not "True"'),
        ({"commandId": 3.5}, 'not "3.5"'),
        ({}, "neither a gesture nor a commandId"),
    ],
)
def test_a_task_that_cannot_be_shown_fails_with_the_reason(parameters: dict[str, Any], words: str) -> None:
    with pytest.raises(TaskFailed) as failed:
        asked(parameters)
    assert words in failed.value.reason


def test_answers_are_offered_but_for_the_gesture_that_the_task_asks_for() -> None:
    answers = {Outcome.NOT_GOOD: "Horns", Outcome.PROBLEM: "Ring straight"}

    def offered(gesture: str) -> dict[str, str]:
        one = resolve_prompt(TASK, {"gesture": gesture}, Definition(), GESTURES, COMMANDS, answers=answers)
        return {outcome.value: part.gesture for outcome, part in one.answers.items()}

    assert offered("Thumbs up") == {"notGood": "Horns", "problem": "Ring straight"}
    assert offered("Horns") == {"problem": "Ring straight"}
