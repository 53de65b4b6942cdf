"""Operations on entity maps, and queries that are answered by one (clauses 5.14, 6.32, 6.34 and 6.35)."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final
from urllib.parse import quote, unquote

import orjson

from services.context_broker.api.exchange import PREFIX, Answer, Exchange
from services.context_broker.api.operation import Operation
from services.context_broker.api.problems import not_stored
from services.context_broker.distribution.distribution import in_place_of
from services.context_broker.queries.ordering import ordering
from services.context_broker.queries.pages import PLACE
from services.context_broker.queries.query_document import query_parameters, selectors_of
from services.context_broker.queries.reading import QUERY_PARAMETERS, selection_of, window_of
from services.context_broker.queries.selection import Selection, hits_of
from services.context_broker.snapshots.entity_maps import (
    MAP_PARAMETERS,
    MOST_ENTITIES,
    OWN,
    EntityMap,
    Listed,
)
from services.context_broker.sources.registration_operations import answer, with_context
from services.context_broker.storage.journal import NotStored
from services.context_broker.storage.store import Mix, Store
from services.context_broker.temporal.operations import QUERYING
from services.context_broker.temporal.query import temporal_window

Performing = Callable[[Exchange], Awaitable[Answer]]
"""Carries a query out, sources included."""

HEADER: Final = b"ngsild-entitymap"
OF_ONE: Final = frozenset({"retrieveEntity", "retrieveTemporal"})
"""Operations on one entity: a map tells them whom to ask for it (clauses 5.7.1.4 and 5.7.3.4)."""
THROUGH_A_MAP: Final = OF_ONE | {"queryEntity", "queryBatch", "queryTemporal"}
"""Operations that can be answered by a map."""
_OPTION: Final = "entityMap"
_LOCAL: Final = frozenset({"local"})
_SHAPING: Final = frozenset({"options", "format", "count", "pick", "omit", "lang", "datasetId"})
"""Parameters that say how hits look, not which they are."""
_DONE: Final = Answer(204)
_PAGE: Final = 1000
_NOBODY: Final = "urn:ngsi-ld:EntityMap:nobody"
"""Asked for where a page has nothing, so that an empty answer looks as the asker wants it."""


class EntityMapOperations:
    """What can be done to entity maps. `perform` carries out an operation by its name."""

    def __init__(self, perform: Callable[[str, Exchange], Awaitable[Answer]]) -> None:
        self._perform = perform

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations of this room."""
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
        return await _told(exchange, exchange.tenant.entity_maps.get(exchange.names[0]), 200)

    async def update(self, exchange: Exchange) -> Answer:
        """PATCH entityMaps/{id}."""
        document, _ = await exchange.body()
        try:
            await exchange.tenant.entity_maps.update(exchange.names[0], document)
        except NotStored as error:
            raise not_stored(str(error)) from error
        return _DONE

    async def delete(self, exchange: Exchange) -> Answer:
        """DELETE entityMaps/{id}."""
        try:
            await exchange.tenant.entity_maps.delete(exchange.names[0])
        except NotStored as error:
            raise not_stored(str(error)) from error
        return _DONE

    async def create(self, exchange: Exchange) -> Answer:
        """GET or POST entityMaps (clause 5.14.4): the map of what a query finds."""
        exchange.accept()
        any_of: tuple[Selection, ...] = ()
        if exchange.method == "GET":
            context, parameters = await exchange.reader_context(), exchange.parameters
        else:
            document, context = await exchange.body()
            parameters, any_of = query_parameters(document), selectors_of(document, context)
        store = exchange.tenant.store
        hits = await hits_of(store, selection_of(parameters, context, any_of), MOST_ENTITIES + 1)
        order = ordering(parameters, context.terms.expand)
        if order is not None:
            hits = sorted(hits, key=order.place_of)
        return await self._kept(exchange, {one.id: list(_origins(store, one.id)) for one in hits})

    async def create_temporal(self, exchange: Exchange) -> Answer:
        """GET or POST temporal/entityMaps (clause 5.14.5)."""
        exchange.accept()
        name = "queryTemporal" if exchange.method == "GET" else "queryTemporalBatch"
        mapped: dict[str, list[str]] = {}
        plain = _without(exchange.parameters, MAP_PARAMETERS | _SHAPING)
        while True:
            parameters = {**plain, "limit": str(_PAGE), "offset": str(len(mapped)), "lastN": "1"}
            told = await self._perform(name, _plainly(exchange, parameters))
            if told.status >= 300:
                return told
            page = [one["id"] for one in orjson.loads(told.body)]
            before = len(mapped)
            mapped.update((one, [OWN]) for one in page)
            if len(page) < _PAGE or len(mapped) == before:
                break
        return await self._kept(exchange, mapped)

    async def answer(self, operation: Operation, exchange: Exchange, perform: Performing) -> Answer:
        """Answer a query that names a map, or wants one made (clauses 5.5.14 and 6.4.3.2).

        Where the map that is named is not there, or not any more, one is made (clause 5.7.2.4).
        """
        named = _named(exchange)
        if operation.name in OF_ONE:
            return await self._entity(exchange, named, perform)
        if named is not None:
            return await self._page(exchange, named, perform)
        past = operation.name == "queryTemporal"
        making = "createEntityMapQueryTemporal" if past else "createEntityMapQueryEntity"
        parameters = _for_the_query(exchange.parameters)
        if "entityMapLifetime" in exchange.parameters:
            parameters["entityMapLifetime"] = exchange.parameters["entityMapLifetime"]
        made = await self._perform(making, _plainly(exchange, parameters))
        if made.status >= 300:
            return made
        map_id = orjson.loads(made.body)["id"]
        result = await self._page(exchange, exchange.tenant.entity_maps.get(map_id), perform)
        result.headers += [one for one in made.headers if one[0] == b"ngsild-warning"]
        return Answer(201 if result.status == 200 else result.status, result.body, result.headers)

    async def _entity(self, exchange: Exchange, one: EntityMap | None, perform: Performing) -> Answer:
        """Answer with one entity, asking those who have it by the map; without one, note who they are."""
        who_has = Listed()
        parameters = _for_the_query(exchange.parameters)
        asking = in_place_of(exchange, entity_map=one, elsewhere=who_has, parameters=parameters)
        result = await perform(asking)
        if result.status >= 300:
            return result
        if one is None:
            entities = who_has.entities or {exchange.names[0]: [OWN]}
            one = await self._made(exchange, entities, who_has)
        return Answer(result.status, result.body, [*result.headers, _location(one)])

    async def _page(self, exchange: Exchange, one: EntityMap, perform: Performing) -> Answer:
        """Answer with the piece of a map that is asked for; what no longer fits the query is left out."""
        wanted = in_place_of(exchange, parameters=_for_the_query(exchange.parameters))
        window = (temporal_window if "/temporal/" in wanted.path else window_of)(wanted)
        given = _ids_in(exchange)
        ids = [entity for entity in one.entities if given is None or entity in given]
        some = ids[window.offset : window.offset + window.limit] or [_NOBODY]
        parameters = {
            **_without(wanted.parameters, {"offset", "count", "idPattern", PLACE}),
            "limit": str(len(some)),
        }
        if exchange.method == "GET":
            asking = in_place_of(exchange, entity_map=one, parameters={**parameters, "id": ",".join(some)})
        else:
            raw = _narrowed(exchange, some)
            asking = in_place_of(exchange, entity_map=one, parameters=parameters, raw=raw)
        result = await perform(asking)
        headers = [header for header in result.headers if not _is_page_link(header)]
        if window.count:
            headers.append((b"ngsild-results-count", str(len(ids)).encode()))
        media_type = next((value for name, value in headers if name == b"content-type"), b"").decode()
        before, after = window.offset - window.limit, window.offset + window.limit
        if window.offset and window.limit:
            headers.append(_page_link(wanted, max(0, before), "prev", media_type))
        if window.limit and after < len(ids):
            headers.append(_page_link(wanted, after, "next", media_type))
        return Answer(result.status, result.body, [*headers, _location(one)])

    @staticmethod
    async def _made(exchange: Exchange, entities: dict[str, list[str]], elsewhere: Listed) -> EntityMap:
        lifetime = exchange.parameter("entityMapLifetime")
        try:
            return await exchange.tenant.entity_maps.make(entities, lifetime, elsewhere.linked)
        except NotStored as error:
            raise not_stored(str(error)) from error

    async def _kept(self, exchange: Exchange, entities: dict[str, list[str]]) -> Answer:
        """Keep a map of the entities that were found here and of those that the maps of sources list."""
        elsewhere = exchange.elsewhere or Listed()
        for one, registrations in elsewhere.entities.items():
            known = entities.setdefault(one, [])
            known += [registration for registration in registrations if registration not in known]
        return await _told(exchange, await self._made(exchange, entities, elsewhere), 201)


