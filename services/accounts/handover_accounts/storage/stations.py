"""Stations: a screen with gloves, signed in by an engineer, that people join and leave.

A station is an account without a password. Its session acts with the grants of the station, in the name of
the person who has joined. Joining identifies a person and gives no right: what is done at a station is done
with the rights of the station, and the audit names the method.
"""

import json
import time
from typing import Any

from sqlalchemy import Connection, delete, insert, select, update

from handover.errors import Problem
from handover_accounts.storage.changes import Change
from handover_accounts.storage.tables import joins, stations, users
from handover_accounts.storage.users import add_user, checked_name, find, renew_sessions_of


def add_station(change: Change, name: str, gloves: list[str], leave_after_min: float) -> str:
    """Add a station and return its subject. Raises `Problem` 409 for a glove of another station."""
    for row in change.connection.execute(select(stations)).mappings():
        if shared := set(gloves) & set(json.loads(row["gloves"])):
            raise Problem(409, "Glove in use", f"{', '.join(sorted(shared))} belongs to another station")
    subject = add_user(change, checked_name(name), None)
    change.connection.execute(
        insert(stations).values(
            subject=subject, gloves=json.dumps(sorted(set(gloves))), leave_after_s=leave_after_min * 60
        )
    )
    change.record("station.added", subject, text=", ".join(sorted(set(gloves))))
    return subject


def station_of(connection: Connection, subject: str) -> dict[str, Any] | None:
    """Return the station with that subject, if it is one."""
    row = connection.execute(select(stations).where(stations.c.subject == subject)).mappings().first()
    return None if row is None else {**row, "gloves": json.loads(row["gloves"])}


def require_station(connection: Connection, subject: str) -> dict[str, Any]:
    """Return a station; raise `Problem` 409 for any other caller."""
    station = station_of(connection, subject)
    if station is None:
        raise Problem(409, "No station", "this screen is not signed in as a station; an engineer does that")
    return station


def station_with(connection: Connection, glove: str) -> str | None:
    """Return the subject of the station that has a glove."""
    for row in connection.execute(select(stations)).mappings():
        if glove in json.loads(row["gloves"]):
            return str(row["subject"])
    return None


def joined(connection: Connection, station: str) -> dict[str, Any] | None:
    """Return the person who has joined a station: `subject`, `name`, `person`, `method`, `joined_s`."""
    tables = joins.join(users, users.c.subject == joins.c.subject).join(
        stations, stations.c.subject == joins.c.station
    )
    query = select(
        joins.c.subject,
        joins.c.method,
        joins.c.joined_s,
        joins.c.seen_s,
        stations.c.leave_after_s,
        users.c.name,
        users.c.person,
    ).select_from(tables)
    row = connection.execute(query.where(joins.c.station == station)).mappings().first()
    if row is None or row["seen_s"] + row["leave_after_s"] <= time.time():
        return None
    return dict(row)


def join(change: Change, station: str, subject: str, method: str) -> None:
    """Let a person join a station, in place of the one who had. Raises `Problem` 409 for a station."""
    if station_of(change.connection, subject) is not None:
        raise Problem(409, "No person", "a station cannot join a station")
    find(change.connection, subject)
    leave(change, station, "next")
    now_s = time.time()
    elsewhere = select(joins.c.station).where(joins.c.subject == subject)
    for other in list(change.connection.execute(elsewhere).scalars()):
        leave(change, other, "elsewhere")
    change.connection.execute(
        insert(joins).values(station=station, subject=subject, method=method, joined_s=now_s, seen_s=now_s)
    )
    renew_sessions_of(change, station)
    change.record("station.joined", station, text=method)


def leave(change: Change, station: str, reason: str) -> None:
    """Let the person leave who has joined a station; has no effect without one."""
    subject = change.connection.execute(select(joins.c.subject).where(joins.c.station == station)).scalar()
    change.is_recorded = True
    if subject is None:
        return
    change.connection.execute(delete(joins).where(joins.c.station == station))
    renew_sessions_of(change, station)
    change.record("station.left", station, text=f"{subject}: {reason}")


def stay(connection: Connection, station: str) -> None:
    """Note that the person who has joined is there."""
    connection.execute(update(joins).where(joins.c.station == station).values(seen_s=time.time()))


def leave_by_time(change: Change) -> None:
    """Let everybody leave who was not seen for the time of the station."""
    query = select(joins.c.station).join(stations, stations.c.subject == joins.c.station)
    due = joins.c.seen_s + stations.c.leave_after_s <= time.time()
    change.is_recorded = True
    for station in list(change.connection.execute(query.where(due)).scalars()):
        leave(change, station, "time")


def has_due(connection: Connection) -> bool:
    """Return whether somebody has to leave by time."""
    query = select(joins.c.station).join(stations, stations.c.subject == joins.c.station)
    due = joins.c.seen_s + stations.c.leave_after_s <= time.time()
    return connection.execute(query.where(due).limit(1)).scalar() is not None
