"""The table of the leases of Devices: who has each, and its fencing number, which only grows."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from sqlalchemy import (
    Boolean,
    Column,
    Connection,
    Engine,
    Float,
    Integer,
    MetaData,
    String,
    Table,
    insert,
    select,
    update,
)

from handover.database import migrations

_meta = MetaData()
device_leases = Table(
    "orchestrator_device_leases",
    _meta,
    Column("device", String(2000), primary_key=True),
    Column("number", Integer, nullable=False),
    Column("holder", String(100), nullable=False),
    Column("session", String(100), nullable=False),
    Column("performer", String(300), nullable=False),
    Column("host", String(300), nullable=False),
    Column("pid", Integer, nullable=False),
    Column("duration_s", Float, nullable=False),
    Column("since", String(40), nullable=False),
    Column("is_released", Boolean, nullable=False),
)
_VERSION = 1


@dataclass(frozen=True, slots=True)
class LeaseHolder:
    """A process that acts for Devices.

    `holder` is its durable identity, `session` that of this run of it; the rest is for people.
    """

    holder: str
    session: str
    performer: str
    host: str
    pid: int


@dataclass(frozen=True, slots=True)
class StoredLease:
    """The last lease of a Device."""

    device: str
    number: int
    holder: LeaseHolder
    duration_s: float
    since: str
    is_released: bool


def prepare(engine: Engine) -> None:
    """Create the table, or bring it to the version of this release."""
    migrations.migrate(engine, _meta, component="orchestrator_leases", version=_VERSION)


def leases_of(connection: Connection, devices: Iterable[str] | None = None) -> dict[str, StoredLease]:
    """Return the last lease of each of the Devices, of all without an argument."""
    query = select(device_leases)
    if devices is not None:
        query = query.where(device_leases.c.device.in_(list(devices)))
    return {row.device: _to_lease(row) for row in connection.execute(query)}


def store(connection: Connection, lease: StoredLease, *, is_new: bool) -> None:
    """Write a lease."""
    values: dict[str, Any] = {
        "number": lease.number,
        "holder": lease.holder.holder,
        "session": lease.holder.session,
        "performer": lease.holder.performer,
        "host": lease.holder.host,
        "pid": lease.holder.pid,
        "duration_s": lease.duration_s,
        "since": lease.since,
        "is_released": lease.is_released,
    }
    if is_new:
        connection.execute(insert(device_leases).values(device=lease.device, **values))
    else:
        connection.execute(
            update(device_leases).where(device_leases.c.device == lease.device).values(**values)
        )


def _to_lease(row: Any) -> StoredLease:
    holder = LeaseHolder(row.holder, row.session, row.performer, row.host, row.pid)
    return StoredLease(row.device, row.number, holder, row.duration_s, row.since, row.is_released)
