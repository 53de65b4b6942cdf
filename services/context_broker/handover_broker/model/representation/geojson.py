"""Entities as GeoJSON: one is a Feature, several a FeatureCollection (clauses 4.5.16, 4.5.17 and 6.3.15).

The geometry is that of one GeoProperty, `location` unless another is requested; null if there is none.
"""

from collections.abc import Iterable
from typing import Any, Final

import orjson

from handover_broker.model.context import Context
from handover_broker.model.entity import Entity

LOCATION: Final = "location"


def feature_of(document: dict[str, Any], at: Any) -> dict[str, Any]:
    """Return a rendered entity as a Feature with the geometry `at`, None if it has none."""
    properties = {name: value for name, value in document.items() if name != "id"}
    named = {"id": document["id"]} if "id" in document else {}
    return {**named, "type": "Feature", "geometry": at, "properties": properties}


def geometry(entity: Entity, place: str, datasets: frozenset[str | None] | None = None) -> Any:
    """Return the geometry of a GeoProperty (IRI); None if it has none.

    Of several instances it is the default one, or the first of the requested `datasets`.
    """
    instances = entity.attributes.get(place, [])
    if datasets is not None:
        instances = [candidate for candidate in instances if candidate.get("datasetId") in datasets]
    instance = next((candidate for candidate in instances if "datasetId" not in candidate), None)
    if instance is None and instances and (datasets is not None or len(instances) == 1):
        instance = instances[0]
    return instance["value"] if instance is not None and instance["type"] == "GeoProperty" else None


def feature_body(feature: dict[str, Any], context: Context, *, with_context: bool) -> bytes:
    """Return a Feature as text, with its @context if requested."""
    return _body(orjson.dumps(feature), context, with_context=with_context)


def collection_body(features: Iterable[dict[str, Any]], context: Context, *, with_context: bool) -> bytes:
    """Return a FeatureCollection as text, with the @context of all if requested."""
    return _body(
        orjson.dumps({"type": "FeatureCollection", "features": list(features)}),
        context,
        with_context=with_context,
    )


def _body(text: bytes, context: Context, *, with_context: bool) -> bytes:
    return text[:-1] + b',"@context":' + context.text + b"}" if with_context else text
