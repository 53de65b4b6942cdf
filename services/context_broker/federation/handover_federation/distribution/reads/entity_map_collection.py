"""Collects entity maps from context sources that create some (clauses 4.3.6.7, 5.14.4, 5.14.5).

A source's map lists its entities that match the query, and is linked from the broker's map. Later pages are
requested by the linked map, so that the source need not repeat its search. If filters need whole entities,
the entities are read as well.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover_broker.model.context import Context
from handover_broker.model.validation import require_uri
from handover_broker.query.parameters import FILTERS
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.temporal.operations import temporal_parameters
from handover_federation.distribution.distributed_operations import (
    Perform,
    Sources,
    gather_all,
)
from handover_federation.distribution.forwarding.forwarder import (
    INVALID,
    SILENT,
    SourceError,
    SourceRequest,
)
from handover_federation.distribution.instances import types_in
from handover_federation.distribution.query_targets import (
    refuse_order,
    selector_parameters,
    target_of,
)
from handover_federation.distribution.reads.entity_fetching import (
    fetch_entities,
    is_queryable,
    narrowed,
)
from handover_federation.distribution.reads.fragment_collector import FragmentCollector
from handover_federation.distribution.reads.source_responses import query_source
from handover_federation.distribution.reads.temporal_fetching import (
    entity_parameters,
    temporal_parameters_of,
)
from handover_federation.entity_maps.entity_map import Listed
from handover_federation.entity_maps.mapped_request import with_map
from handover_federation.registrations.registration import Match, Registration

CREATE_ENTITY_MAP: Final = "createEntityMapQueryEntity"
CREATE_TEMPORAL_MAP: Final = "createEntityMapQueryTemporal"
_LIFETIME: Final = "entityMapLifetime"
_PAGE: Final = 1000
_MAX_PAGES: Final = 100
"""Pages of temporal entities that are read from a source without entity maps."""


class EntityMapCollector:
    """Makes context sources create maps for one query; `listed` collects the results."""

    def __init__(self, sources: Sources, context: Context, lifetime: str | None) -> None:
        self._sources = sources
        self._context = context
        self._lifetime = () if lifetime is None else ((_LIFETIME, lifetime),)
        self.listed = Listed()

    async def collect(
        self, match: Match, parameters: Mapping[str, str], into: FragmentCollector, *, is_split: bool
    ) -> None:
        """Have a source create a map, and read its entities if the map is not enough."""
        registration = match.registration
        is_listed = False
        if registration.takes(CREATE_ENTITY_MAP):
            try:
                dialect = await self._sources.forwarder.dialect(registration, self._context, body=None)
                questions = list(narrowed(match, parameters, self._context, dialect, is_split=is_split))
                if len(questions) == 1:
                    selection = [question for question in questions[0] if question[0] != "options"]
                    source_request = SourceRequest(
                        "GET", "entityMaps", dialect, (*selection, *self._lifetime)
                    )
                    is_listed = await self._take(registration, source_request)
            except SourceError as error:
                self._sources.add_error(error)
                return
            except Problem as problem:  # the @context of the source
                self._sources.add_error(SourceError(registration, SILENT, 502, problem.detail))
                return
        if is_queryable(match) and (not is_listed or _needs_entities(registration, parameters, is_split)):
            self.listed.entities = {
                entity_id: rest
                for entity_id, who_has in self.listed.entities.items()
                if (rest := [holder for holder in who_has if holder != registration.id])
            }  # the ids in the map are candidates; the entities that are read decide
            await fetch_entities(self._sources, match, parameters, self._context, into, is_split=is_split)

    async def _take(self, registration: Registration, source_request: SourceRequest) -> bool:
        """Take the map that a source creates; return whether it did. Raises `SourceError` if there is no
        response."""
        try:
            response = await query_source(self._sources, registration, source_request)
        except SourceError as error:
            if error.answered is None:
                raise
            return False  # the source creates no maps although it has registered the operation
        if response is None:
            return False
        try:
            document = orjson.loads(response.body)
        except orjson.JSONDecodeError:
            document = None
        entities = document.get("entityMap") if isinstance(document, dict) else None
        map_id = document.get("id") if isinstance(document, dict) else None
        if not isinstance(entities, dict) or not isinstance(map_id, str):
            self._sources.add_warning(
                INVALID, f"{registration.shown} returns something other than an entity map"
            )
            return False
        self.listed.linked[registration.id] = map_id
        for entity_id in entities:
            if _may_have(registration, entity_id) and self._is_visible(registration, entity_id, ()):
                self.listed.entities.setdefault(entity_id, []).append(registration.id)
        return True

    async def collect_temporal(self, match: Match, parameters: Mapping[str, str]) -> None:
        """Have a source create a map for a temporal query, or read the ids of its entities."""
        registration = match.registration
        try:
            dialect = await self._sources.forwarder.dialect(registration, self._context, body=None)
            target = [*entity_parameters(match, parameters, dialect.name)]
            target += temporal_parameters_of(
                match, parameters, dialect, same=dialect.context is self._context
            )
            if registration.takes(CREATE_TEMPORAL_MAP):
                source_request = SourceRequest(
                    "GET", "temporal/entityMaps", dialect, (*target, *self._lifetime)
                )
                if await self._take(registration, source_request):
                    return
            if registration.takes("queryTemporal"):
                await self._read_ids(
                    registration, SourceRequest("GET", "temporal/entities", dialect, tuple(target))
                )
        except SourceError as error:
            self._sources.add_error(error)
        except Problem as problem:
            self._sources.add_error(SourceError(registration, SILENT, 502, problem.detail))

    async def _read_ids(self, registration: Registration, source_request: SourceRequest) -> None:
        selection = [
            parameter
            for parameter in source_request.parameters
            if parameter[0] not in {"lastN", "options", "format"}
        ]
        for page in range(_MAX_PAGES):
            window = (("lastN", "1"), ("limit", str(_PAGE)), ("offset", str(page * _PAGE)))
            target = SourceRequest("GET", source_request.path, source_request.dialect, (*selection, *window))
            response = await query_source(self._sources, registration, target)
            try:
                documents = orjson.loads(response.body) if response is not None and response.body else []
            except orjson.JSONDecodeError:
                documents = None
            if not isinstance(documents, list):
                why = f"{registration.shown} returns no temporal entities"
                raise SourceError(registration, INVALID, 502, why)
            names = source_request.dialect.context
            ids = {
                document.get("id")
                for document in documents
                if isinstance(document, dict)
                and self._is_visible(registration, str(document.get("id")), types_in(document, names) or ())
            }
            fresh = [
                listed_id
                for listed_id in ids
                if isinstance(listed_id, str) and self._is_new(listed_id, registration)
            ]
            for entity_id in sorted(fresh):
                self.listed.entities.setdefault(entity_id, []).append(registration.id)
            if not fresh or len(documents) < _PAGE:
                return

    def _is_visible(self, registration: Registration, entity_id: str, types: Iterable[str]) -> bool:
        """Return whether the answer of a source about an entity counts and the client may see the entity."""
        return self._sources.admission.admits(registration, entity_id, types) and not (
            self._sources.request.tenant.store.hides(entity_id, types)
        )

    def _is_new(self, entity_id: str, registration: Registration) -> bool:
        return registration.id not in self.listed.entities.get(entity_id, ())


async def map_temporal(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET or POST temporal/entityMaps."""
    if request.method == "GET":
        context, parameters = await request.reader_context(), dict(request.parameters)
        questions = [parameters]
    else:
        document, context = await request.body()
        if not isinstance(document, dict):
            return await perform(request)
        parameters = {**request.parameters, **temporal_parameters(document)}
        query = {name: value for name, value in document.items() if name not in {"temporalQ", "aggrParams"}}
        questions = list(selector_parameters(query, parameters))
    map_collector = EntityMapCollector(sources, context, request.parameter(_LIFETIME))
    asking = []
    for question in questions:
        target, where = target_of(question, context, None)
        matches = sources.registry.matching((CREATE_TEMPORAL_MAP, "queryTemporal"), target, where)
        refuse_order(question, sources.unvisited(matches, uses_map=False))
        asking += [map_collector.collect_temporal(match, question) for match in sources.unvisited(matches)]
    if not asking:
        return await perform(request)
    local = {**request.parameters, "local": "true"}
    own = with_map(request, parameters=local, listed=map_collector.listed)
    await gather_all(*asking)
    return await perform(own)


def _needs_entities(registration: Registration, parameters: Mapping[str, str], is_split: bool) -> bool:
    """Return whether the ids in a map are not enough to know the matching entities."""
    if "join" in parameters:
        return True
    has_other_names = any(name.lower() == "jsonldcontext" for name, _ in registration.source_info)
    return (is_split or has_other_names) and any(name in parameters for name in FILTERS)


def _may_have(registration: Registration, entity_id: Any) -> bool:
    try:
        require_uri(entity_id, "an id in an entity map")
    except Problem:
        return False
    return any(
        not piece.entities or any(entity.has(entity_id) for entity in piece.entities)
        for piece in registration.information
    )
