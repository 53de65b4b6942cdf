"""The operations of NGSI-LD in the OpenAPI document of the broker, from the table of the router.

Bodies are documents of ETSI GS CIM 009, whose clause each operation names; their schemas are not repeated.
"""

import re
from collections.abc import Iterable
from typing import Any, Final

from handover_broker.query.parameters import BOOLEANS
from handover_broker.request.request_context import PREFIX, WITHOUT_BODY
from handover_broker.request.routing import Operation

_WITH_BODY: Final = frozenset({"POST", "PUT", "PATCH"})
_CHANGED: Final = {204: "Done", 207: "Done in part"}
_SUCCESSES: Final = {
    "GET": {200: "The result", 203: "The result, in the form of an earlier version", 206: "A part of it"},
    "POST": {200: "The result", 201: "Created", 206: "A part of the result", **_CHANGED},
    "PUT": _CHANGED,
    "PATCH": _CHANGED,
    "DELETE": _CHANGED,
}
_REFUSALS: Final = {
    400: "Invalid request or document",
    401: "No valid token",
    403: "Not allowed, or too many results",
    404: "Not found",
    405: "Method not allowed",
    406: "Not acceptable",
    409: "Conflict",
    411: "No Content-Length",
    413: "Body too large",
    415: "Unsupported media type",
    422: "Not supported",
    502: "A context source failed",
    503: "Not available now",
    504: "A context source, or an @context, does not answer",
    507: "The disk is full",
}


def paths_of(operations: Iterable[Operation]) -> dict[str, dict[str, Any]]:
    """Return the operations as the `paths` of an OpenAPI document."""
    paths: dict[str, dict[str, Any]] = {}
    for operation in operations:
        paths.setdefault(PREFIX + operation.path, {})[operation.method.lower()] = _described(operation)
    return paths


def _described(operation: Operation) -> dict[str, Any]:
    parameters = [_parameter(name, "path") for name in re.findall(r"{(\w+)}", operation.path)]
    parameters += [_parameter(name, "query") for name in sorted(operation.parameters)]
    parameters.append(_parameter("NGSILD-Tenant", "header"))
    successes = dict(_SUCCESSES[operation.method])
    if "entityMap" in operation.parameters:
        successes[201] = "The result, and an entity map was created"
    described: dict[str, Any] = {
        "tags": ["NGSI-LD"],
        "summary": operation.name,
        "description": f"ETSI GS CIM 009, clause {operation.clause}",
        "operationId": f"{operation.name} {operation.method} {operation.path}",
        "parameters": parameters,
        "responses": {
            **{str(status): {"description": text} for status, text in successes.items()},
            **{str(status): _refusal(status, text) for status, text in _REFUSALS.items()},
        },
    }
    if operation.method in _WITH_BODY:
        kinds = ["application/json", "application/ld+json"]
        kinds += ["application/merge-patch+json"] if operation.method == "PATCH" else []
        described["requestBody"] = {"required": True, "content": {kind: {"schema": {}} for kind in kinds}}
    return described


def _parameter(name: str, place: str) -> dict[str, Any]:
    kind = "boolean" if name in BOOLEANS else "string"
    return {"name": name, "in": place, "required": place == "path", "schema": {"type": kind}}


def _refusal(status: int, description: str) -> dict[str, Any]:
    if status in WITHOUT_BODY:
        headers = {name.decode().title(): {"schema": {"type": "string"}} for name, _ in WITHOUT_BODY[status]}
        return {"description": description, "headers": headers}
    schema = {"$ref": "#/components/schemas/Problem"}
    return {"description": description, "content": {"application/json": {"schema": schema}}}
