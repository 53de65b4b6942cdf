"""The files for modelers: the descriptor has what the reader knows; templates make Tasks that it reads."""

import json
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import pytest

from handover_bpmn.model import Activity
from handover_bpmn.notation.dialects import handover_elements
from handover_bpmn.notation.file import read_bpmn
from handover_bpmn.spans import evaluated_needs, read_needs

MODELER = Path("deploy/modeler")
RESERVE = "handover.reserve"
TEMPLATES: list[dict[str, Any]] = json.loads((MODELER / "element-templates" / "handover.json").read_text())


def test_the_descriptor_has_every_element_and_attribute_that_the_reader_knows() -> None:
    types = json.loads((MODELER / "handover-moddle.json").read_text())["types"]
    described = {
        each["name"][0].lower() + each["name"][1:]: {
            one["name"] for one in each["properties"] if one.get("isAttr")
        }
        for each in types
        if "extends" not in each
    }
    [attribute] = [each for each in types if "extends" in each]
    assert [each["name"] for each in attribute["properties"]] == ["reserve"]
    assert described == {name: set(attributes) for name, attributes in handover_elements.ATTRIBUTES.items()}


def activity_of(template: dict[str, Any]) -> Activity:
    """Return the activity of a diagram to which the template is applied, as the Modeler does it."""
    attributes, inputs = "", ""
    for each in template["properties"]:
        name, value = each["binding"]["name"], escape(each["value"])
        if each["binding"]["type"] == "property":
            attributes += f' {name}="{value}"'
        elif value:
            inputs += f'<camunda:inputParameter name="{name}">{value}</camunda:inputParameter>'
    (type_,) = template["appliesTo"]
    tag = f"bpmn:{type_[5].lower()}{type_[6:]}"
    inputs = f"<camunda:inputOutput>{inputs}</camunda:inputOutput>"
    extensions = f"<bpmn:extensionElements>{inputs}</bpmn:extensionElements>"
    xml = (
        '<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" '
        'xmlns:camunda="http://camunda.org/schema/1.0/bpmn" targetNamespace="t">'
        '<bpmn:process id="p" isExecutable="true"><bpmn:startEvent id="s"/>'
        f'<{tag} id="work"{attributes}>{extensions}</{tag}><bpmn:endEvent id="e"/>'
        '<bpmn:sequenceFlow id="a" sourceRef="s" targetRef="work"/>'
        '<bpmn:sequenceFlow id="b" sourceRef="work" targetRef="e"/></bpmn:process></bpmn:definitions>'
    )
    (definition,) = read_bpmn(xml.encode()).definitions
    return definition.activities()["work"]


def test_a_template_reserves_what_is_written() -> None:
    (template,) = [each for each in TEMPLATES if each["id"] == RESERVE]
    (field,) = template["properties"]
    name, value = field["binding"]["name"], field["value"]
    extensions = f'<c:properties><c:property name="{name}" value="{value}"/></c:properties>'
    xml = (
        '<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" '
        'xmlns:c="http://camunda.org/schema/1.0/bpmn" targetNamespace="t">'
        f'<bpmn:process id="p"><bpmn:extensionElements>{extensions}</bpmn:extensionElements>'
        '<bpmn:startEvent id="s"/></bpmn:process></bpmn:definitions>'
    )
    (definition,) = read_bpmn(xml.encode()).definitions
    (span,) = definition.scope.spans
    assert evaluated_needs(span, {}) == read_needs(value)


@pytest.mark.parametrize(
    "template", [t for t in TEMPLATES if t["id"] != RESERVE], ids=lambda template: template["id"]
)
def test_a_template_makes_a_task_with_its_parameters(template: dict[str, Any]) -> None:
    activity = activity_of(template)
    expected = {
        each["binding"]["name"]
        for each in template["properties"]
        if each["binding"]["type"] == "camunda:inputParameter" and each["value"]
    }
    assert set(activity.parameters) == expected
    if template["appliesTo"] == ["bpmn:ServiceTask"]:
        assert activity.hints["topic"] == "robot"
        assert activity.parameters["operation"].literal in {"moveTo", "scan", "pick", "place"}
