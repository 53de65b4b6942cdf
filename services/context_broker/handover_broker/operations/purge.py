"""Purge: selected entities are deleted, or lose some of their attributes (clause 5.6.21)."""

import asyncio
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover_broker.model import changes
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity, Event
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import timestamp_now
from handover_broker.query.parameters import Use, names_for
from handover_broker.query.selection import Selection, hits_of
from handover_broker.request.query_parameters import names_of, selection_of
from handover_broker.request.request_context import RequestContext, Response

PURGE_PARAMETERS: Final = names_for(Use.PURGE)
AT_ONCE: Final = 500
"""Entities that are written together."""

_SYSTEM: Final = frozenset({"createdAt", "modifiedAt", "deletedAt", "expiresAt", "observedAt"})


async def purge(request: RequestContext) -> Response:
    """DELETE entities: 204 when all are purged, 207 with those that were not."""
    context = await request.reader_context()
    selection = selection_to_purge(request, context)
    names, keep = _named(request, context)
    store = request.tenant.store
    ids = [entity.id for entity in await hits_of(store, selection)]
    succeeded: list[str] = []
    errors: list[dict[str, Any]] = []
    for start in range(0, len(ids), AT_ONCE):
        staged: dict[str, asyncio.Future[None]] = {}
        for entity_id in ids[start : start + AT_ONCE]:
            entity = store.latest(entity_id)
            event = None if entity is None or not selection.wants(entity) else _event(entity, names, keep)
            if event is None:
                succeeded.append(entity_id)
            else:
                staged[entity_id] = store.stage(event)
        outcomes = await asyncio.gather(*staged.values(), return_exceptions=True)
        for entity_id, outcome in zip(staged, outcomes, strict=True):
            if isinstance(outcome, Problem):
                errors.append({"entityId": entity_id, "error": outcome.body()})
            elif outcome is not None:
                raise outcome
            else:
                succeeded.append(entity_id)
    if not errors:
        return Response(204)
    body = orjson.dumps({"success": succeeded, "errors": errors})
    return Response(207, body, [(b"content-type", b"application/json")])


def _event(entity: Entity, names: frozenset[str] | None, keep: bool) -> Event | None:
    """Return the effect of the purge on an entity, None if there is none."""
    if names is None:
        return Event.end_of(entity)
    outcome = changes.pruned(entity, names, timestamp_now(), keep=keep)
    return None if outcome.entity is entity else Event(entity, outcome.entity, outcome.touched)


def _named(request: RequestContext, context: Context) -> tuple[frozenset[str] | None, bool]:
    """Return the attributes to delete or to keep; None if whole entities are deleted."""
    keep, drop = request.parameter("keep"), request.parameter("drop")
    if keep is not None and drop is not None:
        raise bad_request_data("keep and drop exclude each other: what is not kept is dropped; leave out one")
    return names_of(drop if keep is None else keep, context), keep is not None


def selection_to_purge(request: RequestContext, context: Context) -> Selection:
    """Return the selection to purge; raise a problem (400) if it selects everything.

    Ids and system attributes alone select nothing, unless only attributes are deleted (clause 5.6.21.4).
    """
    parameters = request.parameters
    attributes = parameters.get("attrs", "").split(",")
    selection = selection_of({**parameters, "local": "true"}, context)
    if selection.query is not None and selection.query.hops:
        raise bad_request_data("a purge does not follow links; leave linked entities out of q")
    narrows = (
        selection.types is not None
        or (selection.attributes is not None and not _SYSTEM.issuperset(attributes))
        or (selection.query is not None and selection.query.names_attributes)
        or selection.places is not None
        or "keep" in parameters
        or "drop" in parameters
    )
    if not narrows and not request.flag("local"):
        raise bad_request_data(
            "the purge is too broad: select entities by type, by an attribute in attrs or q, or by place; "
            "local=true purges all entities of this broker"
        )
    return selection
