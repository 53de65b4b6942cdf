"""JSON Schema as a form: its fields, and the faults of a result by field."""

from typing import Any

import pytest

from handover_bpmn.forms import form, json_schema
from handover_bpmn.forms.fields import FieldKind

SCHEMA = {
    "type": "object",
    "properties": {
        "weight": {"type": "number", "title": "Weight", "minimum": 0.5, "maximum": 20, "unit": "kg"},
        "count": {"type": "integer", "default": 3},
        "good": {"type": "boolean"},
        "colour": {"oneOf": [{"const": "r", "title": "Red"}, {"const": "g", "title": "Green"}]},
        "size": {"enum": [1, 2]},
        "tags": {"type": "array", "items": {"enum": ["a", "b"]}},
        "serial": {"type": "string", "pattern": "^[A-Z]\\d+$", "maxLength": 5, "readOnly": True},
        "when": {"type": "string", "format": "date"},
        "place": {"type": "object", "properties": {"row": {"type": "integer"}}, "required": ["row"]},
        "holes": {"type": "array", "items": {"type": "object", "properties": {"mm": {"type": "number"}}}},
        "pose": {"type": "array"},
    },
    "required": ["weight", "colour"],
}


def faults(outputs: dict[str, Any], schema: dict[str, Any] = SCHEMA) -> dict[str, str]:
    return {fault.path: fault.reason.code for fault in json_schema.check(schema, {}, outputs)[1]}


def test_each_property_is_a_field() -> None:
    fields = json_schema.fields_of(SCHEMA, {"serial": "A7"})
    assert {each.path: each.kind for each in fields} == {
        "weight": FieldKind.NUMBER,
        "count": FieldKind.INTEGER,
        "good": FieldKind.BOOLEAN,
        "colour": FieldKind.CHOICE,
        "size": FieldKind.CHOICE,
        "tags": FieldKind.CHOICES,
        "serial": FieldKind.TEXT,
        "when": FieldKind.DATE,
        "place": FieldKind.GROUP,
        "holes": FieldKind.LIST,
        "pose": FieldKind.JSON,
    }
    by_path = {each.path: each for each in fields}
    assert [each.path for each in fields if each.is_required] == ["weight", "colour"]
    assert (by_path["serial"].initial, by_path["count"].initial) == ("A7", 3)
    assert (by_path["weight"].unit, by_path["weight"].maximum) == ("kg", 20)
    (row,) = by_path["place"].fields
    assert (row.path, row.is_required) == ("place.row", True)


@pytest.mark.parametrize(
    ("outputs", "expected"),
    [
        ({}, {"weight": "form.required", "colour": "form.required"}),
        ({"weight": 0.1, "colour": "r"}, {"weight": "form.too_small"}),
        ({"weight": 21, "colour": "x"}, {"weight": "form.too_large", "colour": "form.not_allowed"}),
        ({"weight": "heavy", "colour": "r"}, {"weight": "form.not_a_number"}),
        ({"weight": 1, "colour": "r", "place": {}}, {"place.row": "form.required"}),
        ({"weight": 1, "colour": "r", "when": "soon"}, {"when": "form.format"}),
        ({"weight": 1, "colour": "r", "serial": "7"}, {"serial": "form.format"}),
        ({"weight": 1, "colour": "r", "holes": [{"mm": "x"}]}, {"holes.0.mm": "form.not_a_number"}),
    ],
)
def test_a_wrong_result_is_refused_by_field(outputs: dict[str, Any], expected: dict[str, str]) -> None:
    assert faults(outputs) == expected


def test_a_read_only_value_cannot_be_changed() -> None:
    values, found = json_schema.check(SCHEMA, {"serial": "A7"}, {"weight": 1, "colour": "r", "serial": "B8"})
    assert (values["serial"], found) == ("A7", [])


def test_references_are_never_loaded_and_slow_patterns_do_not_stall() -> None:
    remote = {"properties": {"a": {"$ref": "http://127.0.0.1:1/schema.json"}}}
    assert faults({"a": 1}, remote) == {}
    slow = {"properties": {"a": {"type": "string", "pattern": "^(a+)+$"}}}
    assert faults({"a": "a" * 5000 + "!"}, slow) == {"a": "form.format"}


def test_a_schema_that_is_none_is_named() -> None:
    assert form.form_fault({"type": "nothing"}) is not None
    assert form.form_fault(SCHEMA) is None
