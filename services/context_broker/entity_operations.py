"""Operations on one entity, and the query for many (clauses 6.4 to 6.7, 5.6 and 5.7)."""

from typing import Final
from urllib.parse import quote

import orjson

from handover.errors import Problem
from services.context_broker import changes
from services.context_broker.changes import Outcome
from services.context_broker.contexts import Context
from services.context_broker.entity import SAYS, Entity, Event, Instance
from services.context_broker.exchange import PREFIX, Answer, Exchange
from services.context_broker.intake import (
    Change,
    expand,
    read_attribute,
    read_change,
    read_entity,
    refuse_deletions,
)
from services.context_broker.operation import Operation
from services.context_broker.problems import already_exists, bad_request_data, not_found
from services.context_broker.reading import (
    QUERY_PARAMETERS,
    VIEW_PARAMETERS,
    entities_answer,
    entity_answer,
    options_of,
    selection_of,
    view_of,
    window_of,
)
from services.context_broker.selection import search
from services.context_broker.store import Store
from services.context_broker.words import require_name, require_uri, shown, timestamp_now

DONE: Final = Answer(204)
_LOCAL: Final = frozenset({"local"})
_DELETE_ATTR: Final = frozenset({"datasetId", "deleteAll", "local"})
_WRITE_OPTIONS: Final = frozenset({"options", "local"})


