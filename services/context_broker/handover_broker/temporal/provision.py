"""Operations that provide, change and delete temporal evolutions (clauses 5.6.11 to 5.6.16).

They change the history only. A current entity is changed by other operations.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any, Final
from urllib.parse import quote

import orjson

from handover.errors import Problem
from handover_broker.model.completion import completed_part
from handover_broker.model.entity import (
    NULL,
    Attributes,
    Entity,
    Instance,
    Terms,
    dataset_of,
    is_deletion,
)
from handover_broker.model.entity_parser import DEFAULT_INSTANCE, expand, read_attribute
from handover_broker.model.problems import bad_request_data, not_found, not_stored
from handover_broker.model.validation import moment, require_name, require_uri, shown, timestamp_now
from handover_broker.operations.entity_operations import DONE, absent
from handover_broker.request.request_context import (
    PREFIX,
    RequestContext,
    Response,
)
from handover_broker.request.routing import Operation
from handover_broker.storage.database import NotStored
from handover_broker.storage.entries import Entries
from handover_broker.storage.history_archive import END_OF_TIME, Archive, HistoryRow, TemporalOnlyRow
from handover_broker.temporal.evolution_parser import ProvidedEvolution, parse_evolution
from handover_broker.temporal.history import (
    SCOPE,
    HistoryRecorder,
    RowContent,
    TemporalOnlyEntity,
    parse_instance_id,
)
from handover_broker.temporal.subjects import Subject, subjects_of
from handover_broker.tenants import Tenant

INSTANCES_PER_ROW: Final = 100
"""Instances of one request in one row; so many are read to find one of them."""
LONG_BODY_BYTES: Final = 256 * 1024
"""From this size on a body is parsed in a thread."""
ROWS_PER_COMMIT: Final = 500
"""Rows that are rewritten or deleted in one commit, so that other commits are not delayed."""

_LOCAL: Final = frozenset({"local"})
_SEEN: Final = "observed_to >= ? AND observed_from <= ?"


class TemporalProvision:
    """Operations that write temporal evolutions."""

    def __init__(self, archive: Archive, recorder: HistoryRecorder | None) -> None:
        self._archive = archive
        self._recorder = recorder or HistoryRecorder()
        self._locks: dict[tuple[str, str], tuple[asyncio.Lock, int]] = {}

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        by_id = "temporal/entities/{id}"
        attribute = f"{by_id}/attrs/{{name}}"
        instance = f"{attribute}/{{instance}}"
        deleting = frozenset({"datasetId", "deleteAll", "local"})
        return (
            Operation(
                "POST",
                "temporal/entities",
                "upsertTemporal",
                "6.18.3.1",
                self.upsert,
                _LOCAL,
                makes_tenant=True,
            ),
            Operation("DELETE", by_id, "deleteTemporal", "6.19.3.2", self.delete, _LOCAL),
            Operation("POST", f"{by_id}/attrs", "appendAttrsTemporal", "6.20.3.1", self.append, _LOCAL),
            Operation(
                "DELETE", attribute, "deleteAttrsTemporal", "6.21.3.1", self.delete_attribute, deleting
            ),
            Operation(
                "PATCH", instance, "updateAttrInstanceTemporal", "6.22.3.1", self.update_instance, _LOCAL
            ),
            Operation(
                "DELETE", instance, "deleteAttrInstanceTemporal", "6.22.3.2", self.delete_instance, _LOCAL
            ),
        )

    async def upsert(self, request: RequestContext) -> Response:
        """POST temporal/entities: add the provided instances to the history of the entity.

        An instance with the observedAt and the datasetId of a stored one replaces it, so that a repeated
        request adds nothing. (POST …/attrs only ever adds.)
        """
        document, context = await request.body()
        provided = await _parsed_evolution(request, document, context.terms)
        if provided.id is None:
            raise bad_request_data('the entity has no "id"; give it a URI such as urn:ngsi-ld:Task:demo:1')
        if not provided.types:
            raise bad_request_data(
                f'the entity {provided.id} has no "type"; name its type, for example "Task"'
            )
        async with self._exclusive(request.tenant, provided.id):
            subject = await self._subject(request.tenant, provided.id)
            await self._add(request.tenant, provided.id, provided, subject, overwrites=True)
        if subject is not None:
            return DONE
        location = f"{PREFIX}temporal/entities/{quote(provided.id, safe=':')}".encode()
        return Response(201, b"", [(b"location", location)])

    async def append(self, request: RequestContext) -> Response:
        """POST temporal/entities/{id}/attrs."""
        document, context = await request.body()
        entity_id = _entity_id(request)
        provided = await _parsed_evolution(request, document, context.terms)
        if provided.id is not None and provided.id != entity_id:
            raise bad_request_data(
                f"the body is about {provided.id}, the path about {entity_id}; agree on one"
            )
        async with self._exclusive(request.tenant, entity_id):
            subject = await self._existing(request.tenant, entity_id)
            await self._add(request.tenant, entity_id, provided, subject)
        return DONE

    async def delete(self, request: RequestContext) -> Response:
        """DELETE temporal/entities/{id}: delete the history."""
        entity_id, tenant = _entity_id(request), request.tenant
        async with self._exclusive(tenant, entity_id):
            subject = await self._existing(tenant, entity_id)
            for entity_seq in subject.entity_seqs:
                while True:
                    bound = await asyncio.to_thread(self._archive.bound_of, entity_seq, ROWS_PER_COMMIT)
                    await _commit(
                        tenant, Entries(cleared=[(entity_seq, END_OF_TIME if bound is None else bound)])
                    )
                    if bound is None:
                        break
            gone = {
                entity_seq: TemporalOnlyRow(tenant.name, entity_id, None)
                for entity_seq in subject.entity_seqs
            }
            await _commit(tenant, Entries(temporal_only=gone))
        return DONE

    async def delete_attribute(self, request: RequestContext) -> Response:
        """DELETE temporal/entities/{id}/attrs/{name}; instances of one datasetId, or all with deleteAll."""
        entity_id, tenant = _entity_id(request), request.tenant
        name = _attribute(request, (await request.reader_context()).terms)
        text = request.parameter("datasetId")
        dataset = None if text in {None, DEFAULT_INSTANCE} else require_uri(text, "datasetId")
        every = request.flag("deleteAll")

        def cut(change: RowContent) -> bool:
            return change.cut(name, lambda instance_dataset: every or instance_dataset == dataset)

        async with self._exclusive(tenant, entity_id):
            subject = await self._existing(tenant, entity_id)
            count = 0
            for entity_seq in subject.entity_seqs:
                after: int | None = -1
                while after is not None:
                    rows, after = await asyncio.to_thread(self._rewritten, entity_seq, after, cut)
                    if rows:
                        count += len(rows)
                        await _commit(tenant, Entries(history=rows))
        if not count:
            which = "no instance" if every else f"no instance with {_dataset_shown(dataset)}"
            raise not_found(
                f"the history of {entity_id} has {which} of the attribute {shown(request.names[1])}"
            )
        return DONE

    async def update_instance(self, request: RequestContext) -> Response:
        """PATCH temporal/entities/{id}/attrs/{name}/{instance}: overwrites members of the instance."""
        document, context = await request.body()
        entity_id, tenant = _entity_id(request), request.tenant
        name = _attribute(request, context.terms)
        if not isinstance(document, dict):
            raise bad_request_data(f"an instance of an attribute is a JSON object, not {shown(document)}")
        if len(document) == 1 and request.names[1] in document:
            document = document[request.names[1]]  # as an attribute in an entity
            if isinstance(document, list) and len(document) == 1:
                document = document[0]
            if not isinstance(document, dict):
                raise bad_request_data(f"a PATCH takes one instance, not {shown(document)}; send an object")
        async with self._exclusive(tenant, entity_id):
            entity_seq, seq, position, change = await self._row(request, entity_id)
            instance = change.find(name, position)
            if instance is None:
                raise _absent_instance(request)
            content = {member: value for member, value in document.items() if member != "@context"}
            part = read_attribute(request.names[1], completed_part(content, instance), context.terms)[0]
            if is_deletion(part):
                raise bad_request_data(
                    "an instance is deleted with DELETE, not by a PATCH; leave the NULL out"
                )
            if dataset_of(part) not in {None, dataset_of(instance)}:
                raise bad_request_data(
                    "an instance keeps its datasetId; leave it out, or add another instance"
                )
            change.put(position, _patched(instance, part))
            await _commit(tenant, Entries(history=[_row(entity_seq, seq, change)]))
        return DONE

    async def delete_instance(self, request: RequestContext) -> Response:
        """DELETE temporal/entities/{id}/attrs/{name}/{instance}."""
        entity_id, tenant = _entity_id(request), request.tenant
        name = _attribute(request, (await request.reader_context()).terms)
        async with self._exclusive(tenant, entity_id):
            entity_seq, seq, position, change = await self._row(request, entity_id)
            if not change.without(name, position):
                raise _absent_instance(request)
            await _commit(tenant, Entries(history=[_row(entity_seq, seq, change)]))
        return DONE

    # Storing

    async def _add(
        self,
        tenant: Tenant,
        entity_id: str,
        provided: ProvidedEvolution,
        subject: Subject | None,
        *,
        overwrites: bool = False,
    ) -> None:
        at = timestamp_now()
        entries = Entries()
        added = provided.stamped(at).attributes
        live = tenant.store.latest(entity_id)
        if live is not None:
            if provided.expires_at is not None:
                raise bad_request_data(
                    f"{entity_id} is current: set its expiresAt with PATCH entities/{{id}}"
                )
            _require_public(tenant, live, provided)
            entity_seq = live.seq
        else:
            entity_seq = subject.entity_seqs[-1] if subject is not None else tenant.store.next_seq()
            existing = (
                TemporalOnlyEntity((), (), at, at, None) if subject is None else subject.as_temporal_only(at)
            )
            existing = replace(
                existing,
                types=tuple(dict.fromkeys((*existing.types, *provided.types))),
                scopes=provided.scopes or existing.scopes,
                expires_at=provided.expires_at or existing.expires_at,
            )
            tenant.store.require_shown(Entity(entity_id, existing.types, {}, at, at))
            entries.temporal_only[entity_seq] = TemporalOnlyRow(tenant.name, entity_id, existing.stored())
        try:
            if overwrites and subject is not None:
                rows, added = await asyncio.to_thread(self._overwritten, subject.entity_seqs, added)
                entries.history += rows
            for number, attributes in enumerate(_pieces(added)):
                if number % 10 == 9:
                    await asyncio.sleep(0)  # serve other requests in between
                entries.history.append(self._recorder.row(entity_seq, RowContent(attributes), at))  # type: ignore[arg-type]  # lists without gaps
        except orjson.JSONEncodeError:
            raise bad_request_data(f"entity {entity_id} is nested too deep; use at most 200 levels") from None
        await _commit(tenant, entries)

    def _overwritten(
        self, entity_seqs: Sequence[int], attributes: Attributes
    ) -> tuple[list[HistoryRow], Attributes]:
        """Replace stored instances by provided ones of the same time.

        Return the changed rows, and the provided instances that replaced nothing.
        """
        new = {
            (name, dataset_of(instance), seen): instance
            for name, several in attributes.items()
            for instance in several
            if (seen := moment(instance.get("observedAt", ""))) is not None
        }
        if not new:
            return [], attributes
        times = [seen for _, _, seen in new]
        within = (min(times) - 1e-6, max(times) + 1e-6)
        rows: list[HistoryRow] = []
        taken: set[int] = set()
        for entity_seq, seq, _, body in self._archive.history(entity_seqs, _SEEN, within, latest_first=True):
            change, before = RowContent.restored(body), len(taken)
            for name, position, stored in list(change.instances(seq)):
                seen = moment(stored.get("observedAt", ""))
                replacement = None if seen is None else new.get((name, dataset_of(stored), seen))
                if replacement is None or id(replacement) in taken or change.find(name, position) is None:
                    continue
                change.put(position, {**replacement, "createdAt": stored["createdAt"]})
                taken.add(id(replacement))
            if len(taken) > before:
                rows.append(_row(entity_seq, seq, change))
            if len(taken) == len(new):
                break
        left = {
            name: [instance for instance in several if id(instance) not in taken]
            for name, several in attributes.items()
        }
        return rows, {name: several for name, several in left.items() if several}

    async def _subject(self, tenant: Tenant, entity_id: str) -> Subject | None:
        temporal_only = await asyncio.to_thread(
            lambda: list(self._archive.temporal_only_entities(tenant.name, entity_id))
        )
        live = tenant.store.latest(entity_id)
        subjects = subjects_of(() if live is None else (live,), temporal_only)
        if subjects:
            tenant.store.require_shown(subjects[0].with_all_types())
        return subjects[0] if subjects else None

    async def _existing(self, tenant: Tenant, entity_id: str) -> Subject:
        subject = await self._subject(tenant, entity_id)
        if subject is None:
            raise absent(entity_id)
        return subject

    async def _row(self, request: RequestContext, entity_id: str) -> tuple[int, int, int, RowContent]:
        """Return the position of the instance in the path, and the change that it is part of."""
        subject = await self._existing(request.tenant, entity_id)
        instance_uri = require_uri(request.names[2], "the instanceId in the path")
        where = parse_instance_id(instance_uri)
        if where is None or where[0] not in subject.entity_seqs:
            raise _absent_instance(request)
        entity_seq, seq, position = where
        rows = await asyncio.to_thread(self._archive.changes_after, entity_seq, seq - 1, 1)
        if not rows or rows[0][0] != seq:
            raise _absent_instance(request)
        return entity_seq, seq, position, RowContent.restored(rows[0][1])

    def _rewritten(
        self, entity_seq: int, after: int, cut: Callable[[RowContent], bool]
    ) -> tuple[list[HistoryRow], int | None]:
        """Return the next rows that `cut` has changed, and the seq to continue after, if any."""
        stored = self._archive.changes_after(entity_seq, after, ROWS_PER_COMMIT)
        changed = [(seq, change) for seq, body in stored if cut(change := RowContent.restored(body))]
        rows = [_row(entity_seq, seq, change) for seq, change in changed]
        return rows, stored[-1][0] if len(stored) == ROWS_PER_COMMIT else None

    @asynccontextmanager
    async def _exclusive(self, tenant: Tenant, entity_id: str) -> AsyncIterator[None]:
        """Serialize changes of the history of one entity."""
        key = (tenant.name, entity_id)
        lock, waiting = self._locks.get(key, (asyncio.Lock(), 0))
        self._locks[key] = (lock, waiting + 1)
        try:
            async with lock:
                yield
        finally:
            lock, waiting = self._locks[key]
            if waiting == 1:
                del self._locks[key]
            else:
                self._locks[key] = (lock, waiting - 1)


async def _parsed_evolution(request: RequestContext, document: Any, terms: Terms) -> ProvidedEvolution:
    """Return the evolution in the body; a long body is parsed in a thread."""
    if len(request.raw) < LONG_BODY_BYTES:
        return parse_evolution(document, terms)
    return await asyncio.to_thread(parse_evolution, document, terms)


async def _commit(tenant: Tenant, entries: Entries) -> None:
    try:
        await tenant.commits.store(entries)
    except NotStored as error:
        raise not_stored(str(error), is_away=error.is_away) from error


def _row(entity_seq: int, seq: int, change: RowContent) -> HistoryRow:
    body = None if change.is_empty() else change.stored()
    return HistoryRow(entity_seq, seq, *change.observed(seq / 1_000_000), 1, body)


def _pieces(attributes: Attributes) -> Iterator[Attributes]:
    """Yield the instances in groups for one row each, ordered by time."""
    instances = [(name, part) for name, several in attributes.items() for part in several]
    if len(instances) > INSTANCES_PER_ROW:
        instances.sort(key=lambda named_instance: moment(named_instance[1].get("observedAt", "")) or 0.0)
    for start in range(0, len(instances), INSTANCES_PER_ROW):
        piece: Attributes = {}
        for name, instance in instances[start : start + INSTANCES_PER_ROW]:
            piece.setdefault(name, []).append(instance)
        yield piece


def _patched(instance: Instance, part: Instance) -> Instance:
    merged = {**instance, **part} if instance["type"] == part["type"] else {**part}
    for member, value in list(merged.items()):
        if value == NULL:
            del merged[member]
        elif ":" in member and isinstance(value, list):
            merged[member] = [remaining for remaining in value if not is_deletion(remaining)]
            if not merged[member]:
                del merged[member]
    if (dataset := dataset_of(instance)) is not None:
        merged["datasetId"] = dataset
    return {**merged, "createdAt": instance["createdAt"], "modifiedAt": timestamp_now()}


def _entity_id(request: RequestContext) -> str:
    return require_uri(request.names[0], "the entity id in the path")


def _attribute(request: RequestContext, terms: Terms) -> str:
    name = require_name(request.names[1], "the attribute name in the path")
    return SCOPE if name == SCOPE else expand(name, terms)


def _dataset_shown(dataset: str | None) -> str:
    return "no datasetId" if dataset is None else f"the datasetId {shown(dataset)}"


def _absent_instance(request: RequestContext) -> Problem:
    entity_id, name, instance = request.names
    return not_found(
        f"the history of {entity_id} has no instance {shown(instance)} of the attribute {shown(name)}; "
        "its temporal representation has the instanceIds"
    )


def _require_public(tenant: Tenant, live: Entity, provided: ProvidedEvolution) -> None:
    """Raise a problem (400) for data about the body of a person in the history of other entities."""
    is_private = tenant.receivers.is_private
    if is_private(live.id, provided.types) and not is_private(live.id, live.types):
        raise bad_request_data(
            f"{live.id} is current and not about the body of a person; add the type to it first, because its "
            "types decide who sees its history"
        )
