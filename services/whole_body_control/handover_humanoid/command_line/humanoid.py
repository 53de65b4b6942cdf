"""`handover humanoid`: humanoids by name, and what they do in simulation.

Nothing here drives a physical robot: assisted walking with one is not offered.
"""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from handover.command_line.output import AsJson, print_json
from handover.distribution import install_command
from handover.errors import UsageError

app = typer.Typer(help="Humanoids: their models, walking and throwing in simulation.", no_args_is_help=True)

Name = Annotated[str, typer.Option("--robot", help="The humanoid; see `handover humanoid list`.")]


@app.command("list")
def list_humanoids(as_json: AsJson = False) -> None:
    """List the humanoids, ours and those of other packages."""
    robots = _imported()
    listed: list[dict[str, Any]] = []
    for name in robots.HUMANOIDS.names():
        try:
            humanoid = robots.humanoid(name)
        except UsageError as error:
            listed.append({"name": name, "fault": str(error)})
            continue
        listed.append(
            {
                "name": name,
                "joints": len(humanoid.joints),
                "massKg": float(humanoid.mass_kg),
                "chains": list(humanoid.chains),
                "hands": list(humanoid.grips),
            }
        )
    if as_json:
        print_json(listed)
        return
    for described in listed:
        if "fault" in described:
            print(f"{described['name']:<12} not usable: {described['fault']}")
            continue
        print(
            f"{described['name']:<12} {described['joints']} joints, {described['massKg']:.1f} kg; "
            f"chains: {', '.join(described['chains'])}; hands: {', '.join(described['hands']) or 'none'}"
        )


@app.command()
def walk(
    robot: Name = "coman",
    speed: Annotated[float, typer.Option("--speed", min=-0.2, max=0.2, help="Ahead, in m/s.")] = 0.1,
    turn: Annotated[float, typer.Option("--turn", min=-0.3, max=0.3, help="To the left, in rad/s.")] = 0.0,
    seconds: Annotated[float, typer.Option("--seconds", min=1, max=600, help="Simulated time.")] = 10.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the sensor noise.")] = 1,
) -> None:
    """Walk in simulated physics with noisy sensors, and print how well; exit with 1 after a fall."""
    import numpy as np  # noqa: PLC0415 - only this command needs them

    robots = _imported()
    from handover_humanoid.behaviours.simulated_walk import SimulatedWalk  # noqa: PLC0415
    from handover_humanoid.behaviours.walking import WalkingController  # noqa: PLC0415
    from handover_humanoid.patterns.footsteps import Wish  # noqa: PLC0415
    from handover_humanoid.simulation.simulated_robot import (  # noqa: PLC0415
        TYPICAL_NOISE,
        SimulatedRobot,
    )
    from handover_humanoid.solvers.compiled import fastest_solver  # noqa: PLC0415

    humanoid = robots.humanoid(robot)
    controller = WalkingController(humanoid, fastest_solver())
    simulated = SimulatedRobot(humanoid, controller.start, TYPICAL_NOISE, seed)
    for asked, most, unit in (
        (speed, float(controller.fastest.velocity[0]), "m/s"),
        (turn, controller.fastest.yaw_rate, "rad/s"),
    ):
        if abs(asked) > most:
            print(f"{robot} cannot step so far: {most:.3g} {unit} at most, instead of {abs(asked):g} {unit}")
    record = SimulatedWalk(controller, simulated).run(seconds, lambda _: Wish(np.array([speed, 0.0]), turn))
    way = simulated.true_configuration()[:2] - controller.start[:2]
    print(f"{record.time_s[-1]:.1f} s simulated, {np.linalg.norm(way):.2f} m from the start")
    print(f"centre of mass: {1e3 * record.tracking_rms_m():.1f} mm RMS from the plan")
    print(
        f"centre of pressure 1 cm inside of the standing sole: {record.share_inside():.1%} of single support"
    )
    if record.has_fallen:
        raise UsageError(f"{robot} fell after {record.time_s[-1]:.1f} s; try a smaller --speed or --turn")


