"""The record of a request: what a caller does, and when that is recorded; see `audit_trail`."""

from collections.abc import Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Final, Protocol

from sqlalchemy import Connection

from handover.security.audit import INTENDED, AuditLog
from handover.security.caller import Caller, CallerKind
from handover.security.permissions import READING, Permission
from handover.security.resource_patterns import ANY_RESOURCE

DONE, REFUSED, FAILED = "done", "refused", "failed"
_PRIVATE: Final = frozenset({Permission.READ_HEALTH_DATA, Permission.READ_STUDIES})
_UNRECORDED: Final = frozenset({CallerKind.SERVICE, CallerKind.DEVICE})
_current: ContextVar["AuditedRequest | None"] = ContextVar("handover_act", default=None)


class Way(Enum):
    """When a change is recorded."""

    BEFORE = auto()
    """The intent before the act, the outcome after it."""
    WITH_CHANGE = auto()
    """In the transaction of the change."""
    AFTER = auto()
    """After the act, which only lowers."""


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
    intent: int | None = None
    """The number of the intent whose outcome this is."""
    at_ms: int | None = None
    """When it happened; None for the time of the record."""

    def append(self, audit_log: AuditLog, connection: Connection) -> int:
        """Append it to the log in the transaction of `connection`; return its number."""
        return audit_log.append(
            connection,
            self.caller.subject,
            self.action,
            resource=self.resource,
            outcome=self.outcome,
            method=self.method or self.caller.kind,
            text=self.text,
            is_personal=self.is_personal,
            name=None if self.caller.kind is CallerKind.LOCAL else self.caller.name,
            intent=self.intent,
            at_ms=self.at_ms,
        )


class Trail(Protocol):
    """What records a request, such as `AuditTrail`."""

    log: AuditLog
    usual_way: Way

    async def store(self, entries: Sequence[AuditEntry]) -> list[int]:
        """Append records in one transaction; return their numbers. Raises `Problem` 503."""

    async def open(self, act: "AuditedRequest") -> None:
        """Record that a stream begins. Raises `Problem` 503."""


@dataclass(slots=True)
class AuditedRequest:
    """What a caller does with a request; `Requirement` and `Guard` say who the caller is and what for."""

    trail: Trail
    action: str
    path: str
    caller: Caller | None = None
    permission: Permission | None = None
    resource: str = ANY_RESOURCE
    method: str | None = None
    way: Way = field(default=Way.BEFORE, init=False)
    intent: int | None = field(default=None, init=False)
    """The number of the record of the intent."""
    record: int | None = field(default=None, init=False)
    """The number of the last record in a transaction, which may have failed."""
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

    async def begin(self) -> None:
        """Record the intent where that is the way. Raises `Problem` 503; nothing may have been done yet."""
        is_wanted = self.way is Way.BEFORE and self.is_change and self.is_relevant
        if is_wanted and self.intent is None and not self.is_recorded:
            (self.intent,) = await self.trail.store([self.entry(INTENDED)])

    def append(self, connection: Connection) -> None:
        """Append the record in the transaction of `connection`, once in each, until the act is finished.

        A transaction that fails takes its record with it, and another attempt has another transaction.
        """
        transaction = connection.get_transaction()
        if self.is_finished or not self.is_relevant or transaction is self._transaction:
            return
        self._transaction = transaction
        self.is_recorded = True
        self.record = self.entry(DONE).append(self.trail.log, connection)

    def entry(self, outcome: str) -> AuditEntry:
        """Return the record with an outcome."""
        assert self.caller is not None  # noqa: S101 - `is_relevant`
        return AuditEntry(
            self.caller,
            self.action,
            self.resource,
            outcome,
            self.path,
            method=self.method,
            intent=self.intent,
        )


def is_recorded(caller: Caller) -> bool:
    """Return whether the audit trail has acts of this caller: of people, stations and scripts."""
    return caller.kind not in _UNRECORDED


def begin_request(trail: Trail, action: str, path: str) -> AuditedRequest:
    """Begin the record of a request; it is the current one of this task and of threads it starts."""
    act = AuditedRequest(trail, action[:64], path[:400])
    _current.set(act)
    return act


def current_request() -> AuditedRequest | None:
    """Return the act of the current request, if it has an audit trail."""
    return _current.get()


async def begin_act() -> None:
    """Record the intent of the current act, whose permission the handler has required by itself.

    Raises `Problem` 503; the act must not have begun.
    """
    act = _current.get()
    if act is not None:
        await act.begin()


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
