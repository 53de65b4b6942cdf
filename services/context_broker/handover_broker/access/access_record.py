"""The audit trail of the broker: who changes entities, and who reads data about the body of a person.

The store of a recorded caller notes what a request reads and changes; the records are appended before the
response is sent. Before a change its intent is recorded, so that one that cannot be recorded is refused and
changes nothing; a request to pause or cancel a Task is carried out all the same, and its response says so in
a header. Of services and devices, and of the local owner in whose name services act without accounts,
nothing is noted, so that their requests cost nothing.

A record about the body of a person names the Person of `refPerson` by an alias, and any other resource that
names a person has one, too. An alias is deleted with its entity: the log then names nobody, and its chain
stays verifiable. Aliases without an entity are searched at each start, since a deletion may be interrupted.
"""

import asyncio
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import Any, Final

import orjson
from sqlalchemy import Connection

from handover.runtime.background_tasks import BackgroundTasks
from handover.security.audit import INTENDED, AuditLog
from handover.security.audit_trail import DONE, FAILED, REFUSED, AuditEntry, AuditTrail, is_recorded
from handover.security.caller import LOCAL_OWNER, Caller
from handover.security.resource_patterns import ANY_RESOURCE
from handover.settings import Settings
from handover.telemetry import get_logger
from handover_broker.access.operation_access import OperationAccess, access_of
from handover_broker.access.rights import PERSON, Rights, resource_prefix
from handover_broker.model.entity import Entity, Event
from handover_broker.model.personal_data import is_of, person_of, short_name, type_in
from handover_broker.request.request_context import Request
from handover_broker.request.routing import Operation
from handover_broker.tenants import Tenants
from handover_datamodels.states import RequestedStatus

log = get_logger(__name__)

SERVICE: Final = "context-broker"
MAX_NAMED: Final = 50
"""Entities of one request that are named; the record of the others names everything."""
_READING_METHODS: Final = frozenset({"GET", "HEAD"})
_REQUESTED: Final = b"requestedStatus"


class AccessRecord:
    """What one request reads and changes; see `Recording`."""

    def __init__(
        self, rights: Rights, operation: Operation, request: Request, names: tuple[str, ...]
    ) -> None:
        self._rights = rights
        self._operation = operation
        self._request = request
        self._names = names
        access = access_of(operation)
        self.is_change = access is OperationAccess.WRITE_ENTITIES or (
            access is OperationAccess.MANAGE_TENANT and request.method not in _READING_METHODS
        )
        self.is_lowering = self.is_change and _only_lowers(names, request)
        self.intent: int | None = None
        """The number of the record of the intent."""
        self._read: dict[str, None] = {}
        self._changed: dict[str, bool] = {}
        self._refused: dict[str, bool] = {}

    def note_read(self, entities: Iterable[Entity]) -> None:
        """Note the entities about the body of a person."""
        for entity in entities:
            if self._rights.is_private(entity.id, entity.types):
                self._read[self._personal(entity)] = None

    def note_change(self, event: Event, *, is_refused: bool) -> None:
        """Note a change, or that it was refused."""
        entity = event.after or event.before
        assert entity is not None  # noqa: S101 - a change has at least one end
        noted = self._refused if is_refused else self._changed
        if self._rights.is_private(entity.id, entity.types):
            noted[self._personal(entity)] = True
        else:
            noted[self._rights.prefix + entity.id] = is_of(entity, frozenset({PERSON}))

    def entries(self, status: int) -> Iterator[AuditEntry]:
        """Yield the records of a request whose response has `status`."""
        if not self.is_change:
            if status < 400:
                if b"ngsild-snapshot" in self._request.headers:
                    yield self._entry(ANY_RESOURCE, DONE, is_personal=False)
                yield from self._named(dict.fromkeys(self._read, True), DONE)
            return
        if status < 400:
            yield from self._named(self._changed, DONE)
            yield from self._named(self._refused, REFUSED)
            if not self._changed and not self._refused:
                yield self._without_entities(DONE)
        elif status == 403:
            if self._refused:
                yield from self._named(self._refused, REFUSED)
            else:
                yield self._without_entities(REFUSED)
        elif status >= 500 or self.intent is not None:
            yield self._without_entities(FAILED)

    def intended(self) -> AuditEntry:
        """Return the record of the intent."""
        return self._without_entities(INTENDED)

    def _named(self, resources: dict[str, bool], outcome: str) -> Iterator[AuditEntry]:
        for number, (resource, is_personal) in enumerate(resources.items()):
            if number == MAX_NAMED:
                yield self._entry(self._rights.everything, outcome, is_personal=False)
                return
            yield self._entry(resource, outcome, is_personal=is_personal)

    def _without_entities(self, outcome: str) -> AuditEntry:
        """Return the record of a change that reached no entity: forwarded, refused, or of another kind."""
        entity_id = self._names[0] if self._names else _first_id(self._request.body)
        if entity_id is None:
            return self._entry(self._rights.everything, outcome, is_personal=False)
        kind = type_in(entity_id)
        is_personal = kind == PERSON or kind in self._rights.health_types
        return self._entry(self._rights.prefix + entity_id, outcome, is_personal=is_personal)

    def _entry(self, resource: str, outcome: str, *, is_personal: bool) -> AuditEntry:
        return AuditEntry(
            self._rights.caller,
            self._operation.title[:64],
            resource,
            outcome,
            self._request.path[:400],
            is_personal,
            intent=self.intent,
        )

    def _personal(self, entity: Entity) -> str:
        return self._rights.prefix + (person_of(entity) or entity.id)


