"""Commands that need two services: `handover robot check` and `handover bridge device`."""

import asyncio
import os
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from pydantic import ValidationError

from handover.command_line.parameters import parse_parameter
from handover.errors import UsageError
from handover.network.tls_trust import client_context

robot_check = typer.Typer()
bridge_device = typer.Typer()


@robot_check.command()
def check_robot(
    process: Annotated[Path, typer.Argument(help="A BPMN 2.0 file.")],
    cell: Annotated[
        Path | None, typer.Option("--cell", help="The cell file, else that of the settings.")
    ] = None,
    parameters: Annotated[
        list[str] | None, typer.Option("--set", help="A process parameter, name=value; JSON or text.")
    ] = None,
    max_cycle_s: Annotated[
        float | None, typer.Option("--max-cycle", help="Fail above this cycle time of the robots in s.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Run the motions of a process dry; exit with 1 if one collides, exceeds a limit or is out of reach."""
    from handover_cell.robot_check import as_json, check_process  # noqa: PLC0415 - loads two services
    from handover_robots.settings import TrajectorySettings  # noqa: PLC0415 - as above

    settings = TrajectorySettings.load(**({} if cell is None else {"cell_file": cell}))
    checked = check_process(
        process, settings, dict(parse_parameter(parameter) for parameter in parameters or [])
    )
    if not checked:
        raise UsageError(f"{process} has no activity of a robot of this cell")
    cycle_s = sum(activity.duration_s for activity in checked)
    is_slow = max_cycle_s is not None and cycle_s > max_cycle_s
    if json:
        print(as_json(checked))
    else:
        for activity in checked:
            state = "FAILED" if activity.faults else "skipped" if activity.skipped else "ok"
            what = f"{activity.robot:<12} {activity.operation:<11} {activity.name}"
            print(f"{state:<8} {activity.duration_s:6.2f} s  {what}")
            for line in (*activity.faults, *([activity.skipped] if activity.skipped else [])):
                print(f"         {line}")
            if activity.nearest is not None:
                near = activity.nearest
                print(f"         nearest: {near.first} to {near.second}, {1000 * near.distance_m:.0f} mm")
        print(f"cycle time of the robots: {cycle_s:.2f} s{' (too long)' if is_slow else ''}")
    if is_slow or any(activity.faults for activity in checked):
        raise typer.Exit(1)


@bridge_device.command()
def connect_ros_device(
    name: Annotated[str, typer.Argument(help="The name of the robot, registered at the gateway.")],
    file: Annotated[Path, typer.Option("--file", help="What of the graph makes the device, in YAML.")],
    host: Annotated[str, typer.Option("--host", help="The gateway or edge.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", help="Its port for devices.")] = 54010,
    tls: Annotated[bool, typer.Option("--tls", help="Connect with TLS.")] = False,
) -> None:
    """Connect a robot of the ROS graph with a device gateway or edge; HANDOVER_DEVICE_TOKEN has its token."""
    from handover_cell.ros_device import RosDevice, RosDeviceFile  # noqa: PLC0415 - loads two services
    from handover_devices.device_client import DeviceClient  # noqa: PLC0415 - as above
    from handover_ros.command_line.bridge import on_the_graph  # noqa: PLC0415 - as above
    from handover_ros.settings import BridgeSettings  # noqa: PLC0415 - as above
    from handover_ros.types.type_store import TypeStore  # noqa: PLC0415 - as above

    settings = BridgeSettings.load()
    try:
        described = RosDeviceFile.model_validate(yaml.safe_load(file.read_text(encoding="utf-8")))
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, ValidationError, UnicodeDecodeError) as error:
        raise UsageError(f"{file} does not describe a ROS device: {error}") from None
    token = os.environ.get("HANDOVER_DEVICE_TOKEN", "")
    if not token:
        raise UsageError("set HANDOVER_DEVICE_TOKEN to the token of the device (handover device token NAME)")
    context = client_context(*settings.ca_files) if tls else None
    client = DeviceClient(host, port, name, token, tls=context)

    async def relay(graph: Any) -> None:
        await RosDevice(graph, client, described).run()

    with suppress(KeyboardInterrupt):
        asyncio.run(on_the_graph(settings, TypeStore(), 0.0, relay))
    if client.refused is not None:
        raise UsageError(f"{name} was refused: {client.refused}")
