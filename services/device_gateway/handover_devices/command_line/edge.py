"""`handover edge`: run an edge, which relays devices on site to a central gateway; grant devices to it."""

import os
import runpy
import time
from typing import Annotated, Any

import typer

from handover.command_line.access import ask_service
from handover.command_line.waiting import wait_for_secrets, wait_for_security
from handover_devices.settings import GatewaySettings

app = typer.Typer(
    help="An edge relays devices on site to a central gateway: run, status, grant.", no_args_is_help=True
)

Edge = Annotated[str, typer.Argument(help="The name of the edge at the centre.")]


@app.command()
def run(
    centre: Annotated[str, typer.Argument(help="host:port of the device port of the central gateway.")],
    name: Edge,
    buffer_mib: Annotated[
        int | None, typer.Option("--buffer", min=1, help="Size of what waits for the centre, in MiB.")
    ] = None,
) -> None:
    """Run an edge in the foreground; HANDOVER_EDGE_TOKEN has its token.

    Devices connect to it as to any gateway (HANDOVER_DEVICE_HOST, HANDOVER_DEVICE_PORT).
    """
    wait_for_secrets(GatewaySettings.model_fields)
    wait_for_security("HANDOVER_TLS_KEY", "HANDOVER_TLS_CERTIFICATE")
    os.environ["HANDOVER_EDGE_UPSTREAM"], os.environ["HANDOVER_EDGE_NAME"] = centre, name
    if buffer_mib is not None:
        os.environ["HANDOVER_EDGE_BUFFER_MIB"] = str(buffer_mib)
    runpy.run_module("handover_devices", run_name="__main__", alter_sys=True)


@app.command()
def status() -> None:
    """Print the state of the edge that runs on this machine; exit with 1 while the centre is unreachable."""
    state = _ask("GET", "/edge")
    link = "connected" if state["connected"] else f"not connected: {state['fault']}"
    print(f"{state['name']} > {state['upstream']}: {link}")
    print(f"devices: {state['connectedDevices']} of {state['devices']} connected")
    age = "" if state["oldest"] is None else f", the oldest of {time.time() - state['oldest']:.0f} s ago"
    filled = 100 * state["waitingBytes"] / state["maxBytes"]
    print(f"waiting: {state['waiting']} messages, {filled:.1f} % of the buffer{age}")
    print(
        f"dropped because the buffer was full: {state['dropped']}; refused by the centre: {state['refused']}"
    )
    if not state["connected"]:
        raise typer.Exit(1)


@app.command()
def grant(
    edge: Edge,
    devices: Annotated[list[str], typer.Argument(help="Devices registered at the centre.")],
    remove: Annotated[bool, typer.Option("--remove", help="Take the devices from the edge instead.")] = False,
) -> None:
    """Let an edge relay devices, at the centre; a device has one edge at most."""
    for name in devices:
        description = _ask("GET", f"/devices/{name}")["description"]
        if remove and description.get("edge") != edge:
            print(f"{name} was not granted to {edge}")
            continue
        _ask("PUT", f"/devices/{name}", json={**description, "edge": None if remove else edge})
        print(f"{name} is {'no longer ' if remove else ''}relayed by {edge}")


def _ask(method: str, path: str, **request: Any) -> dict[str, Any]:
    settings = GatewaySettings.load()
    answer = ask_service("device gateway", settings, method, settings.device_gateway, path, **request)
    state: dict[str, Any] = answer.json()
    return state
