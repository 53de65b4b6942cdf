"""The store: channels, routes, the steps that were taken, and the messages. Every function blocks."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from sqlalchemy import Connection, Engine, delete, func, insert, select, update

from handover_alerts.storage import tables

WAITING: Final = "waiting"
SENT: Final = "sent"
FAILED: Final = "failed"


@dataclass(frozen=True, slots=True)
class Message:
    """A message in the log; `id` is None before it is stored."""

    alert: str
    route: str
    step: str
    channel: str
    subject: str
    body: str
    created_us: int
    id: int | None = None
    state: str = WAITING
    attempts: int = 0
    ended_us: int | None = None
    error: str | None = None


Transaction = Callable[[], AbstractContextManager[Connection]]


class Store:
    """Reads and writes the database. Steps and messages are written in transactions of the leader."""

    def __init__(self, engine: Engine, transaction: Transaction | None = None) -> None:
        self._engine = engine
        self._transaction = transaction or engine.begin

    def configuration(self) -> tuple[dict[str, str], dict[str, str]]:
        """Return channels and routes as JSON, by name."""
        with self._engine.connect() as connection:
            return (
                {row.name: row.channel for row in connection.execute(select(tables.channels))},
                {row.name: row.route for row in connection.execute(select(tables.routes))},
            )

    def save_channel(self, name: str, channel: str | None) -> None:
        """Write a channel; None deletes it."""
        with self._engine.begin() as connection:
            connection.execute(delete(tables.channels).where(tables.channels.c.name == name))
            if channel is not None:
                connection.execute(insert(tables.channels).values(name=name, channel=channel))

    def save_route(self, name: str, route: str | None) -> None:
        """Write a route; None deletes it."""
        with self._engine.begin() as connection:
            connection.execute(delete(tables.routes).where(tables.routes.c.name == name))
            if route is not None:
                connection.execute(insert(tables.routes).values(name=name, route=route))

    def steps(self) -> dict[tuple[str, int], dict[str, datetime]]:
        """Return when each step was taken, by Alert and time of issue."""
        taken: dict[tuple[str, int], dict[str, datetime]] = {}
        with self._engine.connect() as connection:
            for row in connection.execute(select(tables.steps)):
                at = datetime.fromtimestamp(row.taken_us / 1e6, UTC)
                taken.setdefault((row.alert, row.issued_us), {})[row.step] = at
        return taken

    def take(self, alert: str, issued_us: int, step: str, taken_us: int, messages: Iterable[Message]) -> None:
        """Store that a step was taken, with its messages, in one transaction."""
        rows = [_values(entry) for entry in messages]
        with self._transaction() as connection:
            connection.execute(
                insert(tables.steps).values(alert=alert, issued_us=issued_us, step=step, taken_us=taken_us)
            )
            if rows:
                connection.execute(insert(tables.messages), rows)

    def add(self, message: Message) -> int:
        """Store a message and return its number."""
        with self._engine.begin() as connection:
            made = connection.execute(insert(tables.messages).values(_values(message)))
            return int(made.inserted_primary_key[0]) if made.inserted_primary_key else 0

    def waiting(self, channel: str, limit: int) -> list[Message]:
        """Return messages of a channel that wait, oldest first."""
        table = tables.messages
        query = (
            select(table)
            .where((table.c.state == WAITING) & (table.c.channel == channel))
            .order_by(table.c.id)
            .limit(limit)
        )
        with self._engine.connect() as connection:
            return [Message(**row) for row in connection.execute(query).mappings()]

    def waiting_channels(self) -> dict[str, int]:
        """Return how many messages wait, by channel."""
        table = tables.messages
        query = (
            select(table.c.channel, func.count()).where(table.c.state == WAITING).group_by(table.c.channel)
        )
        with self._engine.connect() as connection:
            return {row[0]: int(row[1]) for row in connection.execute(query)}

    def sent_since(self, channel: str, since_us: int, limit: int) -> list[float]:
        """Return when the newest messages were sent to a channel, in seconds, oldest first.

        Messages that were sent together have the same time, and count once.
        """
        table = tables.messages
        query = (
            select(table.c.ended_us)
            .where((table.c.channel == channel) & (table.c.state == SENT) & (table.c.ended_us > since_us))
            .distinct()
            .order_by(table.c.ended_us.desc())
            .limit(limit)
        )
        with self._engine.connect() as connection:
            return [ended_us / 1e6 for ended_us in reversed(connection.execute(query).scalars().all())]

    def mark(self, numbers: Sequence[int], state: str, now_us: int, error: str | None = None) -> None:
        """Store what became of an attempt to send messages."""
        table = tables.messages
        ended = None if state == WAITING else now_us
        with self._transaction() as connection:
            connection.execute(
                update(table)
                .where(table.c.id.in_(numbers))
                .values(state=state, attempts=table.c.attempts + 1, ended_us=ended, error=error)
            )

    def log(
        self,
        *,
        before: int | None = None,
        limit: int = 100,
        alert: str | None = None,
        state: str | None = None,
    ) -> list[Message]:
        """Return messages, newest first."""
        table = tables.messages
        query = select(table).order_by(table.c.id.desc()).limit(limit)
        if before is not None:
            query = query.where(table.c.id < before)
        if alert is not None:
            query = query.where(table.c.alert == alert)
        if state is not None:
            query = query.where(table.c.state == state)
        with self._engine.connect() as connection:
            return [Message(**row) for row in connection.execute(query).mappings()]

    def message(self, number: int) -> Message | None:
        """Return one message."""
        with self._engine.connect() as connection:
            query = select(tables.messages).where(tables.messages.c.id == number)
            row = connection.execute(query).mappings().first()
        return None if row is None else Message(**row)

    def delete_old(self, before_us: int, active: Iterable[tuple[str, int]]) -> None:
        """Delete messages that ended before a time, and the steps of occurrences that are not `active`."""
        kept = set(active)
        with self._engine.begin() as connection:
            table = tables.messages
            connection.execute(
                delete(table).where((table.c.state != WAITING) & (table.c.ended_us < before_us))
            )
            step = tables.steps.c
            query = select(step.alert, step.issued_us).where(step.taken_us < before_us).distinct()
            for row in connection.execute(query).all():
                if (row.alert, row.issued_us) not in kept:
                    _delete_steps(connection, row.alert, row.issued_us)


def _delete_steps(connection: Connection, alert: str, issued_us: int) -> None:
    here = (tables.steps.c.alert == alert) & (tables.steps.c.issued_us == issued_us)
    connection.execute(delete(tables.steps).where(here))


def _values(message: Message) -> dict[str, Any]:
    return {
        "alert": message.alert,
        "route": message.route,
        "step": message.step,
        "channel": message.channel,
        "subject": message.subject,
        "body": message.body,
        "created_us": message.created_us,
        "state": message.state,
        "attempts": message.attempts,
    }
