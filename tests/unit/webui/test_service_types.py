"""The generated TypeScript types of the REST interfaces of the services."""

from typing import Any

import pytest

from webui import service_types


@pytest.mark.parametrize("service", service_types.ROUTES)
def test_the_types_of_the_page_match_the_openapi_documents(service: str) -> None:
    written = (service_types.FOLDER / f"{service}.ts").read_text(encoding="utf-8")
    expected = service_types.typescript(service, service_types.openapi_of(service))
    assert written == expected, "run python -m webui.service_types"


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
