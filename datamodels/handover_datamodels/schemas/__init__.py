"""JSON Schemas of the vocabulary in normalized form, for validation without our models.

They are generated from the models: `python -m handover_datamodels.schemas` writes them, `--check` compares
them.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from handover_datamodels.entities import TYPES, Entity
from handover_datamodels.streams import STREAMS

FOLDER = Path(__file__).parent


class _Normalized(GenerateJsonSchema):
    """Optional attributes are omitted in normalized form: they are never null and have no default."""

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])


def schema_of(model: type[Entity]) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of `model` in normalized form."""
    generated = model.model_json_schema(schema_generator=_Normalized, mode="validation")
    name = model.ngsi_type()
    return {
        "$schema": GenerateJsonSchema.schema_dialect,
        "$id": f"https://w3id.org/handover/schemas/{name}.json",
        "title": name,
        **_shortened(_untitled(generated)),
    }


def stream_schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a message of a stream."""
    name = model.__name__
    return {
        "$schema": GenerateJsonSchema.schema_dialect,
        "$id": f"https://w3id.org/handover/schemas/{name}.json",
        **model.model_json_schema(mode="validation"),
        "title": name,
    }


def written(name: str) -> str:
    """Return the text of the schema file of an entity type or a message."""
    schema = stream_schema_of(STREAMS[name]) if name in STREAMS else schema_of(TYPES[name])
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def outdated(folder: Path = FOLDER) -> list[Path]:
    """Return the schema files in `folder` that are missing or outdated."""
    return [
        path
        for name in (*TYPES, *STREAMS)
        if not (path := folder / f"{name}.json").is_file()
        or path.read_text(encoding="utf-8") != written(name)
    ]


def write(folder: Path = FOLDER) -> list[Path]:
    """Write every outdated schema file and return their paths."""
    paths = outdated(folder)
    for path in paths:
        path.write_text(written(path.stem), encoding="utf-8", newline="\n")
    return paths


def _shortened(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema with one definition of a Property instead of one for each type of value.

    This is shorter and independent of the names of pydantic's definitions.
    """
    kinds = {
        name: (made, common)
        for name, made in schema["$defs"].items()
        if (common := name.partition("_")[0]) in {"Property", "Measurement"} and "_" in name
    }
    definitions = {name: made for name, made in schema["$defs"].items() if name not in kinds}
    values = {name: (made["properties"]["value"], common) for name, (made, common) in kinds.items()}
    for made, common in kinds.values():
        members = {key: value for key, value in made["properties"].items() if key != "value"}
        definitions[common] = {**made, "properties": members}
    short: dict[str, Any] = _referred({**schema, "$defs": dict(sorted(definitions.items()))}, values)
    return short


def _referred(schema: Any, values: Mapping[str, tuple[Any, str]]) -> Any:
    """Return the schema with each Property of `values` as the common one with a specific value.

    A measurement may also be a list of instances.
    """
    if isinstance(schema, list):
        return [_referred(item, values) for item in schema]
    if not isinstance(schema, Mapping):
        return schema
    name = str(schema.get("$ref", "")).removeprefix("#/$defs/")
    if name not in values:
        return {key: _referred(value, values) for key, value in schema.items()}
    shown, common = values[name]
    value = _referred(shown, values)
    reference = {"$ref": f"#/$defs/{common}"} | ({"properties": {"value": value}} if value else {})
    if common == "Property":
        return reference
    return {"anyOf": [reference, {"type": "array", "items": reference, "minItems": 1}]}


def _untitled(schema: Any) -> Any:
    """Return the schema without pydantic's titles and with short descriptions."""
    if isinstance(schema, list):
        return [_untitled(item) for item in schema]
    if not isinstance(schema, Mapping):
        return schema
    return {
        key: value.partition("\n")[0] if key == "description" and isinstance(value, str) else _untitled(value)
        for key, value in schema.items()
        if not (key == "title" and isinstance(value, str))
    }
