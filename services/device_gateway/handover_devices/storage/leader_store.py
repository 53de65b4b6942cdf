"""The leader of several replicas on one PostgreSQL database: where the others reach it, and in which term.

Each leader begins a term. Commands are written in a transaction that has looked at the term. So a process
that has not noticed yet that another one leads writes none, and sends none: a command is durable before it is
sent. Every function blocks on the database.
"""

from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection, Engine, delete, insert, select
from sqlalchemy.exc import SQLAlchemyError

from handover_devices.storage import tables

_ONLY: Final = 1


@dataclass(frozen=True, slots=True)
class Leader:
    """Where a leader is; `tls_name` is the name in the certificates of its ports, empty without TLS.

    `token` is made for the term: a replica shows it to the leader.
    """

    host: str
    device_port: int
    rest_port: int
    tls_name: str
    token: str


class Deposed(SQLAlchemyError):
    """Another process leads by now."""


def begin_term(connection: Connection, leader: Leader) -> int:
    """Store where the leader is; return the number of its term."""
    table = tables.leader
    before = connection.execute(select(table.c.term).with_for_update()).scalar()
    term = (before or 0) + 1
    connection.execute(delete(table))
    connection.execute(
        insert(table).values(
            id=_ONLY,
            term=term,
            host=leader.host,
            device_port=leader.device_port,
            rest_port=leader.rest_port,
            tls_name=leader.tls_name,
            token=leader.token,
        )
    )
    return int(term)


def find(engine: Engine) -> Leader | None:
    """Return where the leader is, or was when it began; None before the first one."""
    with engine.connect() as connection:
        row = connection.execute(select(tables.leader)).mappings().first()
    if row is None:
        return None
    return Leader(**{name: row[name] for name in Leader.__dataclass_fields__})


def require_term(connection: Connection, term: int) -> None:
    """Let no other term begin before the end of this transaction; raise `Deposed` if one has begun."""
    query = select(tables.leader.c.term).where(tables.leader.c.term == term).with_for_update(read=True)
    if connection.execute(query).first() is None:
        raise Deposed("another process leads the device gateways")