async def _told(exchange: Exchange, one: EntityMap, status: int) -> Answer:
    media_type, context = exchange.accept(), await exchange.reader_context()
    result = answer(with_context(one.document(), media_type, context), media_type, context)
    return Answer(status, result.body, [*result.headers, _location(one)])


def _named(exchange: Exchange) -> EntityMap | None:
    """Return the map that a request names; None if it names none, or one that is not there any more."""
    named = exchange.headers.get(HEADER)
    if named is None:
        return None
    map_id = unquote(named.decode("latin-1").strip().rstrip("/").rpartition("/")[2])
    return exchange.tenant.entity_maps.find(map_id)


def _location(one: EntityMap) -> tuple[bytes, bytes]:
    return HEADER, f"{PREFIX}entityMaps/{quote(one.id, safe=':')}".encode()


def _origins(store: Store, entity_id: str) -> list[str]:
    told = store.origins.get(entity_id) if isinstance(store, Mix) else None
    return told or [OWN]


def _without(given: Mapping[Any, Any], names: Any) -> dict[Any, Any]:
    return {name: value for name, value in given.items() if name not in names}


def _plainly(exchange: Exchange, parameters: Mapping[str, str]) -> Exchange:
    return in_place_of(exchange, parameters=parameters, headers=_without(exchange.headers, {b"accept"}))


