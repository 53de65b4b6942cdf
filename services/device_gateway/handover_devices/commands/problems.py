"""The refusals of commands, as problems of HTTP."""

from collections.abc import Mapping
from typing import Any, Final

import orjson
from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError, best_match

from handover.errors import Problem
from handover_devices.model.description import DeviceDescription

MAX_PARAMETERS_BYTES: Final = 32 * 1024


def unknown_command(device: str, name: str, description: DeviceDescription) -> Problem:
    """Return the refusal of a command that the device does not take."""
    names = ", ".join(command.name for command in description.commands) or "–"
    return Problem.translated(
        404,
        "No such command",
        "device.command_unknown",
        '{device} takes no command "{command}"; it takes {known}',
        device=device,
        command=name[:64],
        known=names,
    )


def no_command(device: str, identifier: str) -> Problem:
    """Return the answer for an id that no command of the device has."""
    return Problem.translated(
        404,
        "No such command",
        "device.no_command_with_id",
        '{device} has no command with the id "{id}"',
        device=device,
        id=identifier[:128],
    )


def require_valid(name: str, parameters: Mapping[str, Any], schema: Mapping[str, Any] | None) -> None:
    """Raise `Problem` 422 unless the parameters are those of the schema of the command."""
    try:
        size = len(orjson.dumps(dict(parameters)))
    except TypeError as error:
        raise Problem.translated(
            422,
            "Wrong parameters",
            "device.parameters_no_json",
            "the parameters are no plain JSON: {error}",
            error=str(error),
        ) from None
    if size > MAX_PARAMETERS_BYTES:
        raise Problem.translated(
            422,
            "Wrong parameters",
            "device.parameters_too_large",
            "the parameters have {size} bytes, and at most {maximum} fit",
            size=size,
            maximum=MAX_PARAMETERS_BYTES,
        )
    if schema is None:
        return
    fault: ValidationError | None = best_match(Draft202012Validator(schema).iter_errors(dict(parameters)))
    if fault is not None:
        where = "".join(f", {part}" for part in [name, *fault.absolute_path])[2:]
        raise Problem.translated(
            422,
            "Wrong parameters",
            "device.parameters_invalid",
            "parameters of {place}: {reason}",
            place=where,
            reason=fault.message[:300],
        )


def too_many_commands(device: str, maximum: int) -> Problem:
    """Return the refusal of a command while `maximum` are open."""
    return Problem.translated(
        429,
        "Too many commands",
        "device.commands_too_many",
        "{device} has {maximum} open commands; wait until some have ended",
        device=device,
        maximum=maximum,
    )


def id_taken(identifier: str) -> Problem:
    """Return the refusal of a command whose id another one has."""
    return Problem.translated(
        409,
        "Another command",
        "device.command_id_taken",
        'the id "{id}" is that of another command; use a new one',
        id=identifier,
    )


def device_away(device: str, command: str) -> Problem:
    """Return the refusal of a motion of a device that is not connected."""
    return Problem.translated(
        409,
        "Device away",
        "device.motion_away",
        '{device} is not connected, and "{command}" is a motion, which is never queued; '
        "connect the device and send the command again",
        device=device,
        command=command,
    )


def edge_away(device: str, command: str, edge: str) -> Problem:
    """Return the refusal of a motion of a device whose edge is not connected."""
    return Problem.translated(
        409,
        "Edge away",
        "device.motion_edge_away",
        '{device} is reached through the edge {edge}, which is not connected, and "{command}" is a '
        "motion, which is never queued; restore the connection of the edge and send the command again",
        device=device,
        command=command,
        edge=edge,
    )


def no_longer_leading() -> Problem:
    """Return the answer to a client whose command may not have been written."""
    return Problem.translated(
        503,
        "No leader",
        "device.leader_changed",
        "another gateway took over; ask for the command by its id, and send it again if there is none",
    )
