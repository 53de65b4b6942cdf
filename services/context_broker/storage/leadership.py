"""Leadership: of several brokers on one database, one delivers notifications and minds the clock.

A broker with a file of its own always leads. On PostgreSQL the leader is who holds a lock there, which the
server takes back when the leader's connection ends, however that came about; then another takes over.
"""

import asyncio
import random
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Final, Protocol

from handover.telemetry import get_logger
from services.context_broker.storage.postgres import CHANNEL, LEADING, PostgresDatabase

if TYPE_CHECKING:
    import psycopg

log = get_logger(__name__)

TRY_EVERY_S: Final = 1.0
"""How often a follower tries to lead, and a leader makes sure that it still does."""

TIDY_EVERY_S: Final = 300.0
LISTEN_S: Final = 0.1
"""How long the thread listens before it looks whether it is to end."""

Told = Callable[[bool], None]
"""Is told on the event loop that this broker leads now, or no longer does."""


class Leadership(Protocol):
    """Whether this broker leads. What only one may do (notify, timers, tidying up) asks `leads` first."""

    @property
    def leads(self) -> bool:
        """Say whether this broker leads now."""

    async def check(self) -> None:
        """Return if this broker hears of what others do; raise, with a sentence, if it does not."""

    def start(self, told: Told, heard: Callable[[], None]) -> None:
        """Begin; call it on the event loop. `told` hears of every turn, `heard` when others have written."""

    def stop(self) -> None:
        """Stand back, so that another may lead at once."""


class SoleBroker:
    """The broker that shares its database with nobody."""

    leads = True

    async def check(self) -> None:
        """There are no others."""

    def start(self, told: Told, heard: Callable[[], None]) -> None:
        """Lead from the start."""

    def stop(self) -> None:
        """Nobody takes over."""


class ElectedBroker:
    """One of several brokers: a thread with a connection of its own holds the lock and hears of changes.

    The leader also runs `tidying` on the database now and then.
    """

    def __init__(self, database: PostgresDatabase, tidying: str) -> None:
        self._database = database
        self._tidying = tidying
        self._has_lock = False
        """As the thread knows it."""
        self._leads = False
        """As the event loop has been told: nothing is delivered before what is owed has been looked for."""
        self._listens = False
        self._over = threading.Event()
        self._told: Told
        self._heard: Callable[[], None]
        self._loop: asyncio.AbstractEventLoop
        self._thread = threading.Thread(target=self._work, name="leadership", daemon=True)

    @property
    def leads(self) -> bool:
        """Say whether this broker leads now."""
        return self._leads

    async def check(self) -> None:
        """Raise, with a sentence, while this broker does not hear of what others do."""
        if not self._listens:
            raise ConnectionError(f"{self._database.name} is out of reach, what is read here may be old")

    def start(self, told: Told, heard: Callable[[], None]) -> None:
        """Begin to listen and to try."""
        self._told, self._heard = told, heard
        self._loop = asyncio.get_running_loop()
        self._thread.start()

    def stop(self) -> None:
        """Stand back."""
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join()

    # In the thread

    def _work(self) -> None:
        while not self._over.is_set():
            try:
                with self._database.connected() as connection:
                    self._keep_watch(connection)
            except Exception as error:  # noqa: BLE001 - whatever ends a watch, the next begins
                if not self._over.is_set():
                    log.warning("the database is out of reach", error=str(error).strip())
            finally:
                self._listens = False
                self._turn(leads=False)
            self._over.wait(TRY_EVERY_S * random.uniform(0.5, 1.0))  # noqa: S311 - jitter

    def _keep_watch(self, connection: "psycopg.Connection") -> None:
        connection.execute(f"LISTEN {CHANNEL}")
        self._listens = True
        self._heard()  # what came before there was somebody to hear it
        due_s = tidy_s = 0.0
        while not self._over.is_set():
            if time.monotonic() >= due_s:
                due_s = time.monotonic() + TRY_EVERY_S * random.uniform(0.7, 1.0)  # noqa: S311 - jitter
                if self._has_lock:
                    connection.execute("SELECT 1")
                elif _won(connection):
                    self._turn(leads=True)
            if self._has_lock and time.monotonic() >= tidy_s:
                tidy_s = time.monotonic() + TIDY_EVERY_S
                connection.execute(self._tidying)
            for _ in connection.notifies(timeout=LISTEN_S, stop_after=1):
                self._heard()

    def _turn(self, *, leads: bool) -> None:
        if leads == self._has_lock:
            return
        self._has_lock = leads
        self._leads = self._leads and leads
        log.info("this broker leads" if leads else "this broker leads no longer")
        with suppress(RuntimeError):  # the loop has ended before
            self._loop.call_soon_threadsafe(self._take_turn, leads)

    # On the event loop

    def _take_turn(self, leads: bool) -> None:
        self._leads = leads and self._has_lock
        self._told(leads)


def _won(connection: "psycopg.Connection") -> bool:
    row = connection.execute(f"SELECT pg_try_advisory_lock({LEADING})").fetchone()
    return bool(row and row[0])
