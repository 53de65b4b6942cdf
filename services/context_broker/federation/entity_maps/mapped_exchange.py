"""Exchanges that are answered from an entity map, or that collect the contents of a new one."""

from typing import Any

from services.context_broker.federation.entity_maps.entity_map import EntityMap, Listed
from services.context_broker.request.request_context import RequestContext as Exchange


class MappedExchange(Exchange):
    """`entity_map` answers the request; `listed` collects the contents of the maps of context sources."""

    __slots__ = ("entity_map", "listed")

    entity_map: EntityMap | None
    listed: Listed | None


def with_map(
    exchange: Exchange, *, entity_map: EntityMap | None = None, listed: Listed | None = None, **changes: Any
) -> MappedExchange:
    """Return a copy of the exchange with an entity map, or with a collection for a new one."""
    result = MappedExchange.__new__(MappedExchange)
    for name in Exchange.__slots__:
        setattr(result, name, getattr(exchange, name))
    result.entity_map = entity_map or entity_map_of(exchange)
    result.listed = listed or listed_of(exchange)
    for name, value in changes.items():
        setattr(result, name, value)
    return result


def entity_map_of(exchange: Exchange) -> EntityMap | None:
    """Return the entity map that answers the request, None if there is none."""
    return exchange.entity_map if isinstance(exchange, MappedExchange) else None


def listed_of(exchange: Exchange) -> Listed | None:
    """Return the collected contents for a new map; None if no map is created."""
    return exchange.listed if isinstance(exchange, MappedExchange) else None
