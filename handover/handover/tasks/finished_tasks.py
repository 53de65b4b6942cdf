"""Finished Tasks: a record of the ended Tasks of a performer, in a separate SQLite file.

A finished Task is deleted from the broker after some time. It may reappear from an old backup or because a
client posts it again, and must not be executed twice. So its end is recorded before it is reported, and
reported again if the broker shows the Task as unfinished. Records outlive the Tasks in the broker.

The file also records the acts of unfinished Tasks that must not be repeated, each before it begins and with
its result. An act without a result has an unknown outcome after a crash. And it has the identity of the
performer as a holder of leases (`device_lease`): a process that opens the file replaces the one before it.
"""

import asyncio
import re
import secrets
import sqlite3
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import orjson

from handover.database.sqlite_files import prepare_own
from handover.database.sqlite_integrity.checkpoints import Checkpoints, CountedConnection, make_durable
from handover.database.sqlite_integrity.reserve import with_reserve
from handover.errors import UsageError
from handover.files.folder_lock import hold
from handover.settings import Settings
from handover_datamodels.entities import TaskStatus
from handover_datamodels.numbers import not_finite_place

MIN_KEEP_H = 30 * 24.0
KEEP_PER_RETENTION = 2.0
DELETE_OLD_EVERY = 1_000
"""Expired records are deleted at the start, and after so many new ones."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class End:
    """The end of a Task: `completed` or `failed`, with its outputParameters."""

    status: TaskStatus
    outputs: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class KnownAct:
    """An act of a Task that was begun; `result` is None if no result was recorded."""

    result: Mapping[str, Any] | None


class FinishedTasks:
    """The ends of the Tasks of `performer`; call `open` first. One separate thread accesses the file."""

    def __init__(self, settings: Settings, performer: str, *, clock: Callable[[], float] = time.time) -> None:
        self._performer = performer
        name = re.sub(r"[^A-Za-z0-9_.-]", "_", performer)
        self.path = settings.data_dir / f"{name}.finished.db"
        self._keep_s = 3600.0 * max(MIN_KEEP_H, KEEP_PER_RETENTION * settings.retention_h)
        self._clock = clock
        self._recorded = 0
        self._disk: ThreadPoolExecutor | None = None
        self._connection: sqlite3.Connection | None = None
        self._checkpoints: Checkpoints | None = None
        self.is_upgraded = False
        """Whether the file is of a release that did not record which Tasks it had begun."""
        self._release: Callable[[], None] = lambda: None

    async def open(self) -> None:
        """Open the file; raise `UsageError` if that is not possible, or if another process has it open."""
        self._disk = ThreadPoolExecutor(1, "finished-tasks")
        try:
            await self._on_disk(with_reserve, self.path, self._open)
        except (sqlite3.Error, OSError) as error:
            raise UsageError(
                f"the record of finished Tasks, {self.path}, cannot be used: {error}; make the directory "
                "writable, remove the file if it is damaged, or set HANDOVER_DATA_DIR to another directory"
            ) from None

    async def close(self) -> None:
        """Close the file."""
        if self._disk is not None:
            await self._on_disk(self._close)
            self._disk.shutdown(wait=False)

    async def identity(self) -> tuple[str, bool]:
        """Return the durable identity of this holder of leases, and whether it was ever granted one."""
        return await self._on_disk(self._identity)

    async def mark_leased(self) -> None:
        """Note durably that a lease was granted. Raises `OSError` when it cannot be written."""
        try:
            await self._on_disk(self._mark_leased)
        except sqlite3.Error as error:
            raise OSError(f"{self.path}: {error}") from error

    async def find(self, task_id: str) -> End | None:
        """Return the end of a Task; None if this performer has not finished it."""
        return await self._on_disk(self._find, task_id)

    async def record(self, task_id: str, end: End) -> None:
        """Record the end of a Task durably: it survives `kill -9` and a power cut.

        A recorded `completed` is not replaced by `failed`: what was done stays done.

        Raises `OSError` when it cannot be written, `TypeError` when the outputs are no plain JSON.
        """
        outputs = _plain_json(end.outputs)
        try:
            await self._on_disk(self._record, task_id, end.status.value, outputs)
        except sqlite3.Error as error:
            raise OSError(f"{self.path}: {error}") from error

    async def act(self, task_id: str, name: str) -> KnownAct | None:
        """Return an act of a Task; None if it was not begun."""
        return await self._on_disk(self._act, task_id, name)

    async def begin_act(self, task_id: str, name: str) -> KnownAct | None:
        """Record durably that an act begins and return None; return it unchanged if it was begun before.

        Raises `OSError` when it cannot be written.
        """
        try:
            return await self._on_disk(self._begin_act, task_id, name)
        except sqlite3.Error as error:
            raise OSError(f"{self.path}: {error}") from error

    async def end_act(self, task_id: str, name: str, result: Mapping[str, Any]) -> None:
        """Record the result of an act durably. Raises `OSError` or `TypeError` as `record` does."""
        written = _plain_json(result)
        try:
            await self._on_disk(self._end_act, task_id, name, written)
        except sqlite3.Error as error:
            raise OSError(f"{self.path}: {error}") from error

    async def _on_disk(self, act: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._disk, act, *arguments)

    def _open(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._release()  # of an attempt on a full disk
        self._release = hold(self.path, self._performer)
        existed = self.path.exists()
        prepare_own(self.path)
        self._checkpoints = Checkpoints(self.path)
        connection = sqlite3.connect(self.path, timeout=5.0, factory=CountedConnection)
        make_durable(connection)
        self._checkpoints.count(connection)
        connection.execute(
            "CREATE TABLE IF NOT EXISTS finished (task TEXT PRIMARY KEY, status TEXT NOT NULL, "
            "outputs TEXT NOT NULL, recorded_s REAL NOT NULL) WITHOUT ROWID"
        )
        connection.execute("CREATE INDEX IF NOT EXISTS finished_recorded ON finished (recorded_s)")
        connection.execute(
            "CREATE TABLE IF NOT EXISTS acts (task TEXT NOT NULL, name TEXT NOT NULL, result TEXT, "
            "begun_s REAL NOT NULL, PRIMARY KEY (task, name)) WITHOUT ROWID"
        )
        tables = {str(name) for (name,) in connection.execute("SELECT name FROM sqlite_master")}
        connection.execute(
            "CREATE TABLE IF NOT EXISTS identity (id TEXT PRIMARY KEY, is_leased INTEGER NOT NULL)"
        )
        self.is_upgraded = existed and "identity" not in tables
        self._connection = connection
        self._delete_old()

    def _close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self._checkpoints is not None:
            self._checkpoints.close()
            self._checkpoints = None
        self._release()

    def _identity(self) -> tuple[str, bool]:
        row = self._opened.execute("SELECT id, is_leased FROM identity").fetchone()
        if row is None:
            row = (secrets.token_hex(16), 0)
            with self._transaction() as connection:
                connection.execute("INSERT INTO identity VALUES (?, ?)", row)
        return str(row[0]), bool(row[1])

    def _mark_leased(self) -> None:
        with self._transaction() as connection:
            connection.execute("UPDATE identity SET is_leased = 1")

    def _find(self, task_id: str) -> End | None:
        row = self._opened.execute(
            "SELECT status, outputs FROM finished WHERE task = ?", (task_id,)
        ).fetchone()
        return None if row is None else End(TaskStatus(row[0]), orjson.loads(row[1]))

    def _record(self, task_id: str, status: str, outputs: str) -> None:
        with self._transaction() as connection:
            connection.execute(
                "INSERT INTO finished VALUES (?, ?, ?, ?) ON CONFLICT (task) DO UPDATE SET "
                "status = excluded.status, outputs = excluded.outputs, recorded_s = excluded.recorded_s "
                "WHERE finished.status <> 'completed' OR excluded.status = 'completed'",
                (task_id, status, outputs, self._clock()),
            )
            connection.execute("DELETE FROM acts WHERE task = ?", (task_id,))
        self._recorded += 1
        if self._recorded % DELETE_OLD_EVERY == 0:
            self._delete_old()

    def _act(self, task_id: str, name: str) -> KnownAct | None:
        row = self._opened.execute(
            "SELECT result FROM acts WHERE task = ? AND name = ?", (task_id, name)
        ).fetchone()
        return None if row is None else KnownAct(None if row[0] is None else orjson.loads(row[0]))

    def _begin_act(self, task_id: str, name: str) -> KnownAct | None:
        if (recorded := self._act(task_id, name)) is not None:
            return recorded
        with self._transaction() as connection:
            connection.execute("INSERT INTO acts VALUES (?, ?, NULL, ?)", (task_id, name, self._clock()))
        return None

    def _end_act(self, task_id: str, name: str, result: str) -> None:
        with self._transaction() as connection:
            connection.execute(
                "UPDATE acts SET result = ? WHERE task = ? AND name = ?", (result, task_id, name)
            )

    def _delete_old(self) -> None:
        before_s = self._clock() - self._keep_s
        with self._transaction() as connection:
            connection.execute("DELETE FROM finished WHERE recorded_s < ?", (before_s,))
            connection.execute("DELETE FROM acts WHERE begun_s < ?", (before_s,))

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Commit what is written inside, or nothing of it; the driver begins with the first write."""
        connection = self._opened
        try:
            yield connection
            connection.commit()
        except BaseException:
            connection.rollback()
            raise

    @property
    def _opened(self) -> sqlite3.Connection:
        if self._connection is None:
            raise RuntimeError("the record of finished Tasks is not open")
        return self._connection


def _plain_json(value: Mapping[str, Any]) -> str:
    """Return a result as JSON; raise `TypeError` if JSON cannot express it."""
    if (place := not_finite_place(value)) is not None:
        raise TypeError(f'"{place}" is NaN or infinite, and JSON has no such number; return a finite one')
    return orjson.dumps(dict(value)).decode()
