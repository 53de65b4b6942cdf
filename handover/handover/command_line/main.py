"""The `handover` command: runs a service, prints the settings, finds the commands of installed packages.

Each distribution of a service has it. Those of a whole cell, such as `handover up`, are in `handover-cell`.
"""

import os
import runpy
import sys
from dataclasses import asdict
from typing import Annotated

import typer

from handover.command_line.commands import COMMANDS, InstalledCommands
from handover.command_line.foreground import DataDir, say, settings_in
from handover.command_line.output import AsJson, print_json
from handover.command_line.waiting import wait_for_secrets, wait_for_security
from handover.distribution import install_part, version
from handover.errors import HandoverError, Problem, UsageError
from handover.extensions import SERVICES
from handover.services import all_services, service_named
from handover.serving.supervisor import run_watched
from handover.settings import Settings, origins
from handover.telemetry import log_to_stderr

app = typer.Typer(
    cls=InstalledCommands,
    help="People and robots hand work to each other.",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
NEXT_STEPS = {
    "demo": "watch a person and a robot work, on the page that it names",
    "up": "run all services with a simulated robot, for processes of your own",
    "doctor": "see whether this machine has what a cell needs",
}
"""What to do next with a cell, by the command."""


def _print_version(is_asked: bool) -> None:
    if is_asked:
        say(f"handover {version()}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def handover(
    context: typer.Context,
    _: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and end."),
    ] = False,
) -> None:
    """People and robots hand work to each other."""
    if context.invoked_subcommand is None:
        say("People and robots hand work to each other. What to do next:\n")
        commands = COMMANDS.names()
        steps = {name: text for name, text in NEXT_STEPS.items() if name in commands}
        steps = steps or {f"run {name}": "run this service" for name in SERVICES.names()}
        steps = steps or {"settings": "print every setting with its value and source"}
        width = max(map(len, steps))
        for name, text in steps.items():
            say(f"  handover {name:<{width}}  {text}")
        say("\nAll commands: handover --help")


@app.command()
def run(
    service: Annotated[str, typer.Argument(help="The name of an installed service, such as context-broker.")],
    port: Annotated[int | None, typer.Option("--port", help="Listen here instead.")] = None,
    watch: Annotated[
        bool,
        typer.Option("--watch", help="Restart it when it does not answer although it works (Linux)."),
    ] = False,
    data_dir: DataDir = None,
) -> None:
    """Run one service in the foreground."""
    chosen = service_named(service)
    wait_for_secrets(chosen.settings.model_fields)
    wait_for_security("HANDOVER_TLS_KEY", "HANDOVER_TLS_CERTIFICATE")
    if port is not None:
        os.environ[chosen.port_setting] = str(port)
    settings = settings_in(data_dir)
    if watch:
        run_watched(chosen.name, chosen.url(), settings, say)  # returns in the process of the service
    runpy.run_module(chosen.module, run_name="__main__", alter_sys=True)


@app.command()
def settings(as_json: AsJson = False) -> None:
    """Print every setting with its value and source."""
    listed = list(origins([Settings, *(service.settings for service in all_services())]))
    if as_json:
        print_json([asdict(setting) for setting in listed])
        return
    width = max(len(setting.name) for setting in listed)
    for setting in listed:
        say(f"{setting.name:<{width}}  {setting.value or '-':<36} {setting.origin:<12} {setting.description}")


def main() -> None:
    """Run the command; print errors of the user in one line, without a traceback."""
    log_to_stderr()
    try:
        app()
    except Problem as problem:
        raise SystemExit(_one_line(problem, 1)) from None
    except UsageError as error:
        raise SystemExit(_one_line(error, 2)) from None
    except HandoverError as error:
        raise SystemExit(_one_line(error, 1)) from None
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if not package.startswith("handover_"):
            raise
        missing = UsageError(f"{package} is not installed: {install_part(package.replace('_', '-'))}")
        raise SystemExit(_one_line(missing, 2)) from None


def _one_line(error: HandoverError, code: int) -> int:
    print(f"handover: {error}", file=sys.stderr)
    return code
