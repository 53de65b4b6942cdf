"""The types of JSON in request bodies: pydantic converts between them, these models and types do not.

By default pydantic reads `false` as 0, 0 as `false`, "1" as 1, and the number 0.5 as a time in 1970. The
OpenAPI document of a service describes none of that, and it hides a mistake of the client. Strict mode is no
way out: it refuses a list for a tuple, and a text for a time or an enumeration.

So `StrictModel` changes only the scalars in the schema that pydantic derives from it: booleans and numbers
are strict, an integer may be written as 1.0 (as in JSON Schema), and a time is a text. `StrictJson` does the
same for a body that is no model.
"""

from collections.abc import Callable, Mapping
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

_MAX_WHOLE: Final = 2.0**63
_NO_TYPES: Final = frozenset({"default", "expected", "metadata", "serialization", "keys_schema"})
"""Members of a schema that describe no JSON values; the names of a JSON object are texts, also of numbers."""
_NAMED: Final = frozenset({"fields", "choices"})
"""Members that are schemas by names which a client or a model chose."""

Check = Callable[[Any], Any]


def iso_text(example: str, hint: str = "") -> Check:
    """Return a check that refuses a time as a number, also in a query; pydantic reads it as seconds."""

    def checked(value: Any) -> Any:
        if isinstance(value, int | float) or (isinstance(value, str) and _is_number(value)):
            raise ValueError(f"Write this as ISO 8601 text, for example {example}, not as a number{hint}")
        return value

    return checked


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _whole_number(value: Any) -> Any:
    is_whole = isinstance(value, float) and value.is_integer() and abs(value) < _MAX_WHOLE
    return int(value) if is_whole else value


def _no_boolean(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("Write a number here, for example 1, not true or false")  # noqa: TRY004 - for pydantic
    return value


TIME_TEXT: Final = iso_text("2026-11-01T10:00:00Z")
_CHECKS: Final[Mapping[str, Check]] = {
    "int": _whole_number,
    "literal": _no_boolean,
    "datetime": TIME_TEXT,
    "date": iso_text("2026-11-01"),
    "time": iso_text("10:00", "; in YAML in quotes"),  # without them 10:00 is 600
}
"""What is checked or converted before pydantic reads a value of this type."""


def _strict(schema: Any) -> Any:
    """Return a schema with strict scalars, up to the models in it; a strict one is returned unchanged."""
    if isinstance(schema, list | tuple):
        return type(schema)(map(_strict, schema))
    if not isinstance(schema, dict):
        return schema
    kind = schema.get("type")
    if kind in {"model", "dataclass"} or _has_check(schema):
        return schema
    if kind in {"bool", "int", "float"}:
        schema = {**schema, "strict": True}
    if kind == "literal" and not _has_numbers_only(schema["expected"]):
        return schema
    if isinstance(kind, str) and kind in _CHECKS:
        inner: Any = schema
        return core_schema.no_info_before_validator_function(_CHECKS[kind], inner)
    return {name: _strict_member(name, value) for name, value in schema.items()}


def _strict_member(name: str, value: Any) -> Any:
    if name in _NO_TYPES:
        return value
    if name in _NAMED and isinstance(value, dict):
        return {chosen: _strict(schema) for chosen, schema in value.items()}
    return _strict(value)


def _has_check(schema: Mapping[str, Any]) -> bool:
    return schema.get("type") == "function-before" and schema["function"]["function"] in _CHECKS.values()


def _has_numbers_only(values: list[Any]) -> bool:
    return all(isinstance(value, int) and not isinstance(value, bool) for value in values)


class StrictModel(BaseModel):
    """A model of a request body, whose booleans, numbers and times are not converted."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the model with strict scalars."""
        schema = handler(source)
        model: Any = handler.resolve_ref_schema(schema)
        while model["type"] != "model":
            model = model["schema"]  # that which a validator of the whole model has inside
        model["schema"] = _strict(model["schema"])
        return schema


class RequestBody(StrictModel):
    """A frozen request body that refuses unknown members."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class StrictJson:
    """`Annotated[dict[str, float], StrictJson()]`: a body that is no model, whose scalars are not converted.

    Models in it are not changed.
    """

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of `source` with strict scalars."""
        schema: CoreSchema = _strict(handler(source))
        return schema
