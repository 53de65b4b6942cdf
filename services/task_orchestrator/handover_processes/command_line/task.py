"""`handover task`: the open Tasks of people: list, claim and complete them."""

from typing import Annotated, Any

import typer

from handover.command_line.output import AsJson, print_json
from handover.command_line.parameters import parse_parameter
from handover_processes.command_line.asking import ask

app = typer.Typer(help="Tasks of people: list, claim, complete.", no_args_is_help=True)

MAX_LISTED = 5000

Task = Annotated[str, typer.Argument(help="The id of the Task, as `list` shows it.")]
By = Annotated[str, typer.Option("--by", help="The person who does it; with accounts the account counts.")]


@app.command("list")
def list_tasks(
    process: Annotated[str | None, typer.Option("--process", help="Only of this process.")] = None,
    group: Annotated[str | None, typer.Option("--group", help="Only those offered to this group.")] = None,
    claimed_by: Annotated[
        str | None, typer.Option("--claimed-by", help="Only those that this person has claimed.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the open Tasks of people, those that are due first before others."""
    query = {"process": process, "group": group, "claimed_by": claimed_by, "limit": MAX_LISTED}
    tasks = ask("GET", "/tasks", params={name: value for name, value in query.items() if value is not None})
    if as_json:
        print_json(tasks)
        return
    for task in tasks:
        of = f"{task['name']} of {task['processName']}"
        print(f"{task['id']:<60} {task['status']:<11} {of}  ({_holder(task)})")
    if not tasks:
        print("no Task of a person is open")


@app.command()
def claim(
    task: Task,
    by: By,
    groups: Annotated[list[str] | None, typer.Option("--group", help="A group of the person.")] = None,
    override: Annotated[
        bool, typer.Option("--override", help="Also a Task that is offered to other people.")
    ] = False,
) -> None:
    """Claim a Task and start it."""
    body = {"by": by, "groups": groups or [], "override": override}
    claimed = ask("POST", f"/tasks/{task}/claim", json=body)
    print(f"{claimed['id']} is claimed by {claimed['claimedBy']}")


@app.command()
def complete(
    task: Task,
    by: By,
    outcome: Annotated[str, typer.Option("--outcome", help="ok, notGood or problem.")] = "ok",
    note: Annotated[str, typer.Option("--note", help="A note for those who read the result.")] = "",
    outputs: Annotated[
        list[str] | None,
        typer.Option("--set", help="A value of the result, name=value; the value is JSON or text."),
    ] = None,
) -> None:
    """End a claimed Task with its result. A Task that asks for a PIN is completed on the page."""
    body = {
        "by": by,
        "outcome": outcome,
        "note": note,
        "outputs": dict(parse_parameter(output) for output in outputs or []),
    }
    completed = ask("POST", f"/tasks/{task}/complete", json=body)
    print(f"{completed['id']} is {completed['status']}")


def _holder(task: dict[str, Any]) -> str:
    """Return who has a Task, or to whom it is offered."""
    if task["claimedBy"]:
        return f"claimed by {task['claimedBy']}"
    offered = [*([task["person"]] if task["person"] else task["persons"]), *task["groups"]]
    return f"offered to {', '.join(offered)}" if offered else "offered to everybody"
