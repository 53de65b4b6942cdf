"""The audit trail of a service: who changed something, and who read data of persons, on every route.

A service gives its `AuditTrail` to `create_app`. Each request to a route with a permission is then recorded:

- a change is recorded with its result, before the response is sent. A service with a database calls
  `record_request(connection)` in the transaction of the change, so that both are committed or neither is;
  otherwise the record has a transaction of its own;
- reading health data or studies is recorded before the response is sent, once in `REPEAT_S` for the same
  caller, route and resource, since pages ask again and again;
- a refused change is recorded too.

A request that cannot be recorded is answered with 503. Services and devices are not recorded: they act for
processes and people whose acts are recorded where they are requested.

Records that wait for the database at the same time share one transaction, so that many requests at once cost
few of them.

The action of a record is the method and the path of the route, the resource is what the permission was
required for, and the text is the path that was requested. A transaction in another thread finds the act by
`asyncio.to_thread`, which copies the context; a queue of changes keeps `current_request()` itself.
"""

import asyncio
import math
import time
from collections import OrderedDict
from collections.abc import Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from threading import Lock
from typing import Any, Final, Self

from sqlalchemy import Connection, Engine, MetaData
from sqlalchemy.exc import SQLAlchemyError

from handover.background_tasks import BackgroundTasks
from handover.database import connect
from handover.errors import Problem, UsageError
from handover.migrations import migrate
from handover.security.audit import AuditLog, AuditTables
from handover.security.caller import Caller, CallerKind
from handover.security.permissions import READING, Permission
from handover.security.resource_patterns import ANY_RESOURCE
from handover.settings import Settings

REPEAT_S: Final = 600.0
MAX_REMEMBERED: Final = 10_000
EXPIRE_EVERY_S: Final = 3600.0
VERSION: Final = 1
NAMES_VERSION: Final = 2
"""The version of the tables of a trail with names."""

DONE, REFUSED, FAILED = "done", "refused", "failed"
_PRIVATE: Final = frozenset({Permission.READ_HEALTH_DATA, Permission.READ_STUDIES})
_UNRECORDED: Final = frozenset({CallerKind.SERVICE, CallerKind.DEVICE})
_current: ContextVar["AuditedRequest | None"] = ContextVar("handover_act", default=None)


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """A record to append. `is_personal`: the resource names a person, so the record has an alias of it."""

    caller: Caller
    action: str
    resource: str
    outcome: str
    text: str
    is_personal: bool = False
    method: str | None = None
    """How the caller was identified; None for the kind of the caller."""

    def append(self, log: AuditLog, connection: Connection) -> None:
        """Append it to `log` in the transaction of `connection`."""
        log.append(
            connection,
            self.caller.subject,
            self.action,
            resource=self.resource,
            outcome=self.outcome,
            method=self.method or self.caller.kind,
            text=self.text,
            is_personal=self.is_personal,
            name=None if self.caller.kind is CallerKind.LOCAL else self.caller.name,
        )


@dataclass(slots=True)
class AuditedRequest:
    """What a caller does with a request; `Requirement` and `Guard` say who the caller is and what for."""

    trail: "AuditTrail"
    action: str
    path: str
    caller: Caller | None = None
    permission: Permission | None = None
    resource: str = ANY_RESOURCE
    method: str | None = None
    is_recorded: bool = field(default=False, init=False)
    is_finished: bool = field(default=False, init=False)
    _transaction: object = field(default=None, init=False)

    @property
    def is_change(self) -> bool:
        """Return whether the permission is one to change something."""
        return self.permission is not None and self.permission not in READING

    @property
    def is_relevant(self) -> bool:
        """Return whether the audit trail has acts of this caller with this permission."""
        if self.caller is None or not is_recorded(self.caller):
            return False
        return self.is_change or self.permission in _PRIVATE

    def append(self, connection: Connection) -> None:
        """Append the record in the transaction of `connection`, once in each, until the act is finished.

        A transaction that fails takes its record with it, and another attempt has another transaction.
        """
        transaction = connection.get_transaction()
        if self.is_finished or not self.is_relevant or transaction is self._transaction:
            return
        self._transaction = transaction
        self.is_recorded = True
        self.entry(DONE).append(self.trail.log, connection)

    def entry(self, outcome: str) -> AuditEntry:
        """Return the record with an outcome."""
        assert self.caller is not None  # noqa: S101 - `is_relevant`
        return AuditEntry(self.caller, self.action, self.resource, outcome, self.path, method=self.method)


def is_recorded(caller: Caller) -> bool:
    """Return whether the audit trail has acts of this caller: of people, stations and scripts."""
    return caller.kind not in _UNRECORDED


