"""Distances on the globe, in metres, between GeoJSON geometries; correct at the poles and the date line.

The earth is a sphere (clause 4.23.1 of ETSI GS CIM 009); the ellipsoid differs by half a percent at most.
Lines are straight in longitude and latitude (RFC 7946, section 3.1.1).
"""

import itertools
from collections.abc import Iterator, Mapping
from math import asin, cos, degrees, hypot, inf, radians, sin, sqrt
from typing import Any, Final

from handover_broker.model.geometry import DEPTHS

EARTH_RADIUS_M: Final = 6_371_008.8
"""The mean radius of the earth."""

_LONGEST_PIECE_DEG: Final = 5.0
"""Lines are cut into segments of this length, in which the distance to a point has only one minimum."""
_ZOOMS: Final = 10
"""Bisections of a segment in the search for the nearest point."""
_TOUCH_UPS: Final = 3
"""Newton steps on a flat map around the nearest point."""
_ROWS: Final = 128
"""Segments of one geometry that are compared with all of the other at once; with 100,000 it takes 300 MB."""
_PAIRS: Final = 1024
"""Pairs of segments that are measured at once."""

Position = tuple[float, float]
"""Longitude and latitude in degrees."""
Segment = tuple[Position, Position]
Box = tuple[float, float, float, float]
"""West, south, east and north in degrees; east may be beyond 180 and west beyond -180."""


def distance_m(a: Position, b: Position) -> float:
    """Return the distance of two positions (haversine)."""
    south, north = radians(a[1]), radians(b[1])
    half = sin((north - south) / 2) ** 2 + cos(south) * cos(north) * sin(radians(b[0] - a[0]) / 2) ** 2
    return 2 * EARTH_RADIUS_M * asin(min(1.0, sqrt(half)))


def point_of(geometry: Mapping[str, Any]) -> Position | None:
    """Return the position of a Point; None for other geometries."""
    if geometry["type"] != "Point":
        return None
    longitude, latitude, *_ = geometry["coordinates"]
    return longitude, latitude


def border_distance_m(a: Mapping[str, Any], b: Mapping[str, Any]) -> float:
    """Return the shortest distance of the points, lines and borders of two geometries that do not cross.

    It is the distance from an end of one segment to the other segment. The candidates are selected by the
    distances of the segments' midpoints, all at once.
    """
    import numpy as np  # noqa: PLC0415 - takes time to load, and few ask for anything but points near points

    some, others = np.array(_pieces(a), dtype=float), np.array(_pieces(b), dtype=float)
    there, half_there = _middles(others)
    best = inf
    for start in range(0, len(some), _ROWS):
        rows = some[start : start + _ROWS]
        here, half_here = _middles(rows)
        apart = np.arccos(np.clip(here @ there.T, -1.0, 1.0)) * EARTH_RADIUS_M
        margins = half_here[:, None] + half_there[None, :]
        at_least = apart - margins
        limit = min(best, float((apart + margins).min()))
        rivals = np.argwhere(at_least <= limit)
        bounds = at_least[rivals[:, 0], rivals[:, 1]]
        order = np.argsort(bounds)
        for block in range(0, len(order), _PAIRS):
            chosen = order[block : block + _PAIRS]
            if bounds[chosen[0]] > best:
                break
            best = min(best, _shortest_m(rows[rivals[chosen, 0]], others[rivals[chosen, 1]]))
    return best


def box_of(geometry: Mapping[str, Any]) -> Box:
    """Return the bounding box of a geometry."""
    positions = list(_positions(geometry["coordinates"], DEPTHS[geometry["type"]]))
    longitudes = [position[0] for position in positions]
    latitudes = [position[1] for position in positions]
    return min(longitudes), min(latitudes), max(longitudes), max(latitudes)


def box_around(box: Box, within_m: float) -> Box:
    """Return a box that contains everything within `within_m` of `box`."""
    west, south, east, north = box
    margin = within_m / EARTH_RADIUS_M
    margin_deg = degrees(margin) * 1.000001 + 1e-9
    farthest_from_equator = max(abs(south), abs(north))
    if farthest_from_equator + margin_deg >= 90:
        wide_deg = 360.0  # a pole is within the distance: all longitudes are
    else:
        wide_deg = degrees(asin(min(1.0, sin(margin) / cos(radians(farthest_from_equator)))))
        wide_deg = wide_deg * 1.000001 + 1e-9
    return west - wide_deg, south - margin_deg, east + wide_deg, north + margin_deg


