"""Questions to the orchestrator, and options that several commands have."""

from typing import Annotated, Any

import httpx
import typer

from handover.command_line.access import ask_service
from handover.settings import Settings

By = Annotated[str, typer.Option("--by", help="The person who decides it.")]
Why = Annotated[str | None, typer.Option("--why", help="The reason, for the history.")]


def ask(method: str, path: str, **request: Any) -> Any:
    """Return the content of the answer of the task orchestrator. Raises `UsageError`."""
    answer = ask_page(method, path, **request)
    return answer.json() if answer.content else None


def ask_page(method: str, path: str, **request: Any) -> httpx.Response:
    """Return the answer of the orchestrator with its headers; raise `UsageError` if it refuses."""
    settings = Settings.load()
    url = settings.url_of(settings.orchestrator_port)
    return ask_service("task orchestrator", settings, method, url, path, refusal=_refusal, **request)


def _refusal(answer: httpx.Response) -> str:
    try:
        problem = answer.json()
    except ValueError:
        return f"the orchestrator answered {answer.status_code}: {answer.text[:200]}"
    faults = [
        f"  line {fault.get('line', '?')}, {drawn_name(fault)}: {fault['message']}"
        for fault in problem.get("faults", [])
    ]
    if faults:
        return "\n".join([f"{problem.get('title')}:", *faults])
    findings = [f"  {finding_line(finding)}" for finding in problem.get("findings", [])]
    if findings:
        return "\n".join([f"{problem.get('title')}:", *findings])
    return str(problem.get("detail") or problem.get("title"))


def drawn_name(fault: dict[str, Any]) -> str:
    """Return the drawn name of an element, in quotes."""
    element, name = fault.get("element"), fault.get("name")
    if not element:
        return "the file"
    return f'{element} ("{name}")' if name and name != element else str(element)


def finding_line(finding: dict[str, Any]) -> str:
    """Return a finding of a migration as a line."""
    kind = "obstacle" if finding["obstacle"] else "differs"
    return f"{kind}  {drawn_name(finding)}: {finding['reason']}"