@app.command(context_settings={"ignore_unknown_options": True})  # a negative number is no option
def throw(  # noqa: PLR0917 - options of a command
    x: Annotated[float, typer.Argument(help="Where the ball is to land, ahead of the robot in m.")] = 0.8,
    y: Annotated[float, typer.Argument(help="To its left in m.")] = 0.0,
    z: Annotated[float, typer.Argument(help="Above the ground in m.")] = 0.5,
    robot: Name = "coman",
    hand: Annotated[str, typer.Option("--hand", help="left_hand or right_hand.")] = "right_hand",
    throws: Annotated[int, typer.Option("--throws", min=1, max=1000)] = 3,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the sensor noise.")] = 1,
) -> None:
    """Throw a ball in simulated physics, rehearsed, and corrected by what was measured at each release."""
    import numpy as np  # noqa: PLC0415 - only this command needs them

    robots = _imported()
    from handover_humanoid.behaviours.rehearsal import rehearse  # noqa: PLC0415
    from handover_humanoid.behaviours.simulated_throw import SimulatedThrow  # noqa: PLC0415
    from handover_humanoid.behaviours.throwing import Practice, aimed_throw  # noqa: PLC0415
    from handover_humanoid.model.kinematics import Kinematics  # noqa: PLC0415
    from handover_humanoid.patterns.throwing import ThrowPlanner  # noqa: PLC0415
    from handover_humanoid.simulation.ball import build_with_ball  # noqa: PLC0415
    from handover_humanoid.simulation.simulated_robot import TYPICAL_NOISE  # noqa: PLC0415
    from handover_humanoid.solvers.compiled import fastest_solver  # noqa: PLC0415

    humanoid = robots.humanoid(robot)
    if hand not in humanoid.grips:
        raise UsageError(f'{robot} has no hand "{hand}"; it has: {", ".join(humanoid.grips) or "none"}')
    game = SimulatedThrow(humanoid, build_with_ball(humanoid), fastest_solver(), TYPICAL_NOISE, seed)
    start, practice, target = game.controller.start, Practice(), np.array([x, y, z])
    planner = ThrowPlanner(Kinematics(humanoid), start, humanoid.grips[hand])
    planner.plan(target)  # what is out of reach is refused before the rehearsal
    rehearse(practice, humanoid, [hand], target, fastest_solver())
    for number in range(1, throws + 1):
        _, planned = aimed_throw(planner, practice, hand, start[:2], target)
        record = game.throw(planned)
        practice.learn(hand, start[:2], planned.landing, record.predicted)
        missed = 1e3 * float(np.linalg.norm(record.landed - target))
        place = ", ".join(f"{value:.3f}" for value in record.landed)
        print(
            f"throw {number}: flight {planned.flight_s:.2f} s, {planned.usage:.0%} of a joint speed; "
            f"landed at ({place}) m, {missed:.0f} mm off",
            flush=True,
        )


@app.command("rehearse")
def rehearse_throws(
    robot: Name = "coman",
    into: Annotated[
        Path | None, typer.Option("--into", help="A folder instead of that of the model.")
    ] = None,
) -> None:
    """Let each hand rehearse its throws in simulation, and keep what it learns beside the model.

    A model without it rehearses when it is to juggle for the first time, which takes some seconds.
    """
    robots = _imported()
    from handover_humanoid.behaviours.rehearsal import (  # noqa: PLC0415
        FILE,
        rehearsed,
        write_rehearsals,
    )

    humanoid = robots.humanoid(robot)
    if not humanoid.grips:
        raise UsageError(f"{robot} has no hand that throws; add grips to its model")
    throws = {grip: rehearsed(humanoid, grip) for grip in humanoid.grips}
    file = (into or robots.folder(robot)) / FILE
    write_rehearsals(file, humanoid, throws)
    print(f"{file}: " + ", ".join(f"{grip} {len(learned)} throws" for grip, learned in throws.items()))


