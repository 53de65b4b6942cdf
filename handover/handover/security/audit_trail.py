"""The audit trail of a service: who changed something, and who read data of persons, on every route.

A service gives its `AuditTrail` to `create_app`. Each request to a route with a permission is then recorded,
a change in one of three ways (`Way`, chosen by a decorator of the route):

- by default the intent is recorded before the handler is called and the outcome after it, so that a request
  that cannot be recorded is refused with 503 and has changed nothing. A process that ends in between leaves
  an intent without an outcome, which the list of records shows as such;
- `@recorded_with_change`: the handler does no more than one transaction in the database of the trail, which
  calls `record_request(connection)`, so that both are committed or neither is;
- `@lowers` (stop, pause, cancel, a lower limit, release of control): it is always carried out, and recorded
  afterwards. Where that fails, the response has `recorded: false`, and the record is kept in memory until it
  can be written; a process that ends before loses it, and its log has it.

A route whose handler calls `record_request` in a transaction although the intent was recorded gets its
outcome in that transaction. An outcome that cannot be written never changes the response, since the act has
happened: it is kept in memory, and written when there is room.

Reading health data or studies is recorded before the response is sent, once in `REPEAT_S` for the same
caller, route and resource, since pages ask again and again; a read that cannot be recorded is refused with
503. A refused change is recorded too. Services and devices are not recorded: they act for processes and
people whose acts are recorded where they are requested.

Records that wait for the database at the same time share one transaction, so that many requests at once cost
few of them.

The action of a record is the method and the path of the route, the resource is what the permission was
required for, and the text is the path that was requested. A transaction in another thread finds the act by
`asyncio.to_thread`, which copies the context; a queue of changes keeps `current_request()` itself. A handler
that requires the permission by itself calls `begin_act` between that and the act.
"""

import asyncio
import math
import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from threading import Lock
from typing import Any, Final, Self

from sqlalchemy import Connection, Engine, MetaData
from sqlalchemy.exc import SQLAlchemyError

from handover.database import connect
from handover.database.migrations import migrate
from handover.database.outage import database_reason
from handover.errors import Problem, UsageError
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.retry import Backoff
from handover.security.audit import AuditLog, AuditTables
from handover.security.audited_request import (
    DONE,
    FAILED,
    REFUSED,
    AuditedRequest,
    AuditEntry,
    Way,
    begin_act,
    begin_request,
    current_request,
    is_recorded,
    record_deletion,
    record_request,
)
from handover.security.caller import Caller
from handover.settings import Settings
from handover.telemetry import get_logger

log = get_logger(__name__)

__all__ = [
    "DONE",
    "FAILED",
    "RECORDED_HEADER",
    "REFUSED",
    "AuditEntry",
    "AuditTrail",
    "AuditedRequest",
    "Way",
    "begin_act",
    "begin_request",
    "current_request",
    "is_recorded",
    "record_deletion",
    "record_request",
]

REPEAT_S: Final = 600.0
MAX_REMEMBERED: Final = 10_000
EXPIRE_EVERY_S: Final = 3600.0
VERSION: Final = 3
NAMES_VERSION: Final = 4
"""The version of the tables of a trail with names."""
MAX_LATE: Final = 10_000
"""Records that wait in memory for room; further ones are only in the log of the service."""
RECORD_TIMEOUT_S: Final = 2.0
"""How long the response of what lowers waits for its record."""
LATE_RETRY_S: Final = 5.0
"""The longest pause between two attempts to write the records that were kept."""

RECORDED_HEADER: Final = "Handover-Recorded"
"""`false` in the response to what lowers and is not recorded yet."""


