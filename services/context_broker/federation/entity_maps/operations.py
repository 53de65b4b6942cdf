"""Operations on entity maps, and queries that are answered from one (clauses 5.14, 6.32, 6.34 and 6.35)."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final
from urllib.parse import quote, unquote

import orjson

from services.context_broker.extensions.federation import MAP_HEADER, SINGLE_ENTITY_READS
from services.context_broker.federation.entity_maps.entity_map import MAX_ENTITIES, OWN, EntityMap, Listed
from services.context_broker.federation.entity_maps.mapped_exchange import listed_of, with_map
from services.context_broker.federation.entity_maps.pages import (
    SHAPING,
    Perform,
    for_the_query,
    map_page,
    query_mark,
)
from services.context_broker.federation.tenant_state import federated
from services.context_broker.model.problems import not_stored
from services.context_broker.query.ordering import ordering
from services.context_broker.query.query_document import query_parameters, selectors_of
from services.context_broker.query.selection import Selection, hits_of
from services.context_broker.request.derived_exchange import derived
from services.context_broker.request.document_answers import document_answer, in_media_type
from services.context_broker.request.query_parameters import MAP_PARAMETERS, QUERY_PARAMETERS, selection_of
from services.context_broker.request.request_context import (
    PREFIX,
)
from services.context_broker.request.request_context import (
    RequestContext as Exchange,
)
from services.context_broker.request.request_context import (
    Response as Answer,
)
from services.context_broker.request.routing import Operation
from services.context_broker.storage.database import NotStored
from services.context_broker.storage.store import OverlayStore, Store
from services.context_broker.temporal.operations import QUERYING

_LOCAL: Final = frozenset({"local"})
_DONE: Final = Answer(204)
_PAGE: Final = 1000


class EntityMapOperations:
    """Operations on entity maps. `perform` carries out an operation by its name."""

    def __init__(self, perform: Callable[[str, Exchange], Awaitable[Answer]]) -> None:
        self._perform = perform

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        one, all_of_them, temporal = "entityMaps/{id}", "entityMaps", "temporal/entityMaps"
        asking = QUERY_PARAMETERS | MAP_PARAMETERS
        name, past = "createEntityMapQueryEntity", "createEntityMapQueryTemporal"
        return (
            Operation("GET", one, "retrieveEntityMap", "6.32.3.1", self.retrieve, _LOCAL),
            Operation("PATCH", one, "updateEntityMap", "6.32.3.2", self.update, _LOCAL),
            Operation("DELETE", one, "deleteEntityMap", "6.32.3.3", self.delete, _LOCAL),
            Operation("GET", all_of_them, name, "6.34.3.1", self.create, asking),
            Operation("POST", all_of_them, name, "6.34.3.2", self.create, asking),
            Operation("GET", temporal, past, "6.35.3.1", self.create_temporal, QUERYING | MAP_PARAMETERS),
            Operation("POST", temporal, past, "6.35.3.2", self.create_temporal, QUERYING | MAP_PARAMETERS),
        )

    async def retrieve(self, exchange: Exchange) -> Answer:
        """GET entityMaps/{id}."""
        return await _map_answer(exchange, federated(exchange.tenant).entity_maps.get(exchange.names[0]), 200)

    async def update(self, exchange: Exchange) -> Answer:
        """PATCH entityMaps/{id}."""
        document, _ = await exchange.body()
        try:
            await federated(exchange.tenant).entity_maps.update(exchange.names[0], document)
        except NotStored as error:
            raise not_stored(str(error)) from error
        return _DONE

    async def delete(self, exchange: Exchange) -> Answer:
        """DELETE entityMaps/{id}."""
        try:
            await federated(exchange.tenant).entity_maps.delete(exchange.names[0])
        except NotStored as error:
            raise not_stored(str(error)) from error
        return _DONE

    async def create(self, exchange: Exchange) -> Answer:
        """GET or POST entityMaps (clause 5.14.4): create the map of a query."""
        exchange.accept()
        any_of: tuple[Selection, ...] = ()
        if exchange.method == "GET":
            context, parameters = await exchange.reader_context(), exchange.parameters
        else:
            document, context = await exchange.body()
            parameters, any_of = query_parameters(document), selectors_of(document, context)
        store = exchange.tenant.store
        hits = await hits_of(store, selection_of(parameters, context, any_of), MAX_ENTITIES + 1)
        order = ordering(parameters, context.terms.expand)
        if order is not None:
            hits = sorted(hits, key=order.place_of)
        return await self._kept(exchange, {one.id: list(_origins(store, one.id)) for one in hits})

    async def create_temporal(self, exchange: Exchange) -> Answer:
        """GET or POST temporal/entityMaps (clause 5.14.5)."""
        exchange.accept()
        name = "queryTemporal" if exchange.method == "GET" else "queryTemporalBatch"
        mapped: dict[str, list[str]] = {}
        plain = _without(exchange.parameters, MAP_PARAMETERS | SHAPING)
        while True:
            parameters = {**plain, "limit": str(_PAGE), "offset": str(len(mapped)), "lastN": "1"}
            result = await self._perform(name, _plainly(exchange, parameters))
            if result.status >= 300:
                return result
            page = [one["id"] for one in orjson.loads(result.body)]
            before = len(mapped)
            mapped.update((one, [OWN]) for one in page)
            if len(page) < _PAGE or len(mapped) == before:
                break
        return await self._kept(exchange, mapped)

    async def answer(self, operation: Operation, exchange: Exchange, perform: Perform) -> Answer:
        """Answer a query that names a map, or wants one created (clauses 5.5.14 and 6.4.3.2).

        If the named map does not exist any more, a new one is created (clause 5.7.2.4).
        """
        named = _named(exchange)
        if operation.name in SINGLE_ENTITY_READS:
            return await self._entity(exchange, named, perform)
        if named is not None:
            return await self._page(exchange, named, perform)
        past = operation.name == "queryTemporal"
        making = "createEntityMapQueryTemporal" if past else "createEntityMapQueryEntity"
        parameters = for_the_query(exchange.parameters)
        if "entityMapLifetime" in exchange.parameters:
            parameters["entityMapLifetime"] = exchange.parameters["entityMapLifetime"]
        made = await self._perform(making, _plainly(exchange, parameters))
        if made.status >= 300:
            return made
        map_id = orjson.loads(made.body)["id"]
        result = await self._page(exchange, federated(exchange.tenant).entity_maps.get(map_id), perform)
        result.headers += [one for one in made.headers if one[0] == b"ngsild-warning"]
        return Answer(201 if result.status == 200 else result.status, result.body, result.headers)

    async def _entity(self, exchange: Exchange, one: EntityMap | None, perform: Perform) -> Answer:
        """Answer with one entity from the sources in the map; without a map, create one with its sources."""
        listed = Listed()
        parameters = for_the_query(exchange.parameters)
        asking = with_map(exchange, entity_map=one, listed=listed, parameters=parameters)
        result = await perform(asking)
        if result.status >= 300:
            return result
        if one is None:
            entities = listed.entities or {exchange.names[0]: [OWN]}
            one = await self._made(exchange, entities, listed)
        return Answer(result.status, result.body, [*result.headers, _location(one)])

    @staticmethod
    async def _page(exchange: Exchange, one: EntityMap, perform: Perform) -> Answer:
        result = await map_page(exchange, one, perform)
        return Answer(result.status, result.body, [*result.headers, _location(one)])

    @staticmethod
    async def _made(exchange: Exchange, entities: dict[str, list[str]], elsewhere: Listed) -> EntityMap:
        lifetime = exchange.parameter("entityMapLifetime")
        try:
            query = query_mark(exchange)
            return await federated(exchange.tenant).entity_maps.make(
                entities, lifetime, elsewhere.linked, query
            )
        except NotStored as error:
            raise not_stored(str(error)) from error

    async def _kept(self, exchange: Exchange, entities: dict[str, list[str]]) -> Answer:
        """Store a map of the broker's own matches and of those in the maps of sources."""
        elsewhere = listed_of(exchange) or Listed()
        for one, registrations in elsewhere.entities.items():
            known = entities.setdefault(one, [])
            known += [registration for registration in registrations if registration not in known]
        return await _map_answer(exchange, await self._made(exchange, entities, elsewhere), 201)


