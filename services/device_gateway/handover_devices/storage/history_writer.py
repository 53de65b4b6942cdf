"""The history writer: writes messages, values and commands in groups, one transaction at a time.

How it works: `add` appends rows and returns a future. One task takes all rows that wait, and one thread
writes them in one transaction; rows that arrive meanwhile form the next group. So the disk is synchronized
once for each group and not for each message. When the future is done, the rows survive `kill -9`.

While the database cannot be written, rows wait and the writing is repeated with backoff. `is_full` is True
from `MAX_WAITING_ROWS` on: the connections stop reading then, so memory is bounded, and nothing is lost that
was acknowledged.

A value is identified by its series and time, and is not written twice: a device that repeats its telemetry
after a broken connection does no harm.
"""

import asyncio
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, TypeVar

from sqlalchemy import Connection, Engine, Table, delete, select
from sqlalchemy.exc import SQLAlchemyError

from handover.database.outage import database_reason
from handover.errors import Problem
from handover.runtime.retry import Backoff
from handover.security.audit_trail import AuditedRequest, current_request, record_request
from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.storage import leader_store, partitions, tables
from handover_devices.storage.outbox import MessageQueue, RelayRow
from handover_devices.storage.partitions import DAY_US

log = get_logger(__name__)

MAX_WAITING_ROWS: Final = 50_000
GROUP_S: Final = 0.02
"""Time from a group to the next: rows that come when none was written lately are written at once."""
URGENT_S: Final = 0.004
"""The same, when a request waits."""

T = TypeVar("T")
Row = tuple[Any, ...]


class MessageRow(NamedTuple):
    """A row of the message log."""

    device: str
    at_us: int
    direction: str
    type: str
    body: str
    answer: str | None


class CommandRow(NamedTuple):
    """A row of a command: inserted, or replaced."""

    device: str
    id: str
    name: str
    kind: str
    parameters: str
    created_us: int
    deadline_us: int
    state: str
    progress: float | None
    result: str | None
    reason: str | None
    boot: str | None
    reason_message: str | None = None
    """Code and parameters of the reason, as JSON."""


class EdgeMark(NamedTuple):
    """The last number that was received in the stream of an edge."""

    edge: str
    stream: str
    seq: int


@dataclass(slots=True)
class _Group:
    messages: list[Row] = field(default_factory=list)
    values: list[tuple[str, str, int, float]] = field(default_factory=list)
    commands: dict[tuple[str, str], Row] = field(default_factory=dict)
    relays: list[RelayRow] = field(default_factory=list)
    marks: dict[str, EdgeMark] = field(default_factory=dict)
    requests: list[AuditedRequest] = field(default_factory=list)
    done: "asyncio.Future[None] | None" = None

    def __len__(self) -> int:
        return len(self.messages) + len(self.values) + len(self.commands) + len(self.relays)


