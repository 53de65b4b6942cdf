"""`handover process`: deploy BPMN files; start, list, show, cancel processes; mend what cannot continue."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from handover.command_line.output import AsJson, print_json
from handover.command_line.parameters import parse_parameter
from handover.errors import UsageError
from handover_processes.command_line.asking import By, Why, ask, ask_page, finding_line
from handover_processes.command_line.exporters import EXPORTERS, Exporter
from handover_processes.command_line.mapping import mapping
from handover_processes.command_line.offers import offers

app = typer.Typer(help="Processes: deploy, start, list, show, export, cancel, mend.", no_args_is_help=True)
app.add_typer(mapping, name="mapping")
app.add_typer(offers, name="offers")


@app.command()
def deploy(
    files: Annotated[list[Path], typer.Argument(help="BPMN 2.0 files, and forms of form-js (*.form).")],
) -> None:
    """Deploy process definitions and forms to the orchestrator; several files together, all or none."""
    contents = {file: _content(file) for file in files}
    if len(files) > 1 or files[0].suffix == ".form":
        named = [
            {"name": file.name, "content": content.decode(errors="replace")}
            for file, content in contents.items()
        ]
        answer = ask("POST", "/deployments", json={"files": named})
        for definition in answer["definitions"]:
            print(f"{definition['name']} version {definition['version']} deployed")
        for form in answer["forms"]:
            print(f"form {form['id']} version {form['version']} deployed")
            for text in form["warnings"]:
                print(f"warning: form {form['id']}: {text}")
        _print_warnings(answer["warnings"])
        return
    bpmn = contents[files[0]]
    answer = ask("POST", "/definitions", content=bpmn, headers={"Content-Type": "application/xml"})
    for definition in answer["definitions"]:
        print(f"{definition['name']} version {definition['version']} deployed")
    _print_warnings(answer["warnings"])
    for line in answer["allocation"]:
        print(f"{line['name']}: {line['reason']}")
        if line["warning"] and line["warning"] != line["reason"]:
            print(f"  warning: {line['warning']}")


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}") from None


def _print_warnings(warnings: list[dict[str, Any]]) -> None:
    for warning in warnings:
        print(f"warning: line {warning['line']}, {warning['element'] or 'the file'}: {warning['message']}")


@app.command()
def start(
    definition: Annotated[str, typer.Argument(help="The name of the process definition.")],
    parameters: Annotated[
        list[str] | None, typer.Option("--set", help="A parameter, name=value; the value is JSON or text.")
    ] = None,
) -> None:
    """Start a process."""
    values = dict(parse_parameter(parameter) for parameter in parameters or [])
    answer = ask("POST", "/processes", json={"definition": definition, "parameters": values})
    print(f"{answer['id']} started: {answer['name']}")


@app.command("list")
def list_processes(
    limit: Annotated[
        int, typer.Option("--limit", min=1, max=1000, help="How many processes, the latest first.")
    ] = 100,
    as_json: AsJson = False,
) -> None:
    """List the process definitions and the processes: status, name, version and the elements that wait."""
    definitions = ask("GET", "/definitions")
    page = ask_page("GET", "/processes", params={"limit": limit})
    processes = page.json()
    if as_json:
        print_json({"definitions": definitions, "processes": processes})
        return
    for definition in definitions:
        held = ", ".join(hold["kind"] for hold in definition["holds"])
        print(f"definition  {definition['name']:<24} version {definition['version']}  {held}".rstrip())
    for process in processes:
        waits = f", waits at {', '.join(process['waiting'])}" if process["waiting"] else ""
        of = f"{process['definition']} version {process['version']}"
        print(f"process     {process['id']:<40} {_status(process):<11} {process['name']} ({of}){waits}")
        for incident in process["incidents"]:
            where = f"token {incident['token']} at {incident['name']}"
            print(f"  incident  {where}: {incident['reason']}")
    if "next" in page.links:
        print(f"the latest {limit} processes are listed; --limit lists more, up to 1000", file=sys.stderr)


def _status(process: dict[str, Any]) -> str:
    """Return the status; a cancelled process has `failed` and a reason that says it."""
    is_cancelled = process["status"] == "failed" and str(process["reason"]).startswith("cancelled")
    return "cancelled" if is_cancelled else str(process["status"])


@app.command()
def show(process: Annotated[str, typer.Argument(help="The id of the process.")]) -> None:
    """Show a process with all details, as JSON."""
    print_json(ask("GET", f"/processes/{process}"))


@app.command()
def export(
    process: Annotated[str, typer.Argument(help="The id of the process.")],
    form: Annotated[
        str, typer.Option("--format", help="csv, json, xes, or an exporter that is installed.")
    ] = "csv",
    output: Annotated[
        Path | None, typer.Option("--output", help="The file; standard output if absent.")
    ] = None,
) -> None:
    """Write the history of a process to a file."""
    exporter: Exporter = EXPORTERS.load(form)
    content = exporter(ask("GET", f"/processes/{process}"))
    if output is None:
        sys.stdout.buffer.write(content)
        return
    try:
        output.write_bytes(content)
    except OSError as error:
        raise UsageError(f"{output} cannot be written: {error.strerror}") from None


@app.command()
def cancel(
    process: Annotated[str, typer.Argument(help="The id of the process.")],
    by: Annotated[str | None, typer.Option("--by", help="Who cancels it.")] = None,
) -> None:
    """Cancel a process and its Tasks."""
    ask("POST", f"/processes/{process}/cancel", json={"by": by})
    print(f"{process} is cancelled")


Process = Annotated[str, typer.Argument(help="The id of the process.")]
Token = Annotated[str, typer.Argument(help="The token of the incident, as `list` shows it.")]
Variables = Annotated[
    list[str] | None,
    typer.Option("--set", help="A variable to set, name=value; the value is JSON or text."),
]


@app.command()
def retry(process: Process, token: Token, by: By, why: Why = None, variables: Variables = None) -> None:
    """Try again what could not continue; a failed Task is posted again. Variables are set before."""
    _mend(process, f"tokens/{token}/retry", by, why, variables)


@app.command()
def skip(process: Process, token: Token, by: By, why: Why = None, variables: Variables = None) -> None:
    """Continue behind the element, with the variables as its results."""
    _mend(process, f"tokens/{token}/skip", by, why, variables)


@app.command()
def move(
    process: Process,
    token: Token,
    by: By,
    to: Annotated[str, typer.Option("--to", help="The id of the element to continue at.")],
    why: Why = None,
) -> None:
    """Continue at another element of the same scope."""
    _mend(process, f"tokens/{token}/move", by, why, None, to=to)


@app.command()
def release(
    process: Process,
    reservation: Annotated[str, typer.Argument(help="The key of the reservation, as `show` lists it.")],
    by: By,
    why: Why = None,
) -> None:
    """Release what is reserved for a part of a process; the next activity of it reserves again."""
    ask("POST", f"/processes/{process}/reservations/{reservation}/release", json={"by": by, "why": why})
    print(f"{process} has released {reservation}")


@app.command("set")
def set_variables(
    process: Process,
    by: By,
    variables: Variables,
    scope: Annotated[str | None, typer.Option("--scope", help="A part of it, one of its `scopes`.")] = None,
    why: Why = None,
) -> None:
    """Set variables of a running process, or of a subprocess, instance or called process of it."""
    _mend(process, "variables", by, why, variables, **({} if scope is None else {"scope": scope}))


@app.command()
def migrate(
    by: By,
    process: Annotated[str | None, typer.Argument(help="The id of the process.")] = None,
    *,
    definition: Annotated[str | None, typer.Option("--definition", help="All of this definition.")] = None,
    source: Annotated[int | None, typer.Option("--from", help="All that have this version.")] = None,
    version: Annotated[int | None, typer.Option("--to", help="The version; the latest if absent.")] = None,
    mapping: Annotated[
        list[str] | None, typer.Option("--map", help="An element with another id in that version, old=new.")
    ] = None,
    why: Why = None,
    variables: Variables = None,
    dry: Annotated[bool, typer.Option("--dry", help="Only show what differs.")] = False,
) -> None:
    """Continue a process, or all of a version, in another version of the definition; open Tasks stay.

    Exit code 1 if a process cannot be migrated, also with --dry.
    """
    body: dict[str, Any] = {
        "by": by,
        "why": why,
        "version": version,
        "variables": dict(parse_parameter(variable) for variable in variables or []),
        "mapping": {name: str(value) for name, value in map(parse_parameter, mapping or [])},
    }
    query = {"dry": dry}
    if process is not None:
        report = ask("POST", f"/processes/{process}/migration", json=body, params=query)
        _print_migrations([report])
        return
    if definition is None or source is None:
        raise UsageError("name a process, or a definition and a version: --definition NAME --from VERSION")
    body["source"] = source
    answer = ask("POST", f"/definitions/{definition}/migration", json=body, params=query)
    print(f"{answer['migrated']} migrated, {answer['refused']} not possible")
    _print_migrations(answer["processes"])


def _print_migrations(reports: list[dict[str, Any]]) -> None:
    """Print what became of each process; end with 1 if one cannot be migrated."""
    for report in reports:
        _print_migration(report)
    if not all(report["possible"] for report in reports):
        raise typer.Exit(1)


def _print_migration(report: dict[str, Any]) -> None:
    to = f"version {report['target']}"
    if report["migrated"]:
        print(f"{report['process']} is migrated to {to}")
    else:
        print(f"{report['process']} {'can' if report['possible'] else 'cannot'} be migrated to {to}")
    for finding in report["findings"]:
        print(f"  {finding_line(finding)}")


@app.command()
def pause(
    by: By,
    process: Annotated[str | None, typer.Argument(help="The id of the process; all if absent.")] = None,
    definition: Annotated[str | None, typer.Option("--definition", help="All of this definition.")] = None,
    why: Why = None,
) -> None:
    """Pause a process, those of a definition, or all; robots and people are asked to pause their Tasks."""
    _pause("pause", by, process, definition, why)


@app.command()
def resume(
    by: By,
    process: Annotated[str | None, typer.Argument(help="The id of the process; all if absent.")] = None,
    definition: Annotated[str | None, typer.Option("--definition", help="All of this definition.")] = None,
    why: Why = None,
) -> None:
    """Continue paused processes."""
    _pause("resume", by, process, definition, why)


def _pause(what: str, by: str, process: str | None, definition: str | None, why: str | None) -> None:
    body = {"by": by, "why": why}
    if process is not None:
        answer = ask("POST", f"/processes/{process}/{what}", json=body)
        print(f"{answer['id']} is {answer['status']}")
        return
    query = {} if definition is None else {"definition": definition}
    answer = ask("POST", f"/{what}", json=body, params=query)
    print("\n".join(answer["processes"]) or "no process runs")


@app.command()
def suspend(
    by: By, definition: Annotated[str, typer.Argument(help="The definition.")], why: Why = None
) -> None:
    """Let no process of a definition start; those that run continue."""
    ask("POST", f"/definitions/{definition}/suspend", json={"by": by, "why": why})
    print(f"{definition} is suspended")


@app.command()
def activate(
    by: By, definition: Annotated[str, typer.Argument(help="The definition.")], why: Why = None
) -> None:
    """Let processes of a suspended definition start again."""
    ask("POST", f"/definitions/{definition}/activate", json={"by": by, "why": why})
    print(f"{definition} is active")


@app.command()
def delete(
    by: By,
    definition: Annotated[str, typer.Argument(help="The definition.")],
    version: Annotated[
        int | None, typer.Option("--version", min=1, help="Only this version, an earlier one.")
    ] = None,
    why: Why = None,
) -> None:
    """Delete a definition with all versions, or one of them, if no process of it runs."""
    params = {"by": by, **({"why": why} if why else {})}
    if version is None:
        ask("DELETE", f"/definitions/{definition}", params=params)
        print(f"{definition} is deleted")
        return
    ask("DELETE", f"/definitions/{definition}/versions/{version}", params=params)
    print(f"version {version} of {definition} is deleted")


@app.command()
def message(
    name: Annotated[str, typer.Argument(help="The name of the BPMN message.")],
    key: Annotated[str | None, typer.Option("--key", help="The correlation key or business key.")] = None,
    process: Annotated[str | None, typer.Option("--process", help="The only process that gets it.")] = None,
    variables: Variables = None,
) -> None:
    """Send a message to the process that waits for it, or that it starts."""
    values = dict(parse_parameter(variable) for variable in variables or [])
    body = {"name": name, "key": key, "process": process, "variables": values}
    answer = ask("POST", "/messages", json=body)
    print(f"{answer['outcome']}{': ' + answer['process'] if answer['process'] else ''}")


@app.command()
def signal(
    name: Annotated[str, typer.Argument(help="The name of the BPMN signal.")], variables: Variables = None
) -> None:
    """Send a signal to all processes that wait for it."""
    values = dict(parse_parameter(variable) for variable in variables or [])
    answer = ask("POST", "/signals", json={"name": name, "variables": values})
    print("\n".join(answer["processes"]) or "no process waits for it")


def _mend(
    process: str, what: str, by: str, why: str | None, variables: list[str] | None, **others: str
) -> None:
    values = dict(parse_parameter(variable) for variable in variables or [])
    body = {"by": by, "why": why, "variables": values, **others}
    answer = ask("POST", f"/processes/{process}/{what}", json=body)
    print(f"{answer['id']} continues: {', '.join(answer['waiting']) or answer['status']}")
