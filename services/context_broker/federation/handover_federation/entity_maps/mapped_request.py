"""Requests that are answered from an entity map, or that collect the contents of a new one."""

from typing import Any

from handover_broker.request.request_context import RequestContext
from handover_federation.entity_maps.entity_map import EntityMap, Listed


class MappedRequest(RequestContext):
    """`entity_map` answers the request; `listed` collects the contents of the maps of context sources."""

    __slots__ = ("entity_map", "listed")

    entity_map: EntityMap | None
    listed: Listed | None


def with_map(
    request: RequestContext,
    *,
    entity_map: EntityMap | None = None,
    listed: Listed | None = None,
    **changes: Any,
) -> MappedRequest:
    """Return a copy of the request with an entity map, or with a collection for a new one."""
    result = MappedRequest.__new__(MappedRequest)
    for name in RequestContext.__slots__:
        setattr(result, name, getattr(request, name))
    result.entity_map = entity_map or entity_map_of(request)
    result.listed = listed or listed_of(request)
    for name, value in changes.items():
        setattr(result, name, value)
    return result


def entity_map_of(request: RequestContext) -> EntityMap | None:
    """Return the entity map that answers the request, None if there is none."""
    return request.entity_map if isinstance(request, MappedRequest) else None


def listed_of(request: RequestContext) -> Listed | None:
    """Return the collected contents for a new map; None if no map is created."""
    return request.listed if isinstance(request, MappedRequest) else None
