"""The doctor: checks machine and broker, and prints one line for each missing part, with the remedy."""

import asyncio
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import httpx
import typer

from handover.broker import BrokerClient
from handover.broker.abilities import ABILITIES, FoundAbilities, find_abilities
from handover.command_line.access import cli_access
from handover.command_line.foreground import DataDir, say, settings_in
from handover.command_line.output import AsJson, print_json
from handover.errors import HandoverError, UsageError
from handover.extensions import Service
from handover.network.tls_trust import client_context
from handover.runtime.ports import PortLeaving, hold, reserved_ports, unreserved
from handover.services import has_own_broker, wanted_services
from handover.settings import Settings
from handover_cell.launching.launcher import require_space

app = typer.Typer()

DOCKER_TIMEOUT_S = 20.0

OPTIONAL_PROGRAMS = {
    "chromium": "needed only to test the pages",
    "mosquitto": "needed only to test MQTT notifications",
    "docker": "needed only to run the containers",
}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing looked at; `needed` says whether Handover cannot work without it."""

    about: str
    ok: bool
    words: str
    needed: bool = True


def examine(settings: Settings) -> list[Finding]:
    """Look at the machine and return every finding."""
    return [*_python(), *_disk(settings), *_ports(), *_broker(settings), *_serial(), *_programs()]


def _python() -> Iterator[Finding]:
    version = ".".join(str(part) for part in sys.version_info[:3])
    fits = (3, 11) <= sys.version_info[:2] <= (3, 13)
    yield Finding("Python", fits, version if fits else f"{version}; 3.11 to 3.13 is needed")
    for package in ("uvloop", "httptools"):
        there = importlib.util.find_spec(package) is not None
        yield Finding(package, there, "installed" if there else "not installed; slower without", needed=False)


def _disk(settings: Settings) -> Iterator[Finding]:
    folder = settings.data_dir.absolute()
    if not folder.exists():
        parent = next(folder_above for folder_above in folder.parents if folder_above.exists())
        is_possible = parent.is_dir() and os.access(parent, os.W_OK | os.X_OK)
        words = f"{folder} does not exist; " + (
            "the first service makes it" if is_possible else f"{parent} is not writable; choose another"
        )
        yield Finding("data directory", is_possible, words)
        return
    try:
        require_space(folder)
    except UsageError as error:
        yield Finding("data directory", False, str(error))
    else:
        free_gib = shutil.disk_usage(folder).free / 2**30
        yield Finding("data directory", True, f"{folder}, {free_gib:.0f} GiB free")


def _ports() -> Iterator[Finding]:
    for service in wanted_services():
        is_running: bool | None = None
        for host, port, setting in service.listens():
            try:
                hold(host, port, setting).close()
            except UsageError as error:
                is_running = _is_running(service) if is_running is None else is_running
                words = f"it runs, port {port}" if is_running else str(error)
                is_lasting = not isinstance(error, PortLeaving)
                yield Finding(service.name, is_running, words, needed=is_lasting)
            else:
                yield Finding(service.name, True, f"port {port} is free")
    yield from _reserved({port for service in wanted_services() for _, port, _ in service.listens()})


def _is_running(service: Service) -> bool:
    """Return whether a service of ours answers at its address, and no other program."""
    try:
        answer = httpx.get(
            f"{service.url()}/healthz",
            timeout=10,
            trust_env=False,
            verify=client_context(*service.settings.load().ca_files),
        )
        return bool(answer.is_success and answer.json() == {"status": "ok"})
    except (httpx.TransportError, ValueError):
        return False


def _reserved(ports: set[int]) -> Iterator[Finding]:
    """Say whether outgoing connections of this machine are kept from our ports."""
    at_risk = unreserved(ports)
    if not at_risk:
        yield Finding("ports", True, "no outgoing connection can get one of ours", needed=False)
        return
    wanted_ports = ",".join(str(port) for port in sorted({*at_risk, *reserved_ports()}))
    yield Finding(
        "ports",
        False,
        f"outgoing connections of this machine may get {', '.join(map(str, at_risk))}; a service then waits; "
        f"reserve them: echo net.ipv4.ip_local_reserved_ports={wanted_ports} | "
        "sudo tee /etc/sysctl.d/60-handover.conf && sudo sysctl --system",
        needed=False,
    )


def _broker(settings: Settings) -> Iterator[Finding]:
    """Say what a broker that is not ours can do."""
    if has_own_broker():
        return
    try:
        abilities = asyncio.run(_abilities(settings))
    except HandoverError as error:
        yield Finding("broker", False, str(error))
        return
    about = f"broker {settings.broker_url}"
    yield Finding(about, True, abilities.broker)
    for ability in ABILITIES:
        is_there = abilities.are_there[ability.name]
        words = "is there" if is_there else f"is not there: {ability.without}; {ability.remedy}"
        yield Finding(about, is_there, f"{ability.name} {words}", needed=False)


async def _abilities(settings: Settings) -> FoundAbilities:
    """Probe the broker without our @context, which it can fetch only from a cell that runs."""
    without_context = settings.model_copy(update={"context_url": ""})
    async with cli_access(settings) as access, BrokerClient(without_context, credentials=access) as broker:
        return await find_abilities(broker, settings)


def _serial() -> Iterator[Finding]:
    ports = sorted([*Path("/dev").glob("ttyUSB*"), *Path("/dev").glob("ttyACM*")])
    if not ports:
        yield Finding("serial glove", False, "none plugged in; the simulated one serves", needed=False)
    for port in ports:
        usable = os.access(port, os.R_OK | os.W_OK)
        mend = "usable" if usable else "no permission; add yourself to the group dialout and log in again"
        yield Finding(f"serial port {port}", usable, mend)


def _programs() -> Iterator[Finding]:
    for program, purpose in OPTIONAL_PROGRAMS.items():
        there = shutil.which(program)
        fault = _docker_fault(there) if program == "docker" and there else None
        yield Finding(program, there is not None and fault is None, fault or there or purpose, needed=False)


def _docker_fault(program: str) -> str | None:
    """Return why containers cannot run although the client is installed."""
    try:
        asked = subprocess.run(  # noqa: S603 - found in the path
            [program, "version", "--format", "{{.Server.Version}}"],
            capture_output=True,
            text=True,
            timeout=DOCKER_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        reason = f"no answer within {DOCKER_TIMEOUT_S:.0f} s"
    except OSError as error:
        reason = str(error)
    else:
        if asked.returncode == 0 and asked.stdout.strip():
            return None
        reason = (asked.stderr.strip().splitlines() or ["no answer"])[-1]
    return f"{program} is installed, and its engine does not answer ({reason}); start it for containers"


@app.command()
def doctor(data_dir: DataDir = None, as_json: AsJson = False) -> None:
    """Check this machine and a broker that is not ours; print the remedy for each missing part.

    `wrong` is what keeps a part of Handover from working, then the exit code is 1; what is `missing` is
    optional.
    """
    findings = examine(settings_in(data_dir))
    if as_json:
        print_json([asdict(finding) for finding in findings])
    else:
        for finding in findings:
            level = "ok" if finding.ok else "wrong" if finding.needed else "missing"
            say(f"{level:<7}  {finding.about}: {finding.words}")
    if not all(finding.ok or not finding.needed for finding in findings):
        raise typer.Exit(1)
