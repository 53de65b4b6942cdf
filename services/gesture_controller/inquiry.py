"""The inquiry: what a Task asks of the hand, found out once, before anybody is asked.

What stands in the Task's workParameters goes first, then what its TaskDefinition says; a command without
a gesture is shown with the person's own gesture for it, else with that of the command map.
"""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from datamodels.entities import Task
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.job import TaskFailed
from handover.telemetry import get_logger
from services.gesture_controller.errand import Asked
from services.gesture_controller.gestures import Commands, Gestures

log = get_logger(__name__)

RETRY_S = 0.5


@dataclass(frozen=True, slots=True)
class Definition:
    """What a TaskDefinition says to the person, as far as it says anything."""

    name: str | None = None
    description: str | None = None
    gesture: Any = None
    command_id: Any = None


async def definition_of(task: Task, broker: BrokerClient) -> Definition:
    """Return what the TaskDefinition of `task` says; an empty one if the broker has none.

    Waits while the broker is away.
    """
    while True:
        try:
            entity = await broker.retrieve(task.is_defined_by.object)
        except NotFound:
            return Definition()
        except BrokerUnavailable:
            await asyncio.sleep(RETRY_S)
        except BrokerError as error:
            log.warning("task definition cannot be had", task=task.id, error=str(error))
            return Definition()
        else:
            name, description = _value(entity, "name"), _value(entity, "description")
            return Definition(
                name if isinstance(name, str) else None,
                description if isinstance(description, str) else None,
                _value(entity, "gesture"),
                _value(entity, "commandId"),
            )


def what_is_asked(
    task: Task,
    parameters: Mapping[str, Any],
    definition: Definition,
    gestures: Gestures,
    commands: Commands,
) -> Asked:
    """Return what `task` asks, with the `commands` of the person; raise `TaskFailed` if nobody can tell."""
    named = _first(parameters.get("gesture"), definition.gesture)
    command_id = _command_id(_first(parameters.get("commandId"), definition.command_id))
    if parameters.get("commandId") is not None and parameters.get("gesture") is None:
        named = None  # the Task's own command goes before the definition's gesture
    if named is not None:
        gesture = _known(named, gestures)
        command_id = commands.ids.get(gesture) if command_id is None else command_id
    elif command_id is not None:
        gesture = _shown_for(command_id, commands)
    else:
        raise TaskFailed(
            "the Task names neither a gesture nor a commandId; put one of them in its workParameters"
        )
    parts = gestures.parts_of(gesture)
    description = _description(task, parameters, definition)
    return Asked(task.id, description, gesture, parts[0].code, command_id, parts)


def needs_definition(parameters: Mapping[str, Any]) -> bool:
    """Say whether the workParameters leave something to ask the TaskDefinition for."""
    asks = parameters.get("gesture") is not None or parameters.get("commandId") is not None
    return not (asks and _text(parameters.get("description")))


def _known(named: Any, gestures: Gestures) -> str:
    gesture = gestures.find(named) if isinstance(named, str) else None
    if gesture is None:
        hint = gestures.like(str(named))
        raise TaskFailed(f'the Task asks for the unknown gesture "{named}"; {hint}')
    return gesture


def _shown_for(command_id: int, commands: Commands) -> str:
    gesture = commands.gestures.get(command_id)
    if gesture is None:
        raise TaskFailed(
            f"the Task asks for the command {command_id}, which has no gesture; "
            "name a gesture in its workParameters or give the command one in the gestures file"
        )
    return gesture


def _command_id(given: Any) -> int | None:
    if given is None:
        return None
    if isinstance(given, str) and given.isdecimal():
        return int(given)
    if isinstance(given, bool) or not isinstance(given, int):
        raise TaskFailed(f'commandId is a whole number such as 3, not "{given}"')
    return given


def _description(task: Task, parameters: Mapping[str, Any], definition: Definition) -> str:
    own_name = task.is_defined_by.object.rsplit(":", 1)[-1]
    return _text(parameters.get("description")) or definition.description or definition.name or own_name


def _text(given: Any) -> str:
    return given if isinstance(given, str) else ""


def _first(*given: Any) -> Any:
    return next((one for one in given if one is not None), None)


def _value(entity: Mapping[str, Any], attribute: str) -> Any:
    given = entity.get(attribute)
    return given.get("value") if isinstance(given, Mapping) else given
