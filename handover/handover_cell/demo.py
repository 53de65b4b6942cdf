"""The demonstration: a simulated operator and a simulated robot work through the bin-picking process."""

import asyncio
import shutil
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx

from handover.broker import BrokerClient, BrokerError
from handover.command_line.access import AccessAuth, cli_access
from handover.errors import UsageError
from handover.network.tls_trust import client_context
from handover.runtime.python_processes import module_command
from handover.services import service_named, wanted_services
from handover.settings import Settings
from handover_cell.launching.launcher import Launcher
from handover_cell.obstacles import obstacle
from handover_cell.progress import ProgressPrinter, Say
from handover_datamodels.entities import Task
from handover_gloves.command_line.glove import bridge_arguments

DEFINITION = "bin-picking"
GLOVE = "glove-1"
ROBOT = "ur10-1"
"""The robot of the process, where its start names no other."""
QUERY_EVERY_S = 0.15
FINISHED = {"completed", "failed"}


async def demo(settings: Settings, *, once: bool, timeout_s: float, say: Say) -> None:
    """Start everything, run the process, print its progress; run until stopped unless `once`.

    Raises `UsageError` with the reason when the process does not complete within `timeout_s`.
    """
    began_s = time.monotonic()
    services = wanted_services()
    async with Launcher(services, settings, say) as launcher:
        await launcher.keep("simulated-operator", _operator())
        say(f"{', '.join(service.name for service in services)}: ready in {time.monotonic() - began_s:.1f} s")
        say(f"Look at it on {service_named('webui').url()}")
        try:
            async with asyncio.timeout(timeout_s):
                parameters = await run_process(settings, say, once=once)
        except TimeoutError:
            raise UsageError(
                f"the process did not complete within {timeout_s:.0f} s; "
                f"see the logs in {settings.data_dir / 'logs'}"
            ) from None
        if not once:
            say("")
            say("Everything keeps running; Ctrl-C stops it. To run the process again, in another terminal:")
            options = "".join(f" --set {name}={value}" for name, value in parameters.items())
            say(f"  {_program()} process start {DEFINITION}{options}")
            await asyncio.Event().wait()


async def run_process(settings: Settings, say: Say, *, once: bool) -> dict[str, str]:
    """Start the bin-picking process with the first robot of the cell, and print its progress.

    Returns the process parameters. Raises `UsageError` if the process fails, and with `once` also if it waits
    for a person to mend something: nobody is there.
    """
    orchestrator = service_named("task-orchestrator").url()
    began = datetime.now(UTC)
    async with (
        cli_access(settings) as access,
        httpx.AsyncClient(
            base_url=orchestrator,
            trust_env=False,
            verify=client_context(*settings.ca_files),
            auth=AccessAuth(access),
        ) as http,
        BrokerClient(settings, credentials=access) as broker,
    ):
        parameters = await _parameters(http)
        answer = await http.post("/processes", json={"definition": DEFINITION, "parameters": parameters})
        if not answer.is_success:
            raise UsageError(f"the process could not be started: {answer.text}")
        process_id = str(answer.json()["id"])
        instance = process_id.rsplit(":", 1)[-1]
        say(f"{0:6.1f} s  process   {instance} begins")
        progress = ProgressPrinter(began, say)
        tasks = f"^{settings.entity_id('Task', instance)}-.*"
        shown: str | None = None
        while True:
            process = await _look(http, f"/processes/{process_id}")
            progress.update(await _tasks(broker, tasks))
            if process.get("status") in FINISHED:
                break
            fault = await obstacle(process, lambda name: _look(http, f"/processes/{name}"), _program())
            if fault is not None and once:
                raise UsageError(f"the process waits for a person: {fault}")
            if fault is not None and fault != shown:
                say(fault)
            shown = fault
            await asyncio.sleep(QUERY_EVERY_S)
    seconds = (datetime.now(UTC) - began).total_seconds()
    if process["status"] == "failed":
        raise UsageError(
            f"the process failed after {seconds:.1f} s: {process.get('reason', 'no reason given')}"
        )
    say(f"{seconds:6.1f} s  process   completed")
    say(progress.summary())
    return parameters


async def _parameters(http: httpx.AsyncClient) -> dict[str, str]:
    """Return the process parameters that differ from those of the definition."""
    robots = await _look(http, f"{service_named('trajectory-tool').url()}/robots") or []
    names = [robot["id"] for robot in robots]
    return {"robot": f"Device:{names[0]}"} if names and ROBOT not in names else {}


async def _look(http: httpx.AsyncClient, url: str) -> Any:
    """Return what a service has; empty while it restarts."""
    try:
        answer = await http.get(url)
    except httpx.TransportError:
        return {}
    return answer.json() if answer.is_success else {}


async def _tasks(broker: BrokerClient, id_pattern: str) -> list[Task]:
    try:
        return await broker.find(Task, id_pattern=id_pattern)
    except BrokerError:
        return []


def _program() -> str:
    """Return the command of this program: its name if that is in the path, else its path."""
    program = Path(sys.executable).with_name("handover")
    if shutil.which(program.name) == str(program):
        return program.name
    return str(program.relative_to(Path.cwd()) if program.is_relative_to(Path.cwd()) else program)


def _operator() -> list[str]:
    return module_command("glove_sdk_bridge", *bridge_arguments(["simulate", "--glove", GLOVE]))
