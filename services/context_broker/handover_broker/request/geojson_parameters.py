"""Parameters of GeoJSON responses: the geometry, and the place of the @context."""

import re
from typing import Final

from handover_broker.model.context import Context
from handover_broker.model.entity_parser import expand
from handover_broker.model.negotiation import GEO_JSON, WITH_GEO_JSON
from handover_broker.model.problems import bad_request_data
from handover_broker.model.representation.geojson import LOCATION
from handover_broker.model.validation import require_name
from handover_broker.request.request_context import RequestContext

_PLAIN_BODY: Final = re.compile(rb'(?:^|[,;\s])body\s*=\s*"?json"?(?:$|[,;\s])', re.IGNORECASE)


def place_of(request: RequestContext, context: Context) -> str:
    """Return the GeoProperty (IRI) that is requested as the geometry.

    Raises a problem (400) if one is requested and the response is not GeoJSON.
    """
    name = request.parameter("geometryProperty")
    if name is None:
        return context.terms.expand(LOCATION)
    if request.accept(WITH_GEO_JSON) != GEO_JSON:
        raise bad_request_data(f"geometryProperty needs Accept: {GEO_JSON}; leave it out, or accept that")
    return expand(require_name(name, "geometryProperty"), context.terms)


def has_context_in_body(request: RequestContext) -> bool:
    """Return whether the @context is in the GeoJSON: yes, unless the client prefers a plain JSON body."""
    return _PLAIN_BODY.search(request.headers.get(b"prefer", b"")) is None
