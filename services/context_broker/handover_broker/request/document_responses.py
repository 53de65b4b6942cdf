"""Responses of one JSON document, or a list of them, in the media type that the client accepts."""

from typing import Any

import orjson

from handover_broker.model.context import Context
from handover_broker.request.query_parameters import json_headers
from handover_broker.request.request_context import JSON_LD, Response


def document_response(body: Any, media_type: str, context: Context) -> Response:
    """Return 200 with the body; `in_media_type` has been applied to each of its documents."""
    headers = json_headers(context)
    if media_type == JSON_LD:
        headers = [(b"content-type", JSON_LD.encode())]
    return Response(200, orjson.dumps(body), headers)


def in_media_type(document: dict[str, Any], media_type: str, context: Context) -> dict[str, Any]:
    """Return the document, with its @context for JSON-LD."""
    return {"@context": context.document, **document} if media_type == JSON_LD else document
