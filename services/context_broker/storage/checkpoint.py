"""Filing: commits are safe in the log at once, and are filed in the tables later, many at a time.

Many changes in one transaction cost a fraction of as many transactions, and what changed often is written
once; what was owed to a subscriber and told meanwhile is not written at all. Whoever reads the tables has
everything filed first, so they never say less than the log.
"""

import math
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from prometheus_client import Counter, Gauge

from handover.errors import UsageError
from handover.sqlite_files import damage
from handover.telemetry import get_logger
from services.context_broker.storage import checksums
from services.context_broker.storage.database import NotStored, Row, SqliteDatabase, Writer, unusable
from services.context_broker.storage.entries import Entries, Kind
from services.context_broker.storage.records import decoded, encoded
from services.context_broker.storage.write_ahead_log import Damaged, WriteAheadLog

log = get_logger(__name__)

QUIET_S: Final = 1.0
"""How long changes wait when there are few, so that whoever opens the file finds it up to date."""
RETRY_S: Final = 1.0
HICCUP_S: Final = 0.002
REMEMBERED: Final = 16
SUPPOSED: Final = 0.995
QUICK_BYTES: Final = 64 * 1024
"""What is written at once at most."""

UNCHECKPOINTED = Gauge(
    "handover_broker_write_ahead_log_commits", "Commits in the log that are not in the tables yet"
)
CHECKPOINT_FAILURES = Counter(
    "handover_broker_checkpoint_failures_total", "Times the tables could not be written"
)

Write = Callable[[Writer, Entries], None]


