"""Device leases: of the performers of one Device, one acts. The kit's side is `handover.tasks.device_lease`.

A lease has a holder, a duration and a number. The number grows with each grant and is stored before it is
answered, so no two holders ever have the same. The time at which a lease ends is kept in memory, by a clock
that continues in suspend; a renewal extends it without a write. After a restart, and for a lease that another
orchestrator on the database granted, it counts from the moment at which this one first reads the lease: late
rather than early.

Each request reads the leases in a transaction of the lock of the orchestrators, so an orchestrator that has
lost the lock grants and renews nothing.
"""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.exc import DBAPIError

from handover.database import LockLost
from handover.database.outage import database_reason
from handover.errors import Problem
from handover.tasks.device_lease import boot_time_s
from handover.telemetry import get_logger
from handover_processes.storage import device_leases as table
from handover_processes.storage.device_leases import LeaseHolder, StoredLease
from handover_processes.storage.store import Store

log = get_logger(__name__)


OnDisk = Callable[..., Awaitable[Any]]
"""Runs a blocking function, with its arguments, in the thread of the database."""


@dataclass(frozen=True, slots=True)
class LeaseAnswer:
    """The lease of a Device after a request: granted to the caller, or held by `lease.holder`."""

    lease: StoredLease
    is_granted: bool
    ends_in_s: float
    is_new: bool = False


class DeviceLeases:
    """Grants, renews and releases leases; `open` comes first.

    Before a lease is granted or renewed, `may_lease` is awaited, which raises `Problem` if that must not be.
    """

    def __init__(
        self,
        store: Store,
        on_disk: OnDisk,
        may_lease: Callable[[], Awaitable[None]],
        *,
        clock: Callable[[], float] = boot_time_s,
    ) -> None:
        self._store = store
        self._on_disk = on_disk
        self._may_lease = may_lease
        self._clock = clock
        self._ends_s: dict[tuple[str, int], float] = {}
        """When a lease ends, by Device and number."""
        self._known: dict[str, StoredLease] = {}
        self._turn = asyncio.Lock()

    async def open(self) -> None:
        """Create the table, and count all stored leases from now."""
        await self._on_disk(table.prepare, self._store.engine)
        for lease in (await self._on_disk(self._read_all)).values():
            self._note(lease)

    async def acquire(
        self, devices: Sequence[str], holder: LeaseHolder, duration_s: float
    ) -> list[LeaseAnswer]:
        """Grant or renew the leases of `devices`, as far as nobody else has them.

        A new session of the same holder replaces the session before it. Raises `Problem` 503 if the database
        cannot be used, if another orchestrator uses it, or if another cell has the name of this one.
        """
        await self._may_lease()
        async with self._turn:
            answers: list[LeaseAnswer] = await self._write(self._acquire, devices, holder, duration_s)
            end_s = self._clock() + duration_s
            for answer in answers:
                if answer.is_granted:
                    self._note(answer.lease, end_s)
                if answer.is_new:
                    log.info(
                        "device leased",
                        device=answer.lease.device,
                        number=answer.lease.number,
                        performer=holder.performer,
                        pid=holder.pid,
                        host=holder.host,
                    )
            return answers

    async def release(self, devices: Sequence[str], holder: str, session: str) -> None:
        """End the leases that a session has. Raises `Problem` 503 as `acquire`."""
        async with self._turn:
            for lease in await self._write(self._release, devices, holder, session):
                self._note(lease)

    def all(self) -> list[tuple[StoredLease, float]]:
        """Return all leases with the time until each ends; 0 for those that have ended."""
        return [(lease, self._remaining_s(lease)) for _, lease in sorted(self._known.items())]

    def unheld(self) -> dict[str, float]:
        """Return the Devices of which nobody has the lease now, though somebody had; and for how many s."""
        now_s = self._clock()
        ends = ((device, self._ends_s[device, lease.number]) for device, lease in self._known.items())
        return {device: now_s - end_s for device, end_s in ends if end_s <= now_s}

    def last(self, device: str) -> StoredLease | None:
        """Return the last lease of a Device."""
        return self._known.get(device)

    def _remaining_s(self, lease: StoredLease) -> float:
        return max(self._ends_s[lease.device, lease.number] - self._clock(), 0.0)

    def _note(self, lease: StoredLease, ends_s: float | None = None) -> None:
        """Remember a lease; one that is not known counts from now."""
        holder = self._known.get(lease.device)
        if holder is not None and holder.number != lease.number:
            self._ends_s.pop((lease.device, holder.number), None)
        key = lease.device, lease.number
        now_s = self._clock()
        if ends_s is not None:
            self._ends_s[key] = ends_s
        elif lease.is_released:
            self._ends_s[key] = min(self._ends_s.get(key, now_s), now_s)
        else:
            self._ends_s.setdefault(key, now_s + lease.duration_s)
        self._known[lease.device] = lease

    async def _write(self, act: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return await self._on_disk(act, *arguments)
        except (DBAPIError, LockLost) as error:
            reason = database_reason(error)
            raise Problem(503, "Not leased", f"the leases cannot be stored: {reason}") from error

    def _read_all(self) -> dict[str, StoredLease]:
        with self._store.engine.connect() as connection:
            return table.leases_of(connection)

    def _acquire(self, devices: Sequence[str], holder: LeaseHolder, duration_s: float) -> list[LeaseAnswer]:
        with self._store.lock.transaction() as connection:
            stored = table.leases_of(connection, devices)
            for lease in stored.values():
                self._note(lease)
            answers = []
            for device in devices:
                before = stored.get(device)
                remaining_s = 0.0 if before is None else self._remaining_s(before)
                is_free = before is None or before.is_released or remaining_s <= 0
                if before is not None and not is_free and before.holder.holder != holder.holder:
                    answers.append(LeaseAnswer(before, is_granted=False, ends_in_s=remaining_s))
                    continue
                if before is not None and not is_free and before.holder.session == holder.session:
                    answers.append(LeaseAnswer(before, is_granted=True, ends_in_s=duration_s))
                    continue
                number = 1 if before is None else before.number + 1
                since = datetime.now(UTC).isoformat(timespec="seconds")
                lease = StoredLease(device, number, holder, duration_s, since, is_released=False)
                table.store(connection, lease, is_new=before is None)
                answers.append(LeaseAnswer(lease, is_granted=True, ends_in_s=duration_s, is_new=True))
            return answers

    def _release(self, devices: Sequence[str], holder: str, session: str) -> list[StoredLease]:
        with self._store.lock.transaction() as connection:
            released = []
            for lease in table.leases_of(connection, devices).values():
                if (lease.holder.holder, lease.holder.session) == (holder, session):
                    released.append(replace(lease, is_released=True))
                    table.store(connection, released[-1], is_new=False)
            return released