def begin_request(trail: "AuditTrail", action: str, path: str) -> AuditedRequest:
    """Begin the record of a request; it is the current one of this task and of threads it starts."""
    act = AuditedRequest(trail, action[:64], path[:400])
    _current.set(act)
    return act


def current_request() -> AuditedRequest | None:
    """Return the act of the current request, if it has an audit trail."""
    return _current.get()


def record_request(connection: Connection, act: AuditedRequest | None = None) -> None:
    """Record the current act (or `act`) in the transaction of `connection`; none outside of a request."""
    act = act or _current.get()
    if act is not None and act.is_change:
        act.append(connection)


def record_deletion(connection: Connection) -> None:
    """Record the current act, which deletes a Person, and forget the Person's name."""
    act = _current.get()
    if act is not None:
        record_request(connection)
        act.trail.log.forget(connection, act.resource)


class AuditTrail:
    """The audit log of `service`, in its database `engine` or in one of its own; a context manager.

    `has_names`: it keeps the names of callers, for persons who ask who looked at their data.
    """

    def __init__(
        self, settings: Settings, service: str, engine: Engine | None = None, *, has_names: bool = False
    ) -> None:
        self.service = service
        self._name = service.replace("-", "_")
        self._metadata = MetaData()
        self._tables = AuditTables(self._metadata, self._name, has_aliases=True, has_names=has_names)
        self.log = AuditLog(self._tables)
        self._settings = settings
        self._given = engine
        self._engine: Engine | None = None
        self._opening = Lock()
        self._repeated: OrderedDict[tuple[str, str, str], float] = OrderedDict()
        self._tasks = BackgroundTasks(f"audit of {service}")
        self._waiting: list[tuple[AuditEntry, asyncio.Future[None]]] = []
        self._turn = asyncio.Lock()
        self._writing: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        await asyncio.to_thread(self._opened)
        await self._tasks.__aenter__()
        self._tasks.start_restarting(self._expire)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__(None, None, None)
        if self._given is None and self._engine is not None:
            self._engine.dispose()

    def _opened(self) -> Engine:
        """Return the database, with the tables of the log."""
        with self._opening:
            if self._engine is None:
                engine = self._given or connect(self._settings.database(f"{self.service}-audit"))
                names = self._tables.names
                migrate(
                    engine,
                    self._metadata,
                    component=f"{self._name}_audit",
                    version=VERSION if names is None else NAMES_VERSION,
                    steps={} if names is None else {VERSION: names.create},
                )
                self._engine = engine
            return self._engine

    async def finish(self, act: AuditedRequest, status: int) -> None:
        """Record an act whose response has `status`, unless its transaction did. Raises `Problem` 503."""
        act.is_finished = True
        if not act.is_relevant or (act.is_recorded and status < 400):
            return
        outcome = DONE if status < 400 else REFUSED if status == 403 else FAILED
        if outcome == FAILED and status < 500:
            return  # the request was wrong and had no effect
        if act.is_change:
            await self.store([act.entry(outcome)])
        elif outcome == DONE:
            await self.store_once([act.entry(outcome)])

    async def open(self, act: AuditedRequest) -> None:
        """Record that a stream begins. Raises `Problem` 503."""
        if act.is_relevant:
            await self.store([act.entry(DONE)])

    async def record(self, caller: Caller, action: str, resource: str) -> None:
        """Record what is no request to a route. Raises `Problem` 503."""

        def append(connection: Connection) -> None:
            self.log.append(connection, caller.subject, action, resource=resource, method=caller.kind)

        await self.read(append)

    async def store(self, entries: Sequence[AuditEntry]) -> None:
        """Append records. Raises `Problem` 503 if the database does not accept them."""
        loop = asyncio.get_running_loop()
        stored = [(entry, loop.create_future()) for entry in entries]
        self._waiting += stored
        async with self._turn:
            if self._waiting:
                batch, self._waiting = self._waiting, []
                self._writing = loop.create_task(self._write(batch))
                await asyncio.shield(self._writing)  # others wait for it, too
        for _, future in stored:
            await future

    async def _write(self, batch: Sequence[tuple[AuditEntry, asyncio.Future[None]]]) -> None:
        def append() -> None:
            with self._opened().begin() as connection:
                for entry, _ in batch:
                    entry.append(self.log, connection)

        reason = None
        try:
            await asyncio.to_thread(append)
        except (SQLAlchemyError, UsageError) as error:
            reason = str(getattr(error, "orig", error)).strip().splitlines()[0]
        for _, future in batch:
            if future.done():
                continue  # the request was cancelled
            if reason is None:
                future.set_result(None)
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
        new = {_read_of(one): one for one in entries if self._read_s(one) <= now_s - REPEAT_S}
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
