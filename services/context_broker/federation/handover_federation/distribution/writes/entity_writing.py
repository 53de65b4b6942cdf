"""Distributes writes of single entities: create, replace, merge, append, update, delete.

Clauses 5.6.1 to 5.6.6 and 5.6.11 to 5.6.19. The broker's own part comes first: a write that it rejects as
invalid is not forwarded. All sources are then written at the same time, also if the broker already has the
entity (create) or lacks the attribute: that part has failed, and the response is 207 if another succeeds.
"""

from collections.abc import Mapping
from typing import Any, Final
from urllib.parse import quote

import orjson

from handover.errors import Problem
from handover_broker.model.context import Context
from handover_broker.model.entity_parser import expand
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import require_name, require_uri, shown
from handover_broker.query.type_selection import type_selection
from handover_broker.request.derived_request import derived
from handover_broker.request.query_parameters import datasets_of
from handover_broker.request.request_context import (
    PREFIX,
    RequestContext,
    Response,
)
from handover_federation.distribution.distributed_operations import (
    Perform,
    Sources,
    gather_all,
)
from handover_federation.distribution.forwarding.forwarder import (
    SILENT,
    SourceError,
    SourceRequest,
    in_dialect,
    quoted,
)
from handover_federation.distribution.instances import (
    ANY,
    attributes_in,
    datasets_in,
    instances_in,
    part_of,
    types_in,
)
from handover_federation.distribution.writes import outcomes
from handover_federation.distribution.writes.outcomes import Outcome
from handover_federation.distribution.writes.routing import (
    WriteRoute,
    WriteRouting,
    route_write,
)
from handover_federation.registrations.coverage import placement_filter
from handover_federation.registrations.registration import EntityTarget

_PASSED_ON: Final = ("options", "format", "observedAt", "lang", "datasetId", "deleteAll")
_DONE: Final = Response(204)