def _only_lowers(names: tuple[str, ...], request: Request) -> bool:
    """Return whether a request does no more than ask for the pause or the cancellation of a Task."""
    if not names or (_REQUESTED not in request.body and _REQUESTED not in request.raw_path):
        return False  # it names no entity in its path, or is about something else
    try:
        document: Any = orjson.loads(request.body)
    except orjson.JSONDecodeError:
        return False
    if not isinstance(document, dict):
        return False
    attribute = document if names and names[-1] == _REQUESTED.decode() else document.get(_REQUESTED.decode())
    others = {} if attribute is document else document
    if others.keys() - {_REQUESTED.decode(), "@context", "id", "type"}:
        return False
    value = attribute.get("value") if isinstance(attribute, dict) else attribute
    return isinstance(value, str) and value in {RequestedStatus.PAUSED, RequestedStatus.CANCELLED}


def _first_id(body: bytes) -> str | None:
    """Return the id of the entity in a body, or of the only one in a list."""
    try:
        document: Any = orjson.loads(body)
    except orjson.JSONDecodeError:
        return None
    if isinstance(document, list):
        document = document[0] if len(document) == 1 else None
    entity_id = document.get("id") if isinstance(document, dict) else document
    return entity_id if isinstance(entity_id, str) else None


class AccessLog:
    """The audit trail of the broker; `start` and `stop` begin and end its background work."""

    def __init__(self, settings: Settings, tenants: Tenants, health_types: frozenset[str]) -> None:
        self.trail = AuditTrail(settings, SERVICE)
        self._tenants = tenants
        self._own_tenant = settings.broker_tenant or ""
        self._personal_types = health_types | {PERSON}
        self._tasks = BackgroundTasks("access log")
        self._has_deletions = asyncio.Event()
        self._starting = asyncio.Lock()
        self._is_started = False

    async def start(self) -> None:
        """Open the log; without accounts nothing is recorded, and it is opened with the first record."""
        async with self._starting:
            if self._is_started:
                return
            self._is_started = True
            await self.trail.__aenter__()
            await self._tasks.__aenter__()
            self._has_deletions.set()
            self._tenants.on_deletion = self._note_deletion
            self._tasks.start_restarting(self._forget_deleted)

    async def stop(self) -> None:
        """Close the log."""
        if self._is_started:
            self._is_started = False
            await self._tasks.__aexit__()
            await self.trail.__aexit__()

    @staticmethod
    def has_records_of(caller: Caller) -> bool:
        """Return whether the requests of a caller are recorded."""
        return caller is not LOCAL_OWNER and is_recorded(caller)

    async def record_sent(self, entries: Sequence[AuditEntry]) -> None:
        """Record what was sent to an owner, once in a while for each person. Raises `Problem` 503."""
        await self.start()
        await self.trail.store_once(entries)

    async def begin(self, record: AccessRecord) -> None:
        """Record the intent of a change. Raises `Problem` 503 if that is not possible."""
        if not record.is_lowering:
            if not self._is_started:
                await self.start()
            (record.intent,) = await self.trail.store([record.intended()])

    async def finish(self, record: AccessRecord, status: int) -> bool:
        """Record what a request has done; return whether that was possible now.

        Raises `Problem` 503 if a read cannot be recorded; a change has happened, and is recorded later.
        """
        entries = list(record.entries(status))
        if not entries:
            return True
        if not self._is_started:
            await self.start()
        if record.is_change:
            return await self.trail.store_now_or_later(*entries)
        await self.trail.store_once(entries)
        return True

    def _note_deletion(self, _: str, entity: Entity) -> None:
        if is_of(entity, self._personal_types):
            self._has_deletions.set()

    async def _forget_deleted(self) -> None:
        """Delete the aliases of persons and of entities about them that are no longer in the broker."""
        while True:
            await self._has_deletions.wait()
            self._has_deletions.clear()
            names = await self.trail.read(self.trail.log.aliased)
            gone = self._without_entity(names)
            if gone:
                await self.trail.read(partial(_forget, self.trail.log, gone))
                log.info("deleted persons are no longer named in the audit log", count=len(gone))

    def _without_entity(self, names: Iterable[str]) -> list[str]:
        missing = [name for name in names if not self._is_entity(name)]
        if not missing:
            return []
        mentioned = {
            self._prefix(tenant.name) + person
            for tenant in self._tenants
            for entity in tenant.store.entities_of(lambda kind: short_name(kind) in self._personal_types)
            if (person := person_of(entity)) is not None
        }
        return [name for name in missing if name not in mentioned]

    def _is_entity(self, name: str) -> bool:
        return any(
            name.startswith(prefix := self._prefix(tenant.name))
            and tenant.store.get(name.removeprefix(prefix)) is not None
            for tenant in self._tenants
        )

    def _prefix(self, tenant: str) -> str:
        return resource_prefix(tenant, self._own_tenant)


def _forget(audit_log: AuditLog, names: Iterable[str], connection: Connection) -> None:
    for name in names:
        audit_log.forget(connection, name)
