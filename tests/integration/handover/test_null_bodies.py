"""A null in a body is refused or has a meaning: no route of a service fails, then or at a later read."""

import re
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from tests.integration.handover.test_perimeter import SERVICES
from tests.kit.cell import Cell, new_cell

pytestmark = pytest.mark.slow

MAX_DEPTH = 6
TEXTS = {"date-time": "2026-11-01T10:00:00Z", "uri": "http://127.0.0.1:9/", "binary": ""}
KEPT_RUNNING = ("shutdown", "stop", "restart", "quit")
"""Words in paths that end what the other requests need."""
WITHOUT_BODIES = {"webui", "ros_fiware_bridge"}
"""Services whose description names no body."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with new_cell(tmp_path_factory.mktemp("cell")) as made:
        made.extra["HANDOVER_ASSISTIVE_MACHINES"] = "bed"
        made.extra |= {"HANDOVER_HUMANOID_MODEL": "coman", "HANDOVER_HUMANOID_FIFO": "false"}
        made.start(*SERVICES, within_s=90.0)
        yield made


class Schemas:
    """The bodies that the routes of a service take, made from its description."""

    def __init__(self, description: dict[str, Any]) -> None:
        self.paths: dict[str, dict[str, Any]] = description["paths"]
        self._named: dict[str, Any] = description.get("components", {}).get("schemas", {})

    def bodies(self) -> Iterator[tuple[str, str, Any]]:
        """Yield method, path and a body of each route that takes JSON."""
        for path, methods in self.paths.items():
            for method, operation in methods.items():
                content = operation.get("requestBody", {}).get("content", {})
                if "application/json" in content and not any(word in path for word in KEPT_RUNNING):
                    body = self._example(content["application/json"].get("schema", {}), 0)
                    yield method.upper(), re.sub(r"\{.*?\}", "x", path), body

    def reads(self) -> list[str]:
        """Return the paths that can be read without a parameter."""
        return [
            path
            for path, methods in self.paths.items()
            if "get" in methods
            and "{" not in path
            and not any(one.get("required") for one in methods["get"].get("parameters", ()))
        ]

    def _example(self, schema: dict[str, Any], depth: int) -> Any:
        if "$ref" in schema:
            return self._example(self._named[schema["$ref"].rpartition("/")[2]], depth)
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


def with_null(value: Any) -> Iterator[Any]:
    """Yield copies of a body with null in place of each of its values."""
    items = list(
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    for name, one in items:
        for inner in (None, *with_null(one)):
            copied = list(value) if isinstance(value, list) else dict(value)
            copied[name] = inner
            yield copied


@pytest.mark.parametrize("service", SERVICES[1:])
def test_no_route_of_a_service_fails_for_a_null_nor_a_read_after_it(cell: Cell, service: str) -> None:
    with httpx.Client(base_url=cell.url(service), timeout=120, trust_env=False) as http:
        schemas = Schemas(http.get("/openapi.json").json())
        failing = {path for path in schemas.reads() if http.get(path).status_code >= 500}
        sent = 0
        for method, path, body in schemas.bodies():
            for nulled in (None, *with_null(body)):
                answer = http.request(method, path, json=nulled, headers={"Content-Type": "application/json"})
                is_known = answer.status_code in {501, 502, 503, 504}  # what it would need does not run here
                assert answer.status_code < 500 or is_known, (method, path, nulled, answer.text)
                sent += 1
        assert sent or service in WITHOUT_BODIES
        for path in schemas.reads():
            answer = http.get(path)
            assert answer.status_code < 500 or path in failing, (path, answer.text)
        assert http.get("/readyz").status_code == 200
