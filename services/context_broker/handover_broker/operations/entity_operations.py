"""Operations on one entity, and the query for many (clauses 6.4 to 6.7, 5.6 and 5.7)."""

from typing import Any, Final
from urllib.parse import quote

import orjson

from handover.errors import Problem
from handover_broker.model import changes
from handover_broker.model.changes import Outcome
from handover_broker.model.completion import completed, completed_part, instance_for, normalized
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity, Event, Instance
from handover_broker.model.entity_parser import (
    DEFAULT_INSTANCE,
    Change,
    Nulls,
    expand,
    nulls_in,
    read_attribute,
    read_change,
    read_entity,
    refuse_nulls,
)
from handover_broker.model.negotiation import WITH_GEO_JSON
from handover_broker.model.problems import (
    already_exists,
    bad_request_data,
    invalid_request,
    not_found,
)
from handover_broker.model.representation.rendering import render
from handover_broker.model.validation import (
    require_name,
    require_time,
    require_uri,
    shown,
    timestamp_now,
)
from handover_broker.operations.purge import PURGE_PARAMETERS, purge
from handover_broker.query.earlier_names import with_earlier_names
from handover_broker.query.type_selection import type_selection
from handover_broker.request.entity_query import answered, entity_query_of, join_of
from handover_broker.request.entity_responses import Showing, entity_answer
from handover_broker.request.query_parameters import (
    LINK_PARAMETERS,
    MAP_PARAMETERS,
    QUERY_PARAMETERS,
    VIEW_PARAMETERS,
    options_of,
    view_of,
)
from handover_broker.request.request_context import JSON, PREFIX, RequestContext, Response
from handover_broker.request.routing import Operation, brief
from handover_broker.storage.store import Store

DONE: Final = Response(204)
_AT: Final = f"{PREFIX}entities/".encode()
_AS_IT_IS: Final = b"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_.-~:"
"""Characters that need no percent-encoding in a path."""
_FORM: Final = frozenset({"options", "format"})
_CREATE: Final = _FORM | {"local"}
_RETRIEVE: Final = VIEW_PARAMETERS | LINK_PARAMETERS | {"local", "type"}
_ONE: Final = frozenset({"type", "local"})
_WRITE: Final = _ONE | _FORM
_DELETE_ATTR: Final = _ONE | {"datasetId", "deleteAll"}
_MERGE: Final = _WRITE | {"observedAt", "lang"}
FORMS: Final = frozenset({"normalized", "concise", "simplified", "keyValues"})
_SIMPLIFIED: Final = frozenset({"simplified", "keyValues"})


