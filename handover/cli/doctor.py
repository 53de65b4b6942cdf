"""The doctor: checks machine and broker, and prints one line for each missing part, with the remedy."""

import asyncio
import importlib.util
import os
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from handover.broker import BrokerClient
from handover.broker_abilities import ABILITIES, FoundAbilities, find_abilities
from handover.cli.access import cli_access
from handover.cli.launcher import require_space
from handover.cli.services import has_own_broker, wanted
from handover.errors import HandoverError, UsageError
from handover.ports import hold, reserved_ports, unreserved
from handover.settings import Settings

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
    try:
        require_space(settings.data_dir)
    except UsageError as error:
        yield Finding("data directory", False, str(error))
    else:
        free_gib = shutil.disk_usage(settings.data_dir).free / 2**30
        yield Finding("data directory", True, f"{settings.data_dir.absolute()}, {free_gib:.0f} GiB free")


def _ports() -> Iterator[Finding]:
    for service in wanted():
        for host, port, setting in service.listens():
            try:
                hold(host, port, setting).close()
            except UsageError as error:
                yield Finding(service.name, False, f"{error} (or it is running already)", needed=False)
            else:
                yield Finding(service.name, True, f"port {port} is free")
    yield from _reserved({port for service in wanted() for _, port, _ in service.listens()})


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
        found = asyncio.run(_abilities(settings))
    except HandoverError as error:
        yield Finding("broker", False, str(error))
        return
    about = f"broker {settings.broker_url}"
    yield Finding(about, True, found.broker)
    for ability in ABILITIES:
        is_there = found.are_there[ability.name]
        words = "is there" if is_there else f"is not there: {ability.without}; {ability.remedy}"
        yield Finding(about, is_there, f"{ability.name} {words}", needed=False)


async def _abilities(settings: Settings) -> FoundAbilities:
    async with cli_access(settings) as access, BrokerClient(settings, credentials=access) as broker:
        return await find_abilities(broker, settings)


def _serial() -> Iterator[Finding]:
    ports = sorted([*Path("/dev").glob("ttyUSB*"), *Path("/dev").glob("ttyACM*")])
    if not ports:
        yield Finding("serial glove", False, "none plugged in; the simulated one serves", needed=False)
    for port in ports:
        usable = os.access(port, os.R_OK | os.W_OK)
        mend = "usable" if usable else "no permission; add yourself to the group dialout and log in again"
        yield Finding(f"serial port {port}", usable, mend, needed=False)


def _programs() -> Iterator[Finding]:
    for program, purpose in OPTIONAL_PROGRAMS.items():
        there = shutil.which(program)
        yield Finding(program, there is not None, there or purpose, needed=False)
