"""GeoJSON geometries, as a GeoProperty holds them (RFC 7946; clause 4.7 of ETSI GS CIM 009)."""

from collections.abc import Mapping
from typing import Any, Final

DEPTHS: Final = {
    "Point": 0,
    "MultiPoint": 1,
    "LineString": 1,
    "MultiLineString": 2,
    "Polygon": 2,
    "MultiPolygon": 3,
}
"""How deep the positions of each kind of geometry are nested."""


def looks_like_geometry(value: Any) -> bool:
    """Say whether `value` is meant to be a geometry: its type is one and it has coordinates."""
    kind = value.get("type") if isinstance(value, Mapping) else None
    return isinstance(kind, str) and kind in DEPTHS and "coordinates" in value


def fault_of(value: Any) -> str | None:
    """Return what is wrong with a geometry, None if nothing is."""
    kind = value.get("type") if isinstance(value, Mapping) else None
    if not isinstance(kind, str) or kind not in DEPTHS:
        return f"its value must be a GeoJSON geometry of type {', '.join(DEPTHS)}"
    coordinates = value.get("coordinates")
    if not _is_nested(coordinates, DEPTHS[kind]):
        return f"the coordinates fit no {kind}: a position is a list of two or three numbers, longitude first"
    if kind in {"LineString", "MultiLineString"}:
        lines = [coordinates] if kind == "LineString" else coordinates
        return None if all(len(line) >= 2 for line in lines) else "a LineString has at least two positions"
    if kind in {"Polygon", "MultiPolygon"}:
        polygons = [coordinates] if kind == "Polygon" else coordinates
        return None if all(_is_closed(ring) for polygon in polygons for ring in polygon) else _ring_fault
    return None


_ring_fault = "each ring of a Polygon has at least four positions, the last the same as the first"


def _is_closed(ring: list[Any]) -> bool:
    return len(ring) >= 4 and ring[0] == ring[-1]


def _is_nested(coordinates: Any, depth: int) -> bool:
    if not isinstance(coordinates, list):
        return False
    if depth == 0:
        return 2 <= len(coordinates) <= 3 and all(_is_number(part) for part in coordinates)
    return bool(coordinates) and all(_is_nested(part, depth - 1) for part in coordinates)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
