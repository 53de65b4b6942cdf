"""form-js: components become fields for the present data, and results are checked by the same fields."""

from typing import Any

import orjson
import pytest

from handover_bpmn.forms import form_js
from handover_bpmn.forms.fields import FieldKind
from handover_bpmn.forms.form_js import BadForm


def form(*components: dict[str, Any]) -> dict[str, Any]:
    return {"type": "default", "id": "f", "components": list(components)}


def faults(schema: dict[str, Any], outputs: dict[str, Any], **data: Any) -> dict[str, str]:
    return {fault.path: fault.reason.code for fault in form_js.check(schema, data, outputs)[1]}


def field(component: dict[str, Any], **data: Any) -> Any:
    (only,) = form_js.resolve(form({"id": "x", **component}), data).fields
    return only


@pytest.mark.parametrize(
    ("component", "kind"),
    [
        ({"type": "textfield", "key": "a"}, FieldKind.TEXT),
        ({"type": "textarea", "key": "a"}, FieldKind.MULTILINE),
        ({"type": "number", "key": "a"}, FieldKind.NUMBER),
        ({"type": "checkbox", "key": "a"}, FieldKind.BOOLEAN),
        ({"type": "checklist", "key": "a", "values": []}, FieldKind.CHOICES),
        ({"type": "taglist", "key": "a", "values": []}, FieldKind.CHOICES),
        ({"type": "radio", "key": "a", "values": []}, FieldKind.CHOICE),
        ({"type": "select", "key": "a", "values": []}, FieldKind.CHOICE),
        ({"type": "datetime", "key": "a", "subtype": "date"}, FieldKind.DATE),
        ({"type": "datetime", "key": "a", "subtype": "time"}, FieldKind.TIME),
        ({"type": "datetime", "key": "a", "subtype": "datetime"}, FieldKind.DATETIME),
        ({"type": "text", "text": "# Read"}, FieldKind.NOTE),
        ({"type": "html", "content": "<b>Read</b>"}, FieldKind.NOTE),
        ({"type": "image", "source": "data:image/png;base64,AA"}, FieldKind.IMAGE),
        ({"type": "iframe", "url": "https://example.org"}, FieldKind.LINK),
        ({"type": "separator"}, FieldKind.SEPARATOR),
    ],
)
def test_each_component_is_a_field(component: dict[str, Any], kind: FieldKind) -> None:
    assert field(component).kind is kind


def test_values_known_before_come_before_the_default_value() -> None:
    component = {"type": "number", "key": "part.weight", "defaultValue": 1}
    assert field(component).initial == 1
    assert field(component, part={"weight": 7}).initial == 7


def test_labels_limits_and_options_are_evaluated() -> None:
    shown = field(
        {"type": "number", "key": "w", "label": "At most {{limit}} kg", "validate": {"max": "=limit"}},
        limit=5,
    )
    assert (shown.label, shown.maximum) == ("At most 5 kg", 5)
    chosen = field({"type": "select", "key": "s", "valuesExpression": "=sizes"}, sizes=["S", "M"])
    assert [option.value for option in chosen.options] == ["S", "M"]
    keyed = field({"type": "radio", "key": "s", "valuesKey": "boxes"}, boxes=[{"label": "Small", "value": 1}])
    assert [(option.value, option.label) for option in keyed.options] == [(1, "Small")]


def test_a_hidden_component_is_neither_shown_nor_required_nor_in_the_result() -> None:
    schema = form(
        {"type": "checkbox", "key": "broken"},
        {
            "type": "textfield",
            "key": "why",
            "validate": {"required": True},
            "conditional": {"hide": "=not(broken)"},
        },
    )
    assert faults(schema, {"broken": True}) == {"why": "form.required"}
    values, found = form_js.check(schema, {}, {"broken": False, "why": "typed before"})
    assert (values, found) == ({"broken": False}, [])
    assert form_js.resolve(schema, {}).is_dynamic