async def create(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """POST entities, or temporal/entities."""
    document, context = await request.body()
    if not isinstance(document, Mapping):
        return await perform(request)
    operation, root = ("upsertTemporal", "temporal/") if _is_temporal(request) else ("createEntity", "")
    entity_id = require_uri(document.get("id", document.get("@id")), "the entity id")
    names = attributes_in(document, context)
    types = types_in(document, context)
    target = EntityTarget((entity_id,), None, types)
    routing = route_write(
        sources, (operation,), target, instances_in(document, names), placement_filter(document)
    )
    if not routing.others:
        return await perform(request)
    location = f"{PREFIX}{root}entities/{quote(entity_id, safe=':')}".encode()
    response = Response(201, b"", [(b"location", location)])
    path = f"{root}entities"
    change = DistributedWrite(sources, request, perform, context, document, names, operation, path)
    return await change.entity_answer(entity_id, routing, response)


async def change_entity(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """PUT or PATCH entities/{id}."""
    operation = "replaceEntity" if request.method == "PUT" else "mergeEntity"
    change, entity_id, routing = await _of_document(sources, request, perform, operation, "")
    if not routing.others:
        return await perform(request)
    return await change.entity_answer(entity_id, routing, _DONE)


async def change_attributes(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """POST or PATCH entities/{id}/attrs, or POST temporal/entities/{id}/attrs."""
    operation = "appendAttrs" if request.method == "POST" else "updateEntity"
    if _is_temporal(request):
        operation = "appendAttrsTemporal"
    change, _, routing = await _of_document(sources, request, perform, operation, "/attrs")
    if not routing.others:
        return await perform(request)
    return await change.attributes_answer(routing)


async def change_attribute(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """PATCH, PUT or DELETE entities/{id}/attrs/{name}; the same (and one instance) of temporal/entities."""
    operation = {"PATCH": "updateAttrs", "PUT": "replaceAttrs"}.get(request.method, "deleteAttrs")
    if _is_temporal(request):
        operation = "deleteAttrsTemporal"
        if len(request.names) > 2:
            is_end = request.method == "DELETE"
            operation = "deleteAttrInstanceTemporal" if is_end else "updateAttrInstanceTemporal"
    if request.method == "DELETE":
        document, context = None, await request.reader_context()
    else:
        document, context = await request.body()
    entity_id = require_uri(request.names[0], "the entity id in the path")
    name = request.names[1]
    iri = expand(require_name(name, "the attribute name in the path"), context.terms)
    target = EntityTarget(
        (entity_id,), None, _types_of(sources, request, entity_id, context), frozenset({iri})
    )
    instances = frozenset((iri, dataset) for dataset in _datasets_of(request, document))
    routing = route_write(sources, (operation,), target, instances)
    if not routing.others:
        return await perform(request)
    change = DistributedWrite(sources, request, perform, context, document, {name: iri}, operation, None)
    return await change.attributes_answer(routing)


async def delete(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """DELETE entities/{id}, or temporal/entities/{id}."""
    operation, root = ("deleteTemporal", "temporal/") if _is_temporal(request) else ("deleteEntity", "")
    context = await request.reader_context()
    entity_id = require_uri(request.names[0], "the entity id in the path")
    target = EntityTarget((entity_id,), None, _types_of(sources, request, entity_id, context))
    routing = route_write(sources, (operation,), target, None)
    if not routing.others:
        return await perform(request)
    path = f"{root}entities/{quoted(entity_id)}"
    change = DistributedWrite(sources, request, perform, context, None, {}, operation, path)
    return await change.entity_answer(entity_id, routing, _DONE)


def _is_temporal(request: RequestContext) -> bool:
    return request.path.startswith(f"{PREFIX}temporal/")


class DistributedWrite:
    """One write with all its parts. `names` are the attributes of the document (or the one in the path)
    with their IRIs."""

    def __init__(  # noqa: PLR0917 - the parts of one request
        self,
        sources: Sources,
        request: RequestContext,
        perform: Perform,
        context: Context,
        document: Mapping[str, Any] | None,
        names: Mapping[str, str],
        operation: str,
        path: str | None,
    ) -> None:
        self._sources = sources
        self._request = request
        self._perform = perform
        self._context = context
        self._document = document
        self._names = names
        self._operation = operation
        self._path = path
        self._entity_id = request.names[0] if request.names else str((document or {}).get("id", ""))
        parameters = request.parameters
        self._parameters = tuple((name, parameters[name]) for name in _PASSED_ON if name in parameters)

    async def entity_answer(self, entity_id: str, routing: WriteRouting, well: Response) -> Response:
        """Carry out the write and return the response of an operation on an entity."""
        own, parts = await self._carried_out(routing)
        good, failed = outcomes.settled(parts)
        if not failed:
            return own if own is not None and own.status < 400 else well
        if not good and (answer := outcomes.failure(failed)) is not None:
            return answer
        return outcomes.entity_result(entity_id, good, failed)

    async def attributes_answer(self, routing: WriteRouting) -> Response:
        """Carry out the write and return the response of an operation on attributes (clause 5.2.18).

        Names in it are IRIs, because it has no @context (clause 6.3.6).
        """
        own, parts = await self._carried_out(routing)
        good, failed = outcomes.settled(parts)
        result = orjson.loads(own.body) if own is not None and own.status == 207 else None
        if not failed and result is None:
            return own if own is not None and own.status < 400 else _DONE
        if not good and result is None and (answer := outcomes.failure(failed)) is not None:
            return answer
        done = {name for outcome in good for name in outcome.names}
        # What is absent here and was changed at a source is changed.
        own_left = [] if result is None else result["notUpdated"]
        left = [refused for refused in own_left if refused["attributeName"] not in done]
        for outcome in failed:
            reason = str((outcome.problem or {}).get("detail") or f"answered {outcome.status}")
            by = {"registrationId": outcome.registration.id} if outcome.registration is not None else {}
            left += [{"attributeName": name, "reason": reason, **by} for name in sorted(outcome.names)]
        if result is not None:
            done |= set(result["updated"])
        return outcomes.multi_status({"updated": sorted(done), "notUpdated": left}) if left else _DONE

    async def _carried_out(self, routing: WriteRouting) -> tuple[Response | None, list[Outcome]]:
        """Return the broker's own response if it had a part, and all outcomes; raises what it rejects."""
        own, written = None, list[Outcome]()
        if routing.own is not None:
            try:
                own = await self._perform(self._own_part(routing))
                if own.status != 207:
                    written.append(Outcome(None, routing.own_names, own.status))
            except Problem as problem:
                if problem.status not in {404, 409} or problem.__cause__ is not None:
                    raise
                is_held = problem.status == 409 or self._is_held()
                written.append(Outcome(None, routing.own_names, problem.status, problem.body(), is_held))
        results = await gather_all(*(self.forwarded(route) for route in routing.others))
        return own, [*written, *(part for parts in results for part in parts)]

    def _is_held(self) -> bool:
        """Return whether the broker has the current entity in the path, of the requested type."""
        entity = (
            None if _is_temporal(self._request) else self._request.tenant.store.latest(self._request.names[0])
        )
        wanted = self._request.parameter("type")
        if entity is None or wanted is None:
            return entity is not None
        return type_selection(wanted, self._context.terms.expand).wants(entity.types)

    def _own_part(self, routing: WriteRouting) -> RequestContext:
        if self._document is None or not any(match.registration.mode.is_proxied for match in routing.others):
            return self._request
        own = routing.own or frozenset()
        if self._path is None and own:  # one attribute, in the path
            return self._request
        return derived(self._request, raw=orjson.dumps(part_of(self._document, self._names, own)))

    def _attribute_path(self, name: str) -> str:
        """Return the path of the attribute, or of an instance of it, with the given name."""
        entity_id, _, *instance = self._request.names
        root = "temporal/" if _is_temporal(self._request) else ""
        return "/".join((f"{root}entities", quoted(entity_id), "attrs", quoted(name), *map(quoted, instance)))

    async def forwarded(self, route: WriteRoute) -> list[Outcome]:
        """Return the outcomes of a source's part; none if the request has passed the source before."""
        registration, names = route.registration, route.names
        if route.operation is None:
            return [outcomes.of_refusal(registration, names, self._operation)]
        try:
            body = None if self._document is None else self._request.content_type()
            dialect = await self._sources.forwarder.dialect(registration, self._context, body=body)
            path = self._path
            document = None
            if path is None:
                (iri,) = self._names.values()
                path = self._attribute_path(dialect.name(iri))
                document = (
                    None if self._document is None else in_dialect(self._document, self._context, dialect)
                )
            elif self._document is not None:
                part = part_of(self._document, self._names, route.instances)
                part.pop("@context", None)
                document = in_dialect(part, self._context, dialect)
            source_request = SourceRequest(self._request.method, path, dialect, self._parameters, document)
            await self._sources.record(registration, [self._entity_id])
            response, _ = await self._sources.forwarder.send(
                registration, source_request, self._sources.origin
            )
        except SourceError as error:
            return [outcomes.of_source_error(error, names)]
        except Problem as problem:  # the @context of the source
            return [outcomes.of_source_error(SourceError(registration, SILENT, 502, problem.detail), names)]
        if not registration.mode.is_proxied and self._sources.is_loop_answer(registration, response.status):
            return []
        expand = dialect.context.terms.expand
        return outcomes.of_parts(registration, names, response, self._entity_id, expand)


async def _of_document(
    sources: Sources, request: RequestContext, perform: Perform, operation: str, below: str
) -> tuple[DistributedWrite, str, WriteRouting]:
    document, context = await request.body()
    entity_id = require_uri(request.names[0], "the entity id in the path")
    if not isinstance(document, Mapping):
        raise bad_request_data(f"the body is a JSON object, not {shown(document)}")
    names = attributes_in(document, context)
    types = types_in(document, context) or _types_of(sources, request, entity_id, context)
    target = EntityTarget((entity_id,), None, types)
    where = placement_filter(document) if operation == "replaceEntity" else None
    routing = route_write(sources, (operation,), target, instances_in(document, names), where)
    root = "temporal/" if _is_temporal(request) else ""
    path = f"{root}entities/{quoted(entity_id)}{below}"
    change = DistributedWrite(sources, request, perform, context, document, names, operation, path)
    return change, entity_id, routing


def _datasets_of(request: RequestContext, document: Any) -> set[str | None]:
    """Return the datasetIds of the instances in a write of one attribute."""
    if len(request.names) > 2 or request.parameter("deleteAll") == "true":
        return {ANY}
    if document is not None:
        return datasets_in(document)
    text = request.parameter("datasetId")
    return {None} if text is None else set(datasets_of(text) or {None})


def _types_of(
    sources: Sources, request: RequestContext, entity_id: str, context: Context
) -> frozenset[str] | None:
    """Return the known types of an entity: from the request, or from the broker's own entity."""
    if text := request.parameter("type"):
        return frozenset(context.terms.expand(name) for name in text.split(",") if name) or None
    entity = sources.request.tenant.store.latest(entity_id)
    return None if entity is None else frozenset(entity.types)
