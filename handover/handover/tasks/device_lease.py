"""Leases of Devices: of several performers of one Device, one acts, and the others stand by.

The task orchestrator grants leases from its database (`/device-leases`). A lease has a holder, a duration and
a fencing number that only grows. The holder renews it every few seconds. `DeviceLeases` does that for a
performer; `DeviceLease.authority` gives a driver what it asks before every setpoint or goal, a comparison of
local values:

    authority = lease.authority()        # at the start of a motion
    if not authority.is_valid():         # in each cycle, then the setpoint is not sent
        ...

When a lease ends is computed from before its renewal was sent, by a clock that continues in suspend, so a
process that was paused finds its lease ended before the orchestrator grants it to another process. A motion
comes to rest `REST_S` before that (`may_continue`). A lease that ends because the orchestrator is away pauses
the work; if this process gets it back, and nobody had it meanwhile, the work continues. If another process
had it, the work is dropped without a report.

Without an orchestrator nobody can decide between two performers. The setting `device_leases` says what holds
then: see `docs/adr/0021-leases-of-devices.md`.
"""

import asyncio
import math
import os
import secrets
import socket
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, Literal

import orjson

from handover.network.http_client import BodyReadingHttpClient, SendError, address
from handover.security.service_access import AccountsUnavailable
from handover.settings import Settings
from handover.telemetry import get_logger

log = get_logger(__name__)

LEASE_S: Final = 12.0
RENEW_EVERY_S: Final = 3.0
RETRY_EVERY_S: Final = 1.0
"""Pause after a request without an answer, and the longest pause of a performer that stands by."""
REST_S: Final = 2.0
"""A motion comes to rest this long before its lease ends."""
REQUEST_TIMEOUT_S: Final = 5.0
MAX_DEVICES_PER_REQUEST: Final = 500
PATH: Final = "/device-leases"

Mode = Literal["auto", "required", "off"]
Headers = Callable[[], Awaitable[Mapping[str, str]]]