@pytest.mark.parametrize(
    ("component", "value", "code"),
    [
        ({"type": "textfield", "validate": {"required": True}}, "", "form.required"),
        ({"type": "checkbox", "validate": {"required": True}}, False, "form.required"),
        ({"type": "textfield", "validate": {"minLength": 3}}, "ab", "form.too_short"),
        ({"type": "textfield", "validate": {"maxLength": 3}}, "abcd", "form.too_long"),
        ({"type": "textfield", "validate": {"pattern": "^A\\d$"}}, "B1", "form.format"),
        ({"type": "textfield", "validate": {"validationType": "email"}}, "anna", "form.format"),
        ({"type": "textfield", "validate": {"validationType": "phone"}}, "one", "form.format"),
        ({"type": "textfield"}, 7, "form.not_text"),
        ({"type": "number", "validate": {"min": 2}}, 1, "form.too_small"),
        ({"type": "number", "validate": {"max": 2}}, 3, "form.too_large"),
        ({"type": "number", "decimalDigits": 1}, 1.25, "form.decimals"),
        ({"type": "number"}, "many", "form.not_a_number"),
        ({"type": "radio", "values": [{"label": "A", "value": "a"}]}, "b", "form.not_allowed"),
        ({"type": "checklist", "values": [{"label": "A", "value": "a"}]}, ["b"], "form.not_allowed"),
        ({"type": "datetime", "subtype": "date"}, "tomorrow", "form.not_a_date"),
    ],
)
def test_a_wrong_value_is_refused_by_field(component: dict[str, Any], value: Any, code: str) -> None:
    assert faults(form({"key": "a", **component}), {"a": value}) == {"a": code}


def test_items_of_a_list_are_checked_each() -> None:
    number = {"type": "number", "key": "mm", "validate": {"required": True}}
    schema = form({"type": "dynamiclist", "path": "holes", "components": [number]})
    assert faults(schema, {"holes": [{"mm": 3}, {}]}) == {"holes.1.mm": "form.required"}
    assert faults(schema, {"holes": "three"}) == {"holes": "form.list"}
    assert form_js.check(schema, {}, {"holes": [{"mm": 3}]})[0] == {"holes": [{"mm": 3}]}


def test_groups_join_paths_and_read_only_values_cannot_be_changed() -> None:
    inner = {"type": "textfield", "key": "serial", "readonly": True}
    schema = form({"type": "group", "path": "part", "components": [inner]})
    values, _ = form_js.check(schema, {"part": {"serial": "A7"}}, {"part": {"serial": "other"}})
    assert values == {"part": {"serial": "A7"}}


def test_computed_values_are_those_of_the_server() -> None:
    schema = form(
        {"type": "number", "key": "a"}, {"type": "expression", "key": "twice", "expression": "=a * 2"}
    )
    assert form_js.check(schema, {}, {"a": 4, "twice": 99})[0] == {"a": 4, "twice": 8}


def test_a_table_has_columns_and_rows() -> None:
    shown = field({"type": "table", "dataSource": "=parts"}, parts=[{"id": 1}])
    assert (shown.columns, shown.initial) == ((("id", "id"),), [{"id": 1}])


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"{", "form.not_json"),
        (b'{"properties": {}}', "form.not_form_js"),
        (b'{"components": []}', "form.no_id"),
        (orjson.dumps(form({"type": "textfield"})), "form.bad_key"),
        (orjson.dumps(form({"type": "textfield", "key": "a..b"})), "form.bad_key"),
        (
            orjson.dumps(form({"type": "textfield", "key": "a", "conditional": {"hide": "=1 +"}})),
            "form.bad_expression",
        ),
        (orjson.dumps(form(*[{"type": "text", "text": "x"}] * 1001)), "form.too_many"),
        (b" " * (512 * 1024 + 1), "form.too_big"),
    ],
)
def test_a_bad_form_is_refused_with_the_reason(content: bytes, code: str) -> None:
    with pytest.raises(BadForm) as refused:
        form_js.read_form(content)
    assert refused.value.code == code


def test_components_that_are_not_shown_are_warnings() -> None:
    read = form_js.read_form(orjson.dumps(form({"type": "filepicker", "key": "a", "label": "Photo"})))
    assert [warning.code for warning in read.warnings] == ["form.unsupported"]
