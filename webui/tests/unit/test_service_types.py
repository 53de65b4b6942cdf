"""The generated TypeScript types of REST interfaces. `make python-check` compares those of the page."""

from typing import Any

import pytest

from handover_web import service_types


def response(schema: str) -> dict[str, Any]:
    """A route that returns a schema."""
    content = {"application/json": {"schema": {"$ref": f"#/components/schemas/{schema}"}}}
    return {
        "get": {"responses": {"200": {"content": content}, "422": {"$ref": "#/components/schemas/Problem"}}}
    }


def test_only_the_schemas_of_used_routes_are_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service_types, "ROUTES", {"lamps": ("/lamps",)})
    color = {"type": "string", "enum": ["red", "green"]}
    lamp = {
        "type": "object",
        "properties": {"color": {"$ref": "#/components/schemas/Color-Output"}, "watts": {"type": "number"}},
        "required": ["color"],
    }
    document = {
        "paths": {"/lamps/{lamp}": response("Lamp"), "/boxes": response("Box")},
        "components": {"schemas": {"Lamp": lamp, "Color-Output": color, "Box": {}, "Problem": {}}},
    }
    assert service_types.typescript("lamps", document).endswith(
        '\n\nexport type Color = "red" | "green";\n\n'
        "export interface Lamp {\n  color: Color;\n  watts?: number;\n}\n"
    )
