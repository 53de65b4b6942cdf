"""`handover case`: run a case study."""

from typing import Annotated

import typer

from handover.command_line.foreground import DataDir, say, settings_in, until_stopped
from handover.command_line.output import AsJson, print_json
from handover.services import let_broker_fetch_context

app = typer.Typer()


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
    from handover_cell.cases.case import (  # noqa: PLC0415 - loads the machines
        TrialWish,
        known_cases,
        load_case,
        print_study,
        run_case,
        study_of,
    )

    if name is None:
        if as_json:
            print_json(
                [{"name": known_case.name, "summary": known_case.summary} for known_case in known_cases()]
            )
            return
        for known_case in known_cases():
            say(f"{known_case.name:<14} {known_case.summary}")
        return
    chosen = load_case(name)
    say(f"{chosen.summary} Nothing here is a medical device or a safety function.")
    if once and not live and (study := study_of(name)) is not None:
        print_study(name, study(duration_s, say, consents_to_model=consents_to_model), say)
        return
    wish = TrialWish(duration_s, consents_to_model)
    let_broker_fetch_context()
    until_stopped(run_case(chosen, settings_in(data_dir), wish, once=once, timeout_s=timeout_s, say=say))
