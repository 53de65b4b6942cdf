"""`handover robot simulate-ur`: a controller of Universal Robots to try integrations without an arm."""

import asyncio
from functools import partial
from typing import Annotated

import typer

from handover.errors import UsageError

HOME = "0,-1.5708,1.5708,-1.5708,-1.5708,0"
CB3_HZ, E_SERIES_HZ = 125.0, 500.0

app = typer.Typer()


@app.command()
def simulate_ur(  # noqa: PLR0917 - options of a command
    host: Annotated[str, typer.Option("--host", help="The address to listen on.")] = "127.0.0.1",
    rtde_port: Annotated[int, typer.Option("--rtde-port")] = 30004,
    dashboard_port: Annotated[int, typer.Option("--dashboard-port")] = 29999,
    script_port: Annotated[int, typer.Option("--script-port")] = 30002,
    robotiq_port: Annotated[int, typer.Option("--robotiq-port")] = 63352,
    joints: Annotated[str, typer.Option("--joints", help="The six joint positions in rad.")] = HOME,
    off: Annotated[bool, typer.Option("--off", help="Begin with the arm powered off.")] = False,
    model: Annotated[
        str, typer.Option("--model", help="What the dashboard calls the arm, such as UR5.")
    ] = "UR10",
    cb3: Annotated[bool, typer.Option("--cb3", help="Simulate the CB3 series (125 Hz).")] = False,
) -> None:
    """Simulate a controller of Universal Robots; lines of input are what a person does at the arm."""
    # Only this command needs them.
    from handover_ur.simulator.console import run  # noqa: PLC0415
    from handover_ur.simulator.controller import (  # noqa: PLC0415
        SimulatedController,
    )
    from handover_ur.simulator.simulator import Ports  # noqa: PLC0415

    controller = SimulatedController(
        _positions(joints), running=not off, frequency_hz=CB3_HZ if cb3 else E_SERIES_HZ, model=model
    )
    ports = Ports(rtde_port, dashboard_port, script_port, robotiq_port)
    try:
        asyncio.run(run(controller, host, ports, partial(print, flush=True)))
    except OSError as error:
        raise UsageError(
            f"the simulated controller cannot listen on {host}: {error}; choose another --host, such as "
            "127.0.0.2, or other ports"
        ) from None
    except KeyboardInterrupt:
        pass


def _positions(text: str) -> tuple[float, ...]:
    try:
        positions = tuple(map(float, text.split(",")))
    except ValueError:
        positions = ()
    if len(positions) != len(HOME.split(",")):
        raise UsageError(
            f'--joints has six positions in rad, separated by commas, such as {HOME}; not "{text}"'
        )
    return positions
