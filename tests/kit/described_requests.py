"""Requests made from the OpenAPI document of a service: valid ones, and each with one strange value."""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final
from urllib.parse import quote, urlencode

MAX_DEPTH: Final = 6
TEXTS: Final = {"date-time": "2026-11-01T10:00:00Z", "uri": "http://127.0.0.1:9/", "binary": ""}
LONE_SURROGATE: Final = "\ud800"
STRANGE_TEXTS: Final = (
    "",
    "nan",
    "1e400",
    "-1",
    str(2**70),
    "0001-01-01T00:00:00Z",
    "0001-01-01T00:00:00+14:00",
    "9999-12-31T23:59:59.999999+00:00",
    "\0",
    "é" * 300,
)
"""Texts that are valid for few parameters, and extreme for those."""
STRANGE_VALUES: Final = (
    None,
    LONE_SURROGATE,
    {LONE_SURROGATE: LONE_SURROGATE},
    float("nan"),
    float("-inf"),
    -1,
    2**63,
    2**1100,
    1e308,
    "0001-01-01T00:00:00+14:00",
    "9999-12-31T23:59:59.999999-14:00",
    "\0",
    "",
    [],
    [[]],
    {},
    {"": {}},
    {"x": 2**1100},
    True,
)
"""Values that JSON or its readers can express, and most schemas do not mean."""
KEPT_RUNNING: Final = ("shutdown", "stop", "restart", "quit")
"""Words in paths that end what the other requests need."""


@dataclass(frozen=True)
class DescribedRequest:
    """A request for `template`; `target` has its parameters, `body` is JSON unless it is `...`."""

    method: str
    template: str
    target: str
    body: Any = ...
    has_null: bool = False

    @property
    def content(self) -> bytes | None:
        """The body as JSON, in which lone surrogates are escapes and numbers may be infinite."""
        return None if self.body is ... else json.dumps(self.body).encode()


@dataclass(frozen=True)
class _Parameters:
    path: Mapping[str, str]
    query: Mapping[str, str]

    def target(self, template: str) -> str:
        path = re.sub(r"\{(\w+)(?::\w+)?\}", lambda found: quote(self.path[found[1]], safe=""), template)
        return f"{path}?{urlencode(self.query)}" if self.query else path


class DescribedRequests:
    """The requests that an OpenAPI document describes."""

    def __init__(self, document: Mapping[str, Any], known: Mapping[str, str] | None = None) -> None:
        """Read `document`; `known` are values of path parameters, by their names, of things that exist."""
        self.paths: Mapping[str, Mapping[str, Any]] = document["paths"]
        self._known = known or {}
        self._schemas: Mapping[str, Any] = document.get("components", {}).get("schemas", {})

    def valid(self) -> Iterator[DescribedRequest]:
        """Yield one request for each operation, which its schemas accept."""
        for template, methods in self.paths.items():
            if any(word in template for word in KEPT_RUNNING):
                continue
            for method, operation in methods.items():
                parameters = self._parameters(operation)
                content = operation.get("requestBody", {}).get("content", {})
                schema = content.get("application/json", {}).get("schema")
                body = ... if schema is None else self._example(schema, 0)
                yield DescribedRequest(method.upper(), template, parameters.target(template), body)

    def strange(self, every: int = 1) -> Iterator[DescribedRequest]:
        """Yield the valid requests with one strange value in place of a parameter or a value of the body.

        Of the strange values only one of `every` is used, a different one at each place, and always null.
        """
        for number, request in enumerate(self._strange()):
            if number % every == 0 or request.has_null:
                yield request

    def _strange(self) -> Iterator[DescribedRequest]:
        for request in self.valid():
            operation = self.paths[request.template][request.method.lower()]
            parameters = self._parameters(operation)
            for one in operation.get("parameters", ()):
                if one["in"] not in {"path", "query"}:
                    continue
                for text in STRANGE_TEXTS:
                    if one["in"] == "path" and not text:
                        continue
                    changed = {**getattr(parameters, one["in"]), one["name"]: text}
                    changed_parameters = replace(parameters, **{one["in"]: changed})
                    yield replace(request, target=changed_parameters.target(request.template))
            if request.body is not ...:
                for value, body in with_strange(request.body):
                    yield replace(request, body=body, has_null=value is None)

    def refusals(self) -> set[tuple[str, str, int]]:
        """Return the described refusals: method, path and status."""
        return {
            (method.upper(), path, int(status))
            for path, methods in self.paths.items()
            for method, operation in methods.items()
            for status, response in operation["responses"].items()
            if status.isdecimal() and "application/problem+json" in response.get("content", {})
        }

    def reads(self) -> list[str]:
        """Return the paths that can be read without a parameter."""
        return [
            path
            for path, methods in self.paths.items()
            if "get" in methods
            and "{" not in path
            and not any(one.get("required") for one in methods["get"].get("parameters", ()))
        ]

    def _parameters(self, operation: Mapping[str, Any]) -> _Parameters:
        of: dict[str, dict[str, str]] = {"path": {}, "query": {}, "header": {}, "cookie": {}}
        for one in operation.get("parameters", ()):
            if one["in"] == "path":
                of["path"][one["name"]] = self._known.get(one["name"], "x")
            elif one.get("required"):
                of[one["in"]][one["name"]] = str(self._example(one["schema"], 0))
        return _Parameters(of["path"], of["query"])

    def _example(self, schema: Mapping[str, Any], depth: int) -> Any:
        if "$ref" in schema:
            return self._example(self._schemas[schema["$ref"].rpartition("/")[2]], depth)
        choices = next((schema[some] for some in ("anyOf", "oneOf", "allOf") if some in schema), None)
        if choices is not None:
            return self._example(next(one for one in choices if one.get("type") != "null"), depth)
        kind = "object" if "properties" in schema else schema.get("type")
        example: Any = "x" * max(1, schema.get("minLength", 1))
        if "const" in schema or "enum" in schema:
            example = schema.get("const", next(iter(schema.get("enum", [None]))))
        elif kind == "object":
            properties = schema.get("properties", {}) if depth < MAX_DEPTH else {}
            example = {name: self._example(one, depth + 1) for name, one in properties.items()}
        elif kind == "array":
            example = [self._example(schema.get("items", {}), depth + 1)] * max(1, schema.get("minItems", 1))
        elif kind in {"integer", "number"}:
            example = schema.get("minimum", 1)
        elif kind == "boolean":
            example = True
        return TEXTS.get(schema.get("format", ""), example)


def with_strange(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each strange value, and a copy of a body with it in place of one of its values or of all."""
    yield from ((strange, strange) for strange in STRANGE_VALUES)
    items = list(
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    for name, one in items:
        for strange, inner in with_strange(one):
            copied = list(value) if isinstance(value, list) else dict(value)
            copied[name] = inner
            yield strange, copied