def boot_time_s() -> float:
    """Return the time since the start of the machine, including the time in suspend."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)  # only Linux
    return time.monotonic() if clock is None else time.clock_gettime(clock)


class LeaseState(Enum):
    """Whether this process may act for a Device."""

    UNKNOWN = "unknown"
    """Not granted yet, or ended without an answer of the orchestrator."""
    HELD = "held"
    RESTING = "resting"
    """Held, but it ends soon: motions come to rest."""
    TAKEN = "taken"
    """Another process has it, or had it since this one lost it."""


@dataclass(frozen=True, slots=True)
class Authority:
    """The right to command a Device under one lease; valid until that lease ends."""

    lease: "DeviceLease"
    epoch: int

    def is_valid(self) -> bool:
        """Return whether a setpoint or a goal may be sent now; cheap and thread-safe."""
        lease = self.lease
        return lease.epoch == self.epoch and lease.clock() < lease.ends_s

    def may_continue(self) -> bool:
        """Return whether a motion may continue; it comes to rest otherwise. Cheap and thread-safe."""
        lease = self.lease
        return lease.epoch == self.epoch and lease.clock() < lease.ends_s - REST_S


class DeviceLease:
    """The lease of `device`, as far as this process knows; written in one event loop, read by any thread."""

    def __init__(self, device: str, clock: Callable[[], float] = boot_time_s) -> None:
        self.device = device
        self.clock = clock
        self.number: int | None = None
        """The fencing number; None before the first grant, and without an orchestrator."""
        self.epoch = 0
        """It changes whenever this process loses the lease."""
        self.ends_s = -math.inf
        self.holder: str | None = None
        """The other process that has the lease."""
        self.retry_s = -math.inf
        """When a performer that stands by asks again."""
        self.watchers: list[Callable[[], None]] = []
        """Called when the state may have changed."""
        self._granted = asyncio.Event()

    def authority(self) -> Authority:
        """Return the right to command under the present lease."""
        return Authority(self, self.epoch)

    def is_held(self) -> bool:
        """Return whether this process may act now."""
        return self.clock() < self.ends_s

    def may_begin(self) -> bool:
        """Return whether work may begin: the lease is held and does not end soon."""
        return self.clock() < self.ends_s - REST_S

    def state(self) -> LeaseState:
        """Return whether this process may act."""
        now_s = self.clock()
        if self.holder is not None:
            return LeaseState.TAKEN
        if now_s < self.ends_s - REST_S:
            return LeaseState.HELD
        return LeaseState.RESTING if now_s < self.ends_s else LeaseState.UNKNOWN

    async def wait_until_held(self) -> None:
        """Return when this process may act."""
        while self.state() is not LeaseState.HELD:
            self._granted.clear()
            await self._granted.wait()

    def grant(self, number: int | None, ends_s: float) -> bool:
        """Note that this process has the lease; return whether another one had it since it was lost."""
        is_same = number == self.number
        was_taken = self.number is not None and number is not None and number > self.number + 1
        if not is_same and self.number is not None:
            self.epoch += 1
        self.number = number
        self.holder = None
        self.ends_s = ends_s
        self._granted.set()
        return was_taken

    def refuse(self, holder: str, retry_s: float) -> bool:
        """Note that another process has the lease; return whether that is new."""
        is_new = self.holder != holder
        if self.ends_s > -math.inf:
            self.epoch += 1
        self.ends_s = -math.inf
        self.holder = holder
        self.retry_s = retry_s
        return is_new


class DeviceLeases:
    """The leases of the Devices for which `performer` acts.

    `headers` are the credentials of its requests. `open` comes before `run`. `on_held` is called for each
    Device whose lease this process gets.
    """

    def __init__(
        self,
        settings: Settings,
        performer: str,
        headers: Headers | None = None,
        *,
        clock: Callable[[], float] = boot_time_s,
        on_held: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.mode: Mode = settings.device_leases
        self._performer = performer
        self._urls = tuple(url.rstrip("/") for url in settings.lease_urls) or (settings.orchestrator,)
        self._url = self._urls[0]
        """The orchestrator that is asked; another one after it has not answered."""
        self._headers = headers
        self._clock = clock
        self._on_held = on_held
        self._http = BodyReadingHttpClient(ca_files=settings.ca_files)
        self._leases: dict[str, DeviceLease] = {}
        self._holder = ""
        self._session = secrets.token_hex(8)
        self._was_leased = False
        self._keep_mark: Callable[[], Awaitable[None]] | None = None
        self._changed = asyncio.Event()
        self._away: str | None = None
        """Why there is no answer of the orchestrator."""
        self._is_unleased = False

    def open(self, holder: str, *, was_leased: bool, keep_mark: Callable[[], Awaitable[None]]) -> None:
        """Set the durable identity of this holder, and whether it was ever granted a lease.

        A process with the identity of the present holder gets its lease at once: it replaces it.
        `keep_mark` stores durably that a lease was granted.
        """
        self._holder, self._was_leased, self._keep_mark = holder, was_leased, keep_mark

    def of(self, device: str) -> DeviceLease:
        """Return the lease of a Device, which is asked for from now on."""
        if device not in self._leases:
            lease = self._leases[device] = DeviceLease(device, self._clock)
            if self.mode == "off":
                lease.grant(None, math.inf)
            self._changed.set()
        return self._leases[device]

    def drop(self, device: str) -> None:
        """Ask for the lease of a Device no longer."""
        self._leases.pop(device, None)

    def standby(self) -> str | None:
        """Return why this process may act for none of its Devices; None if it may for one, or has none."""
        states = {lease.state() for lease in self._leases.values()}
        if not states or states & {LeaseState.HELD, LeaseState.RESTING}:
            return None
        taken = next((lease for lease in self._leases.values() if lease.state() is LeaseState.TAKEN), None)
        if taken is not None:
            return f"standby: {taken.holder} holds {taken.device}; this one takes over when that lease ends"
        return f"no lease of {next(iter(self._leases))}: {self._away or 'not granted yet'}"

    async def run(self) -> None:
        """Get and renew the leases until cancelled."""
        if self.mode == "off":
            return
        renew_s = -math.inf
        while True:
            self._changed.clear()
            now_s = self._clock()
            if now_s >= renew_s or self._due(now_s):
                renew_s = self._clock() + (RENEW_EVERY_S if await self._renew() else RETRY_EVERY_S)
            self._notify()
            delay_s = max(min(renew_s, self._next_due_s()) - self._clock(), 0.05)
            try:
                async with asyncio.timeout(delay_s):
                    await self._changed.wait()
            except TimeoutError:
                continue
            renew_s = -math.inf

    async def release(self) -> None:
        """Give the leases back, so that another process has them at once."""
        held = [lease for lease in self._leases.values() if lease.number is not None and lease.is_held()]
        for lease in held:
            lease.epoch += 1
            lease.ends_s = -math.inf
        if held:
            body = {
                "holder": self._holder,
                "session": self._session,
                "devices": [held_lease.device for held_lease in held],
            }
            try:
                await self._post(f"{PATH}/release", body)
            except (SendError, AccountsUnavailable) as error:
                log.info("leases not released", performer=self._performer, error=str(error))
        self._http.close()

    def _due(self, now_s: float) -> bool:
        return any(lease.holder is not None and now_s >= lease.retry_s for lease in self._leases.values())

    def _next_due_s(self) -> float:
        """Return when a state changes by itself, or a performer that stands by asks again."""
        now_s = self._clock()
        times = [lease.retry_s for lease in self._leases.values() if lease.holder is not None]
        ends = (s for lease in self._leases.values() for s in (lease.ends_s - REST_S, lease.ends_s))
        return min((*times, *(s for s in ends if s > now_s)), default=math.inf)

    def _notify(self) -> None:
        for lease in tuple(self._leases.values()):
            for watcher in tuple(lease.watchers):
                watcher()

    async def _renew(self) -> bool:
        """Ask for all leases; return whether the orchestrator has answered."""
        leases = list(self._leases.values())
        for start in range(0, len(leases), MAX_DEVICES_PER_REQUEST):
            if not await self._ask(leases[start : start + MAX_DEVICES_PER_REQUEST]):
                return False
        return True

    async def _ask(self, leases: list[DeviceLease]) -> bool:
        body = {
            "holder": self._holder,
            "session": self._session,
            "performer": self._performer,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "durationS": LEASE_S,
            "devices": [lease.device for lease in leases],
        }
        sent_s = self._clock()
        try:
            status, content = await self._post(PATH, body)
        except (SendError, AccountsUnavailable) as error:
            self._note_away(str(error) or type(error).__name__)
            if self.mode == "auto" and not self._was_leased and not await self._has_listener():
                self._act_without(leases)
            self._ask_next()
            return False
        if status in {404, 405}:
            self._note_away(f"{self._url} gives no leases of Devices ({status})")
            if self.mode == "auto" and not self._was_leased:
                self._act_without(leases)
            return False
        if status != 200:
            detail = content.get("detail") if isinstance(content, dict) else None
            self._note_away(f"{self._url} answers {status}: {detail or 'no reason'}")
            self._ask_next()
            return False
        if self._away is not None and not self._is_unleased:
            log.info("the orchestrator answers again", performer=self._performer)
        self._away, self._is_unleased = None, False
        await self._apply({str(answer["device"]): answer for answer in content["leases"]}, sent_s)
        return True

    async def _apply(self, answers: Mapping[str, Mapping[str, Any]], sent_s: float) -> None:
        if not self._was_leased and any(answer["granted"] for answer in answers.values()):
            self._was_leased = True
            if self._keep_mark is not None:
                await self._keep_mark()
        for device, content in answers.items():
            lease = self._leases.get(device)
            if lease is None:
                continue
            if not content["granted"]:
                holder = content["holder"]
                who = f"{holder['performer']} (process {holder['pid']} on {holder['host']})"
                retry_s = self._clock() + min(max(float(content["endsInS"]), 0.05), RETRY_EVERY_S)
                if lease.refuse(who, retry_s):
                    log.warning("standby: another process holds the device", device=device, holder=who)
                continue
            was_held, number = lease.is_held(), int(content["number"])
            if lease.grant(number, sent_s + LEASE_S):
                log.warning("another process held the device meanwhile", device=device, number=number)
            if not was_held:
                log.info("lease of the device", device=device, number=number, performer=self._performer)
                self._on_held(device)

    def _act_without(self, leases: list[DeviceLease]) -> None:
        if not self._is_unleased:
            self._is_unleased = True
            log.warning(
                "no orchestrator grants leases of devices, so a second performer is not detected",
                performer=self._performer,
                orchestrator=self._url,
                setting="HANDOVER_DEVICE_LEASES",
            )
        for lease in leases:
            if not lease.is_held():
                lease.grant(None, math.inf)
                self._on_held(lease.device)

    def _note_away(self, reason: str) -> None:
        if self._away is None and self._was_leased:
            log.warning("leases not renewed", performer=self._performer, error=reason)
        self._away = reason

    def _ask_next(self) -> None:
        """Ask the next orchestrator from now on."""
        self._url = self._urls[(self._urls.index(self._url) + 1) % len(self._urls)]

    async def _has_listener(self) -> bool:
        """Return whether a server listens at an address of an orchestrator; it may be slow."""
        for url in self._urls:
            place = address(url)
            try:
                async with asyncio.timeout(REQUEST_TIMEOUT_S):
                    _, writer = await asyncio.open_connection(place.host, place.port)
            except TimeoutError:
                return True
            except OSError:
                continue
            writer.close()
            return True
        return False

    async def _post(self, path: str, body: Mapping[str, Any]) -> tuple[int, Any]:
        credentials = {} if self._headers is None else await self._headers()
        headers = [("Content-Type", "application/json"), ("Accept", "application/json"), *credentials.items()]
        reply = await self._http.request(
            "POST", f"{self._url}{path}", headers, orjson.dumps(body), REQUEST_TIMEOUT_S
        )
        try:
            return reply.status, orjson.loads(reply.body) if reply.body else None
        except orjson.JSONDecodeError:
            return 502, None