async def _map_answer(exchange: Exchange, one: EntityMap, status: int) -> Answer:
    media_type, context = exchange.accept(), await exchange.reader_context()
    result = document_answer(in_media_type(one.document(), media_type, context), media_type, context)
    return Answer(status, result.body, [*result.headers, _location(one)])


def _named(exchange: Exchange) -> EntityMap | None:
    """Return the map that a request names; None if it names none, or one that does not exist."""
    named = exchange.headers.get(MAP_HEADER)
    if named is None:
        return None
    map_id = unquote(named.decode("latin-1").strip().rstrip("/").rpartition("/")[2])
    return federated(exchange.tenant).entity_maps.find(map_id)


def _location(one: EntityMap) -> tuple[bytes, bytes]:
    return MAP_HEADER, f"{PREFIX}entityMaps/{quote(one.id, safe=':')}".encode()


def _origins(store: Store, entity_id: str) -> list[str]:
    result = store.origins.get(entity_id) if isinstance(store, OverlayStore) else None
    return result or [OWN]


def _without(given: Mapping[Any, Any], names: Any) -> dict[Any, Any]:
    return {name: value for name, value in given.items() if name not in names}


def _plainly(exchange: Exchange, parameters: Mapping[str, str]) -> Exchange:
    return derived(exchange, parameters=parameters, headers=_without(exchange.headers, {b"accept"}))