class EntityOperations:
    """Operations on single entities."""

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        by_id, attributes, attribute = "entities/{id}", "entities/{id}/attrs", "entities/{id}/attrs/{name}"
        return brief(
            Operation("POST", "entities", "createEntity", "6.4.3.1", self.create, _CREATE, True),
            Operation(
                "GET", "entities", "queryEntity", "6.4.3.2", self.query, QUERY_PARAMETERS | MAP_PARAMETERS
            ),
            Operation("DELETE", "entities", "purgeEntity", "6.4.3.3", self.purge, PURGE_PARAMETERS),
            Operation("GET", by_id, "retrieveEntity", "6.5.3.1", self.retrieve, _RETRIEVE | MAP_PARAMETERS),
            Operation("DELETE", by_id, "deleteEntity", "6.5.3.2", self.delete, _ONE),
            Operation("PUT", by_id, "replaceEntity", "6.5.3.3", self.replace, _WRITE),
            Operation("PATCH", by_id, "mergeEntity", "6.5.3.4", self.merge, _MERGE),
            Operation("POST", attributes, "appendAttrs", "6.6.3.1", self.append, _WRITE),
            Operation("PATCH", attributes, "updateEntity", "6.6.3.2", self.update, _WRITE),
            Operation("PATCH", attribute, "updateAttrs", "6.7.3.1", self.update_attribute, _ONE),
            Operation("DELETE", attribute, "deleteAttrs", "6.7.3.2", self.delete_attribute, _DELETE_ATTR),
            Operation("PUT", attribute, "replaceAttrs", "6.7.3.3", self.replace_attribute, _ONE),
        )

    async def create(self, request: RequestContext) -> Response:
        """POST entities."""
        simplified = is_simplified(request)
        document, context = await request.body()
        nulls = nulls_in(request.raw, Nulls.NOWHERE)
        change = read_entity(bare(document, context) if simplified else document, context.terms, nulls)
        store = request.tenant.store
        await store.stage(creation(store, change))
        return Response(201, b"", [(b"location", _location(change.id or ""))])

    async def query(self, request: RequestContext) -> Response:
        """GET entities."""
        request.accept(WITH_GEO_JSON)
        context = await request.reader_context()
        asking = entity_query_of(request, request.parameters, context)
        return await answered(request, request.tenant.store, asking)

    async def purge(self, request: RequestContext) -> Response:
        """DELETE entities."""
        return await purge(request)

    async def retrieve(self, request: RequestContext) -> Response:
        """GET entities/{id}."""
        request.accept(WITH_GEO_JSON)
        context = await request.reader_context()
        entity_id = request.names[0]
        entity = request.tenant.store.get(entity_id)
        if entity is not None and len(entity.types) == 1:
            context = with_earlier_names(context, entity.types[0])
        view = view_of(request, context)
        join = join_of(request.parameters, view)
        if entity is None:
            raise absent(require_uri(entity_id, "the entity id in the path"))
        _require_type(request, entity, context)
        if view.attributes is not None and view.attributes.isdisjoint(entity.attributes):
            raise not_found(f"entity {entity_id} has none of the attributes {request.parameter('attrs')}")
        if view.projection is not None and not render(entity, context.terms, view):
            raise nothing_left(entity_id)
        store = request.tenant.store
        return entity_answer(request, entity, Showing(context, view, join, store.get))

    async def delete(self, request: RequestContext) -> Response:
        """DELETE entities/{id}."""
        context = await request.reader_context() if request.parameters else None
        await request.tenant.store.stage(Event.end_of(self.existing(request, context)))
        return DONE

    async def replace(self, request: RequestContext) -> Response:
        """PUT entities/{id}."""
        simplified = is_simplified(request)
        document, context = await request.body()
        before = self.existing(request, context)
        if simplified:
            document = bare(document, context, before)
        change = _about(request, read_change(document, context.terms, nulls_in(request.raw, Nulls.NOWHERE)))
        await self._carry_out(request, changes.replaced(before, change, timestamp_now()))
        return DONE

    async def merge(self, request: RequestContext) -> Response:
        """PATCH entities/{id}: other attributes stay, NULL deletes, objects as values are merged."""
        simplified = is_simplified(request)
        observed_at, language = request.parameter("observedAt"), request.parameter("lang")
        if observed_at is not None:
            observed_at = require_time(observed_at, "observedAt in the query")
        document, context = await request.body()
        before = self.existing(request, context)
        change = _about(request, read_merge(document, before, context, language, simplified=simplified))
        await self._carry_out(request, changes.merged(before, change, timestamp_now(), observed_at))
        return DONE

    async def append(self, request: RequestContext) -> Response:
        """POST entities/{id}/attrs."""
        overwrite = "noOverwrite" not in options_of(request, FORMS | {"noOverwrite"})
        simplified = is_simplified(request, frozenset({"noOverwrite"}))
        document, context = await request.body()
        before = self.existing(request, context)
        if simplified:
            document = bare(document, context, before)
        change = _about(request, read_change(document, context.terms, nulls_in(request.raw, Nulls.NOWHERE)))
        outcome = changes.appended(before, change, timestamp_now(), overwrite=overwrite)
        await self._carry_out(request, outcome)
        return _update_result(change, outcome)

    async def update(self, request: RequestContext) -> Response:
        """PATCH entities/{id}/attrs."""
        simplified = is_simplified(request)
        document, context = await request.body()
        before = self.existing(request, context)
        if simplified:
            document = bare(document, context, before)
        change = _about(
            request, read_change(document, context.terms, nulls_in(request.raw, Nulls.ATTRIBUTES))
        )
        outcome = changes.updated(before, change, timestamp_now())
        await self._carry_out(request, outcome)
        return DONE

    async def update_attribute(self, request: RequestContext) -> Response:
        """PATCH entities/{id}/attrs/{name}: overwrites members of the attribute."""
        document, context = await request.body()
        if request.names[1] == "scope":
            raise bad_request_data("a scope has no parts to update; PATCH …/attrs with the whole scope")
        name = self._attribute_name(request, context)
        before = self.existing(request, context)
        content = _without_context(document)
        instance = instance_for(content, self._instances(request, before, name))
        whole = content if instance is None else completed_part(content, instance)
        part = read_attribute(request.names[1], whole, context.terms)[0]
        if instance is not None and part["type"] != instance["type"]:
            raise bad_request_data(
                f"attribute {shown(request.names[1])} is a {instance['type']} and cannot become a "
                f"{part['type']} by an update of its parts; replace it with PUT"
            )
        refuse_nulls({name: [part]}, context.terms, Nulls.ATTRIBUTES)
        try:
            outcome = changes.partially_updated(before, name, part, timestamp_now())
        except KeyError:
            raise _absent_instance(request, part.get("datasetId")) from None
        await self._carry_out(request, outcome)
        return DONE

    async def replace_attribute(self, request: RequestContext) -> Response:
        """PUT entities/{id}/attrs/{name}: replaces one instance, by datasetId; others stay."""
        document, context = await request.body()
        if request.names[1] == "scope":
            raise bad_request_data("a scope is replaced with PATCH …/attrs, or with the whole entity")
        name = self._attribute_name(request, context)
        before = self.existing(request, context)
        remaining = self._instances(request, before, name)
        instances = read_attribute(request.names[1], _without_context(document), context.terms)
        for instance in instances:
            if instance_for(instance, remaining) is None:
                raise _absent_instance(request, instance.get("datasetId"))
        refuse_nulls({name: instances}, context.terms, Nulls.NOWHERE)
        change = Change(None, (), {name: instances})
        await self._carry_out(request, changes.updated(before, change, timestamp_now()))
        return DONE

    async def delete_attribute(self, request: RequestContext) -> Response:
        """DELETE entities/{id}/attrs/{name}; one instance by datasetId, or every one with deleteAll."""
        context = await request.reader_context()
        name = self._attribute_name(request, context)
        before = self.existing(request, context)
        if request.names[1] == "scope":
            if not before.scopes:
                raise not_found(f"entity {before.id} has no scope")
            outcome = changes.updated(before, Change(None, (), {}, scopes=()), timestamp_now())
            await self._carry_out(request, outcome)
            return DONE
        self._instances(request, before, name)
        dataset = request.parameter("datasetId")
        if dataset == DEFAULT_INSTANCE:
            dataset = None
        try:
            outcome = changes.without(before, name, dataset, timestamp_now(), every=request.flag("deleteAll"))
        except KeyError:
            raise _absent_instance(request, dataset) from None
        await self._carry_out(request, outcome)
        return DONE

    def existing(self, request: RequestContext, context: Context | None) -> Entity:
        """Return the entity in the path, as the last write left it.

        Raises a problem (404) if there is none, or if it has none of the types that the parameter `type`
        selects.
        """
        entity = request.tenant.store.latest(request.names[0])
        if entity is None:
            raise absent(require_uri(request.names[0], "the entity id in the path"))
        if context is not None:
            _require_type(request, entity, context)
        return entity

    async def _carry_out(self, request: RequestContext, outcome: Outcome) -> None:
        """Make an outcome durable. No await is allowed between reading the entity and this."""
        before = request.tenant.store.latest(request.names[0])
        if before is not None and outcome.entity is not before:
            await request.tenant.store.stage(Event(before, outcome.entity, outcome.touched))

    @staticmethod
    def _attribute_name(request: RequestContext, context: Context) -> str:
        return expand(require_name(request.names[1], "the attribute name in the path"), context.terms)

    @staticmethod
    def _instances(request: RequestContext, entity: Entity, name: str) -> list[Instance]:
        instances = entity.attributes.get(name)
        if instances is None:
            raise not_found(
                f"entity {entity.id} has no attribute {shown(request.names[1])}; "
                "append it, or read the entity to see its attributes"
            )
        return instances


