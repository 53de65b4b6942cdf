"""The commands of installed packages: entry points in `handover.commands`, each a `typer.Typer`.

    [project.entry-points."handover.commands"]
    lamp = "lamp.commands:app"               # handover lamp …
    "robot.weigh" = "lamp.commands:weigh"    # handover robot weigh …

A package is imported when its command is used or listed, so that `handover up` does not load them all.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, Final

import typer
from typer.core import TyperGroup
from typer.main import get_command

from handover.errors import UsageError
from handover.extensions import ExtensionPoint

COMMANDS: Final = ExtensionPoint(
    "command",
    "handover.commands",
    parts={
        "accounts": "handover-accounts",
        "audit": "handover-accounts",
        "backup": "handover-cell",
        "body": "handover-body",
        "bridge": "handover-ros",
        "broker": "handover-broker",
        "case": "handover-cell",
        "check": "handover-cell",
        "component": "handover-accounts",
        "demo": "handover-cell",
        "device": "handover-devices",
        "doctor": "handover-cell",
        "edge": "handover-devices",
        "glove": "handover-gloves",
        "humanoid": "handover-humanoid",
        "process": "handover-processes",
        "restore": "handover-cell",
        "robot": "handover-robots",
        "robot.simulate-ur": "handover-ur",
        "secure": "handover-cell",
        "specification": "handover-gloves",
        "task": "handover-processes",
        "up": "handover-cell",
    },
)
COMPLETION: Final = frozenset({"install_completion", "show_completion"})
"""The options that Typer adds to each app; `handover` has them for all."""


class InstalledCommands(TyperGroup):
    """The group of the commands that are defined here, and of those that packages register."""

    @cached_property
    def registered(self) -> list[str]:
        """The names of the entry points, read once."""
        return COMMANDS.names()

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands: ours first."""
        own = super().list_commands(ctx)
        return [*own, *sorted(name for name in self.registered if "." not in name and name not in own)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; None if there is none of this name."""
        command = super().get_command(ctx, cmd_name)
        exists = cmd_name in self.registered or cmd_name in COMMANDS.parts
        if command is None and "." not in cmd_name and exists:
            command = _load(cmd_name, cmd_name, self.registered)
            self.add_command(command, cmd_name)
        return command


def commands_of(app: typer.Typer) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield every command and group of `app` with its words, `app` itself with none."""

    def below(command: Any, words: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
        yield words, command
        if isinstance(command, TyperGroup):
            context = typer.Context(command)
            for name in command.list_commands(context):
                yield from below(command.get_command(context, name), (*words, name))

    return below(get_command(app), ())


def _load(registered: str, name: str, all_names: Sequence[str]) -> Any:
    """Return a registered command with those registered below it; one that fails if it cannot be loaded."""
    try:
        app = COMMANDS.load(registered)
    except UsageError as fault:
        app = _failing(fault)
    if not isinstance(app, typer.Typer):
        app = _failing(UsageError(f'the command "{registered}" is no typer.Typer; repair its package'))
    command = get_command(app)
    command.name = name
    command.params = [option for option in command.params if option.name not in COMPLETION]
    if isinstance(command, TyperGroup):
        for below in dict.fromkeys((*all_names, *COMMANDS.parts)):
            parent, _, last = below.rpartition(".")
            if parent == registered:
                command.add_command(_load(below, last, all_names), last)
                command.commands[last].hidden = below not in all_names
    return command


def _failing(fault: UsageError) -> typer.Typer:
    """Return a command that says why it cannot be loaded, so that the others can be used and listed."""
    app = typer.Typer()

    @app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
    def fail() -> None:
        """It cannot be loaded; use it to see the reason."""
        raise fault

    return app
