"""`handover up` and `handover demo`: all services of a cell on this machine."""

import asyncio
import os
from pathlib import Path
from typing import Annotated

import typer

from handover.command_line.foreground import DataDir, say, settings_in, until_stopped
from handover.extensions import load_service
from handover.service_addresses import ROS_BRIDGE
from handover.services import let_broker_fetch_context, service_named, wanted_services
from handover.settings import Settings
from handover_cell.launching.launcher import Launcher

demo_app = typer.Typer()
up_app = typer.Typer()


@demo_app.command()
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


@up_app.command()
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
        load_service(ROS_BRIDGE)  # or says what to install
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
