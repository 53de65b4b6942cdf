"""`handover process`: deploy BPMN files; start, list, show, cancel processes; retry failed Tasks."""

import sys
from pathlib import Path
from typing import Annotated, Any

import httpx
import orjson
import typer

from handover.cli.exporters import EXPORTERS, Exporter
from handover.cli.services import service_named
from handover.errors import UsageError

app = typer.Typer(help="Processes: deploy, start, list, show, export, cancel, retry.", no_args_is_help=True)


@app.command()
def deploy(file: Annotated[Path, typer.Argument(help="A BPMN 2.0 file.")]) -> None:
    """Deploy a process definition to the orchestrator."""
    try:
        bpmn = file.read_bytes()
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}") from None
    answer = _ask("POST", "/definitions", content=bpmn, headers={"Content-Type": "application/xml"})
    print(f"{answer['name']} version {answer['version']} deployed")


@app.command()
def start(
    definition: Annotated[str, typer.Argument(help="The name of the process definition.")],
    parameters: Annotated[
        list[str] | None, typer.Option("--set", help="A parameter, name=value; the value is JSON or text.")
    ] = None,
) -> None:
    """Start a process."""
    given = dict(_parameter(parameter) for parameter in parameters or [])
    answer = _ask("POST", "/processes", json={"definition": definition, "parameters": given})
    print(f"{answer['id']} started")


@app.command("list")
def list_processes() -> None:
    """List the process definitions and the processes."""
    for definition in _ask("GET", "/definitions"):
        print(f"definition  {definition['name']:<24} version {definition['version']}")
    for process in _ask("GET", "/processes"):
        print(f"process     {process['id']:<56} {process['status']}")


@app.command()
def show(process: Annotated[str, typer.Argument(help="The id of the process.")]) -> None:
    """Show a process with all details."""
    print(orjson.dumps(_ask("GET", f"/processes/{process}"), option=orjson.OPT_INDENT_2).decode())


@app.command()
def export(
    process: Annotated[str, typer.Argument(help="The id of the process.")],
    form: Annotated[
        str, typer.Option("--format", help="csv, json, or an exporter that is installed.")
    ] = "csv",
    output: Annotated[
        Path | None, typer.Option("--output", help="The file; standard output if absent.")
    ] = None,
) -> None:
    """Write the history of a process to a file."""
    exporter: Exporter = EXPORTERS.load(form)
    content = exporter(_ask("GET", f"/processes/{process}"))
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
    _ask("POST", f"/processes/{process}/cancel", json={"by": by})
    print(f"{process} is cancelled")


@app.command()
def retry(
    process: Annotated[str, typer.Argument(help="The id of the process that failed.")],
    task: Annotated[str, typer.Argument(help="The id of the Task it failed by, as `show` has it in retry.")],
    by: Annotated[str, typer.Option("--by", help="The person who retries it.")],
) -> None:
    """Retry the failed Task that has ended a process; the process continues."""
    answer = _ask("POST", f"/processes/{process}/tasks/{task}/retry", json={"by": by})
    print(f"{answer['id']} continues: {', '.join(answer['waiting']) or answer['status']}")


def _ask(method: str, path: str, **content: Any) -> Any:
    orchestrator = service_named("task-orchestrator").url()
    try:
        answer = httpx.request(method, f"{orchestrator}{path}", timeout=30, trust_env=False, **content)
    except httpx.TransportError:
        raise UsageError(
            f"the task orchestrator does not answer at {orchestrator}; start it with: handover up"
        ) from None
    if answer.is_success:
        return answer.json() if answer.content else None
    raise UsageError(_refusal(answer))


def _refusal(answer: httpx.Response) -> str:
    try:
        problem = answer.json()
    except ValueError:
        return f"the orchestrator answered {answer.status_code}: {answer.text[:200]}"
    faults = [
        f"  line {fault.get('line', '?')}, {fault.get('element') or 'the file'}: {fault['message']}"
        for fault in problem.get("faults", [])
    ]
    if faults:
        return "\n".join([f"{problem.get('title')}:", *faults])
    return str(problem.get("detail") or problem.get("title"))


def _parameter(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise UsageError(f'a parameter is given as name=value, not "{text}"')
    try:
        return name, orjson.loads(value)
    except orjson.JSONDecodeError:
        return name, value