class AuditTrail:
    """The audit log of `service`, in its database `engine` or in one of its own; a context manager.

    `has_names`: it keeps the names of callers, for persons who ask who looked at their data. `usual_way` is
    that of routes without a decorator.
    """

    def __init__(
        self,
        settings: Settings,
        service: str,
        engine: Engine | None = None,
        *,
        has_names: bool = False,
        usual_way: Way = Way.BEFORE,
    ) -> None:
        self.service = service
        self.usual_way = usual_way
        self._name = service.replace("-", "_")
        self._metadata = MetaData()
        self._tables = AuditTables(
            self._metadata, self._name, has_aliases=True, has_names=has_names, has_intents=True
        )
        self.log = AuditLog(self._tables)
        self._settings = settings
        self._given = engine
        self._engine: Engine | None = None
        self._opening = Lock()
        self._repeated: OrderedDict[tuple[str, str, str], float] = OrderedDict()
        self._tasks = BackgroundTasks(f"audit of {service}")
        self._waiting: list[tuple[AuditEntry, asyncio.Future[int]]] = []
        self._turn = asyncio.Lock()
        self._writing: asyncio.Task[None] | None = None
        self._storing: set[asyncio.Task[bool]] = set()
        self._late: list[AuditEntry] = []
        self._has_late = asyncio.Event()

    async def __aenter__(self) -> Self:
        await asyncio.to_thread(self._opened)
        await self._tasks.__aenter__()
        self._tasks.start_restarting(self._expire)
        self._tasks.start_restarting(self._write_late)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__(None, None, None)
        if self._storing:
            await asyncio.wait(self._storing)
        if self._late:
            await self._write_some_late()
        if self._given is None and self._engine is not None:
            self._engine.dispose()

    def _opened(self) -> Engine:
        """Return the database, with the tables of the log."""
        with self._opening:
            if self._engine is None:
                engine = self._given or connect(self._settings.database(f"{self.service}-audit"))
                names, tables = self._tables.names, self._tables
                migrate(
                    engine,
                    self._metadata,
                    component=f"{self._name}_audit",
                    version=VERSION if names is None else NAMES_VERSION,
                    steps={1: lambda _: None, 2: tables.add_intents, 3: tables.add_names},
                )
                self._engine = engine
            return self._engine

    async def finish(self, act: AuditedRequest, status: int) -> bool:
        """Record an act whose response has `status`, unless its transaction did; return whether it is.

        Raises `Problem` 503 if a read cannot be recorded. A change has happened, or was refused: a record
        of it that cannot be written now is kept, and written later.
        """
        act.is_finished = True
        if not act.is_relevant or (status < 400 and await self._is_recorded(act)):
            return True
        outcome = DONE if status < 400 else REFUSED if status == 403 else FAILED
        if act.intent is None and outcome == FAILED and status < 500:
            return True  # the request was wrong and had no effect
        if act.is_change:
            return await self.store_now_or_later(act.entry(outcome))
        if outcome == DONE:
            await self.store_once([act.entry(outcome)])
        return True

    async def _is_recorded(self, act: AuditedRequest) -> bool:
        """Return whether a transaction has recorded the act; what lowers also counts if that has failed."""
        if not act.is_recorded or act.record is None:
            return False
        if act.way is not Way.AFTER:
            return True
        reading = asyncio.create_task(self.read(partial(self.log.has, seq=act.record, action=act.action)))
        await asyncio.wait({reading}, timeout=RECORD_TIMEOUT_S)
        return reading.done() and reading.exception() is None and bool(reading.result())

    async def store_now_or_later(self, *entries: AuditEntry) -> bool:
        """Record what has happened, now or later; return whether it was recorded within `RECORD_TIMEOUT_S`.

        A database that does not answer must not delay a stop.
        """
        now_ms = time.time_ns() // 1_000_000
        storing = asyncio.create_task(self._stored([replace(entry, at_ms=now_ms) for entry in entries]))
        self._storing.add(storing)
        storing.add_done_callback(self._storing.discard)
        await asyncio.wait({storing}, timeout=RECORD_TIMEOUT_S)
        return storing.done() and storing.result()

    async def _stored(self, entries: Sequence[AuditEntry]) -> bool:
        try:
            await self.store(entries)
        except Problem as problem:
            for entry in entries:
                self._keep(entry, problem)
            return False
        return True

    def _keep(self, entry: AuditEntry, problem: Problem) -> None:
        caller = entry.caller
        log.warning(
            "an act is not recorded yet",
            subject=caller.subject,
            action=entry.action,
            resource=entry.resource,
            outcome=entry.outcome,
            reason=problem.detail,
        )
        if len(self._late) < MAX_LATE:
            self._late.append(entry)
            self._has_late.set()

    async def _write_late(self) -> None:
        backoff = Backoff(max_s=LATE_RETRY_S)
        while True:
            await self._has_late.wait()
            await backoff.wait()
            if await self._write_some_late():
                backoff.reset()

    async def _write_some_late(self) -> bool:
        """Write the records that were kept; return whether the database accepted them."""
        batch = tuple(self._late)
        try:
            await self.store(batch)
        except Problem:
            return False
        del self._late[: len(batch)]
        if not self._late:
            self._has_late.clear()
        log.info("acts are recorded that could not be before", count=len(batch))
        return True

    async def open(self, act: AuditedRequest) -> None:
        """Record that a stream begins. Raises `Problem` 503."""
        if act.is_relevant:
            await self.store([act.entry(DONE)])

    async def record(self, caller: Caller, action: str, resource: str) -> None:
        """Record what is no request to a route. Raises `Problem` 503."""

        def append(connection: Connection) -> None:
            self.log.append(connection, caller.subject, action, resource=resource, method=caller.kind)

        await self.read(append)

    async def store(self, entries: Sequence[AuditEntry]) -> list[int]:
        """Append records; return their numbers. Raises `Problem` 503 if the database does not accept them."""
        loop = asyncio.get_running_loop()
        stored: list[tuple[AuditEntry, asyncio.Future[int]]] = [
            (entry, loop.create_future()) for entry in entries
        ]
        self._waiting += stored
        async with self._turn:
            if self._waiting:
                batch, self._waiting = self._waiting, []
                self._writing = loop.create_task(self._write(batch))
                await asyncio.shield(self._writing)  # others wait for it, too
        results = await asyncio.gather(*(future for _, future in stored), return_exceptions=True)
        for result in results:
            if isinstance(result, BaseException):
                raise result
        return [number for number in results if isinstance(number, int)]

    async def _write(self, batch: Sequence[tuple[AuditEntry, asyncio.Future[int]]]) -> None:
        def append() -> list[int]:
            with self._opened().begin() as connection:
                return [entry.append(self.log, connection) for entry, _ in batch]

        reason = None
        numbers: list[int] = []
        try:
            numbers = await asyncio.to_thread(append)
        except (SQLAlchemyError, UsageError, OSError) as error:
            reason = database_reason(error)
        for position, (_, future) in enumerate(batch):
            if future.done():
                continue  # the request was cancelled
            if reason is None:
                future.set_result(numbers[position])
            else:
                future.set_exception(
                    Problem(
                        503,
                        "Not recorded",
                        f"the audit log cannot be written, so the request is refused: {reason}",
                    )
                )

    async def store_once(self, entries: Sequence[AuditEntry]) -> None:
        """Append records of reads, without those that were recorded in the last `REPEAT_S`.

        Raises `Problem` 503 if the database does not accept them.
        """
        now_s = time.monotonic()
        new = {_read_of(entry): entry for entry in entries if self._read_s(entry) <= now_s - REPEAT_S}
        if not new:
            return
        await self.store(list(new.values()))
        for read in new:
            self._repeated[read] = now_s
            self._repeated.move_to_end(read)
        while len(self._repeated) > MAX_REMEMBERED:
            self._repeated.popitem(last=False)

    def _read_s(self, entry: AuditEntry) -> float:
        return self._repeated.get(_read_of(entry), -math.inf)

    async def _expire(self) -> None:
        days = self._settings.audit_retention_days
        while days:
            await asyncio.to_thread(self._delete_old, days)
            await asyncio.sleep(EXPIRE_EVERY_S)

    def _delete_old(self, days: float) -> None:
        with self._opened().begin() as connection:
            if gone := self.log.expire(connection, int((time.time() - days * 86400) * 1000)):
                self.log.append(connection, self.service, "audit.expired", text=f"{gone} records")

    async def read(self, function: Any) -> Any:
        """Return the result of `function` on a connection."""

        def run() -> Any:
            with self._opened().begin() as connection:
                return function(connection)

        return await asyncio.to_thread(run)


def _read_of(entry: AuditEntry) -> tuple[str, str, str]:
    return entry.caller.subject, entry.action, entry.resource
