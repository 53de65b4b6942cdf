"""The `handover` command."""

import asyncio
import os
import runpy
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from handover.distribution import version
from handover.errors import HandoverError, Problem, UsageError
from handover.private_files import faults_of as open_files
from handover.private_files import owner_of
from handover.service_addresses import OWN_SERVICES
from handover.settings import Settings, origins
from handover.sqlite_files import REMEDY, renew_marks
from handover.telemetry import log_to_stderr
from handover_cell import (
    accounts,
    audit,
    backup,
    body,
    bridge,
    broker,
    component,
    device,
    edge,
    humanoid,
    process,
    robot,
    secrets,
    secure,
    specification,
    task,
)
from handover_cell.check import BROKER, check_database, databases, faults_of_keys
from handover_cell.demo import demo as run_demo
from handover_cell.doctor import examine
from handover_cell.glove import bridge_arguments, change_token
from handover_cell.launcher import Launcher
from handover_cell.output import AsJson, print_json
from handover_cell.services import all_services, let_broker_fetch_context, service_named, wanted_services
from handover_cell.supervisor import run_watched

app = typer.Typer(
    help="People and robots hand work to each other.",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
app.add_typer(process.app, name="process")
app.add_typer(task.app, name="task")
app.add_typer(bridge.app, name="bridge")
app.add_typer(broker.app, name="broker")
app.add_typer(specification.app, name="specification")
app.add_typer(secrets.app, name="secrets")
app.add_typer(secure.app, name="secure")
app.add_typer(robot.app, name="robot")
app.add_typer(accounts.app, name="accounts")
app.add_typer(audit.app, name="audit")
app.add_typer(component.app, name="component")
app.add_typer(device.app, name="device")
app.add_typer(edge.app, name="edge")
app.add_typer(body.app, name="body")
app.add_typer(humanoid.app, name="humanoid")

app.command()(backup.backup)
app.command()(backup.restore)

NEXT_STEPS = """\
People and robots hand work to each other. What to do next:

  handover demo    watch a person and a robot work, on the page that it names
  handover up      run all services with a simulated robot, for processes of your own
  handover doctor  see whether this machine has what a cell needs

All commands: handover --help"""

DataDir = Annotated[Path | None, typer.Option("--data-dir", help="The directory of all persistent data.")]


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
    say("A person and a robot empty a bin together: simulated operator with glove-1, simulated robot.")
    let_broker_fetch_context()
    _until_stopped(run_demo(_settings(data_dir), once=once, timeout_s=timeout_s, say=say))


@app.command()
def case(  # noqa: PLR0917 - options of a command
    name: Annotated[str | None, typer.Argument(help="The case; without it the cases are listed.")] = None,
    as_json: AsJson = False,
    once: Annotated[
        bool, typer.Option("--once", help="End after the trial, with exit code 0 if the machine did right.")
    ] = False,
    duration_s: Annotated[
        float | None,
        typer.Option("--duration", min=5, help="Seconds of the trial, instead of the paper's."),
    ] = None,
    live: Annotated[
        bool,
        typer.Option("--live", help="With --once: in real time, not on a faster clock of its own."),
    ] = False,
    consents_to_model: Annotated[
        bool,
        typer.Option(
            "--consent-to-model",
            help="The simulated persons of the treadmill consent that the language model of the settings "
            "words the advice.",
        ),
    ] = False,
    timeout_s: Annotated[float, typer.Option("--timeout", help="Maximum duration in seconds.")] = 1800.0,
    data_dir: DataDir = None,
) -> None:
    """Run a case study: a machine that adapts to the body of a simulated person, on the page Cases."""
    from handover_cell.case import (  # noqa: PLC0415 - only this command
        TrialWish,
        known_cases,
        load_case,
        print_study,
        run_case,
        study_of,
    )

    if name is None:
        if as_json:
            print_json([{"name": each.name, "summary": each.summary} for each in known_cases()])
            return
        for each in known_cases():
            say(f"{each.name:<14} {each.summary}")
        return
    chosen = load_case(name)
    say(f"{chosen.summary} Nothing here is a medical device or a safety function.")
    if once and not live and (study := study_of(name)) is not None:
        print_study(name, study(duration_s, say, consents_to_model=consents_to_model), say)
        return
    wish = TrialWish(duration_s, consents_to_model)
    let_broker_fetch_context()
    _until_stopped(run_case(chosen, _settings(data_dir), wish, once=once, timeout_s=timeout_s, say=say))


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
    _until_stopped(_up(_settings(data_dir)))


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
    secrets.wait_for_secrets(chosen.settings.model_fields)
    secure.wait_for_security("HANDOVER_TLS_KEY", "HANDOVER_TLS_CERTIFICATE")
    if port is not None:
        os.environ[chosen.port_setting] = str(port)
    settings = _settings(data_dir)
    if watch:
        run_watched(chosen.name, chosen.url(), settings, say)  # returns in the process of the service
    runpy.run_module(chosen.module, run_name="__main__", alter_sys=True)


@app.command(
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
)
def glove(context: typer.Context) -> None:
    """Run the glove bridge: forward, serial, replay, record, simulate, calibrate; or manage a token."""
    if context.args[:1] == ["token"]:
        change_token(context.args[1:], say)
        return
    from glove_sdk_bridge.__main__ import main as bridge  # noqa: PLC0415 - only this command needs it

    secrets.wait_for_secrets(("glove_token",))
    secure.wait_for_security()
    raise typer.Exit(bridge(bridge_arguments(context.args), program="handover glove"))


@app.command()
def settings(as_json: AsJson = False) -> None:
    """Print every setting with its value and source."""
    known = list(origins([service.settings for service in all_services()]))
    if as_json:
        print_json([asdict(setting) for setting in known])
        return
    width = max(len(setting.name) for setting in known)
    for setting in known:
        say(f"{setting.name:<{width}}  {setting.value or '-':<36} {setting.origin:<12} {setting.description}")


@app.command()
def check(
    data_dir: DataDir = None,
    restamp: Annotated[
        bool,
        typer.Option(help="Create the marks of sound databases again, after you replaced a file yourself."),
    ] = False,
) -> None:
    """Check all databases, keys and tokens in the data directory completely.

    Exit code 0: all are sound; 1: one is damaged, others can read it, or it could not be checked; 2: there is
    no data directory. What cannot be read, on a full disk for example, is named; it is not damaged.
    """
    folder = _settings(data_dir).data_dir
    if not folder.is_dir():
        raise UsageError(
            f"there is no data directory {folder.absolute()}; name that of the cell with --data-dir, or run "
            "this command in the folder of the cell"
        )
    found = databases(folder)
    if not found:
        say(f"there is no database in {folder.absolute()}")
    is_damaged = is_unknown = False
    for path in found:
        if restamp and path.name != BROKER:
            renew_marks(path)
        result = check_database(path)
        is_damaged = is_damaged or bool(result.faults)
        for fault in result.faults:
            say(f"damaged  {fault}")
        is_unknown = is_unknown or result.unreadable is not None
        if result.unreadable:
            say(f"unknown  {path}: {result.unreadable}")
        elif not result.faults:
            say(f"ok       {path}")
    key_faults = faults_of_keys()
    for fault in key_faults:
        say(f"damaged  {fault}")
    readable = list(open_files(folder))
    for line in readable:
        say(f"open     {line}")
    if (owner := owner_of(folder)) is not None:
        say(f"accepted {owner}")
    if is_damaged:
        say(f"remedy: {REMEDY}")
    if is_damaged or is_unknown or key_faults or readable:
        raise typer.Exit(1)


@app.command()
def doctor(data_dir: DataDir = None, as_json: AsJson = False) -> None:
    """Check this machine and a broker that is not ours; print the remedy for each missing part.

    `wrong` is what keeps a part of Handover from working, then the exit code is 1; what is `missing` is
    optional.
    """
    findings = examine(_settings(data_dir))
    if as_json:
        print_json([asdict(finding) for finding in findings])
    else:
        for finding in findings:
            level = "ok" if finding.ok else "wrong" if finding.needed else "missing"
            say(f"{level:<7}  {finding.about}: {finding.words}")
    if not all(finding.ok or not finding.needed for finding in findings):
        raise typer.Exit(1)


def say(line: str) -> None:
    """Print a line without buffering."""
    print(line, flush=True)


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


def _settings(data_dir: Path | None) -> Settings:
    if data_dir is not None:
        os.environ["HANDOVER_DATA_DIR"] = str(data_dir.absolute())
    return Settings.load()


def _until_stopped(work: Any) -> None:
    """Run `work` until it ends or until Ctrl-C or SIGTERM."""

    async def watched() -> None:
        import signal  # noqa: PLC0415

        task = asyncio.ensure_future(work)
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, task.cancel)
        try:
            await task
        except asyncio.CancelledError:
            say("stopped")

    asyncio.run(watched())
