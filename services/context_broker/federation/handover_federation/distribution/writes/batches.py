"""Batch writes distributed to context sources (clauses 5.6.7 to 5.6.10 and 5.6.20).

Each entity is routed as if it came alone. Each source gets its entities in one batch, or one by one if it
takes no batches. An entity that the broker's own part refuses as invalid is not forwarded. An entity that
succeeds in one part and fails in another is listed both as a success and as an error (clause 5.6.7.4).
"""

import asyncio
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover_broker.model.context import Context
from handover_broker.model.validation import require_uri
from handover_broker.request.derived_request import derived
from handover_broker.request.request_context import (
    JSON,
    RequestContext,
    Response,
)
from handover_federation.distribution.distributed_operations import (
    Handler,
    Perform,
    Sources,
    gather_all,
)
from handover_federation.distribution.forwarding.forwarder import (
    SILENT,
    SourceDialect,
    SourceError,
    SourceRequest,
    in_dialect,
    quoted,
)
from handover_federation.distribution.instances import (
    Instances,
    attributes_in,
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
from handover_federation.registrations.registration import EntityTarget, Registration

MAX_BATCH_SIZE: Final = 1000
"""Entities in one forwarded batch."""
_WITHOUT_EFFECT: Final = frozenset({("options", "replace"), ("options", "update")})
MAX_CONCURRENT_REQUESTS: Final = 16
"""Concurrent requests to one source that takes no batches."""
_SINGLY: Final = {
    "createBatch": ("createEntity", "POST", "entities"),
    "upsertBatch": ("createEntity", "POST", "entities"),
    "updateBatch": ("appendAttrs", "POST", "entities/{id}/attrs"),
    "mergeBatch": ("mergeEntity", "PATCH", "entities/{id}"),
    "deleteBatch": ("deleteEntity", "DELETE", "entities/{id}"),
}
"""The operation, method and path for a single entity of a batch."""
_WHOLE: Final = frozenset({"createBatch", "upsertBatch"})
"""Operations that replace a whole entity, including its location and scopes."""


@dataclass(slots=True)
class _Item:
    """One entity of a batch. `document` is the entity, or its id in a delete."""

    document: Any
    entity_id: Any
    context: Context
    names: Mapping[str, str]
    routing: WriteRouting
    outcomes: list[Outcome] = field(default_factory=list)
    is_new: bool = False

    def part(self, instances: Instances) -> Any:
        """Return the entity with these instances of attributes only."""
        return (
            part_of(self.document, self.names, instances)
            if isinstance(self.document, Mapping)
            else self.document
        )

    @property
    def own_part(self) -> Any:
        """Return the part that the broker writes itself."""
        proxied = any(match.registration.mode.is_proxied for match in self.routing.others)
        return self.part(self.routing.own or frozenset()) if proxied else self.document


def batch(operation: str) -> Handler:
    """Return the handler of a batch operation, named as in table 4.20-1."""

    async def handler(sources: Sources, request: RequestContext, perform: Perform) -> Response:
        return await _Batch(sources, request, perform, operation).answer()

    return handler


class _Batch:
    """One batch request."""

    def __init__(self, sources: Sources, request: RequestContext, perform: Perform, operation: str) -> None:
        self._sources = sources
        self._request = request
        self._perform = perform
        self._operation = operation
        parameters = request.parameters
        names = ("options", "format", "observedAt", "lang")
        self._parameters = tuple((name, parameters[name]) for name in names if name in parameters)
        if operation == "updateBatch":  # other brokers refuse what changes nothing
            self._parameters = tuple(
                parameter for parameter in self._parameters if parameter not in _WITHOUT_EFFECT
            )

    async def answer(self) -> Response:
        """Carry out the batch."""
        documents = self._request.document()
        if not isinstance(documents, list):
            return await self._perform(self._request)
        media_type = self._request.content_type()
        items = [await self._item(document, media_type) for document in documents]
        if not any(item.routing.others for item in items):
            return await self._perform(self._request)
        await self._do_own([item for item in items if item.routing.own is not None])
        await self._forward([item for item in items if not _is_refused(item)])
        return self._result(items)

    async def _item(self, document: Any, media_type: str) -> _Item:
        nothing = WriteRouting((), frozenset())
        singly = _SINGLY[self._operation][0]
        try:
            if self._operation == "deleteBatch":
                entity_id = require_uri(document, "an entity id")
                context = await self._request.reader_context()
                entity = self._request.tenant.store.latest(entity_id)
                types = None if entity is None else frozenset(entity.types)
                target = EntityTarget((entity_id,), None, types)
                routing = route_write(self._sources, (self._operation, singly), target, None)
                return _Item(document, entity_id, context, {}, routing)
            context = await self._request.context_of(document, media_type)
            entity_id = require_uri(document.get("id", document.get("@id")), "the entity id")
            names = attributes_in(document, context)
            entity = self._request.tenant.store.latest(entity_id)
            types = types_in(document, context) or (None if entity is None else frozenset(entity.types))
            target = EntityTarget((entity_id,), None, types)
            operations = (self._operation, singly)
            where = placement_filter(document) if self._operation in _WHOLE else None
            routing = route_write(self._sources, operations, target, instances_in(document, names), where)
            return _Item(document, entity_id, context, names, routing)
        except (Problem, AttributeError):  # the broker's own part reports the error
            core = await self._sources.forwarder.contexts.of(None)
            result = document.get("id") if isinstance(document, dict) else document
            return _Item(document, result, core, {}, nothing)

    async def _do_own(self, items: list[_Item]) -> None:
        if not items:
            return
        raw = orjson.dumps([item.own_part for item in items])
        answer = await self._perform(derived(self._request, raw=raw))
        result = orjson.loads(answer.body) if answer.body else None
        errors = _errors_in(result)
        created = set(result) if answer.status == 201 and isinstance(result, list) else set()
        for item in items:
            names = item.routing.own_names
            problem = errors.get(_key(item.entity_id))
            status = answer.status if problem is None else _status_of(problem)
            item.outcomes.append(Outcome(None, names, status, problem))
            item.is_new = item.is_new or item.entity_id in created

    async def _forward(self, items: list[_Item]) -> None:
        groups: dict[
            tuple[Any, ...], tuple[Registration, SourceDialect, str, list[tuple[_Item, WriteRoute]]]
        ] = {}
        for item in items:
            for route in item.routing.others:
                source = route.registration
                if route.operation is None:
                    item.outcomes.append(outcomes.of_refusal(source, route.names, self._operation))
                    continue
                try:
                    dialect = await self._sources.forwarder.dialect(
                        source, item.context, body=self._request.content_type()
                    )
                except Problem as problem:
                    error = SourceError(source, SILENT, 502, problem.detail)
                    item.outcomes.append(outcomes.of_source_error(error, route.names))
                    continue
                key = (source.id, route.operation, dialect.media_type, dialect.link, dialect.context.key)
                groups.setdefault(key, (source, dialect, route.operation, []))[3].append((item, route))
        await gather_all(*(self._forward_group(*group) for group in groups.values()))

    async def _forward_group(
        self,
        registration: Registration,
        dialect: SourceDialect,
        operation: str,
        routing: list[tuple[_Item, WriteRoute]],
    ) -> None:
        if operation == self._operation:
            for start in range(0, len(routing), MAX_BATCH_SIZE):
                await self._forward_batch(registration, dialect, routing[start : start + MAX_BATCH_SIZE])
            return
        turn = asyncio.Semaphore(MAX_CONCURRENT_REQUESTS)

        async def alone(item: _Item, route: WriteRoute) -> None:
            async with turn:
                item.outcomes += await self._forward_one(registration, dialect, item, route)

        await gather_all(*(alone(item, route) for item, route in routing))

    async def _forward_batch(
        self, registration: Registration, dialect: SourceDialect, routing: list[tuple[_Item, WriteRoute]]
    ) -> None:
        documents = [_document(item, route, dialect) for item, route in routing]
        path = f"entityOperations/{self._operation.removesuffix('Batch')}"
        source_request = SourceRequest("POST", path, dialect, self._parameters, documents)
        try:
            await self._sources.record(registration, [item.entity_id for item, _ in routing])
            response, _ = await self._sources.forwarder.send(
                registration, source_request, self._sources.origin
            )
        except SourceError as error:
            for item, route in routing:
                item.outcomes.append(outcomes.of_source_error(error, route.names))
            return
        if self._is_loop(registration, response.status):
            return
        result = _result_in(response.body) if response.status in {201, 207} else None
        errors, done = _errors_in(result), set(outcomes.success_in(result))
        created = (
            {entity_id for entity_id in result if isinstance(entity_id, str)}
            if isinstance(result, list)
            else set()
        )
        for item, route in routing:
            key = _key(item.entity_id)
            problem = errors.get(key)
            if problem is not None:
                status, left = _status_of(problem), frozenset[str]() if key in done else route.names
                is_partial = key in done
                item.outcomes.append(Outcome(registration, left, status, problem, is_partial=is_partial))
            if key in done or (problem is None and response.status == 207 and errors):
                item.outcomes.append(Outcome(registration, route.names, 204))
            elif problem is None:
                item.outcomes.append(outcomes.of_response(registration, route.names, response))
            item.is_new = item.is_new or item.entity_id in created

    async def _forward_one(
        self, registration: Registration, dialect: SourceDialect, item: _Item, route: WriteRoute
    ) -> list[Outcome]:
        _, method, path = _SINGLY[self._operation]
        parts = await self._send_single(registration, dialect, item, route, method, path)
        if self._operation != "upsertBatch" or not parts:
            return parts
        if parts[0].status != 409:
            item.is_new = item.is_new or parts[0].problem is None
            return parts
        keeps = "update" in self._request.parameters.get("options", "").split(",")
        if registration.takes("appendAttrs" if keeps else "replaceEntity"):
            method, path = ("POST", "entities/{id}/attrs") if keeps else ("PUT", "entities/{id}")
            return await self._send_single(registration, dialect, item, route, method, path)
        return parts

    async def _send_single(  # noqa: PLR0917 - the parts of one request
        self,
        registration: Registration,
        dialect: SourceDialect,
        item: _Item,
        route: WriteRoute,
        method: str,
        path: str,
    ) -> list[Outcome]:
        document = None if method == "DELETE" else _document(item, route, dialect)
        options = () if self._operation == "upsertBatch" else self._parameters
        where = path.replace("{id}", quoted(item.entity_id))
        source_request = SourceRequest(method, where, dialect, options, document)
        try:
            await self._sources.record(registration, [item.entity_id])
            response, _ = await self._sources.forwarder.send(
                registration, source_request, self._sources.origin
            )
        except SourceError as error:
            return [outcomes.of_source_error(error, route.names)]
        if self._is_loop(registration, response.status):
            return []
        expand = dialect.context.terms.expand
        return outcomes.of_parts(registration, route.names, response, item.entity_id, expand)

    def _is_loop(self, registration: Registration, status: int) -> bool:
        return not registration.mode.is_proxied and self._sources.is_loop_answer(registration, status)

    def _result(self, items: Iterable[_Item]) -> Response:
        success: list[Any] = []
        errors: list[dict[str, Any]] = []
        created: list[Any] = []
        for item in items:
            good, failed = outcomes.settled(item.outcomes)
            if failed:
                errors += outcomes.entity_errors(item.entity_id, failed)
            if failed and not good:
                continue
            success.append(item.entity_id)
            if item.is_new or self._operation == "createBatch":
                created.append(item.entity_id)
        if errors:
            return outcomes.multi_status({"success": success, "errors": errors})
        if created:
            return Response(201, orjson.dumps(created), [(b"content-type", JSON.encode())])
        return Response(204)


def _is_refused(item: _Item) -> bool:
    """Return whether the broker rejects an entity as invalid; "exists already" and "not found" do not
    count."""
    return any(outcome.problem is not None and outcome.status not in {404, 409} for outcome in item.outcomes)


def _document(item: _Item, route: WriteRoute, dialect: SourceDialect) -> Any:
    if not isinstance(item.document, Mapping):
        return item.document
    return in_dialect(item.part(route.instances), item.context, dialect)


def _result_in(body: bytes) -> Any:
    try:
        return orjson.loads(body) if body else None
    except orjson.JSONDecodeError:
        return None


def _errors_in(result: Any) -> dict[Any, dict[str, Any]]:
    return dict(outcomes.errors_in(result))


def _status_of(problem: Mapping[str, Any]) -> int:
    result = problem.get("status")
    return result if isinstance(result, int) and 400 <= result < 600 else 400


def _key(entity_id: Any) -> Any:
    return entity_id if isinstance(entity_id, str) else None
