"""The OpenAPI document of a service: what FastAPI derives from the routes, with the refusals that are sent.

Every refusal is a problem document (RFC 7807). FastAPI describes one of its own instead, and only for 422.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from http import HTTPStatus
from typing import Any, Final

from fastapi import FastAPI

PROBLEM: Final = {
    "title": "Problem",
    "description": "Problem details (RFC 7807). A text for people has a code and parameters beside it.",
    "type": "object",
    "properties": {
        "type": {"type": "string"},
        "title": {"type": "string", "description": "the kind of problem"},
        "status": {"type": "integer"},
        "detail": {"type": "string", "description": "what is wrong, and the way out"},
        "detailCode": {"type": "string"},
        "detailParameters": {"type": "object", "additionalProperties": True},
    },
    "required": ["type", "title", "status", "detail"],
    "additionalProperties": True,
}
_OF_FASTAPI: Final = ("HTTPValidationError", "ValidationError")
_OF_EVERY_ROUTE: Final = (403, 503)
_OF_BODIES: Final = (413, 415, 422)
_OF_CHANGES: Final = (404, 429)
_OF_STATES: Final = (409,)
_CHANGES: Final = frozenset({"post", "put", "patch", "delete"})


class TaggedRoutes:
    """The decorators that add routes to an application; the document lists the routes under one tag."""

    def __init__(self, app: FastAPI, tag: str) -> None:
        self.get = partial(app.get, tags=[tag])
        self.post = partial(app.post, tags=[tag])
        self.put = partial(app.put, tags=[tag])
        self.patch = partial(app.patch, tags=[tag])
        self.delete = partial(app.delete, tags=[tag])


def sends(*media_types: str, or_json: Any = None) -> dict[int | str, dict[str, Any]]:
    """Return the `responses` of a route that sends such files, or JSON of the model `or_json`.

    Without the model, the route has a `response_class` without a media type, such as `Response`; otherwise it
    is described as JSON as well.
    """
    described: dict[str, Any] = {"content": {media_type: {} for media_type in media_types}}
    return {200: described if or_json is None else {**described, "model": or_json}}


def describe_problems(app: FastAPI, *, has_guard: bool) -> None:
    """Let the OpenAPI document of `app` have the refusals of its routes."""
    derived: Callable[[], dict[str, Any]] = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = with_problems(derived(), has_guard=has_guard)
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]  # the way that FastAPI documents


def with_problems(document: dict[str, Any], *, has_guard: bool) -> dict[str, Any]:
    """Return an OpenAPI document with the refusals of each operation."""
    schemas = document.setdefault("components", {}).setdefault("schemas", {})
    for methods in document.get("paths", {}).values():
        for method, operation in methods.items():
            responses = operation.setdefault("responses", {})
            for status in _refusals(method, operation, has_guard=has_guard):
                described = responses.get(str(status), {})
                if "application/problem+json" not in described.get("content", {}):
                    responses[str(status)] = _response(HTTPStatus(status).phrase)
            responses.setdefault("default", _response("Any other problem"))
    for name in _OF_FASTAPI:
        schemas.pop(name, None)
    schemas["Problem"] = PROBLEM
    return document


def _refusals(method: str, operation: Mapping[str, Any], *, has_guard: bool) -> Iterator[int]:
    yield from _OF_EVERY_ROUTE
    if has_guard:
        yield 401
    if "operations" in operation.get("tags", ()):
        return
    yield from _OF_STATES
    if operation.get("parameters"):
        yield from (400, 404, 422)
    if method in _CHANGES:
        yield from _OF_CHANGES
    if "requestBody" in operation:
        yield from (400, 404, *_OF_BODIES)


def _response(description: str) -> dict[str, Any]:
    schema = {"$ref": "#/components/schemas/Problem"}
    return {"description": description, "content": {"application/problem+json": {"schema": schema}}}