class HistoryWriter:
    """Writes rows in groups; run `run` as a task. `on_room` is called when it is no longer full.

    `on_relays` is called when messages of the outbox of an edge were written.
    """

    def __init__(
        self, engine: Engine, on_room: Callable[[], None] = lambda: None, outbox: MessageQueue | None = None
    ) -> None:
        self.on_room = on_room
        self.on_relays: Callable[[], None] = lambda: None
        self.outbox = outbox
        self.term: int | None = None
        """The term in which this process leads; without one commands are written unconditionally."""
        self._engine = engine
        self._thread = ThreadPoolExecutor(1, "device-writer")
        self._waiting = self._group = _Group()
        self._writing = 0
        self._has_waiting = asyncio.Event()
        self._is_urgent = asyncio.Event()
        self._series: dict[tuple[str, str], int] = {}
        self._is_sqlite = engine.dialect.name == "sqlite"
        self._days: set[int] = set()
        """Days whose partition exists, if values are partitioned."""
        self._insert_message = self._insert(tables.messages, MessageRow._fields)
        self._insert_value = self._insert(tables.values, ("series", "t_us", "value"), "DO NOTHING")
        changing = ", ".join(
            f"{name} = excluded.{name}"
            for name in ("deadline_us", "state", "progress", "result", "reason", "boot", "reason_message")
        )
        self._write_mark = self._insert(
            tables.edge_marks,
            EdgeMark._fields,
            "(edge) DO UPDATE SET stream = excluded.stream, seq = excluded.seq "
            "WHERE device_edge_mark.stream <> excluded.stream OR device_edge_mark.seq < excluded.seq",
        )
        self._write_command = self._insert(
            tables.commands, CommandRow._fields, f"(device, id) DO UPDATE SET {changing}"
        )

    @property
    def is_full(self) -> bool:
        """Whether nothing more should be added for now."""
        return len(self._waiting) + self._writing >= MAX_WAITING_ROWS

    def add(
        self,
        messages: Sequence[MessageRow] = (),
        values: Sequence[tuple[str, str, int, float]] = (),
        commands: Sequence[CommandRow] = (),
        relays: Sequence[RelayRow] = (),
        marks: Sequence[EdgeMark] = (),
        *,
        requested: AuditedRequest | None = None,
    ) -> "asyncio.Future[None]":
        """Write rows soon; the future is done when they are durable. Values: device, name, t_us, value.

        What was `requested` is recorded in the same transaction, and is written sooner: a caller waits.
        """
        group = self._waiting
        group.messages.extend(messages)
        group.values.extend(values)
        for command in commands:
            group.commands[command.device, command.id] = command
        group.relays.extend(relays)
        group.marks.update((mark.edge, mark) for mark in marks)
        if requested is not None:
            group.requests.append(requested)
            self._is_urgent.set()
        if group.done is None:
            group.done = asyncio.get_running_loop().create_future()
        self._has_waiting.set()
        return group.done

    async def run(self) -> None:
        """Write until cancelled."""
        while True:
            await self._has_waiting.wait()
            self._is_urgent.clear()
            await self._write_waiting()
            await asyncio.sleep(URGENT_S)
            with suppress(TimeoutError):
                async with asyncio.timeout(GROUP_S - URGENT_S):
                    await self._is_urgent.wait()

    async def close(self) -> None:
        """Write what waits, once, and end the thread."""
        if len(self._waiting):
            try:
                await self._on_thread(self._write, self._waiting)
            except SQLAlchemyError:
                log.exception("rows lost at the end", rows=len(self._waiting))
            else:
                self._finish(self._waiting)
        self._thread.shutdown(wait=False)

    async def call(self, act: Callable[[Connection], T]) -> T:
        """Run `act` in a transaction on the writing thread; raise `Problem` 503 if the database refuses."""

        requested = current_request()

        def transaction() -> T:
            with self._engine.begin() as connection:
                result = act(connection)
                if requested is not None:
                    record_request(connection, requested)
                return result

        try:
            return await self._on_thread(transaction)
        except SQLAlchemyError as error:
            raise unavailable(error) from None

    async def call_beside(self, act: Callable[[Connection], T]) -> T:
        """Run `act` in a transaction on another thread, while rows are written; raise `Problem` 503."""

        def transaction() -> T:
            with self._engine.begin() as connection:
                return act(connection)

        try:
            return await asyncio.to_thread(transaction)
        except SQLAlchemyError as error:
            raise unavailable(error) from None

    def discard_commands(self) -> None:
        """Write no command that waits: another process leads, and has read what was written."""
        for group in (self._group, self._waiting):
            group.commands, group.requests = {}, []

    def forget(self, device: str) -> None:
        """Forget the series of a device that was deleted."""
        for key in [key for key in self._series if key[0] == device]:
            del self._series[key]

    async def _write_waiting(self) -> None:
        group, self._waiting = self._waiting, _Group()
        self._group = group
        self._has_waiting.clear()
        self._writing = len(group)
        metrics.BACKLOG.set(self._writing)
        was_full = self.is_full
        backoff = Backoff()
        while True:
            started_s = time.monotonic()
            try:
                await self._on_thread(self._write, group)
            except SQLAlchemyError as error:
                log.warning("history not written", rows=len(group), error=str(error).splitlines()[0])
                await backoff.wait()
            else:
                break
        metrics.COMMIT.observe(time.monotonic() - started_s)
        metrics.VALUES.inc(len(group.values))
        self._writing = 0
        self._finish(group)
        if group.relays:
            self.on_relays()
        if was_full:
            self.on_room()

    @staticmethod
    def _finish(group: _Group) -> None:
        if group.done is not None and not group.done.done():
            group.done.set_result(None)

    async def _on_thread(self, act: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, act, *arguments)

    def _write(self, group: _Group) -> None:
        new = {key for device, name, _, _ in group.values if (key := (device, name)) not in self._series}
        days = set() if self._is_sqlite else {t_us // DAY_US for _, _, t_us, _ in group.values} - self._days
        try:
            with self._engine.begin() as connection:
                self._number(connection, new)
                partitions.ensure(connection, days)
                if group.messages:
                    connection.exec_driver_sql(self._insert_message, group.messages)
                if group.values:
                    series = self._series
                    rows = [(series[device, name], t_us, value) for device, name, t_us, value in group.values]
                    rows.sort()  # neighbours in the table are written together
                    connection.exec_driver_sql(self._insert_value, rows)
                if group.commands:
                    if self.term is not None:
                        leader_store.require_term(connection, self.term)
                    connection.exec_driver_sql(self._write_command, list(group.commands.values()))
                for request in group.requests:
                    record_request(connection, request)
                if group.marks:
                    connection.exec_driver_sql(self._write_mark, list(group.marks.values()))
                if group.relays and self.outbox is not None:
                    self.outbox.append(connection, group.relays)
        except BaseException:
            for key in new:
                self._series.pop(key, None)
            self._days.clear()  # the retention may have dropped one of them
            raise
        self._days |= days
        if group.relays and self.outbox is not None:
            self.outbox.committed()

    def _number(self, connection: Connection, names: set[tuple[str, str]]) -> None:
        """Read or create the numbers of series."""
        for device, name in sorted(names):
            here = (tables.series.c.device == device) & (tables.series.c.name == name)
            number = connection.execute(select(tables.series.c.id).where(here)).scalar()
            if number is None:
                made = connection.execute(tables.series.insert().values(device=device, name=name))
                number = made.inserted_primary_key[0] if made.inserted_primary_key else None
            assert number is not None  # noqa: S101 - the database numbers each row
            self._series[device, name] = int(number)

    def _insert(self, table: Table, columns: Sequence[str], on_conflict: str = "") -> str:
        mark = "?" if self._is_sqlite else "%s"
        conflict = f" ON CONFLICT {on_conflict}" if on_conflict else ""
        names, marks = ", ".join(columns), ", ".join([mark] * len(columns))
        return f"INSERT INTO {table.name} ({names}) VALUES ({marks}){conflict}"  # noqa: S608 - our own names


def delete_history(connection: Connection, device: str) -> None:
    """Delete all that is stored of a device except its registration."""
    theirs = select(tables.series.c.id).where(tables.series.c.device == device)
    for table in (tables.values, tables.minutes, tables.hours):
        connection.execute(delete(table).where(table.c.series.in_(theirs)))
    for table in (tables.series, tables.messages, tables.commands, tables.files):
        connection.execute(delete(table).where(table.c.device == device))


def unavailable(error: SQLAlchemyError) -> Problem:
    """Return the answer to a request that the database did not carry out."""
    reason = database_reason(error)
    return Problem.translated(
        503,
        "Database unavailable",
        "device.database_refused",
        "nothing was changed: the database refused it ({reason}); try again later",
        reason=reason,
    )
