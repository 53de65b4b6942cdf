"""Generated forms of Camunda 7, as JSON Schema."""

from collections.abc import Mapping

from lxml import etree

from handover_bpmn.languages.base import Json
from handover_bpmn.model import Value
from handover_bpmn.notation.dialects.base import attempt, composed
from handover_bpmn.notation.dialects.camunda7_elements import children_named, has_expression
from handover_bpmn.notation.dialects.camunda7_values import default_of_type, text_value
from handover_bpmn.notation.elements import warn_without_effect
from handover_bpmn.notation.faults import Findings

_FORM_TYPES: Mapping[str, Mapping[str, Json]] = {
    "string": {"type": "string"},
    "long": {"type": "integer"},
    "double": {"type": "number"},
    "boolean": {"type": "boolean"},
    "date": {"type": "string", "format": "date"},
}
_LENGTHS = {"minlength": "minLength", "maxlength": "maxLength", "min": "minimum", "max": "maximum"}


def _constrain(schema: dict[str, Json], name: str, constraint: etree._Element, required: list[str]) -> bool:
    """Add a constraint to the JSON Schema of a field; return whether it has an effect."""
    rule, config = constraint.get("name") or "", constraint.get("config") or ""
    if rule == "required":
        if config != "false":
            required.append(name)
            if schema.get("type") == "string":
                schema.setdefault("minLength", 1)
    elif rule == "readonly":
        if config != "false":
            schema["readOnly"] = True
    elif rule in _LENGTHS:
        number = default_of_type("number", config)
        if isinstance(number, int | float):
            schema[_LENGTHS[rule]] = number
    else:
        return False
    return True


def _default_of(schema: Mapping[str, Json], text: str) -> Json:
    """Return the default of a field; a date may be written as dd/MM/yyyy."""
    parts = text.split("/")
    if schema.get("format") == "date" and len(parts) == 3 and all(part.isdecimal() for part in parts):
        day, month, year = parts
        return f"{year:0>4}-{month:0>2}-{day:0>2}"
    return default_of_type(str(schema["type"]), text)


def read_form(form: etree._Element, findings: Findings) -> Value:
    """Return the JSON Schema of a generated form; default values may be expressions."""
    properties: dict[str, Value] = {}
    required: list[str] = []
    for field in children_named(form, "formField"):
        name = field.get("id") or ""
        if not name:
            findings.fault(field, "a formField needs an id")
            continue
        properties[name] = _form_field(field, name, required, findings)
    members = {"type": Value("object"), "properties": composed("formData", properties)}
    if required:
        members["required"] = Value(required)
    return composed("formData", members)


def _form_field(field: etree._Element, name: str, required: list[str], findings: Findings) -> Value:
    type_ = field.get("type") or "string"
    schema: dict[str, Json] = dict(_FORM_TYPES.get(type_, {"type": "string"}))
    if type_ not in _FORM_TYPES and type_ != "enum":
        warn_without_effect(field, findings, f'the type "{type_[:64]}" of a formField')
    if field.get("label"):
        schema["title"] = field.get("label")
    choices = list(children_named(field, "value"))
    if choices:
        schema["oneOf"] = [
            {"const": choice.get("id"), "title": choice.get("name") or choice.get("id")} for choice in choices
        ]
    for validation in children_named(field, "validation"):
        for constraint in children_named(validation, "constraint"):
            if not _constrain(schema, name, constraint, required):
                warn_without_effect(
                    field, findings, f'the constraint "{(constraint.get("name") or "")[:64]}"'
                )
    members = {key: Value(value) for key, value in schema.items()}
    default = field.get("defaultValue")
    if default is not None and has_expression(default):
        members["default"] = attempt(field, lambda: text_value(default), Value(), findings)
    elif default is not None:
        members["default"] = Value(_default_of(schema, default))
    return composed(f"formField {name}", members)
