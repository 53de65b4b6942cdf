"""The outbox of an edge: messages of its devices until the centre has acknowledged them.

A message is numbered and stored in the transaction of the history, before the device gets its
acknowledgement; it is deleted when the centre has acknowledged its number. The numbers of a database never
repeat, and belong to a `stream`: the centre remembers the last number of the stream that it has stored, and
ignores what arrives again. A database that was restored from a backup begins another stream.

The size is bounded: when it is full the oldest messages are deleted and counted.
"""

from collections.abc import Sequence
from secrets import token_hex
from typing import Final, NamedTuple, Protocol

from sqlalchemy import Connection, Engine, delete, func, insert, select, update

from handover_devices.storage import tables

ROW_BYTES: Final = 64
"""What a row takes beside its message."""
TRIM_FRACTION: Final = 0.02
"""How much is deleted beyond what is necessary, so that a full outbox is not trimmed for each message."""
TRIM_ROWS: Final = 1_000


class RelayRow(NamedTuple):
    """A message to relay: the device, when it was received, and the line."""

    device: str
    at_us: int
    body: str


class StoredRow(NamedTuple):
    """A message of the outbox with its number."""

    seq: int
    device: str
    body: str


class MessageQueue(Protocol):
    """Messages that wait for another gateway. What takes a connection runs on the writing thread."""

    stream: str

    @property
    def waiting(self) -> int:
        """How many messages wait."""
        ...

    def append(self, connection: Connection, rows: Sequence[RelayRow]) -> None:
        """Add messages, once their transaction is committed."""

    def committed(self) -> None:
        """The transaction of `append` is committed."""

    def acknowledge(self, connection: Connection, seq: int) -> None:
        """Delete the messages up to a number."""

    def count(self, connection: Connection) -> None:
        """Count the messages after a transaction that failed."""

    def note_refused(self, connection: Connection, count: int) -> None:
        """Count messages that the other side has refused."""

    def begin_stream(self, connection: Connection) -> None:
        """Begin another stream."""

    def read(self, after: int, limit: int) -> list[StoredRow]:
        """Return the oldest messages with a number above `after`."""
        ...

    def last(self) -> int:
        """Return the greatest number that was given, 0 at first."""
        ...


class Outbox:
    """The messages that wait. What takes a connection runs on the writing thread, in its transactions."""

    def __init__(self, engine: Engine, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self.stream = ""
        self.rows = self.bytes = self.dropped = self.refused = 0
        self._engine = engine
        self._change = (0, 0, 0)
        """Rows, bytes and dropped rows of the transaction that is not committed yet."""

    @property
    def waiting(self) -> int:
        """How many messages wait."""
        return self.rows

    def load(self) -> None:
        """Read the state; begin a stream in a new database. Blocks on the database."""
        with self._engine.begin() as connection:
            state = connection.execute(select(tables.outbox_state)).first()
            if state is None:
                self.stream = token_hex(16)
                new = {"id": 1, "stream": self.stream, "dropped": 0, "refused": 0}
                connection.execute(insert(tables.outbox_state).values(new))
            else:
                self.stream, self.dropped, self.refused = state.stream, state.dropped, state.refused
            self.count(connection)

    def count(self, connection: Connection) -> None:
        """Count the messages, at the start and after a transaction that failed."""
        size = func.coalesce(func.sum(tables.outbox.c.size), 0)
        self.rows, self.bytes = map(int, connection.execute(select(func.count(), size)).one())

    def append(self, connection: Connection, rows: Sequence[RelayRow]) -> None:
        """Store messages; delete the oldest if there are too many."""
        sizes = [len(row.body.encode()) + ROW_BYTES for row in rows]
        connection.execute(
            insert(tables.outbox),
            [{**row._asdict(), "size": size} for row, size in zip(rows, sizes, strict=True)],
        )
        excess = self.bytes + sum(sizes) - self.max_bytes
        dropped = freed = 0
        if excess > 0:
            dropped, freed = self._trim(connection, excess + int(self.max_bytes * TRIM_FRACTION))
        self._change = (len(rows) - dropped, sum(sizes) - freed, dropped)

    def committed(self) -> None:
        """Count what the transaction of `append` has changed."""
        rows, size, dropped = self._change
        self._change = (0, 0, 0)
        self.rows, self.bytes, self.dropped = self.rows + rows, self.bytes + size, self.dropped + dropped

    def acknowledge(self, connection: Connection, seq: int) -> None:
        """Delete the messages up to a number."""
        table = tables.outbox
        old = table.c.seq <= seq
        gone, size = connection.execute(select(func.count(), func.sum(table.c.size)).where(old)).one()
        connection.execute(delete(table).where(old))
        self.rows -= int(gone)
        self.bytes -= int(size or 0)

    def note_refused(self, connection: Connection, count: int) -> None:
        """Count messages that the centre has refused."""
        self.refused += count
        connection.execute(update(tables.outbox_state).values(refused=self.refused))

    def begin_stream(self, connection: Connection) -> None:
        """Begin another stream: the centre has stored numbers that this database has not given yet."""
        self.stream = token_hex(16)
        connection.execute(update(tables.outbox_state).values(stream=self.stream))

    def read(self, after: int, limit: int) -> list[StoredRow]:
        """Return the oldest messages with a number above `after`. Blocks on the database."""
        table = tables.outbox.c
        query = select(table.seq, table.device, table.body).where(table.seq > after).order_by(table.seq)
        with self._engine.connect() as connection:
            return [StoredRow(*row) for row in connection.execute(query.limit(limit))]

    def last(self) -> int:
        """Return the greatest number that was given, 0 at first. Blocks on the database."""
        with self._engine.connect() as connection:
            if connection.dialect.name == "sqlite":
                row = connection.exec_driver_sql(
                    "SELECT seq FROM sqlite_sequence WHERE name = 'device_outbox'"
                ).scalar()
            else:
                row = connection.exec_driver_sql(
                    "SELECT CASE WHEN is_called THEN last_value ELSE 0 END FROM device_outbox_seq_seq"
                ).scalar()
        return int(row or 0)

    def oldest_us(self) -> int | None:
        """Return when the oldest message was received. Blocks on the database."""
        query = select(tables.outbox.c.at_us).order_by(tables.outbox.c.seq).limit(1)
        with self._engine.connect() as connection:
            return connection.execute(query).scalar()

    @staticmethod
    def _trim(connection: Connection, excess: int) -> tuple[int, int]:
        """Delete the oldest messages; return how many, and their bytes."""
        table, state = tables.outbox, tables.outbox_state
        freed = dropped = last = 0
        while freed < excess:
            query = select(table.c.seq, table.c.size).where(table.c.seq > last).order_by(table.c.seq)
            rows = connection.execute(query.limit(TRIM_ROWS)).all()
            if not rows:
                break
            for seq, size in rows:
                last, freed, dropped = seq, freed + size, dropped + 1
                if freed >= excess:
                    break
        connection.execute(delete(table).where(table.c.seq <= last))
        connection.execute(update(state).values(dropped=state.c.dropped + dropped))
        return dropped, freed