def creation(store: Store, change: Change) -> Event:
    """Return the creation of an entity; raise a problem (409) if its id exists."""
    if store.latest(change.id or "") is not None:
        raise already_exists(f"there is an entity {change.id} already; update it, or choose another id")
    entity = changes.created(change, timestamp_now(), store.next_seq())
    return Event(None, entity, frozenset(entity.attributes))


def _location(entity_id: str) -> bytes:
    """Return the path of an entity. Most ids need no percent-encoding."""
    raw = entity_id.encode()
    return _AT + (quote(raw, safe=":").encode() if raw.strip(_AS_IT_IS) else raw)


def absent(entity_id: str) -> Problem:
    """The entity does not exist."""
    return not_found(f"there is no entity {entity_id}; create it, or ask GET entities for those there are")


def nothing_left(entity_id: str) -> Problem:
    """The entity has no member that is picked, or none that is not omitted."""
    return not_found(f"pick and omit leave nothing of entity {entity_id}; select a member that it has")


def _absent_instance(request: RequestContext, dataset: str | None) -> Problem:
    which = "default instance" if dataset is None else f"instance with the datasetId {shown(dataset)}"
    return not_found(f"attribute {shown(request.names[1])} has no {which}")


def read_merge(
    document: object,
    before: Entity,
    context: Context,
    language: str | None = None,
    *,
    simplified: bool = False,
) -> Change:
    """Return a merge, completed from the present entity (`completion`)."""
    if isinstance(document, dict):
        complete = normalized if simplified else completed
        document = complete(document, before, context.terms, language)
    return read_change(document, context.terms, Nulls.VALUES)


