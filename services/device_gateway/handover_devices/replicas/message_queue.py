"""What a replica relays to the leader: messages that are stored already, until the leader has applied them.

They wait in memory. If this process dies, the latest values reach the leader with the next message of the
device, and the answer to a command when the leader sends the command again, or its device answers again. If
the leader dies, the next one gets what the dead one has not acknowledged.
"""

import threading
from collections import deque
from collections.abc import Sequence
from itertools import islice
from secrets import token_hex
from typing import Final

from sqlalchemy import Connection

from handover_devices.storage.outbox import RelayRow, StoredRow

MAX_ROWS: Final = 20_000
"""While no leader is there, the oldest messages are dropped beyond."""


class MemoryQueue:
    """The messages that wait; its methods are called on the writing thread and on others."""

    def __init__(self) -> None:
        self.stream = token_hex(16)
        self._rows: deque[StoredRow] = deque(maxlen=MAX_ROWS)
        self._pending: Sequence[RelayRow] = ()
        self._last = 0
        self._lock = threading.Lock()

    @property
    def waiting(self) -> int:
        """How many messages wait."""
        return len(self._rows)

    def append(self, connection: Connection, rows: Sequence[RelayRow]) -> None:  # noqa: ARG002
        """Add messages, once their transaction is committed."""
        self._pending = rows

    def committed(self) -> None:
        """The transaction of `append` is committed."""
        with self._lock:
            for row in self._pending:
                self._last += 1
                self._rows.append(StoredRow(self._last, row.device, row.body))
        self._pending = ()

    def acknowledge(self, connection: Connection, seq: int) -> None:  # noqa: ARG002
        """Forget the messages up to a number."""
        with self._lock:
            while self._rows and self._rows[0].seq <= seq:
                self._rows.popleft()

    def count(self, connection: Connection) -> None:
        """Do nothing: the numbers are in memory."""

    def note_refused(self, connection: Connection, count: int) -> None:
        """Do nothing: the device was answered by this process."""

    def begin_stream(self, connection: Connection) -> None:  # noqa: ARG002
        """Begin another stream."""
        self.stream = token_hex(16)

    def read(self, after: int, limit: int) -> list[StoredRow]:
        """Return the oldest messages with a number above `after`."""
        with self._lock:
            if not self._rows:
                return []
            skipped = max(after - self._rows[0].seq + 1, 0)  # the numbers have no gaps
            return list(islice(self._rows, skipped, skipped + limit))

    def last(self) -> int:
        """Return the greatest number that was given, 0 at first."""
        return self._last

    def take_all(self) -> list[StoredRow]:
        """Return what waits, and forget it."""
        with self._lock:
            rows = list(self._rows)
            self._rows.clear()
        return rows
