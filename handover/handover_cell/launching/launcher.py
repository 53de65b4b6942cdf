"""The launcher: runs the services as processes, restarts them when they end, and stops them.

Their output goes to `logs/` in the data directory. No service outlives the launcher, even if that is killed.
"""

import asyncio
import contextlib
import os
import shutil
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit

import httpx

from handover.errors import UsageError
from handover.extensions import Service
from handover.logs.log_files import LOG_FILE, open_log, rotate
from handover.network.outbound_policy import is_loopback
from handover.network.tls_trust import client_context, handshake_fault
from handover.runtime.ports import held
from handover.runtime.python_processes import module_command
from handover.runtime.retry import Backoff
from handover.service_addresses import BROKER, ORCHESTRATOR
from handover.serving.watchdog import Watchdog
from handover.settings import LIFELINE, RESTARTED, Settings
from handover_broker.settings import BrokerSettings
from handover_cell.launching.processes import Process, ProcessStarter

READY_WITHIN_S = 30.0
STOP_WITHIN_S = 2.0
MIN_FREE_BYTES = 50 * 1024 * 1024
NO_USE = 2
"""The exit code of a process for which a restart does not help."""
INITIAL_RESTART_S, MAX_RESTART_S = 0.2, 5.0


@dataclass
class Running:
    """A process of the launcher; `url` is None for a process without an HTTP server."""

    name: str
    command: Sequence[str]
    url: str | None
    log: Path
    process: Process | None = None
    backoff: Backoff = field(default_factory=lambda: Backoff(INITIAL_RESTART_S, MAX_RESTART_S))
    started_s: float = field(default_factory=time.monotonic)
    was_stuck: bool = False
    """Whether the watchdog has ended the process before."""

    def last_log_line(self) -> str:
        """Return its last log line, which has the reason of its end."""
        with contextlib.suppress(OSError):
            lines = [line for line in self.log.read_text(errors="replace").splitlines() if line.strip()]
            if lines:
                return lines[-1]
        return f"no log line; see {self.log}"


def _places_of(services: Sequence[Service]) -> set[str]:
    """Return the hosts of the services; on this machine with the port, since other programs are there too."""
    parts = [
        urlsplit(url) for service in services for url in (service.url(), *service.settings.load().own_urls())
    ]
    return {
        part.netloc.rpartition("@")[2] if is_loopback(part.hostname) else part.hostname
        for part in parts
        if part.hostname
    }


