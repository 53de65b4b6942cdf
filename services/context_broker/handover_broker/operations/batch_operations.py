"""Operations on many entities in one request, each with its own result (clauses 5.6.7 to 5.6.10, 6.14 ff)."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover_broker.model import changes
from handover_broker.model.changes import Outcome
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity, Event
from handover_broker.model.entity_parser import Nulls, read_change, read_entity
from handover_broker.model.negotiation import WITH_GEO_JSON
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import require_uri, shown, timestamp_now
from handover_broker.operations.entity_operations import (
    DONE,
    FORMS,
    absent,
    bare,
    creation,
    is_simplified,
    read_merge,
)
from handover_broker.query.query_document import query_parameters, selectors_of
from handover_broker.request.entity_query import answered, entity_query_of
from handover_broker.request.query_parameters import (
    LINK_PARAMETERS,
    MAP_PARAMETERS,
    VIEW_PARAMETERS,
    WALK_PARAMETERS,
    options_of,
)
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.request.routing import Operation, brief
from handover_broker.storage.store import Store

MAX_ENTITIES: Final = 10_000
_LOCAL: Final = frozenset({"local"})
_WRITE: Final = _LOCAL | {"options", "format"}
_UPSERTING: Final = frozenset({"update", "replace"})
_UPDATING: Final = frozenset({"noOverwrite"}) | _UPSERTING
"""Clients send update and replace, which are options of an upsert: an update overwrites anyway."""


@dataclass(frozen=True, slots=True)
class _Change:
    """A started change; without `outcome` there was nothing to do, `refusal` is what was not done."""

    entity_id: str
    outcome: asyncio.Future[None] | None
    is_new: bool = False
    refusal: Problem | None = None


@dataclass(slots=True)
class _BatchResult:
    """The results of the entities of one request."""

    created: list[str] = field(default_factory=list)
    succeeded: list[str] = field(default_factory=list)
    errors: list[dict[str, Any]] = field(default_factory=list)
    on_their_way: list[_Change] = field(default_factory=list)

    def refuse(self, entity_id: Any, problem: Problem) -> None:
        """Add a refused entity."""
        self.errors.append({"entityId": entity_id, "error": problem.body()})

    async def settle(self) -> None:
        """Wait until every started change is durable or has failed."""
        for change in self.on_their_way:
            try:
                if change.outcome is not None:
                    await change.outcome
                if change.refusal is not None:
                    raise change.refusal
            except Problem as problem:
                self.refuse(change.entity_id, problem)
            else:
                self.succeeded.append(change.entity_id)
                if change.is_new:
                    self.created.append(change.entity_id)

    def answer(self, all_well: Response) -> Response:
        """Return `all_well` if nothing was refused, else 207 with the successes and the errors."""
        if not self.errors:
            return all_well
        body = orjson.dumps({"success": self.succeeded, "errors": self.errors})
        return Response(207, body, [(b"content-type", b"application/json")])


class BatchOperations:
    """Operations on many entities."""

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        at = "entityOperations"
        asking = VIEW_PARAMETERS | WALK_PARAMETERS | LINK_PARAMETERS
        return brief(
            Operation(
                "POST", f"{at}/create", "createBatch", "6.14.3.1", self.create, _WRITE, makes_tenant=True
            ),
            Operation(
                "POST", f"{at}/upsert", "upsertBatch", "6.15.3.1", self.upsert, _WRITE, makes_tenant=True
            ),
            Operation("POST", f"{at}/update", "updateBatch", "6.16.3.1", self.update, _WRITE),
            Operation("POST", f"{at}/delete", "deleteBatch", "6.17.3.1", self.delete, _LOCAL),
            Operation("POST", f"{at}/query", "queryBatch", "6.23.3.1", self.query, asking | MAP_PARAMETERS),
            Operation("POST", f"{at}/merge", "mergeBatch", "6.31.3.1", self.merge, _WRITE),
        )

    async def create(self, request: RequestContext) -> Response:
        """POST entityOperations/create."""
        result = await self._each(request, self._create)
        return result.answer(_created(result.created))

    async def upsert(self, request: RequestContext) -> Response:
        """POST entityOperations/upsert; options=update keeps attributes that are not in the body."""
        options = _UPSERTING.intersection(options_of(request, FORMS | _UPSERTING))
        if len(options) > 1:
            raise bad_request_data("options is update or replace, not both")
        keeps = options == {"update"}
        result = await self._each(
            request,
            lambda store, document, context: self._upsert(store, document, context, keeps=keeps),
            _UPSERTING,
        )
        return result.answer(_created(result.created) if result.created else DONE)

    async def update(self, request: RequestContext) -> Response:
        """POST entityOperations/update; options=noOverwrite leaves existing attributes unchanged."""
        options = _UPDATING.intersection(options_of(request, FORMS | _UPDATING))
        if len(options) > 1:
            raise bad_request_data("options is noOverwrite, or else replace or update, which change nothing")
        overwrite = "noOverwrite" not in options
        result = await self._each(
            request,
            lambda store, document, context: self._append(store, document, context, overwrite=overwrite),
            _UPDATING,
        )
        return result.answer(DONE)

    async def merge(self, request: RequestContext) -> Response:
        """POST entityOperations/merge."""
        return (await self._each(request, self._merge)).answer(DONE)

    async def delete(self, request: RequestContext) -> Response:
        """POST entityOperations/delete with a list of ids."""
        request.content_type()
        result, store = _BatchResult(), request.tenant.store
        for listed_id in _as_list(request.document(), "entity ids"):
            try:
                entity_id = require_uri(listed_id, "an entity id")
                result.on_their_way.append(self._delete(store, entity_id))
            except Problem as problem:
                result.refuse(listed_id, problem)
        await result.settle()
        return result.answer(DONE)

    async def query(self, request: RequestContext) -> Response:
        """POST entityOperations/query with a Query document (clause 5.2.23)."""
        request.accept(WITH_GEO_JSON)
        document, context = await request.body()
        parameters = {**request.parameters, **query_parameters(document)}
        original, request.parameters = request.parameters, parameters
        asking = entity_query_of(request, parameters, context, selectors_of(document, context))
        request.parameters = (
            original  # the links to other pages have the query of the URL; the body is sent again
        )
        return await answered(request, request.tenant.store, asking)

    async def _each(
        self,
        request: RequestContext,
        act: Callable[[Store, Any, Context], _Change],
        others: frozenset[str] = frozenset(),
    ) -> _BatchResult:
        """Apply `act` to each document; `others` are options of the operation besides forms."""
        if is_simplified(request, others):
            act = partial(_from_simplified, act)
        media_type = request.content_type()
        request.require_no_link(media_type)
        documents = _as_list(request.document(), "entities")
        result = _BatchResult()
        for document in documents:
            try:
                context = await request.context_of(document, media_type)
                result.on_their_way.append(act(request.tenant.store, document, context))
            except Problem as problem:
                result.refuse(document.get("id") if isinstance(document, dict) else None, problem)
        await result.settle()
        return result

    @staticmethod
    def _delete(store: Store, entity_id: str) -> _Change:
        before = store.latest(entity_id)
        if before is None:
            raise absent(entity_id)
        return _Change(entity_id, store.stage(Event.end_of(before)))

    @staticmethod
    def _create(store: Store, document: Any, context: Context) -> _Change:
        change = read_entity(document, context.terms)
        return _Change(change.id or "", store.stage(creation(store, change)), is_new=True)

    def _upsert(self, store: Store, document: Any, context: Context, *, keeps: bool) -> _Change:
        before = self._known(store, document)
        if before is None:
            return self._create(store, document, context)
        if keeps:
            change = read_change(document, context.terms, Nulls.ATTRIBUTES)
            return self._carry_out(store, before, changes.appended(before, change, timestamp_now()))
        change = read_entity(document, context.terms)
        return self._carry_out(store, before, changes.replaced(before, change, timestamp_now()))

    def _append(self, store: Store, document: Any, context: Context, *, overwrite: bool) -> _Change:
        change = read_change(
            document, context.terms, Nulls.ATTRIBUTES
        )  # checked before its existence (5.6.9.4)
        before = self._existing(store, document)
        outcome = changes.appended(before, change, timestamp_now(), overwrite=overwrite)
        if outcome.refused:
            names = ", ".join(outcome.refused)
            refusal = bad_request_data(f"attributes {names} were left unchanged: {changes.PRESENT}")
            return replace(self._carry_out(store, before, outcome), refusal=refusal)
        return self._carry_out(store, before, outcome)

    def _merge(self, store: Store, document: Any, context: Context) -> _Change:
        before = self._known(store, document)
        if before is None:
            read_change(document, context.terms, Nulls.VALUES)  # checked before its existence (5.6.20.4)
            raise absent(id_of(document))
        change = read_merge(document, before, context)
        return self._carry_out(store, before, changes.merged(before, change, timestamp_now()))

    def _existing(self, store: Store, document: Any) -> Entity:
        before = self._known(store, document)
        if before is None:
            raise absent(id_of(document))
        return before

    @staticmethod
    def _known(store: Store, document: Any) -> Entity | None:
        """Return the entity of a document, as the last write left it; None if there is none."""
        return store.latest(id_of(document))

    @staticmethod
    def _carry_out(store: Store, before: Entity, outcome: Outcome) -> _Change:
        if outcome.entity is before:
            return _Change(before.id, None)
        return _Change(before.id, store.stage(Event(before, outcome.entity, outcome.touched)))


def _created(ids: list[str]) -> Response:
    return Response(201, orjson.dumps(ids), [(b"content-type", b"application/json")])


def _from_simplified(
    act: Callable[[Store, Any, Context], _Change], store: Store, document: Any, context: Context
) -> _Change:
    return act(store, bare(document, context, store.latest(id_of(document))), context)


def id_of(document: Any) -> str:
    """Return the id of an entity in a batch; raise a problem if there is none."""
    if not isinstance(document, dict):
        raise bad_request_data(f"an entity is a JSON object, not {shown(document)}")
    entity_id = document["id"] if "id" in document else document.get("@id")
    if entity_id is None:
        raise bad_request_data('an entity in a batch has an "id"; add it')
    return require_uri(entity_id, "the entity id")


def _as_list(document: Any, what: str) -> list[Any]:
    if not isinstance(document, list) or not document:
        raise bad_request_data(f"the body is a list of {what} with at least one element")
    if len(document) > MAX_ENTITIES:
        raise bad_request_data(f"the body holds {len(document)} {what}; {MAX_ENTITIES} are taken at once")
    if None in document:
        raise bad_request_data(f"the list of {what} has null in it; nothing was done, send it without")
    return document
