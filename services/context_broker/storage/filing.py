"""Filing: commits are safe in the log at once, and are filed in the tables later, many at a time.

Many changes in one transaction cost a fraction of as many transactions, and what changed often is written
once; what was owed to a subscriber and told meanwhile is not written at all. Whoever reads the tables has
everything filed first, so they never say less than the log.
"""

import secrets
import threading
import time
from collections.abc import Callable
from typing import Final

from prometheus_client import Counter, Gauge

from handover.errors import UsageError
from handover.telemetry import get_logger
from services.context_broker.storage.database import NotStored, SqliteDatabase, Writer
from services.context_broker.storage.entries import Entries, Kind
from services.context_broker.storage.log import Damaged, Log
from services.context_broker.storage.records import decoded, encoded

log = get_logger(__name__)

QUIET_S: Final = 1.0
"""How long changes wait when there are few, so that whoever opens the file finds it up to date."""
RETRY_S: Final = 1.0
HICCUP_S: Final = 0.002
REMEMBERED: Final = 16
SUPPOSED: Final = 0.995
QUICK_BYTES: Final = 64 * 1024
"""What is written at once at most."""

UNFILED = Gauge("handover_broker_log_unfiled", "Commits in the log that are not in the tables yet")
NOT_FILED = Counter("handover_broker_log_filing_failed_total", "Times the tables could not be written")

Write = Callable[[Writer, Entries], None]


class Filing:
    """The log and the way from there into the tables; `write` writes entries whose notices have numbers."""

    def __init__(self, database: SqliteDatabase, write: Write) -> None:
        self._database = database
        self._write = write
        self._log = Log(database.path)
        self._waiting: list[bytes] = []
        """Records: what they were made of takes ten times the memory."""
        self._guard = threading.Lock()
        """Of what waits, and of the log."""
        self._filing = threading.Lock()
        """Held by whoever writes the tables: one at a time."""
        self._wanted = threading.Event()
        self._ends = threading.Event()
        self.flush_s = 0.0
        """How long the event loop has waited for the disk of late."""
        self._thread = threading.Thread(target=self._work, name="filing", daemon=True)

    def open(self) -> None:
        """File what an earlier process has left in the log, and begin anew. Raises `UsageError`."""
        try:
            ((opening, filed),) = self._database.read("SELECT opening, filed FROM log_state")
            left = [decoded(record) for record in self._log.read(bytes.fromhex(opening), filed)]
            new = secrets.token_bytes(8)
            with self._database.transaction() as writer:
                for lot in lots(left):
                    self._write(writer, lot)
                writer.run("UPDATE log_state SET opening = ?, filed = 0", (new.hex(),))
            self._log.begin(new)
            self.flush_s = self._log.tried_s()
        except Damaged as error:
            raise UsageError(f"the log before {self._database.path} is damaged: {error}") from None
        except (NotStored, OSError) as error:
            raise UsageError(
                f"the broker cannot use {self._database.path} and the log beside it: {error}; "
                "give it another HANDOVER_DATA_DIR, or make room there"
            ) from None
        if left:
            log.info("filed what was left in the log", commits=len(left))
        self._database.before_reading = self.settle
        UNFILED.set_function(lambda: len(self._waiting))
        self._thread.start()

    def commit_at_once(self, entries: Entries) -> bool:
        """Do as `commit` and return true if there is room and not much to write; else do nothing."""
        record = encoded(entries)
        if len(record) > QUICK_BYTES or not self._log.has_room(record):
            return False
        began_s = time.perf_counter()
        self._append(record)
        # One hiccup is no rule, so that it counts for little however long it was.
        self.flush_s += (min(time.perf_counter() - began_s, HICCUP_S) - self.flush_s) / REMEMBERED
        return True

    def commit(self, entries: Entries) -> None:
        """Write entries and return when they are safe; one thread at a time. Raises `NotStored`."""
        record = encoded(entries)
        if self._log.never_fits(record):
            self._file(entries)
            return
        if not self._log.has_room(record):
            self._file()
        self._append(record)
        # A thread waits for the interpreter too, so that it cannot tell how long the disk took: that it has
        # become quicker is supposed, a little more each time, until the event loop tries it.
        self.flush_s *= SUPPOSED

    def _append(self, record: bytes) -> None:
        was_tight = self._log.is_tight
        try:
            with self._guard:
                self._log.append(record)
                self._waiting.append(record)
        except OSError as error:
            raise NotStored(f"{self._database.name}: {error}") from error
        if len(self._waiting) == 1 or self._log.is_tight is not was_tight:
            self._wanted.set()

    def settle(self) -> None:
        """Return when everything committed so far is in the tables; from any thread. Raises `NotStored`."""
        if self._waiting:
            self._file()

    def close(self) -> None:
        """File what waits, and let go."""
        self._ends.set()
        self._wanted.set()
        if self._thread.is_alive():
            self._thread.join()
        try:
            self.settle()
        except NotStored as error:
            log.warning("what is in the log is filed at the next start", error=str(error))
        self._log.close()

    def _file(self, besides: Entries | None = None) -> None:
        """Write what waits into the tables, and what is too long for the log."""
        with self._filing:
            with self._guard:
                waiting, number = self._waiting.copy(), self._log.number
            if not waiting and besides is None:
                return
            commits = [decoded(record) for record in waiting]
            with self._database.transaction() as writer:
                for lot in lots(commits if besides is None else [*commits, besides]):
                    self._write(writer, lot)
                writer.run("UPDATE log_state SET filed = ?", (number,))
            with self._guard:
                del self._waiting[: len(waiting)]
                self._log.filed(number)

    def _work(self) -> None:
        """File in a thread of its own what has become much, or has waited long."""
        while not self._ends.is_set():
            self._wanted.wait()
            self._wanted.clear()
            if not self._ends.is_set() and not self._log.is_tight:
                self._wanted.wait(QUIET_S)
                self._wanted.clear()
            try:
                self.settle()
            except NotStored as error:
                NOT_FILED.inc()
                log.warning("changes wait in the log: the tables cannot be written", error=str(error))
                self._wanted.wait(RETRY_S)
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
        told = set(lot.settled).intersection(notice.seq for notice in lot.owed)
        if told:
            lot.owed = [notice for notice in lot.owed if notice.seq not in told]
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
