"""The watchdog with real processes: what spins is restarted with an Alert, what sleeps is left alone."""

import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path

import httpx
import psutil
import pytest

from handover.broker import BrokerClient
from handover.extensions import Service
from handover.settings import Settings
from handover_cell.launching.launcher import Launcher
from handover_datamodels.entities import Alert
from tests.integration.cell.busy_service import BusySettings
from tests.kit.cell import Cell
from tests.kit.paths import REPOSITORY
from tests.kit.ports import next_free_port
from tests.kit.waiting import scaled, until

MODULE = "tests.integration.cell.busy_service"
BUSY = Service("busy", MODULE, BusySettings, "busy_port")
Eventually = Callable[..., None]


class Watched:
    """The busy service under a launcher, and what that said."""

    def __init__(self, lines: list[str], broker: BrokerClient) -> None:
        self.lines = lines
        self.broker = broker

    def process(self) -> int | None:
        """Return the process that listens."""
        for process in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):
                ports = {one.laddr.port for one in process.net_connections("inet") if one.laddr}
                if BUSY.port() in ports:
                    return process.pid
        return None

    def said(self, words: str) -> int:
        return sum(words in line for line in self.lines)

    async def alerts(self) -> list[Alert]:
        return [one for one in await self.broker.find(Alert) if one.sub_category.value == "serviceRestarted"]


async def asked_to(what: str) -> None:
    """Send a request that is never answered."""
    async with httpx.AsyncClient(trust_env=False) as http:
        with suppress(httpx.TimeoutException):
            await http.get(f"{BUSY.url()}/{what}", timeout=0.5)


@pytest.fixture
async def watched(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Watched]:
    cell.start("context_broker")
    for name, value in cell.environment.items():
        if name.startswith("HANDOVER_"):
            monkeypatch.setenv(name, value)
    monkeypatch.setenv("HANDOVER_BUSY_PORT", str(next_free_port()))
    monkeypatch.chdir(REPOSITORY)
    lines: list[str] = []
    async with (
        Launcher([BUSY], Settings.load(), lines.append),
        BrokerClient(cell.settings) as broker,
    ):
        yield Watched(lines, broker)


@pytest.mark.nightly
async def test_a_service_that_spins_is_restarted_with_an_alert_and_not_twice_in_a_minute(
    watched: Watched,
) -> None:
    before = watched.process()
    await asked_to("spin")
    await until(lambda: watched.process() not in {before, None}, 300, "the service is not restarted")
    assert watched.said("it is restarted") == 1
    assert httpx.get(f"{BUSY.url()}/restarted", timeout=scaled(60)).text == "1"

    async def alert() -> Alert | None:
        return next(iter(await watched.alerts()), None)

    raised = await until(alert, 120, "there is no Alert")
    assert "busy did not answer" in str(raised.description)
    assert httpx.get(f"{BUSY.url()}/healthz", timeout=scaled(60)).is_success
    again = watched.process()
    await asked_to("spin")
    await until(
        lambda: watched.said("not restarted more than once") or watched.said("it is restarted") == 2,
        300,
        "nothing is said of the second silence",
    )
    assert watched.process() == again or watched.said("it is restarted") == 2


@pytest.mark.nightly
async def test_a_service_without_processor_time_is_not_restarted(watched: Watched) -> None:
    before = watched.process()
    assert before is not None
    os.kill(before, signal.SIGSTOP)
    try:
        await until(lambda: watched.said("it had little processor time"), 300, "nothing is said")
    finally:
        os.kill(before, signal.SIGCONT)
    await until(lambda: watched.said("busy answers again"), 300, "it does not answer again")
    assert watched.process() == before
    assert await watched.alerts() == []


SUPERVISED = f"""
import runpy
from handover.serving.supervisor import run_watched
from {MODULE} import BusySettings
settings = BusySettings.load()
run_watched("busy", settings.url_of(settings.busy_port), settings, lambda line: print(line, flush=True))
runpy.run_module("{MODULE}", run_name="__main__", alter_sys=True)
"""


@pytest.mark.nightly
async def test_a_container_restarts_a_service_that_spins_and_forwards_signals(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.start("context_broker")
    port = str(next_free_port())
    monkeypatch.setenv("HANDOVER_BUSY_PORT", port)
    supervisor = subprocess.Popen(
        [sys.executable, "-c", SUPERVISED],
        env={**cell.environment, "HANDOVER_BUSY_PORT": port},
        cwd=REPOSITORY,
        stdout=(output := (cell.data_dir / "supervised.log").open("wb")),
        stderr=output,
    )
    log = Path(output.name)

    def service() -> int | None:
        children = psutil.Process(supervisor.pid).children()
        with suppress(httpx.TransportError):
            if children and httpx.get(f"{BUSY.url()}/healthz", timeout=scaled(5)).is_success:
                return children[0].pid
        return None

    try:
        before = await until(service, 120, log.read_text)
        await asked_to("spin")
        await until(lambda: "starting it again" in log.read_text(), 300, log.read_text)
        after = await until(service, 120, log.read_text)
        assert after != before
        assert httpx.get(f"{BUSY.url()}/restarted", timeout=scaled(60)).text == "1"
        supervisor.terminate()
        assert supervisor.wait(scaled(60)) in {0, 128 + signal.SIGTERM}
        assert not psutil.pid_exists(after)
    finally:
        supervisor.kill()
        supervisor.wait()
        output.close()
