"""Operations on entity maps, and queries that are answered from one (clauses 5.14, 6.32, 6.34 and 6.35)."""

from collections.abc import Mapping
from typing import Any, Final
from urllib.parse import quote, unquote

import orjson

from handover_broker.extensions.federation import MAP_HEADER, SINGLE_ENTITY_READS
from handover_broker.extensions.plugins import PerformByName
from handover_broker.model.problems import not_stored
from handover_broker.query.ordering import ordering
from handover_broker.query.query_document import query_parameters, selectors_of
from handover_broker.query.selection import Selection, hits_of
from handover_broker.request.derived_request import derived
from handover_broker.request.document_responses import document_response, in_media_type
from handover_broker.request.query_parameters import MAP_PARAMETERS, QUERY_PARAMETERS, selection_of
from handover_broker.request.request_context import (
    PREFIX,
    RequestContext,
    Response,
)
from handover_broker.request.routing import Operation
from handover_broker.storage.database import NotStored
from handover_broker.storage.store import OverlayStore, Store
from handover_broker.temporal.operations import QUERYING
from handover_federation.entity_maps.entity_map import MAX_ENTITIES, OWN, EntityMap, Listed
from handover_federation.entity_maps.mapped_request import listed_of, with_map
from handover_federation.operations.entity_map_pages import (
    SHAPING,
    Perform,
    for_the_query,
    map_page,
    query_mark,
)
from handover_federation.tenant_state import federated

_LOCAL: Final = frozenset({"local"})
_DONE: Final = Response(204)
_PAGE: Final = 1000


class EntityMapOperations:
    """Operations on entity maps. `perform` carries out an operation by its name."""

    def __init__(self, perform: PerformByName) -> None:
        self._perform = perform

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        one_map, all_of_them, temporal = "entityMaps/{id}", "entityMaps", "temporal/entityMaps"
        asking = QUERY_PARAMETERS | MAP_PARAMETERS
        name, past = "createEntityMapQueryEntity", "createEntityMapQueryTemporal"
        return (
            Operation("GET", one_map, "retrieveEntityMap", "6.32.3.1", self.retrieve, _LOCAL),
            Operation("PATCH", one_map, "updateEntityMap", "6.32.3.2", self.update, _LOCAL),
            Operation("DELETE", one_map, "deleteEntityMap", "6.32.3.3", self.delete, _LOCAL),
            Operation("GET", all_of_them, name, "6.34.3.1", self.create, asking),
            Operation("POST", all_of_them, name, "6.34.3.2", self.create, asking),
            Operation("GET", temporal, past, "6.35.3.1", self.create_temporal, QUERYING | MAP_PARAMETERS),
            Operation("POST", temporal, past, "6.35.3.2", self.create_temporal, QUERYING | MAP_PARAMETERS),
        )

    async def retrieve(self, request: RequestContext) -> Response:
        """GET entityMaps/{id}."""
        return await _map_response(request, _visible_map(request), 200)

    async def update(self, request: RequestContext) -> Response:
        """PATCH entityMaps/{id}."""
        document, _ = await request.body()
        _visible_map(request)
        try:
            await federated(request.tenant).entity_maps.update(request.names[0], document)
        except NotStored as error:
            raise not_stored(str(error), is_away=error.is_away) from error
        return _DONE

    async def delete(self, request: RequestContext) -> Response:
        """DELETE entityMaps/{id}."""
        _visible_map(request)
        try:
            await federated(request.tenant).entity_maps.delete(request.names[0])
        except NotStored as error:
            raise not_stored(str(error), is_away=error.is_away) from error
        return _DONE

    async def create(self, request: RequestContext) -> Response:
        """GET or POST entityMaps (clause 5.14.4): create the map of a query."""
        request.accept()
        any_of: tuple[Selection, ...] = ()
        if request.method == "GET":
            context, parameters = await request.reader_context(), request.parameters
        else:
            document, context = await request.body()
            parameters, any_of = query_parameters(document), selectors_of(document, context)
        store = request.tenant.store
        hits = await hits_of(store, selection_of(parameters, context, any_of), MAX_ENTITIES + 1)
        order = ordering(parameters, context.terms.expand)
        if order is not None:
            hits = sorted(hits, key=order.place_of)
        return await self._kept(request, {hit.id: list(_origins(store, hit.id)) for hit in hits})

    async def create_temporal(self, request: RequestContext) -> Response:
        """GET or POST temporal/entityMaps (clause 5.14.5)."""
        request.accept()
        name = "queryTemporal" if request.method == "GET" else "queryTemporalBatch"
        mapped: dict[str, list[str]] = {}
        plain = _without(request.parameters, MAP_PARAMETERS | SHAPING)
        while True:
            parameters = {**plain, "limit": str(_PAGE), "offset": str(len(mapped)), "lastN": "1"}
            result = await self._perform(name, _plainly(request, parameters))
            if result.status >= 300:
                return result
            page = [entity["id"] for entity in orjson.loads(result.body)]
            before = len(mapped)
            mapped.update((entity_id, [OWN]) for entity_id in page)
            if len(page) < _PAGE or len(mapped) == before:
                break
        return await self._kept(request, mapped)

    async def answer(self, operation: Operation, request: RequestContext, perform: Perform) -> Response:
        """Answer a query that names a map, or wants one created (clauses 5.5.14 and 6.4.3.2).

        If the named map does not exist any more, a new one is created (clause 5.7.2.4).
        """
        named = _named(request)
        if operation.name in SINGLE_ENTITY_READS:
            return await self._entity(request, named, perform)
        if named is not None:
            return await self._page(request, named, perform)
        past = operation.name == "queryTemporal"
        making = "createEntityMapQueryTemporal" if past else "createEntityMapQueryEntity"
        parameters = for_the_query(request.parameters)
        if "entityMapLifetime" in request.parameters:
            parameters["entityMapLifetime"] = request.parameters["entityMapLifetime"]
        created = await self._perform(making, _plainly(request, parameters))
        if created.status >= 300:
            return created
        map_id = orjson.loads(created.body)["id"]
        result = await self._page(request, federated(request.tenant).entity_maps.get(map_id), perform)
        result.headers += [header for header in created.headers if header[0] == b"ngsild-warning"]
        return Response(201 if result.status == 200 else result.status, result.body, result.headers)

    async def _entity(
        self, request: RequestContext, entity_map: EntityMap | None, perform: Perform
    ) -> Response:
        """Answer with one entity from the sources in the map; without a map, create one with its sources."""
        listed = Listed()
        parameters = for_the_query(request.parameters)
        asking = with_map(request, entity_map=entity_map, listed=listed, parameters=parameters)
        result = await perform(asking)
        if result.status >= 300:
            return result
        if entity_map is None:
            entities = listed.entities or {request.names[0]: [OWN]}
            entity_map = await self._create(request, entities, listed)
        return Response(result.status, result.body, [*result.headers, _location(entity_map)])

    @staticmethod
    async def _page(request: RequestContext, entity_map: EntityMap, perform: Perform) -> Response:
        result = await map_page(request, entity_map, perform)
        return Response(result.status, result.body, [*result.headers, _location(entity_map)])

    @staticmethod
    async def _create(
        request: RequestContext, entities: dict[str, list[str]], elsewhere: Listed
    ) -> EntityMap:
        lifetime = request.parameter("entityMapLifetime")
        try:
            query = query_mark(request)
            return await federated(request.tenant).entity_maps.make(
                entities,
                lifetime,
                elsewhere.linked,
                query,
                request.caller.subject,
                is_private=request.tenant.store.may_see_private(),
            )
        except NotStored as error:
            raise not_stored(str(error), is_away=error.is_away) from error

    async def _kept(self, request: RequestContext, entities: dict[str, list[str]]) -> Response:
        """Store a map of the broker's own matches and of those in the maps of sources."""
        elsewhere = listed_of(request) or Listed()
        for entity_id, registrations in elsewhere.entities.items():
            holders = entities.setdefault(entity_id, [])
            holders += [registration for registration in registrations if registration not in holders]
        return await _map_response(request, await self._create(request, entities, elsewhere), 201)


