"""The store of rules and of what their watches have found. Every function blocks on the database."""

from collections.abc import Iterable
from typing import NamedTuple

from sqlalchemy import Connection, Engine, delete, insert, select

from handover_devices.storage import tables


class WatchRow(NamedTuple):
    """The state of a rule for one value of one device; times are microseconds since 1970."""

    rule: str
    device: str
    name: str
    is_on: int
    reported: int
    changed_us: int
    measured: float | None
    limit_value: float | None
    process_us: int | None
    learned: str | None


def rules(engine: Engine) -> dict[str, str]:
    """Return the rules as JSON, by name."""
    with engine.connect() as connection:
        return {row.name: row.rule for row in connection.execute(select(tables.rules))}


def save_rule(connection: Connection, name: str, rule: str | None, now_us: int) -> None:
    """Write a rule; None deletes it."""
    connection.execute(delete(tables.rules).where(tables.rules.c.name == name))
    if rule is not None:
        connection.execute(insert(tables.rules).values(name=name, rule=rule, updated_us=now_us))


def watches(engine: Engine) -> list[WatchRow]:
    """Return the state of all watches."""
    with engine.connect() as connection:
        return [WatchRow(**row) for row in connection.execute(select(tables.watches)).mappings()]


def save_watches(connection: Connection, rows: Iterable[WatchRow]) -> None:
    """Write the state of watches."""
    written = list(rows)
    for row in written:
        remove_watch(connection, row.rule, row.device, row.name)
    if written:
        connection.execute(insert(tables.watches), [row._asdict() for row in written])


def remove_watch(connection: Connection, rule: str, device: str, name: str) -> None:
    """Delete the state of a watch."""
    table = tables.watches.c
    here = (table.rule == rule) & (table.device == device) & (table.name == name)
    connection.execute(delete(tables.watches).where(here))
