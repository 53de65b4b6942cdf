"""Values of the elements of handover: references, forms, parameters and results."""

from collections.abc import Iterable

import orjson
from lxml import etree

from handover.messages import message
from handover.tasks.task_life import PASSIVE_TYPES, type_of
from handover_bpmn.forms.form import form_fault
from handover_bpmn.languages import native
from handover_bpmn.languages.base import Json
from handover_bpmn.languages.native_grammar import is_variable_name
from handover_bpmn.model import FormBinding, FormReference, Value
from handover_bpmn.notation.dialects.base import attempt
from handover_bpmn.notation.document import local, text
from handover_bpmn.notation.faults import Findings
from handover_bpmn.references import is_reference


def form_reference(parts: list[etree._Element], findings: Findings) -> FormReference | None:
    """Return the deployed form that a `handover:form` names, if one does."""
    for part in parts:
        name, version = part.get("ref"), part.get("version")
        if name is None:
            continue
        if version is None:
            return FormReference(name)
        if not version.isascii() or not version.isdecimal() or len(version) > 9:
            findings.fault(part, f'version="{version[:64]}" is no number')
            return None
        return FormReference(name, FormBinding.VERSION, int(version))
    return None


def form_in_file(parts: list[etree._Element], findings: Findings) -> dict[str, Value]:
    """Return the form that is written in the file as the parameter `form`."""
    if len(parts) > 1:
        findings.fault(parts[1], "one handover:form is enough")
    if not parts or parts[0].get("ref") is not None:
        return {}
    return {"form": Value(json_schema(parts[0], findings))}


def json_schema(part: etree._Element, findings: Findings) -> Json:
    """Return the JSON object that an element contains; None, with a fault, for others."""
    schema = json_or_text(text(part))
    if not isinstance(schema, dict):
        findings.fault(part, f"handover:{local(part)} contains a JSON object")
        return None
    fault = form_fault(schema)
    if fault is not None:
        findings.fault(part, fault)
    return schema


def boolean(extension: etree._Element, name: str, findings: Findings) -> bool:
    """Return an attribute that is true or false; without it false."""
    text = extension.get(name, "false")
    if text not in {"true", "false"}:
        findings.fault(extension, f'{name}="{text}" is neither true nor false')
    return bool(text == "true")


def read_reference(part: etree._Element, attribute: str, findings: Findings) -> Value:
    """Return the entity that a part names, by an attribute or an expression."""
    literal, expression = part.get(attribute), part.get("expression")
    if (literal is None) == (expression is None):
        findings.fault(part, f"handover:{local(part)} has either {attribute} or expression")
        return Value()
    if expression is not None:
        return read_expression(part, expression, findings)
    if not is_reference(literal):
        findings.fault(
            part, f'{attribute}="{literal}" names no entity; write Type:id such as Device:glove-1, or a URN'
        )
    return Value(literal)


def used_entities(
    type_: str, involved: Iterable[Value], parts: Iterable[etree._Element], findings: Findings
) -> tuple[Value, ...]:
    """Return the entities of a type that a Task uses, by elements of their own or by handover:involves."""
    used = [entity for entity in involved if passive_type(entity) == type_]
    for part in parts:
        value = read_reference(part, "entity", findings)
        if value.expression is None and is_reference(value.literal) and _type_of(value) not in {type_, None}:
            findings.fault(
                part,
                message(
                    "bpmn.wrong_used_type",
                    '"{entity}" is no {type}; write {type}:id',
                    entity=value.literal,
                    type=type_,
                ),
            )
        used.append(value)
    return tuple(used)


def passive_type(value: Value) -> str | None:
    """Return the entity type of a literal reference, if entities of it perform nothing."""
    type_ = _type_of(value)
    return type_ if type_ in PASSIVE_TYPES else None


def _type_of(value: Value) -> str | None:
    """Return the entity type of a literal reference, as far as it names one."""
    if not isinstance(value.literal, str):
        return None
    return type_of(value.literal) if value.literal.startswith("urn:") else value.literal.partition(":")[0]


def read_value(part: etree._Element, findings: Findings) -> Value:
    """Return the value of a parameter."""
    value, expression = part.get("value"), part.get("expression")
    if not part.get("name"):
        findings.fault(part, "a parameter needs a name")
    if (value is None) == (expression is None):
        findings.fault(part, "a parameter has either value or expression")
        return Value()
    return (
        read_expression(part, expression, findings)
        if expression is not None
        else Value(json_or_text(value or ""))
    )


def read_expression(part: etree._Element, text: str, findings: Findings) -> Value:
    """Return an expression of our language."""
    return attempt(part, lambda: Value(expression=native.read(text)), Value(), findings)


def read_outputs(parts: list[etree._Element], findings: Findings) -> dict[str, str]:
    """Return the result that each variable gets."""
    outputs: dict[str, str] = {}
    for part in parts:
        name = part.get("name") or ""
        if not is_variable_name(name):
            findings.fault(part, f'"{name}" cannot be the name of a variable')
        outputs[name] = part.get("from") or name
    return outputs


def json_or_text(text: str) -> Json:
    """Return the JSON that a text is, or the text."""
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:
        return text