class EntityOperations:
    """What can be done to entities one at a time."""

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations of this room."""
        one, attributes, attribute = "entities/{id}", "entities/{id}/attrs", "entities/{id}/attrs/{name}"
        return (
            Operation("POST", "entities", "createEntity", "6.4.3.1", self.create, _LOCAL, True),
            Operation("GET", "entities", "queryEntity", "6.4.3.2", self.query, QUERY_PARAMETERS),
            Operation("GET", one, "retrieveEntity", "6.5.3.1", self.retrieve, VIEW_PARAMETERS),
            Operation("DELETE", one, "deleteEntity", "6.5.3.2", self.delete, _LOCAL),
            Operation("PUT", one, "replaceEntity", "6.5.3.3", self.replace, _LOCAL),
            Operation("PATCH", one, "mergeEntity", "6.5.3.4", self.merge, _WRITE_OPTIONS),
            Operation("POST", attributes, "appendAttrs", "6.6.3.1", self.append, _WRITE_OPTIONS),
            Operation("PATCH", attributes, "updateEntity", "6.6.3.2", self.update, _LOCAL),
            Operation("PATCH", attribute, "updateAttrs", "6.7.3.1", self.update_attribute, _LOCAL),
            Operation("DELETE", attribute, "deleteAttrs", "6.7.3.2", self.delete_attribute, _DELETE_ATTR),
            Operation("PUT", attribute, "replaceAttrs", "6.7.3.3", self.replace_attribute, _LOCAL),
        )

    async def create(self, exchange: Exchange) -> Answer:
        """POST entities."""
        document, context = await exchange.body()
        change = read_entity(document, context.terms)
        store = exchange.tenant.store
        await store.stage(creation(store, change))
        location = f"{PREFIX}entities/{quote(change.id or '', safe=':')}".encode()
        return Answer(201, b"", [(b"location", location)])

    async def query(self, exchange: Exchange) -> Answer:
        """GET entities."""
        exchange.accept()
        context = await exchange.reader_context()
        view, window = view_of(exchange, context), window_of(exchange)
        selection = selection_of(exchange.parameters, context)
        page = await search(exchange.tenant.store, selection, window.offset, window.limit, count=window.count)
        return entities_answer(exchange, page, window, context, view)

    async def retrieve(self, exchange: Exchange) -> Answer:
        """GET entities/{id}."""
        exchange.accept()
        context = await exchange.reader_context()
        view = view_of(exchange, context)
        entity_id = require_uri(exchange.names[0], "the entity id in the path")
        entity = exchange.tenant.store.get(entity_id)
        if entity is None:
            raise absent(entity_id)
        if view.attributes is not None and view.attributes.isdisjoint(entity.attributes):
            raise not_found(f"entity {entity_id} has none of the attributes {exchange.parameter('attrs')}")
        return entity_answer(exchange, entity, context, view)

    async def delete(self, exchange: Exchange) -> Answer:
        """DELETE entities/{id}."""
        await exchange.tenant.store.stage(Event(self.existing(exchange), None))
        return DONE

    async def replace(self, exchange: Exchange) -> Answer:
        """PUT entities/{id}."""
        change, context = await self._change(exchange)
        refuse_deletions(change, context.terms)
        outcome = changes.replaced(self.existing(exchange), change, timestamp_now())
        await self._carry_out(exchange, outcome)
        return DONE

    async def merge(self, exchange: Exchange) -> Answer:
        """PATCH entities/{id}."""
        options_of(exchange, frozenset({"keyValues", "concise", "simplified"}))
        change, _ = await self._change(exchange)
        await self._carry_out(exchange, changes.merged(self.existing(exchange), change, timestamp_now()))
        return DONE

    async def append(self, exchange: Exchange) -> Answer:
        """POST entities/{id}/attrs."""
        overwrite = "noOverwrite" not in options_of(exchange, frozenset({"noOverwrite"}))
        change, context = await self._change(exchange)
        before = self.existing(exchange)
        outcome = changes.appended(before, change, timestamp_now(), overwrite=overwrite)
        await self._carry_out(exchange, outcome)
        return _update_result(change, outcome, context)

    async def update(self, exchange: Exchange) -> Answer:
        """PATCH entities/{id}/attrs."""
        change, context = await self._change(exchange)
        outcome = changes.updated(self.existing(exchange), change, timestamp_now())
        await self._carry_out(exchange, outcome)
        return _update_result(change, outcome, context)

    async def update_attribute(self, exchange: Exchange) -> Answer:
        """PATCH entities/{id}/attrs/{name}: overwrites members of the attribute."""
        document, context = await exchange.body()
        name = self._attribute_name(exchange, context)
        before = self.existing(exchange)
        given = {member: value for member, value in document.items() if member != "@context"}
        instances = self._instances(exchange, before, name)
        completed = _completed(given, instances.get(given.get("datasetId"), {}))
        part = read_attribute(exchange.names[1], completed, context.terms)[0]
        try:
            outcome = changes.partially_updated(before, name, part, timestamp_now())
        except KeyError:
            raise _absent_instance(exchange, part.get("datasetId")) from None
        await self._carry_out(exchange, outcome)
        return DONE

    async def replace_attribute(self, exchange: Exchange) -> Answer:
        """PUT entities/{id}/attrs/{name}."""
        document, context = await exchange.body()
        name = self._attribute_name(exchange, context)
        before = self.existing(exchange)
        self._instances(exchange, before, name)
        given = {member: value for member, value in document.items() if member != "@context"}
        change = Change(None, (), {name: read_attribute(exchange.names[1], given, context.terms)})
        await self._carry_out(exchange, changes.updated(before, change, timestamp_now()))
        return DONE

    async def delete_attribute(self, exchange: Exchange) -> Answer:
        """DELETE entities/{id}/attrs/{name}; one instance by datasetId, or every one with deleteAll."""
        context = await exchange.reader_context()
        name = self._attribute_name(exchange, context)
        before = self.existing(exchange)
        self._instances(exchange, before, name)
        dataset = exchange.parameter("datasetId")
        try:
            outcome = changes.without(
                before, name, dataset, timestamp_now(), every=exchange.flag("deleteAll")
            )
        except KeyError:
            raise _absent_instance(exchange, dataset) from None
        await self._carry_out(exchange, outcome)
        return DONE

    def existing(self, exchange: Exchange) -> Entity:
        """Return the entity that the path names, as the last write left it; raise a problem (404) if none."""
        entity_id = require_uri(exchange.names[0], "the entity id in the path")
        entity = exchange.tenant.store.latest(entity_id)
        if entity is None:
            raise absent(entity_id)
        return entity

    async def _change(self, exchange: Exchange) -> tuple[Change, Context]:
        document, context = await exchange.body()
        change = read_change(document, context.terms)
        if change.id is not None and change.id != exchange.names[0]:
            raise bad_request_data(
                f"the body is about {change.id}, the path about {exchange.names[0]}; agree on one"
            )
        return change, context

    async def _carry_out(self, exchange: Exchange, outcome: Outcome) -> None:
        """Make an outcome durable. No await may stand between reading the entity and this."""
        before = exchange.tenant.store.latest(exchange.names[0])
        if before is not None and outcome.entity is not before:
            await exchange.tenant.store.stage(Event(before, outcome.entity, outcome.touched))

    @staticmethod
    def _attribute_name(exchange: Exchange, context: Context) -> str:
        return expand(require_name(exchange.names[1], "the attribute name in the path"), context.terms)

    @staticmethod
    def _instances(exchange: Exchange, entity: Entity, name: str) -> dict[str | None, Instance]:
        instances = entity.attributes.get(name)
        if instances is None:
            raise not_found(
                f"entity {entity.id} has no attribute {shown(exchange.names[1])}; append it first"
            )
        return {instance.get("datasetId"): instance for instance in instances}


def creation(store: Store, change: Change) -> Event:
    """Return the coming into being of an entity; raise a problem (409) if its id is taken."""
    if store.latest(change.id or "") is not None:
        raise already_exists(f"there is an entity {change.id} already; update it, or choose another id")
    entity = changes.created(change, timestamp_now(), store.next_seq())
    return Event(None, entity, frozenset(entity.attributes))


def absent(entity_id: str) -> Problem:
    """There is no such entity."""
    return not_found(f"there is no entity {entity_id}; create it first")


def _absent_instance(exchange: Exchange, dataset: str | None) -> Problem:
    which = "default instance" if dataset is None else f"instance with the datasetId {shown(dataset)}"
    return not_found(f"attribute {shown(exchange.names[1])} has no {which}")


def _completed(given: dict[str, object], instance: Instance) -> dict[str, object]:
    """Return a part of an attribute completed by the kind and the value that the attribute has."""
    if not instance or given.get("type", instance["type"]) != instance["type"]:
        return given
    says = SAYS[instance["type"]]
    kept = {} if says in given else {says: instance[says]}
    return {"type": instance["type"], **kept, **given}


def _update_result(change: Change, outcome: Outcome, context: Context) -> Answer:
    if not outcome.refused:
        return DONE
    compact = context.terms.compact
    body = {
        "updated": [compact(name) for name in change.attributes if name not in outcome.refused],
        "notUpdated": [
            {"attributeName": compact(name), "reason": reason} for name, reason in outcome.refused.items()
        ],
    }
    return Answer(207, orjson.dumps(body), [(b"content-type", b"application/json")])
