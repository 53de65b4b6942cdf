"""Geo-queries: near a point, within an area, crossing a line (clauses 4.7, 4.10, 5.2.13).

`near` measures in metres on the globe; the other relations are those of OGC simple features on longitude and
latitude, as in RFC 7946.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Final

import orjson

from handover_broker.model.entity import Entity
from handover_broker.model.geometry import DEPTHS, fault_of
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import require_name, shown
from handover_broker.query.parameters import Use, names_for
from handover_broker.query.sphere import (
    Box,
    border_distance_m,
    box_around,
    box_of,
    distance_m,
    point_of,
)

DEFAULT_PROPERTY: Final = "location"
PARAMETERS: Final = names_for(Use.GEO)

_NEAR: Final = re.compile(r"near;(max|min)Distance==((?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][+-]?\d+)?)")
_RELATIONS: Final = frozenset({"within", "contains", "intersects", "equals", "disjoint", "overlaps"})
_FAR_APART: Final = frozenset({"disjoint", "minDistance"})
"""Relations that also hold far from the reference, so a bounding box does not narrow them."""

Geometry = Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class GeoQuery:
    """A relation of the geometries in `attribute` (an IRI) of an entity to the `reference`.

    `relation` is one of within, contains, intersects, equals, disjoint, overlaps, and maxDistance and
    minDistance, of which `within_m` is the distance.
    """

    attribute: str
    relation: str
    reference: Geometry
    within_m: float = 0.0
    box: Box | None = None
    """The box that every match touches; None if there is none."""
    _prepared: dict[str, Any] = field(default_factory=dict)

    def wants(self, entity: Entity) -> bool:
        """Return whether any geometry of the entity matches."""
        return any(
            instance["type"] == "GeoProperty" and self.fits(instance["value"])
            for instance in entity.attributes.get(self.attribute, ())
        )

    def fits(self, place: Any) -> bool:
        """Return whether a geometry matches; an invalid one never does."""
        if fault_of(place) is not None:
            return False
        if self.relation == "maxDistance":
            return self._distance_to(place) <= self.within_m
        if self.relation == "minDistance":
            return self._distance_to(place) > self.within_m
        return self._is_related(place)

    def _distance_to(self, place: Geometry) -> float:
        here, there = point_of(self.reference), point_of(place)
        if here is not None and there is not None:  # the usual case, without a library
            return distance_m(here, there)
        if self.box is not None and not boxes_touch(self.box, box_of(place)):
            return self.within_m * 2
        if self._touch(place):
            return 0.0
        return border_distance_m(self.reference, place)

    def _is_related(self, place: Geometry) -> bool:
        if self.box is not None and not boxes_touch(self.box, box_of(place)):
            return False
        if self.relation == "disjoint":
            return not self._touch(place)
        if self.relation == "intersects":
            return self._touch(place)
        reference = self._shape_of_reference()
        return any(bool(getattr(shape, self.relation)(reference)) for shape in _shapes(place, reference))

    def _touch(self, place: Geometry) -> bool:
        reference = self._shape_of_reference()
        return any(bool(shape.intersects(reference)) for shape in _shapes(place, reference))

    def _shape_of_reference(self) -> Any:
        shape = self._prepared.get("reference")
        if shape is None:
            import shapely  # noqa: PLC0415 - takes 0.1 s to load, and many brokers hold no places

            shape = self._prepared["reference"] = shape_of(self.reference)
            shapely.prepare(shape)
        return shape


def distance_to_m(reference: Geometry, place: Geometry) -> float:
    """Return the distance of two geometries; 0 if they touch (clause 4.23.1)."""
    here, there = point_of(reference), point_of(place)
    if here is not None and there is not None:
        return distance_m(here, there)
    shape = shape_of(reference)
    if any(bool(part.intersects(shape)) for part in _shapes(place, shape)):
        return 0.0
    return border_distance_m(reference, place)


def geo_query(parameters: Mapping[str, str], expand: Callable[[str], str]) -> GeoQuery | None:
    """Return the geo-query in the query parameters; None if there is none.

    Raises a problem (400) when it is incomplete or invalid.
    """
    relation, kind, coordinates = (parameters.get(name) for name in ("georel", "geometry", "coordinates"))
    if relation is None and kind is None and coordinates is None:
        return None  # geoproperty alone is to be ignored (clause 6.4.3.2)
    for name, text in (("georel", relation), ("geometry", kind), ("coordinates", coordinates)):
        if text is None:
            raise bad_request_data(
                f"a geo-query has georel, geometry and coordinates; add {name}, for example "
                "georel=near;maxDistance==2000&geometry=Point&coordinates=[8,40]"
            )
    return _parsed(relation, kind, coordinates, parameters.get("geoproperty"), expand)


def geo_query_document(document: Any, expand: Callable[[str], str], what: str = "geoQ") -> GeoQuery:
    """Return the geo-query of the data type GeoQuery (clause 5.2.13); raise a problem (400) if it is
    invalid."""
    if not isinstance(document, dict):
        raise bad_request_data(f'{what} is an object with "georel", "geometry" and "coordinates"')
    if unknown := sorted(set(document) - PARAMETERS):
        raise bad_request_data(f"{what} has no member {shown(unknown[0])}; leave it out")
    for name in ("georel", "geometry", "coordinates"):
        if name not in document:
            raise bad_request_data(f'{what} has "georel", "geometry" and "coordinates"; add "{name}"')
    return _parsed(
        document["georel"], document["geometry"], document["coordinates"], document.get("geoproperty"), expand
    )


def reference_geometry(kind: Any, coordinates: Any, names: tuple[str, str]) -> Geometry:
    """Return the geometry of a type and coordinates (a list, or its text); `names` are theirs, for errors.

    Raises a problem (400) when it is invalid.
    """
    if not isinstance(kind, str) or kind not in DEPTHS:
        raise bad_request_data(f"{names[0]} is one of {', '.join(DEPTHS)}, not {shown(kind)}")
    text = coordinates if isinstance(coordinates, str) else ""
    if isinstance(coordinates, str):
        try:
            coordinates = orjson.loads(coordinates)
        except orjson.JSONDecodeError:
            raise bad_request_data(
                f"{names[1]} is a JSON list such as [8,40], longitude first, not {shown(text)}"
            ) from None
    geometry = {"type": kind, "coordinates": coordinates}
    fault = fault_of(geometry)
    if fault is not None:
        raise bad_request_data(f"{names[1]} {shown(coordinates)} make no {kind}: {fault}")
    return geometry


def shape_of(geometry: Geometry) -> Any:
    """Return a geometry as a shapely object; one that crosses itself is repaired."""
    import shapely  # noqa: PLC0415 - see above
    from shapely.geometry import shape  # noqa: PLC0415 - see above

    geometry_2d = shapely.force_2d(shape(geometry))
    return geometry_2d if geometry_2d.is_valid else shapely.make_valid(geometry_2d)


def boxes_touch(a: Box, b: Box) -> bool:
    """Return whether two boxes overlap, also across the date line."""
    if a[1] > b[3] or b[1] > a[3]:
        return False
    return any(a[0] <= b[2] + turn and b[0] + turn <= a[2] for turn in (0.0, 360.0, -360.0))


def _parsed(
    relation: Any, kind: Any, coordinates: Any, attribute: Any, expand: Callable[[str], str]
) -> GeoQuery:
    if attribute is None:
        attribute = DEFAULT_PROPERTY
    iri = expand(require_name(attribute, "geoproperty"))
    reference = reference_geometry(kind, coordinates, ("geometry", "coordinates"))
    if not isinstance(relation, str):
        raise bad_request_data(f"georel is text such as near;maxDistance==2000, not {shown(relation)}")
    within_m = 0.0
    if relation not in _RELATIONS:
        relation, within_m = _near(relation)
    box = None if relation in _FAR_APART else box_of(reference)
    if relation == "maxDistance" and box is not None:
        box = box_around(box, within_m)
    return GeoQuery(iri, relation, reference, within_m, box)


def _near(relation: str) -> tuple[str, float]:
    match = _NEAR.fullmatch(relation)
    within_m = float(match[2]) if match else 0.0
    if match is None or not within_m or not isfinite(within_m):
        raise bad_request_data(
            f"georel is {', '.join(sorted(_RELATIONS))}, near;maxDistance==2000 or near;minDistance==2000 "
            f"(in metres, more than 0), not {shown(relation)}"
        )
    return f"{match[1]}Distance", within_m


def _shapes(place: Geometry, reference: Any) -> list[Any]:
    """Return a geometry as a shapely object, repeated around the globe if it or the reference crosses the
    date line."""
    from shapely.affinity import translate  # noqa: PLC0415 - see above

    shape = shape_of(place)
    west, _, east, _ = shape.bounds
    reference_west, _, reference_east, _ = reference.bounds
    shapes = [shape]
    if min(west, reference_west) <= -180 or max(east, reference_east) >= 180:
        shapes += [translate(shape, turn) for turn in (360.0, -360.0)]
    return shapes