class Launcher:
    """Keeps `services` running inside the context; `say` gets lines for the user."""

    def __init__(self, services: Sequence[Service], settings: Settings, say: Callable[[str], None]) -> None:
        self._services = services
        self._data_dir = settings.data_dir.absolute()
        self._settings = settings
        # The broker may notify the services at all their addresses.
        allowed = BrokerSettings.load().outbound_allow
        self._broker_outbound_allow = ",".join(filter(None, (*sorted(_places_of(services)), allowed)))
        self._say = say
        self._running: list[Running] = []
        self._watchers: list[asyncio.Task[None]] = []
        self._ports = contextlib.ExitStack()
        self._starter = ProcessStarter()
        self._stopping = False

    async def __aenter__(self) -> Self:
        require_space(self._data_dir)
        try:
            await self._hold_ports()
            self._starter.open()
            for service in self._services:
                await self.add(service.name, module_command(service.module), service.url())
            await self._all_ready()
        except BaseException:
            await self.stop()
            raise
        for running in self._running:
            self._watchers.append(asyncio.create_task(self._keep(running)))
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    async def add(self, name: str, command: Sequence[str], url: str | None = None) -> None:
        """Start one more process."""
        running = Running(name, command, url, self._data_dir / "logs" / f"{name}.log")
        await self._start(running)
        self._running.append(running)

    async def keep(self, name: str, command: Sequence[str]) -> None:
        """Start one more process and restart it when it ends, unless its exit code is NO_USE."""
        await self.add(name, command)
        self._watchers.append(asyncio.create_task(self._keep(self._running[-1])))

    async def stop(self) -> None:
        """Stop every process: SIGTERM, and SIGKILL after two seconds."""
        self._stopping = True
        for watcher in self._watchers:
            watcher.cancel()
        alive = [r.process for r in self._running if r.process and r.process.returncode is None]
        for process in alive:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
        waits = [asyncio.create_task(process.wait()) for process in alive]
        if waits:
            await asyncio.wait(waits, timeout=STOP_WITHIN_S)
        for process in alive:
            if process.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
        await asyncio.gather(*waits)
        await self._starter.close()
        self._ports.close()

    async def _hold_ports(self) -> None:
        """Reserve the ports of the services, also while a service restarts."""
        for service in self._services:
            for host, port, setting in service.listens():
                self._ports.enter_context(await held(host, port, setting, say=self._say))

    def _environment_of(self, name: str) -> dict[str, str]:
        if name == BROKER:
            return {"HANDOVER_OUTBOUND_ALLOW": self._broker_outbound_allow}
        has_orchestrator = any(service.name == ORCHESTRATOR for service in self._services)
        if has_orchestrator and self._settings.device_leases == "auto":
            return {"HANDOVER_DEVICE_LEASES": "required"}  # it may start later than its performers
        return {}

    async def _start(self, running: Running) -> None:
        with contextlib.suppress(FileNotFoundError):
            rotate(running.log)
        environment = {
            **os.environ,
            **self._environment_of(running.name),
            LIFELINE: "1",
            LOG_FILE: str(running.log),
            **({RESTARTED: "1"} if running.was_stuck else {}),
            "HANDOVER_DATA_DIR": str(self._data_dir),
            "PYTHONUNBUFFERED": "1",
        }
        with os.fdopen(open_log(running.log), "ab") as log:
            running.process = await self._starter.start(running.command, environment, log)
        running.started_s = time.monotonic()

    async def _all_ready(self) -> None:
        deadline_s = time.monotonic() + READY_WITHIN_S
        async with httpx.AsyncClient(
            timeout=2.0, trust_env=False, verify=client_context(*self._settings.ca_files)
        ) as http:
            await asyncio.gather(*(self._ready(http, running, deadline_s) for running in self._running))

    async def _ready(self, http: httpx.AsyncClient, running: Running, deadline_s: float) -> None:
        reason = "it does not answer"
        while time.monotonic() < deadline_s:
            if running.process is not None and running.process.returncode is not None:
                raise UsageError(f"{running.name} could not start: {running.last_log_line()}")
            try:
                answer = await http.get(f"{running.url}/readyz")
            except httpx.TransportError as error:
                reason = handshake_fault(error, running.name) or reason
            else:
                if answer.is_success:
                    return
                reason = answer.text
            await asyncio.sleep(0.05)
        raise UsageError(
            f"{running.name} is not ready after {READY_WITHIN_S:.0f} s: {reason}; see {running.log}"
        )

    async def _keep(self, running: Running) -> None:
        watchdog = running.url and Watchdog(running.name, running.url, self._settings, self._say)
        is_ready = True  # at first; it has been waited for
        while True:
            process = running.process
            assert process is not None  # noqa: S101 - started before it is watched
            watch = watchdog and asyncio.create_task(
                watchdog.watch(process.pid, process.kill, is_ready=is_ready)
            )
            is_ready = False
            try:
                code = await process.wait()
            finally:
                running.was_stuck = bool(watch and watch.done() and not watch.exception())
                if watch:
                    watch.cancel()
            if self._stopping:
                return
            if running.url is None and code == NO_USE:
                self._say(f"{running.name} has ended: {running.last_log_line()}")
                return
            if time.monotonic() - running.started_s > MAX_RESTART_S:
                running.backoff.reset()
            how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"
            self._say(f"{running.name} {how}; restarting it ({running.last_log_line()})")
            await running.backoff.wait()
            await self._start(running)


def require_space(data_dir: Path) -> None:
    """Create the data directory; raise `UsageError` in one line when it is not writable or full."""
    try:
        data_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
        probe = data_dir / ".writable"
        probe.write_bytes(b"x" * 4096)
        probe.unlink()
        free_bytes = shutil.disk_usage(data_dir).free
    except OSError as error:
        raise UsageError(
            f"the data directory {data_dir} cannot be used: {error.strerror}; choose another with --data-dir"
        ) from None
    if free_bytes < MIN_FREE_BYTES:
        raise UsageError(
            f"the disk of {data_dir} is full ({free_bytes // 2**20} MB left, {MIN_FREE_BYTES // 2**20} MB "
            "needed); free disk space or choose another with --data-dir"
        )