async def _map_response(request: RequestContext, entity_map: EntityMap, status: int) -> Response:
    media_type, context = request.accept(), await request.reader_context()
    result = document_response(in_media_type(entity_map.document(), media_type, context), media_type, context)
    return Response(status, result.body, [*result.headers, _location(entity_map)])


def _named(request: RequestContext) -> EntityMap | None:
    """Return the map that a request names; None if it names none, or one that does not exist."""
    named = request.headers.get(MAP_HEADER)
    if named is None:
        return None
    map_id = unquote(named.decode("latin-1").strip().rstrip("/").rpartition("/")[2])
    entity_map = federated(request.tenant).entity_maps.find(map_id)
    return entity_map if entity_map is not None and _is_visible(request, entity_map) else None


def _visible_map(request: RequestContext) -> EntityMap:
    """Return the map in the path; raise a problem (404) if the client may not see it."""
    maps = federated(request.tenant).entity_maps
    entity_map = maps.get(request.names[0])
    if not _is_visible(request, entity_map):
        raise maps.absent(entity_map.id)
    return entity_map


def _is_visible(request: RequestContext, entity_map: EntityMap) -> bool:
    return (
        not entity_map.is_private
        or entity_map.creator == request.caller.subject
        or request.tenant.store.may_see_private(somewhere=False)
    )


def _location(entity_map: EntityMap) -> tuple[bytes, bytes]:
    return MAP_HEADER, f"{PREFIX}entityMaps/{quote(entity_map.id, safe=':')}".encode()


def _origins(store: Store, entity_id: str) -> list[str]:
    result = store.origins.get(entity_id) if isinstance(store, OverlayStore) else None
    return result or [OWN]


def _without(parameters: Mapping[Any, Any], names: Any) -> dict[Any, Any]:
    return {name: value for name, value in parameters.items() if name not in names}


def _plainly(request: RequestContext, parameters: Mapping[str, str]) -> RequestContext:
    return derived(request, parameters=parameters, headers=_without(request.headers, {b"accept"}))
