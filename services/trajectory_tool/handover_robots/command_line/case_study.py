"""`handover robot case-study`: the case study of shared control in simulation."""

from pathlib import Path
from typing import Annotated

import typer

from handover.distribution import install_command
from handover.errors import UsageError


def case_study(  # noqa: PLR0917 - options of a command
    objects: Annotated[
        str | None, typer.Option("--objects", help="Some of the eight objects, separated by commas.")
    ] = None,
    modes: Annotated[
        str | None, typer.Option("--modes", help="Of autonomous, shared, teleoperation; separated by commas.")
    ] = None,
    trials: Annotated[int, typer.Option("--trials", min=1, max=1000, help="Trials of each object.")] = 5,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The seed of the first trial.")] = 1,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write trials.csv, results.json and recordings here.")
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", min=1, max=64, help="Trials at the same time.")] = 1,
) -> None:
    """Pick and place eight objects in simulation: autonomous, in shared control, and teleoperated.

    A simulated person moves a Panda by the control loop of the tool; what lies in the box at the end counts.
    Table I of the IoHRT paper is printed beside the result.
    """
    from handover_robots.physics import is_available  # noqa: PLC0415 - only this command needs them

    if not is_available():
        raise UsageError(f"this needs simulated physics: {install_command('physics')}")
    from handover_robots.case_study import report, study  # noqa: PLC0415
    from handover_robots.case_study.trial import Mode  # noqa: PLC0415

    things = _chosen("object", objects, list(report.TABLE_1))
    columns = [Mode(mode) for mode in _chosen("mode", modes, list(Mode))]
    outcomes = []
    for outcome in study.perform_all(things, columns, range(seed, seed + trials), out, jobs):
        outcomes.append(outcome)
        state = "ok" if outcome.is_success else "FAILED"
        print(
            f"{state:<7} {outcome.thing:<13} {outcome.mode:<14} seed {outcome.seed}: "
            f"{outcome.time_s:6.1f} s, attempts {outcome.attempts}, {outcome.ended}",
            flush=True,
        )
        if out is not None:
            report.write(outcomes, out)
    print()
    print(report.text(outcomes))


def _chosen(kind: str, wanted: str | None, all_names: list[str]) -> list[str]:
    if wanted is None:
        return all_names
    names = [name.strip() for name in wanted.split(",")]
    for name in names:
        if name not in all_names:
            raise UsageError(f'there is no {kind} "{name}"; there is {", ".join(all_names)}')
    return names
