"""`handover robot`: robots from URDFs, and checks of what they would do."""

import asyncio
from pathlib import Path
from typing import Annotated, Any

import typer

from handover.command_line.output import AsJson, print_json
from handover.distribution import install_command
from handover.errors import UsageError
from handover.settings import Settings
from handover_robots.command_line import case_study
from handover_robots.command_line import limits as robot_limits
from handover_robots.command_line.shapes import print_comparison, print_shapes
from handover_robots.command_line.task import perform

app = typer.Typer(help="Robots: add one from a URDF, list them, check a process.", no_args_is_help=True)

app.command("speed-limit")(robot_limits.speed_limit)
app.command("people")(robot_limits.people)
app.command("measure-stop")(robot_limits.measure_stop)
app.command("case-study")(case_study.case_study)

DataDir = Annotated[Path | None, typer.Option("--data-dir", help="The directory of all persistent data.")]


@app.command()
def add(  # noqa: PLR0917 - options of a command
    source: Annotated[
        str,
        typer.Argument(help="A URDF file, package://PACKAGE/FILE of ROS, or example-robot-data:NAME."),
    ],
    name: Annotated[str, typer.Option("--name", help="The name of the robot.")],
    into: Annotated[
        Path | None,
        typer.Option("--into", help="Where to make its folder; else in the data directory."),
    ] = None,
    tip: Annotated[
        str | None,
        typer.Option("--tip", help="The link that is the tip of the tool; else the last one."),
    ] = None,
    srdf: Annotated[
        Path | None,
        typer.Option("--srdf", help="An SRDF with pairs that need no check; else one beside the URDF."),
    ] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace a robot of this name.")] = False,
    data_dir: DataDir = None,
) -> None:
    """Make a robot folder from a URDF, with a report of what is missing or odd.

    It fails if the shapes of two links refuse more than 2 % of the positions that their meshes allow.
    """
    _require_planning()
    from handover_robots.onboarding.add import add_robot  # noqa: PLC0415 - needs the extra
    from handover_robots.robots.folder import require_free_name, robots_folder  # noqa: PLC0415

    require_free_name(name)
    folder = into or robots_folder(_data_dir(data_dir))
    added = add_robot(source, name, folder, tip=tip, srdf=srdf, replaces=replace)
    model = added.model
    for finding in added.findings:
        print(f"{finding.level:<8} {finding.about}: {finding.text}")
    print_comparison(added.comparison)
    print(f"{name}: {len(model.joints)} joints from the base to {model.tip}: {', '.join(model.joint_names)}")
    print(f"written to {added.folder}; correct its files there")
    named = name if into is None else str(added.folder)
    print(f"use it: HANDOVER_ROBOT_MODEL={named}, or in a cell file: model: {named}")


@app.command("list")
def list_robots(data_dir: DataDir = None, as_json: AsJson = False) -> None:
    """List the robots that HANDOVER_ROBOT_MODEL and cell files can name."""
    from handover_robots.robots import ROBOTS  # noqa: PLC0415 - only this command needs it
    from handover_robots.robots.folder import FILE, robots_folder  # noqa: PLC0415

    robots = [(name, "of Handover" if name in ROBOTS.own else "of a package") for name in ROBOTS.names()]
    for path in sorted(robots_folder(_data_dir(data_dir)).glob(f"*/{FILE}")):
        name = path.parent.name
        unused = f" (not used: {name} is of Handover)" if name in ROBOTS.own else ""
        robots.append((name, f"{path.parent}{unused}"))
    if as_json:
        print_json([{"name": name, "source": source} for name, source in robots])
        return
    for name, source in robots:
        print(f"{name:<24} {source}")


@app.command()
def shapes(  # noqa: PLR0917 - options of a command
    name: Annotated[str, typer.Argument(help="The robot, as in HANDOVER_ROBOT_MODEL, or its folder.")],
    meshes: Annotated[
        str, typer.Option("--meshes", help="The URDF of the manufacturer, with its meshes beside it.")
    ],
    configurations: Annotated[
        int, typer.Option("--configurations", min=1, help="How many random positions to compare.")
    ] = 1000,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the random positions.")] = 1,
    json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    data_dir: DataDir = None,
) -> None:
    """Measure how far meshes are outside of the shapes of a robot, and what these refuse or allow falsely."""
    _require_planning()
    print_shapes(name, _data_dir(data_dir), meshes, configurations=configurations, seed=seed, as_json=json)


@app.command("calibrate-camera")
def calibrate_camera(
    robot: Annotated[str, typer.Argument(help="The name of the robot.")] = "ur10-1",
    target: Annotated[
        str, typer.Option("--target", help="The ball: a spherical obstacle of the scene.")
    ] = "calibration-ball",
    camera: Annotated[
        str | None, typer.Option("--camera", help="A fixed camera of the scene, instead of that in the hand.")
    ] = None,
    timeout_s: Annotated[float, typer.Option("--timeout", help="Seconds to wait for the end.")] = 300.0,
) -> None:
    """Find out where a camera is mounted: in the hand, moved around a ball, or fixed, from several balls."""
    asked: dict[str, Any] = {"target": target} if camera is None else {"camera": camera}
    result = asyncio.run(perform(Settings.load(), robot, "calibrateCamera", asked, timeout_s))
    seen = f"{result['images']} images" if "images" in result else f"{result['balls']} balls"
    print(
        f"{robot}: the camera is {result['movedMm']} mm and {result['turnedDeg']} degrees from where it was "
        f"assumed; {seen} agree within {result['residualMm']} mm"
    )


def _data_dir(data_dir: Path | None) -> Path:
    return Settings.load(**({} if data_dir is None else {"data_dir": data_dir})).data_dir


def _require_planning() -> None:
    from handover_robots.planning import is_available  # noqa: PLC0415 - only this command needs it

    if not is_available():
        raise UsageError(f"this needs motion planning: {install_command('motion')}")