class Checkpointer:
    """The log and the way from there into the tables; `write` writes entries whose notices have numbers."""

    def __init__(self, database: SqliteDatabase, write: Write, tidy: Callable[[Writer], None]) -> None:
        self._database = database
        self._write = write
        self._tidy = tidy
        self._log = WriteAheadLog(database.path)
        self.left: list[Entries] = []
        """What an earlier process has left in the log, until it is filed."""
        self._no_room: str | None = None
        """Why nothing can be written: the log could not be begun."""
        self._not_checkpointed: str | None = None
        """Why the tables cannot be written."""
        self._not_written: str | None = None
        """Why the log could not be written the last time."""
        self._identity = self._opening = b""
        self._is_open = False
        """Whether the tables say that the log of `_opening` counts."""
        self._has_begun = False
        self._waiting: list[bytes] = []
        """Records: what they were made of takes ten times the memory."""
        self._guard = threading.Lock()
        """Of what waits, and of the log."""
        self._checkpointer = threading.Lock()
        """Held by whoever writes the tables: one at a time."""
        self._wanted = threading.Event()
        self._ends = threading.Event()
        self._flush_s = 0.0
        self._thread = threading.Thread(target=self._work, name="filing", daemon=True)

    @property
    def path(self) -> Path:
        """Return where the database is."""
        return self._database.path

    @property
    def flush_s(self) -> float:
        """Return how long the event loop has waited for the disk of late."""
        return math.inf if self._no_room is not None else self._flush_s

    def require_database(self) -> None:
        """Raise `UsageError` if there is a log and no database that it belongs to."""
        if self._log.exists() and not (self.path.exists() and self.path.stat().st_size):
            state = "is empty" if self.path.exists() else "is missing"
            logs = " and ".join(path.name for path in self._log.paths)
            raise UsageError(damage(f"{self.path} {state}, while {logs} beside it belong to it"))

    def open(self) -> None:
        """File what an earlier process has left in the log, and begin a new one.

        Raises `UsageError` for damage. Without room on the disk nothing is written until there is some.
        """
        try:
            self.read_left()
        except Damaged as error:
            logs = " and ".join(path.name for path in self._log.paths)
            raise UsageError(
                f"{damage(str(error))}; if {self.path.name} itself was restored, move {logs} away"
            ) from None
        except (NotStored, OSError) as error:
            raise unusable(self.path, error) from None
        try:
            self._begin()
        except NotStored as error:
            log.warning("no room on the disk: reads only", database=str(self.path), error=str(error))
            self._wanted.set()
        self._database.before_reading = self.settle
        UNCHECKPOINTED.set_function(lambda: len(self._waiting))
        self._thread.start()

    def require_room(self) -> None:
        """Raise `NotStored` with the reason while the log or the tables cannot be written."""
        if (reason := self._no_room or self._not_written or self._not_checkpointed) is not None:
            raise NotStored(reason)

    def scan_tables(self, statement: str, parameters: Sequence[Any] = ()) -> Iterator[Row]:
        """Yield the rows of a query as the tables are, without what is left in the log."""
        return self._database.scan_tables(statement, parameters)

    def last_of(self, statement: str) -> int:
        """Return the number that a query gives, as the tables are."""
        ((last,),) = self.scan_tables(statement)
        return int(last)

    def read_left(self) -> None:
        """Read what the tables say of the log, and what is in the log only. Raises `Damaged`."""
        states = list(self.scan_tables("SELECT identity, opening, filed, is_open, checksum FROM log_state"))
        if not states:  # a new database
            self._identity = secrets.token_bytes(8)
        else:
            *state, checksum = states[0]
            if not checksums.holds(checksums.of_state, checksum, state):
                raise Damaged(f"{self.path}: what it says of its log is not as it was written")
            identity, opening, checkpointed, is_open = state
            self._identity, self._opening = bytes.fromhex(identity), bytes.fromhex(opening)
            self._is_open = bool(is_open)
        if self._is_open:
            self.left = [
                decoded(record) for record in self._log.read(self._identity, self._opening, checkpointed)
            ]
        elif (foreign := self._log.foreign(self._identity, self._opening)) is not None:
            raise Damaged(f"{foreign}: {self.path.name} is an older copy, or of another place")

    def _begin(self) -> None:
        """File what is left, and begin a log for a new opening. Raises `NotStored`, and remembers why.

        The tables say that no log counts while its files are overwritten: it may be killed at any time.
        """
        with self._checkpointer:
            if self._has_begun:
                return
            try:
                if self.left or self._is_open:
                    with self._database.transaction() as writer:
                        for lot in lots(self.left):
                            self._write(writer, lot)
                        self._write_state(writer, 0, is_open=False)
                    if self.left:
                        log.info("filed what was left in the log", commits=len(self.left))
                    self.left, self._is_open = [], False
                new = secrets.token_bytes(8)
                self._log.begin(self._identity, new)
                flush_s = self._log.tried_s()
                with self._database.transaction() as writer:
                    self._tidy(writer)
                    self._opening = new
                    self._write_state(writer, 0, is_open=True)
                self._database.checkpoint()
            except (NotStored, OSError) as error:
                self._no_room = str(error)
                self._log.close()
                raise NotStored(str(error)) from error
            self._is_open = self._has_begun = True
            self._flush_s, self._no_room = flush_s, None

    def _write_state(self, writer: Writer, checkpointed: int, *, is_open: bool) -> None:
        """Write what the tables say of the log: whose it is, and up to where it is filed."""
        row = (self._identity.hex(), self._opening.hex(), checkpointed, int(is_open))
        writer.run(
            "INSERT INTO log_state (name, identity, opening, filed, is_open, checksum) "
            "VALUES ('log', ?, ?, ?, ?, ?) ON CONFLICT (name) DO UPDATE SET opening = excluded.opening, "
            "filed = excluded.filed, is_open = excluded.is_open, checksum = excluded.checksum",
            (*row, checksums.of_state(*row)),
        )

    def commit_at_once(self, entries: Entries) -> bool:
        """Do as `commit` and return true if there is room and not much to write; else do nothing."""
        if self._no_room is not None:
            return False
        record = encoded(entries)
        if len(record) > QUICK_BYTES or not self._log.has_room(record):
            return False
        began_s = time.perf_counter()
        self._append(record)
        # One hiccup is no rule, so that it counts for little however long it was.
        self._flush_s += (min(time.perf_counter() - began_s, HICCUP_S) - self._flush_s) / REMEMBERED
        return True

    def commit(self, entries: Entries) -> None:
        """Write entries and return when they are safe; one thread at a time. Raises `NotStored`."""
        if self._no_room is not None:
            self._begin()
        record = encoded(entries)
        if self._log.never_fits(record):
            self._checkpoint(entries)
            return
        if not self._log.has_room(record):
            self._checkpoint()
        self._append(record)
        # A thread waits for the interpreter too, so that it cannot tell how long the disk took: that it has
        # become quicker is supposed, a little more each time, until the event loop tries it.
        self._flush_s *= SUPPOSED

    def _append(self, record: bytes) -> None:
        was_tight = self._log.is_tight
        try:
            with self._guard:
                self._log.append(record)
                self._waiting.append(record)
        except OSError as error:
            self._not_written = str(error)
            self._wanted.set()
            raise NotStored(f"{self._database.name}: {error}") from error
        self._not_written = None
        if len(self._waiting) == 1 or self._log.is_tight is not was_tight:
            self._wanted.set()

    def settle(self) -> None:
        """Return when everything committed so far is in the tables; from any thread. Raises `NotStored`."""
        if self.left:
            raise NotStored(f"{self._database.name}: {self._no_room}")
        if self._waiting:
            self._checkpoint()

    def close(self) -> None:
        """File what waits, and let go."""
        self._ends.set()
        self._wanted.set()
        if self._thread.is_alive():
            self._thread.join()
        is_filed = False
        if self._has_begun:
            try:
                self.settle()
                with self._database.transaction() as writer:
                    self._write_state(writer, 0, is_open=False)
                is_filed = True
            except NotStored as error:
                log.warning("what is in the log is filed at the next start", error=str(error))
        self._log.close(by_sequence=is_filed)

    def _checkpoint(self, besides: Entries | None = None) -> None:
        """Write what waits into the tables, and what is too long for the log."""
        with self._checkpointer:
            with self._guard:
                waiting, number = self._waiting.copy(), self._log.number
            if not waiting and besides is None:
                return
            commits = [decoded(record) for record in waiting]
            with self._database.transaction() as writer:
                for lot in lots(commits if besides is None else [*commits, besides]):
                    self._write(writer, lot)
                self._write_state(writer, number, is_open=True)
            with self._guard:
                del self._waiting[: len(waiting)]
                self._log.checkpointed(number)

    def _work(self) -> None:
        """File in a thread of its own what has become much, or has waited long."""
        while not self._ends.is_set():
            self._wanted.wait()
            self._wanted.clear()
            if not self._ends.is_set() and not self._log.is_tight:
                self._wanted.wait(QUIET_S)
                self._wanted.clear()
            try:
                if not self._has_begun:
                    self._begin()
                    log.info("there is room on the disk again", database=str(self.path))
                if self._not_written is not None:
                    with self._guard:
                        self._log.try_out()
                    self._not_written = None
                self.settle()
                self._not_checkpointed = None
            except Exception as error:  # noqa: BLE001 - without this thread the log would become full
                CHECKPOINT_FAILURES.inc()
                if self._no_room is None:
                    self._not_checkpointed = str(error)
                    log.warning("changes wait in the log: the tables cannot be written", error=str(error))
                self._ends.wait(RETRY_S)
                self._wanted.set()


def lots(commits: list[Entries]) -> list[Entries]:
    """Put commits together as far as the order in which they were made does not matter.

    What was owed and is told is in none of them.
    """
    made: list[Entries] = []
    lot = None
    for one in commits:
        forgets = bool(one.cleared) or _ends_a_subscription(one)
        if lot is None or forgets:
            lot = Entries()
            made.append(lot)
        lot.add(one)
        if forgets:
            lot = None
    for lot in made:
        told = set(lot.settled).intersection(notice.seq for notice in lot.pending)
        if told:
            lot.pending = [notice for notice in lot.pending if notice.seq not in told]
            lot.settled = [seq for seq in lot.settled if seq not in told]
        latest = {row[:2]: row for row in lot.history}
        lot.history = list(latest.values())
    return made


def _ends_a_subscription(entries: Entries) -> bool:
    """Say whether what is owed to a subscription is forgotten with it: one of its name may come after."""
    return any(
        body is None and kind in (Kind.SUBSCRIPTION, Kind.SOURCE_SUBSCRIPTION)
        for (kind, _, _), body in entries.documents.items()
    )
