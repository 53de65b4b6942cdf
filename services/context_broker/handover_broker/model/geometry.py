"""GeoJSON geometries, as a GeoProperty holds them (RFC 7946; clause 4.7 of ETSI GS CIM 009)."""

from collections.abc import Mapping
from math import isfinite
from typing import Any, Final

DEPTHS: Final = {
    "Point": 0,
    "MultiPoint": 1,
    "LineString": 1,
    "MultiLineString": 2,
    "Polygon": 2,
    "MultiPolygon": 3,
}
"""The nesting depth of the positions, by type of geometry."""
MAX_POSITIONS: Final = 10_000
"""Maximum positions of a geometry: relating two geometries takes time proportional to their product."""

_NUMBERS: Final = frozenset({int, float})
_RING_FAULT: Final = "each ring of a Polygon has at least four positions, the last the same as the first"
_RANGE_FAULT: Final = (
    "a longitude is between -180 and 180, a latitude between -90 and 90 degrees, longitude first, and an "
    "altitude is finite; cut what crosses the antimeridian into two parts there (RFC 7946, section 3.1.9)"
)
_SIZE_FAULT: Final = f"a geometry has at most {MAX_POSITIONS} positions; simplify it"


def looks_like_geometry(value: Any) -> bool:
    """Return whether `value` is meant as a geometry: it has the type of one, and coordinates."""
    kind = value.get("type") if isinstance(value, Mapping) else None
    return isinstance(kind, str) and kind in DEPTHS and "coordinates" in value


def fault_of(value: Any) -> str | None:  # noqa: PLR0911 - a list of rules
    """Return the fault of a geometry, None if it has none.

    A valid geometry is safe to compute with: its positions are few enough, finite, and on the globe.
    """
    kind = value.get("type") if isinstance(value, Mapping) else None
    if not isinstance(kind, str) or kind not in DEPTHS:
        return f"its value must be a GeoJSON geometry of type {', '.join(DEPTHS)}"
    coordinates = value.get("coordinates")
    if kind == "Point":
        return _position_fault(coordinates, kind)
    lines = _lines(coordinates, DEPTHS[kind])
    if lines is None:
        return _shape_fault(kind)
    if sum(map(len, lines)) > MAX_POSITIONS:
        return _SIZE_FAULT
    for line in lines:
        for position in line:
            if (fault := _position_fault(position, kind)) is not None:
                return fault
    if kind in {"LineString", "MultiLineString"} and any(len(line) < 2 for line in lines):
        return "a LineString has at least two positions"
    if kind in {"Polygon", "MultiPolygon"} and any(len(ring) < 4 or ring[0] != ring[-1] for ring in lines):
        return _RING_FAULT
    return None


def _lines(coordinates: Any, depth: int) -> list[list[Any]] | None:
    """Return the lists of positions in coordinates of a depth; None if they are nested differently."""
    lists = [coordinates]
    for _ in range(depth - 1):
        if not all(isinstance(part, list) and part for part in lists):
            return None
        lists = [part for outer in lists for part in outer]
    return lists if all(isinstance(part, list) and part for part in lists) else None


def _position_fault(position: Any, kind: str) -> str | None:
    if (
        not isinstance(position, list)
        or not 2 <= len(position) <= 3
        or not _NUMBERS.issuperset(map(type, position))
    ):
        return _shape_fault(kind)
    if not (-180 <= position[0] <= 180 and -90 <= position[1] <= 90) or not isfinite(position[-1]):
        return _RANGE_FAULT
    return None


def _shape_fault(kind: str) -> str:
    return f"the coordinates fit no {kind}: a position is a list of two or three numbers, longitude first"