def bare(document: object, context: Context, before: Entity | None = None) -> object:
    """Return a simplified document in normalized form, with the kinds of the present entity if there is one.

    The standard allows simplified bodies for merges only; other brokers accept them everywhere.
    """
    return normalized(document, before, context.terms) if isinstance(document, dict) else document


def is_simplified(request: RequestContext, others: frozenset[str] = frozenset()) -> bool:
    """Return whether the body is in simplified form; the others are recognized from the body.

    `others` are additional options of the operation.
    """
    if not request.parameters:
        return False
    forms = options_of(request, FORMS | others)
    wanted = request.parameter("format")
    if wanted is not None:
        if wanted not in FORMS:
            raise invalid_request(f"format is one of {', '.join(sorted(FORMS))}, not {shown(wanted)}")
        forms = {wanted}  # it precedes the options (table 6.5.3.4-1)
    return not forms.isdisjoint(_SIMPLIFIED)


def _about(request: RequestContext, change: Change) -> Change:
    """Return a change if it is for the entity in the path; raise a problem if not."""
    if change.id is not None and change.id != request.names[0]:
        raise bad_request_data(
            f"the body is for {change.id}, the path for {request.names[0]}; use the same id in both"
        )
    return change


def _require_type(request: RequestContext, entity: Entity, context: Context) -> None:
    wanted = request.parameter("type")
    if wanted is not None and not type_selection(wanted, context.terms.expand).wants(entity.types):
        raise not_found(f"there is no entity {entity.id} of type {shown(wanted)}; it has other types")


def _without_context(document: dict[str, Any]) -> dict[str, Any]:
    if not isinstance(document, dict):
        raise bad_request_data(f"an attribute is a JSON object, not {shown(document)}")
    return {member: value for member, value in document.items() if member != "@context"}


def _update_result(change: Change, outcome: Outcome) -> Response:
    """Return the result for the attributes (5.2.18); their names are IRIs, since it has no @context
    (6.3.6)."""
    if not outcome.refused:
        return DONE
    names = [*change.attributes, "scope"] if change.scopes and outcome.entity.scopes else change.attributes
    body = {
        "updated": [name for name in names if name not in outcome.refused or name in outcome.touched],
        "notUpdated": [{"attributeName": name, "reason": reason} for name, reason in outcome.refused.items()],
    }
    return Response(207, orjson.dumps(body), [(b"content-type", JSON.encode())])