@app.command()
def lead(
    script: Annotated[
        str, typer.Argument(help="What the person does: forward, side, turn, stop, stumble, tour or long.")
    ] = "forward",
    robot: Name = "coman",
    intention: Annotated[
        str, typer.Option("--intention", help="How it is read: lead, or manipulability (CoSiMA).")
    ] = "lead",
    stiffness: Annotated[
        float, typer.Option("--stiffness", min=5, max=100, help="Of an arm of the person, in N/m.")
    ] = 40.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the sensor noise.")] = 1,
) -> None:
    """Let a simulated person lead a humanoid by the hands; exit with 1 after a fall."""
    import numpy as np  # noqa: PLC0415 - only this command needs them

    robots = _imported()
    from handover_humanoid.behaviours.led_walk_report import Followed, followed  # noqa: PLC0415
    from handover_humanoid.behaviours.simulated_person import (  # noqa: PLC0415
        SCRIPTS,
        LedWalk,
        PersonArm,
    )
    from handover_humanoid.patterns.intention import INTENTIONS  # noqa: PLC0415
    from handover_humanoid.solvers.compiled import fastest_solver  # noqa: PLC0415

    if script not in SCRIPTS:
        raise UsageError(f'there is no script "{script}"; there are: {", ".join(SCRIPTS)}')
    chosen = next((name for name in INTENTIONS if name == intention), None)
    if chosen is None:
        raise UsageError(f'there is no intention "{intention}"; there are: {", ".join(INTENTIONS)}')
    walk = LedWalk(
        robots.humanoid(robot),
        fastest_solver(),
        seed=seed,
        intention=chosen,
        hold=PersonArm(stiffness, stiffness / 5),
    )
    record = walk.run(SCRIPTS[script])
    for part in followed(record, walk.step_limits):
        asked = part.lead
        said = f"{asked.seconds:4.1f} s  ahead {asked.ahead_m:+.2f} m, left {asked.left_m:+.2f} m: "
        if not isinstance(part, Followed):
            ends = [
                "never" if duration_s is None else f"after {duration_s:.1f} s"
                for duration_s in (part.reaction_s, part.standing_s)
            ]
            print(f"{said}velocity 0 {ends[0]}, standing {ends[1]}")
            continue
        reacted = "never" if part.reaction_s is None else f"after {part.reaction_s:.2f} s"
        print(
            f"{said}within 15° {reacted}, then {part.share:.0%} of the time "
            f"(median {np.degrees(part.error):.0f}°, 95 % {np.degrees(part.error_95):.0f}°); motion "
            f"{np.degrees(part.motion_error):.0f}° off after two steps, {part.speed_mps:.2f} m/s"
        )
    if record.has_fallen:
        raise UsageError(f"{robot} fell after {record.time_s[-1] - record.time_s[0]:.1f} s")


@app.command()
def figures(
    into: Annotated[Path, typer.Argument(help="The directory of the pictures; it is made.")] = Path(
        "figures"
    ),
    robot: Name = "coman",
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the sensor noise.")] = 1,
) -> None:
    """Draw Figures 6c, 6d and 8 of CoSiMA from own runs: throws, solver times, a led walk of a minute."""
    import numpy as np  # noqa: PLC0415 - only this command needs them

    robots = _imported("matplotlib", extra="figures")
    from handover_humanoid.figures import draw_led_walk, draw_throws  # noqa: PLC0415
    from handover_humanoid.patterns.intention import INTENTIONS  # noqa: PLC0415

    humanoid = robots.humanoid(robot)
    into.mkdir(parents=True, exist_ok=True)
    file = into / f"humanoid-throws-{robot}.png"
    drawn = draw_throws(humanoid, file, seed)
    print(
        f"{file}: {len(drawn.errors_mm)} throws, median {np.median(drawn.errors_mm):.0f} mm off; solver "
        f"median {np.median(drawn.solve_us):.0f} µs, 99 % {np.quantile(drawn.solve_us, 0.99):.0f} µs"
    )
    for intention in INTENTIONS:
        file = into / f"humanoid-led-{robot}-{intention}.png"
        record = draw_led_walk(humanoid, file, intention, seed)
        fell = ", then it fell" if record.has_fallen else ""
        print(f"{file}: {record.time_s[-1] - record.time_s[0]:.0f} s{fell}")


def _imported(*more: str, extra: str = "humanoid") -> Any:
    """Return the module of the humanoids. Raises `UsageError` without the libraries it needs."""
    missing = [name for name in ("daqp", "mujoco", "pinocchio", *more) if find_spec(name) is None]
    if missing:
        raise UsageError(f"this needs {', '.join(missing)}: {install_command(extra)}")
    from handover_humanoid import robots  # noqa: PLC0415 - only these commands need it

    return robots