def _positions(coordinates: Any, depth: int) -> Iterator[Position]:
    if depth == 0:
        yield coordinates[0], coordinates[1]
        return
    for part in coordinates:
        yield from _positions(part, depth - 1)


def _lines(geometry: Mapping[str, Any]) -> Iterator[list[Position]]:
    kind, coordinates = geometry["type"], geometry["coordinates"]
    if kind == "Point":
        yield [(coordinates[0], coordinates[1])]
    elif kind == "MultiPoint":
        for coordinate in coordinates:
            yield [(coordinate[0], coordinate[1])]
    elif kind == "LineString":
        yield list(_positions(coordinates, 1))
    elif kind in {"MultiLineString", "Polygon"}:
        for line in coordinates:
            yield list(_positions(line, 1))
    else:
        for polygon in coordinates:
            for ring in polygon:
                yield list(_positions(ring, 1))


def _pieces(geometry: Mapping[str, Any]) -> list[Segment]:
    """Return the lines of a geometry cut into short segments; a point is a segment without length."""
    pieces: list[Segment] = []
    for line in _lines(geometry):
        if len(line) == 1:
            pieces.append((line[0], line[0]))
        for start, end in itertools.pairwise(line):
            count = int(hypot(end[0] - start[0], end[1] - start[1]) / _LONGEST_PIECE_DEG) + 1
            cuts = [_along(start, end, number / count) for number in range(count + 1)]
            pieces += itertools.pairwise(cuts)
    return pieces


def _along(start: Position, end: Position, share: float) -> Position:
    return start[0] + (end[0] - start[0]) * share, start[1] + (end[1] - start[1]) * share


def _middles(pieces: Any) -> tuple[Any, Any]:
    """Return the midpoints of segments as unit vectors, and half their lengths in m."""
    import numpy as np  # noqa: PLC0415 - see above

    ends = np.radians(pieces)
    longitudes, latitudes = ends.mean(axis=1).T
    arrows = np.stack(
        (
            np.cos(latitudes) * np.cos(longitudes),
            np.cos(latitudes) * np.sin(longitudes),
            np.sin(latitudes),
        ),
        axis=1,
    )
    # A degree is longest on the equator; a metre is added for the precision of arccos.
    halves = np.hypot(*(ends[:, 1] - ends[:, 0]).T) / 2 * EARTH_RADIUS_M + 1.0
    return arrows, halves


def _shortest_m(some: Any, others: Any) -> float:
    """Return the shortest distance within pairs of segments: `some[0]` and `others[0]`, and so on."""
    return min(
        float(_to_pieces_m(points, pieces).min())
        for points, pieces in (
            (some[:, 0], others),
            (some[:, 1], others),
            (others[:, 0], some),
            (others[:, 1], some),
        )
    )


def _to_pieces_m(points: Any, pieces: Any) -> Any:
    """Return the distance of each point to its segment."""
    import numpy as np  # noqa: PLC0415 - see above

    start, way = pieces[:, 0], pieces[:, 1] - pieces[:, 0]

    def measured(share: Any) -> Any:
        places = np.radians(start + way * share[:, None])
        wanted = np.radians(points)
        half = (
            np.sin((places[:, 1] - wanted[:, 1]) / 2) ** 2
            + np.cos(places[:, 1]) * np.cos(wanted[:, 1]) * np.sin((places[:, 0] - wanted[:, 0]) / 2) ** 2
        )
        return 2 * EARTH_RADIUS_M * np.arcsin(np.minimum(1.0, np.sqrt(half)))

    share = np.full(len(points), 0.5)
    best = measured(share)
    step = 0.5
    for _ in range(_ZOOMS):
        for candidate in (np.clip(share - step, 0.0, 1.0), np.clip(share + step, 0.0, 1.0)):
            distance = measured(candidate)
            share = np.where(distance < best, candidate, share)
            best = np.minimum(best, distance)
        step /= 2
    for _ in range(_TOUCH_UPS):
        nearest = start + way * share[:, None]
        narrow = np.cos(np.radians(nearest[:, 1]))[:, None] * [[1.0, 0.0]] + [[0.0, 1.0]]
        across = points - nearest
        across[:, 0] = (across[:, 0] + 180.0) % 360.0 - 180.0
        flat_way, flat_across = way * narrow, across * narrow
        flat_length = (flat_way**2).sum(axis=1)
        flat_length[flat_length == 0] = 1.0
        share = np.clip(share + (flat_across * flat_way).sum(axis=1) / flat_length, 0.0, 1.0)
        best = np.minimum(best, measured(share))
    return best
