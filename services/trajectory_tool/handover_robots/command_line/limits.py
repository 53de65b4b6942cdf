"""Commands for the limits of robots: senders for tests, and the measurement of a stop."""

import asyncio
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import httpx
import typer
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from handover.command_line.access import cli_access, no_answer
from handover.errors import UsageError
from handover.network.tls_trust import client_context, tls_of
from handover.settings import Settings

TOOL = "trajectory tool"

Robot = Annotated[str, typer.Argument(help="The name of the robot, for example ur10-1.")]
Url = Annotated[str | None, typer.Option("--url", help="The trajectory tool, else that of the settings.")]
Source = Annotated[str, typer.Option("--source", help="The name of the source.")]
Seconds = Annotated[float, typer.Option("--for", help="Send for this many seconds.")]
Period = Annotated[float, typer.Option("--period", help="The time between two reports in s.")]


def speed_limit(  # noqa: PLR0917 - options of a command
    robot: Robot,
    fraction: Annotated[float, typer.Argument(help="The allowed fraction of the speed, 0 to 1.")],
    reason: Annotated[str, typer.Option("--reason", help="Why.")] = "test sender",
    source: Source = "test",
    seconds: Seconds = 10.0,
    period: Period = 1.0,
    url: Url = None,
) -> None:
    """Send speed limits to a robot, as human_state does; afterwards the source is required until removed."""
    report = {"source": source, "fraction": fraction, "reason": reason, "period": period}
    asyncio.run(_send(_stream(url, robot, "speed_limits"), lambda: report, seconds, period))


def people(  # noqa: PLR0917 - options of a command
    robot: Robot,
    places: Annotated[
        list[str] | None, typer.Argument(help="Places as x,y in m in the frame of the cell; none: nobody.")
    ] = None,
    source: Source = "test-lidar",
    warning_field: Annotated[bool, typer.Option("--warning", help="The warning field is infringed.")] = False,
    protective_field: Annotated[
        bool, typer.Option("--protective", help="The protective field is infringed.")
    ] = False,
    sensor: Annotated[
        str | None,
        typer.Option("--sensor", help="Send what this lidar or depth camera of the scene would measure."),
    ] = None,
    seconds: Seconds = 10.0,
    period: Period = 0.1,
    url: Url = None,
) -> None:
    """Send the places of people to a robot, as a lidar does; afterwards the sensor is required.

    With `--sensor`, scans or depth images of them are simulated and sent to all robots of the cell.
    """
    if sensor is not None:
        asyncio.run(_send_measured(_base(url), sensor, places or [], seconds, period))
        return
    seen = [_person(number, place) for number, place in enumerate(places or [], 1)]
    report = {
        "source": source,
        "people": seen,
        "period": period,
    }
    if warning_field or protective_field:
        report |= {"warningField": warning_field, "protectiveField": protective_field}
    asyncio.run(_send(_stream(url, robot, "people"), lambda: report, seconds, period))


def measure_stop(
    turn: Annotated[float, typer.Option("--turn", help="How far the first joint turns in rad.")] = 1.5,
    speed: Annotated[float, typer.Option("--speed", help="The fraction of the joint limits.")] = 1.0,
    cell: Annotated[
        Path | None, typer.Option("--cell", help="The cell file, else that of the settings.")
    ] = None,
) -> None:
    """Move each robot of the cell, stop it on the way, and print how it stopped.

    The trajectory tool must not run. Enter the values with `PUT /robots/ROBOT/limits/stop`.
    """
    from handover_robots.cell.cell import RobotCell  # noqa: PLC0415
    from handover_robots.settings import TrajectorySettings  # noqa: PLC0415
    from handover_robots.tasks.stop_measurement import measure_stop as measure  # noqa: PLC0415

    settings = TrajectorySettings.load(**({} if cell is None else {"cell_file": cell}))

    async def run() -> None:
        async with RobotCell(settings) as robots:
            for name, unit in robots.units.items():
                target = (unit.home[0] + turn, *unit.home[1:])
                stop = await measure(unit, target, speed)
                print(
                    f"{name}: from {stop.speed_mps:.2f} m/s at rest after {stop.duration_s:.3f} s and "
                    f"{stop.distance_m:.3f} m, delay {stop.delay_s:.3f} s"
                )
                print(stop.stored().model_dump_json())

    asyncio.run(run())


def _stream(url: str | None, robot: str, name: str) -> str:
    return f"{_base(url).replace('http', 'ws', 1)}/robots/{robot}/{name}"


def _base(url: str | None) -> str:
    from handover_robots.settings import TrajectorySettings  # noqa: PLC0415 - only these commands

    return url or TrajectorySettings.load().trajectory_tool


async def _send_measured(base: str, name: str, places: list[str], seconds: float, period_s: float) -> None:
    from handover_robots.cell.cell import VIEW_ONLY  # noqa: PLC0415
    from handover_robots.people.simulation import SimulatedSensor  # noqa: PLC0415
    from handover_robots.scene.scene import Scene  # noqa: PLC0415

    try:
        async with httpx.AsyncClient(
            trust_env=False,
            verify=client_context(*Settings.load().ca_files),
            headers=await _headers(),
        ) as client:
            written = (await client.get(f"{base}/cell/scene")).raise_for_status().json()
    except httpx.HTTPError as error:
        raise no_answer(TOOL, base, error) from None
    scene = Scene.model_validate({key: member for key, member in written.items() if key not in VIEW_ONLY})
    if name not in scene.people_sensors:
        sensors = ", ".join(scene.people_sensors) or "none"
        raise UsageError(f'the scene has no sensor "{name}"; it has {sensors}; add it to people_sensors')
    simulated = SimulatedSensor(scene, name)
    people = [(person["x"], person["y"]) for person in (_person(1, place) for place in places)]
    stream = "scans" if simulated.sensor.kind == "lidar" else "depth_images"

    def measured() -> dict[str, Any]:
        return simulated.measure(people, time.time()).model_dump(mode="json", by_alias=True)

    await _send(f"{base.replace('http', 'ws', 1)}/cell/{stream}", measured, seconds, period_s)


async def _headers() -> dict[str, str]:
    async with cli_access(Settings.load()) as access:
        return await access.headers()


def _person(number: int, place: str) -> dict[str, Any]:
    try:
        x, y = map(float, place.split(","))
    except ValueError:
        raise UsageError(f'the place "{place}" must be x,y in m, for example 1.5,-0.4') from None
    return {"id": f"person-{number}", "x": x, "y": y}


async def _send(url: str, report: Callable[[], dict[str, Any]], seconds: float, period_s: float) -> None:
    """Send a report each period; print answers that are refusals, and the last one."""
    ends_s = time.monotonic() + seconds
    try:
        async with connect(
            url, proxy=None, ssl=tls_of(url, Settings.load().ca_files), additional_headers=await _headers()
        ) as stream:
            while True:
                await stream.send(json.dumps({**report(), "stamp": time.time()}))
                answer = json.loads(await stream.recv())
                if not answer["accepted"]:
                    raise UsageError(f"refused: {answer['reason']}")
                if time.monotonic() >= ends_s:
                    break
                await asyncio.sleep(period_s)
    except (OSError, WebSocketException) as error:
        raise no_answer(TOOL, url, error) from None
    print(f"accepted by {url}")
