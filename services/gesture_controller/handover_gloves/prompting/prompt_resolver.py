"""The prompt resolver: finds out what a Task asks for, once, before the person is prompted.

The Task's workParameters count first, then the row of the specification database that its parameter
`specification` names, then its TaskDefinition in the broker, then the row of its TaskDefinition.
A command without a gesture is shown with the person's own gesture for it, else with that of the command map.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.job import TaskFailed
from handover.runtime.retry import retry
from handover.telemetry import get_logger
from handover_datamodels.entities import Task
from handover_gloves.prompting.prompt import PromptSpec
from handover_gloves.recognition.gestures import Answers, Commands, Gestures, answer_parts
from handover_gloves.specifications.database import SpecificationDatabase
from handover_gloves.specifications.definition import Definition, needs_definition

log = get_logger(__name__)


async def find_definition(
    task: Task,
    parameters: Mapping[str, Any],
    broker: BrokerClient,
    database: SpecificationDatabase,
    timeout_s: float,
) -> Definition:
    """Return what the TaskDefinition of `task` adds to its `parameters`; an empty definition if nothing.

    Waits while the broker is unavailable. Waits `timeout_s` for the database, but only if the Task names a
    row of it, or if neither the Task nor the broker has a gesture or command.
    """
    if not needs_definition(parameters):
        return Definition()
    named = parameters.get("specification")
    row = Definition()
    if isinstance(named, str) and named:
        row = await database.look_up(named, timeout_s)
        if not needs_definition(parameters, row):
            return row
    definition = row.filled_from(await _definition_in_broker(task, broker))
    if not needs_definition(parameters, definition):
        return definition
    has_prompt = (
        definition.has_prompt
        or parameters.get("gesture") is not None
        or parameters.get("commandId") is not None
    )
    stored = await database.look_up(task.is_defined_by.object, 0.0 if has_prompt else timeout_s)
    return definition.filled_from(stored)


async def handles_outcomes(task: Task, parameters: Mapping[str, Any], broker: BrokerClient) -> bool:
    """Return True if the process of `task` handles other outcomes than `ok`.

    The Task's own value counts before that of its TaskDefinition. Waits while the broker is unavailable.
    """
    handled = parameters.get("handlesOutcomes")
    if handled is None:
        handled = (await _definition_in_broker(task, broker)).handles_outcomes
    return handled is True


async def requires_pin(task: Task, parameters: Mapping[str, Any], broker: BrokerClient) -> bool:
    """Return True if the person who answers `task` gives the own PIN; see `handles_outcomes`."""
    required = parameters.get("requirePin")
    if required is None:
        required = (await _definition_in_broker(task, broker)).require_pin
    return required is True


async def _definition_in_broker(task: Task, broker: BrokerClient) -> Definition:
    try:
        entity = await retry(lambda: broker.retrieve(task.is_defined_by.object), on=BrokerUnavailable)
    except NotFound:
        return Definition()
    except BrokerError as error:
        log.warning("task definition not available", task=task.id, error=str(error))
        return Definition()
    name, description = _value(entity, "name"), _value(entity, "description")
    return Definition(
        name if isinstance(name, str) else None,
        description if isinstance(description, str) else None,
        _value(entity, "gesture"),
        _value(entity, "commandId"),
        _value(entity, "handlesOutcomes"),
        _value(entity, "requirePin"),
    )


def resolve_prompt(
    task: Task,
    parameters: Mapping[str, Any],
    definition: Definition,
    gestures: Gestures,
    commands: Commands,
    *,
    answers: Answers = MappingProxyType({}),
    compared: Commands | None = None,
    unavailable: str = "",
) -> PromptSpec:
    """Return the prompt of `task` for a person with `gestures` and `commands`.

    Raises `TaskFailed` if no gesture can be found. `answers` are the site's gestures for other outcomes.
    `unavailable` names a source that could not be read, for the error message. A study compares gestures for
    the same commands: `compared` then has the site's commands, and the gesture of the command counts before a
    gesture that the Task names.
    """
    named = _first(parameters.get("gesture"), definition.gesture)
    command_id = _command_id(_first(parameters.get("commandId"), definition.command_id))
    if parameters.get("commandId") is not None and parameters.get("gesture") is None:
        named = None  # the Task's own command counts before the definition's gesture
    if compared is not None and isinstance(named, str):
        command_id = compared.ids.get(gestures.find(named) or "") if command_id is None else command_id
        if command_id in commands.gestures:
            named = None
    if named is not None:
        gesture = _known(named, gestures)
        command_id = commands.ids.get(gesture) if command_id is None else command_id
    elif command_id is not None:
        gesture = _gesture_of_command(command_id, commands)
    else:
        raise TaskFailed(
            "the Task names neither a gesture nor a commandId; put one of them in its workParameters"
            + (f", or see to this: {unavailable}" if unavailable else "")
        )
    parts = gestures.parts_of(gesture)
    description = _description(task, parameters, definition)
    others = answer_parts(answers, gestures, parts)
    return PromptSpec(task.id, description, gesture, parts[0].code, command_id, parts, others)


def _known(named: Any, gestures: Gestures) -> str:
    gesture = gestures.find(named) if isinstance(named, str) else None
    if gesture is None:
        hint = gestures.like(str(named))
        raise TaskFailed.translated(
            "task.unknown_gesture",
            'the Task asks for the unknown gesture "{named}"; {hint}',
            named=named,
            hint=hint,
        )
    return gesture


def _gesture_of_command(command_id: int, commands: Commands) -> str:
    gesture = commands.gestures.get(command_id)
    if gesture is None:
        raise TaskFailed.translated(
            "task.command_without_gesture",
            "the Task asks for the command {command_id}, which has no gesture; name a "
            "gesture in its workParameters or give the command one in the gestures file",
            command_id=command_id,
        )
    return gesture


def _command_id(value: Any) -> int | None:
    if value is None:
        return None
    if isinstance(value, str) and value.isdecimal():
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise TaskFailed.translated(
            "task.command_not_whole", 'commandId is a whole number such as 3, not "{given}"', given=value
        )
    return value


def _description(task: Task, parameters: Mapping[str, Any], definition: Definition) -> str:
    own_name = task.is_defined_by.object.rsplit(":", 1)[-1]
    return _text(parameters.get("description")) or definition.description or definition.name or own_name


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _first(*values: Any) -> Any:
    return next((value for value in values if value is not None), None)


def _value(entity: Mapping[str, Any], attribute: str) -> Any:
    value = entity.get(attribute)
    return value.get("value") if isinstance(value, Mapping) else value
