"""The forms of a command: a message to the device, and a row of the database."""

from typing import Any

import orjson

from handover.messages import Message, message_in, with_code
from handover_devices.commands.command import Command, CommandState
from handover_devices.model.description import CANCEL, CommandKind
from handover_devices.storage.history_writer import CommandRow


def command_message(command: Command, now_s: float) -> dict[str, Any]:
    """Return the message that sends the command."""
    return {
        "type": "command",
        "id": command.id,
        "name": command.name,
        "parameters": dict(command.parameters),
        "deadline": round(command.deadline_s, 3),
        "remaining": round(max(command.deadline_s - now_s, 0.0), 3),  # for devices without a clock
    }


def cancel_message(command: Command) -> dict[str, Any]:
    """Return the message that cancels the command."""
    return {
        "type": "command",
        "id": f"{command.id}:{CANCEL}",
        "name": CANCEL,
        "parameters": {"id": command.id},
    }


def row_of(command: Command) -> CommandRow:
    """Return the row of the command for the database."""
    return CommandRow(
        command.device,
        command.id,
        command.name,
        command.kind.value,
        orjson.dumps(dict(command.parameters)).decode(),
        int(command.created_s * 1e6),
        int(command.deadline_s * 1e6),
        command.state.value,
        command.progress,
        None if command.result is None else orjson.dumps(dict(command.result)).decode(),
        command.reason,
        command.boot,
        None
        if not isinstance(command.reason, Message)
        else orjson.dumps(with_code("reason", command.reason)).decode(),
    )


def command_of(row: CommandRow) -> Command:
    """Return the command of a row of the database."""
    return Command(
        row.device,
        row.id,
        row.name,
        CommandKind(row.kind),
        orjson.loads(row.parameters),
        row.created_us / 1e6,
        row.deadline_us / 1e6,
        CommandState(row.state),
        row.progress,
        None if row.result is None else orjson.loads(row.result),
        row.reason if row.reason_message is None else message_in(orjson.loads(row.reason_message), "reason"),
        row.boot,
    )
