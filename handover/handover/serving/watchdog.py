"""Watchdog: restarts a service that works but does not answer, such as one in an endless loop.

It asks `/healthz` every few seconds. A service that is silent for `MAX_SILENCE_S`, although its process had
`MIN_CPU_S` of processor time meanwhile, is killed and started again by its launcher. Without that
processor time it is the machine that is slow, or the process was stopped: that is only reported. A service is
restarted at most once in `MIN_RESTART_INTERVAL_S`, and each time an Alert is raised, as soon as the broker
takes it. A service that has not answered since its start is left alone for `START_S`: it may load much.

The launcher has a watchdog for each service; in containers `handover run --watch` has one. Processor time is
known on Linux only; elsewhere silence is only reported.
"""

import asyncio
import os
import ssl
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from handover.alerts import clear_alert, raise_alert
from handover.alerts.catalogue import SERVICE_RESTARTED
from handover.broker import BrokerClient, BrokerError
from handover.errors import UsageError
from handover.messages import Message
from handover.security.service_access import ServiceAccess
from handover.settings import Settings

MAX_SILENCE_S: Final = 10.0
MIN_CPU_S: Final = 5.0
MIN_RESTART_INTERVAL_S: Final = 60.0
MIN_LOOKS: Final = 8
"""So often the silence must be seen: a watchdog that had no time itself has not waited for an answer."""
LOOK_EVERY_S: Final = 1.0
ASK_EVERY_S: Final = 2.0
ASK_AGAIN_S: Final = 0.2
START_S: Final = 120.0
"""How long a start may take until the first answer."""
CALM_S: Final = 600.0
"""After so long without a restart the Alert returns to normal."""

_REQUEST: Final = b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n"


class Verdict(StrEnum):
    """What is known of a service that has not answered yet."""

    WAITS = "waits"
    """It may still answer in time."""
    SLOW = "slow"
    """It is silent and had too little processor time to be blamed."""
    STUCK = "stuck"
    """It is silent although it works."""
    STUCK_AGAIN = "stuck again"
    """The same, but it was restarted a short time ago."""


@dataclass(slots=True)
class Patience:
    """Decides when a silent service is restarted; remembers when that was last."""

    restarted_s: float | None = None

    def verdict(self, now_s: float, *, asked_s: float, looks: int, cpu_s: float | None) -> Verdict:
        """Judge a service that was asked at `asked_s`, has not answered, and had `cpu_s` since then."""
        if now_s - asked_s < MAX_SILENCE_S or looks < MIN_LOOKS:
            return Verdict.WAITS
        if cpu_s is None or cpu_s < MIN_CPU_S:
            return Verdict.SLOW
        if self.restarted_s is not None and now_s - self.restarted_s < MIN_RESTART_INTERVAL_S:
            return Verdict.STUCK_AGAIN
        self.restarted_s = now_s
        return Verdict.STUCK


class Watchdog:
    """Watches the processes of the service `name` at `url`, one after the other.

    `say` gets a line about each silence.
    """

    def __init__(self, name: str, url: str, settings: Settings, say: Callable[[str], None]) -> None:
        self._name = name
        self._url = url
        self._settings = settings
        self._say = say
        self._patience = Patience()
        self._to_report: Message | None = None
        self._has_alert = False

    async def watch(self, pid: int, kill: Callable[[], None], *, is_ready: bool = False) -> bool:
        """Watch the process `pid` until it has to be restarted: `kill` it and return True.

        Cancel it when the process has ended. `is_ready` says that it has answered since its start.
        """
        if not is_ready:
            with suppress(TimeoutError):
                async with asyncio.timeout(START_S):
                    await self._answer()
        async with (
            ServiceAccess(self._settings, self._name) as access,
            BrokerClient(self._settings, credentials=access) as broker,
        ):
            while not await self._is_stuck(pid):
                await self._report(broker)
                await asyncio.sleep(ASK_EVERY_S)
        with suppress(ProcessLookupError):
            kill()
        return True

    async def _is_stuck(self, pid: int) -> bool:
        """Ask once; return True if there is no answer although the process works, False after an answer."""
        answer = asyncio.create_task(self._answer())
        asked_s, cpu_before_s = time.monotonic(), cpu_time_s(pid)
        said: set[Verdict] = {Verdict.WAITS}
        looks = 0
        try:
            while True:
                await asyncio.wait({answer}, timeout=LOOK_EVERY_S)
                if answer.done():
                    if len(said) > 1:
                        self._say(f"{self._name} answers again after {time.monotonic() - asked_s:.0f} s")
                    return False
                looks += 1
                now_s, cpu_now_s = time.monotonic(), cpu_time_s(pid)
                cpu_s = None if cpu_before_s is None or cpu_now_s is None else cpu_now_s - cpu_before_s
                verdict = self._patience.verdict(now_s, asked_s=asked_s, looks=looks, cpu_s=cpu_s)
                if verdict not in said:
                    said.add(verdict)
                    self._say(_line(self._name, verdict, now_s - asked_s, cpu_s))
                if verdict is Verdict.STUCK:
                    self._to_report = SERVICE_RESTARTED.describe(
                        "service.restarted",
                        service=self._name,
                        silent=round(now_s - asked_s),
                    )
                    return True
        finally:
            answer.cancel()

    async def _answer(self) -> None:
        """Return when the service has answered anything; ask again while it cannot be connected to."""
        parts = urlsplit(self._url)
        while True:
            with suppress(OSError, asyncio.IncompleteReadError, ValueError):
                reader, writer = await asyncio.open_connection(
                    parts.hostname, parts.port, ssl=_any_certificate() if parts.scheme == "https" else None
                )
                try:
                    writer.write(_REQUEST)
                    if await reader.readexactly(5) == b"HTTP/":
                        return
                finally:
                    writer.close()
            await asyncio.sleep(ASK_AGAIN_S)

    async def _report(self, broker: BrokerClient) -> None:
        """Raise the Alert of a restart, or return it to normal after a while; tried again later."""
        restarted_s = self._patience.restarted_s
        is_calm = restarted_s is not None and time.monotonic() - restarted_s > CALM_S
        if self._to_report is None and not (self._has_alert and is_calm):
            return
        key = f"{SERVICE_RESTARTED.sub_category} {self._name}"
        with suppress(BrokerError, UsageError):
            await clear_alert(broker, self._settings, key=key)  # so that each restart makes it new
            self._has_alert = False
            if self._to_report is not None:
                await raise_alert(
                    broker,
                    self._settings,
                    SERVICE_RESTARTED,
                    key=key,
                    source=self._settings.entity_id("Device", self._name),
                    description=self._to_report,
                )
                self._to_report, self._has_alert = None, True


def cpu_time_s(pid: int) -> float | None:
    """Return the processor time of a process (`utime` and `stime` of proc(5)); None if it is unknown."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2]
        user, system = fields.split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError):
        return None


def _line(service: str, verdict: Verdict, silent_s: float, cpu_s: float | None) -> str:
    silence = f"{service} has not answered for {silent_s:.0f} s"
    if verdict is Verdict.SLOW:
        return (
            f"{silence}; it had little processor time, so it is not restarted: the machine may be overloaded"
        )
    worked = f"{silence} although it had {cpu_s or 0.0:.0f} s of processor time"
    if verdict is Verdict.STUCK_AGAIN:
        return (
            f"{worked}; it was restarted within the last {MIN_RESTART_INTERVAL_S:.0f} s, so it stays for now"
        )
    return f"{worked}; it is restarted"


def _any_certificate() -> ssl.SSLContext:
    """Return a context for a question to the own process that has no secrets, under no name of its own."""
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context
