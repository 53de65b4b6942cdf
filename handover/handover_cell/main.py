"""The `handover` command."""

import asyncio
import os
import runpy
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from handover.command_line.output import AsJson, print_json
from handover.command_line.waiting import wait_for_secrets, wait_for_security
from handover.distribution import version
from handover.errors import HandoverError, Problem, UsageError
from handover.service_addresses import OWN_SERVICES
from handover.settings import Settings, origins
from handover.telemetry import log_to_stderr
from handover_cell.commands import InstalledCommands
from handover_cell.launching.foreground import DataDir, say, settings_in, until_stopped
from handover_cell.launching.launcher import Launcher
from handover_cell.launching.supervisor import run_watched
from handover_cell.services import all_services, let_broker_fetch_context, service_named, wanted_services

app = typer.Typer(
    cls=InstalledCommands,
    help="People and robots hand work to each other.",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
NEXT_STEPS = """\
People and robots hand work to each other. What to do next:

  handover demo    watch a person and a robot work, on the page that it names
  handover up      run all services with a simulated robot, for processes of your own
  handover doctor  see whether this machine has what a cell needs

All commands: handover --help"""


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
        say(NEXT_STEPS)


@app.command()
def demo(
    once: Annotated[
        bool, typer.Option("--once", help="End after the process, with exit code 0 if it completed.")
    ] = False,
    timeout_s: Annotated[
        float, typer.Option("--timeout", help="Maximum duration of the process in seconds.")
    ] = 300.0,
    data_dir: DataDir = None,
) -> None:
    """Run a complete simulated cell with the bin-picking process."""
    from handover_cell.demo import demo as run_demo  # noqa: PLC0415 - only this command needs it

    say("A person and a robot empty a bin together: simulated operator with glove-1, simulated robot.")
    let_broker_fetch_context()
    until_stopped(run_demo(settings_in(data_dir), once=once, timeout_s=timeout_s, say=say))


@app.command()
def up(
    data_dir: DataDir = None,
    ros: Annotated[
        Path | None,
        typer.Option(
            "--ros", help="Also start the ROS bridge with this mapping: a file, or the name of a shipped one."
        ),
    ] = None,
) -> None:
    """Run all services with the simulated robot, without a glove and without a process."""
    if ros is not None:
        os.environ["HANDOVER_ROS_MAPPING"] = str(ros.absolute() if ros.exists() else ros)
    let_broker_fetch_context()
    until_stopped(_up(settings_in(data_dir)))


async def _up(settings: Settings) -> None:
    services = wanted_services()
    async with Launcher(services, settings, say):
        for service in services:
            say(f"{service.name:<20} {service.url()}")
        say(f"ready; the page is at {service_named('webui').url()}; Ctrl-C stops it")
        await asyncio.Event().wait()


@app.command()
def run(
    service: Annotated[str, typer.Argument(help=", ".join(OWN_SERVICES))],
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
    listed = list(origins([service.settings for service in all_services()]))
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


def _one_line(error: HandoverError, code: int) -> int:
    print(f"handover: {error}", file=sys.stderr)
    return code