def _narrowed(exchange: Exchange, ids: list[str]) -> bytes:
    """Return the Query document of a request with its selectors narrowed to some ids; no Query as it is."""
    document = exchange.document()
    selectors = document.get("entities", [{"type": "*"}]) if isinstance(document, dict) else None
    if not isinstance(selectors, list) or not all(isinstance(one, dict) for one in selectors):
        return exchange.raw
    narrowed = [{"id": ids, **({"type": one["type"]} if "type" in one else {})} for one in selectors]
    return orjson.dumps({**document, "entities": narrowed})


def _ids_in(exchange: Exchange) -> set[str] | None:
    """Return the ids that a request asks for; None if it may be any."""
    if exchange.method == "GET":
        given = exchange.parameter("id")
        return None if given is None else set(given.split(","))
    document = exchange.document()
    selectors = document.get("entities") if isinstance(document, dict) else None
    found: set[str] = set()
    for one in selectors if isinstance(selectors, list) else [None]:
        ids = one.get("id") if isinstance(one, dict) else None
        if ids is None:
            return None
        found |= {each for each in (ids if isinstance(ids, list) else [ids]) if isinstance(each, str)}
    return found


def _is_page_link(header: tuple[bytes, bytes]) -> bool:
    name, value = header
    if name == b"ngsild-results-count":
        return True
    return name == b"link" and (b'rel="next"' in value or b'rel="prev"' in value)


def _page_link(exchange: Exchange, offset: int, relation: str, media_type: str) -> tuple[bytes, bytes]:
    parameters = {**exchange.parameters, "offset": str(offset)}
    query = "&".join(
        f"{quote(name, safe='')}={quote(value, safe=':,')}" for name, value in parameters.items()
    )
    return b"link", f'<{exchange.path}?{query}>; rel="{relation}"; type="{media_type}"'.encode()


def wants_map(operation: Operation, exchange: Exchange) -> bool:
    """Say whether a query is to be answered by a map that it names, or wants to have made.

    It says the latter with entityMap=true or with entityMap among its options.
    """
    parameters = exchange.parameters
    if HEADER not in exchange.headers and "entityMap" not in parameters and "options" not in parameters:
        return False
    if operation.name not in THROUGH_A_MAP:
        return False
    return HEADER in exchange.headers or exchange.flag("entityMap") or _OPTION in _options(parameters)


def _options(parameters: Mapping[str, str]) -> list[str]:
    return parameters.get("options", "").split(",")


def _for_the_query(parameters: Mapping[str, str]) -> dict[str, str]:
    """Return the parameters without those that are about maps."""
    plain: dict[str, str] = _without(parameters, MAP_PARAMETERS)
    if _OPTION in _options(parameters):
        plain["options"] = ",".join(one for one in _options(parameters) if one != _OPTION)
        if not plain["options"]:
            del plain["options"]
    return plain
