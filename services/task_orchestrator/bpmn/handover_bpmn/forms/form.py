"""Form: a JSON Schema or a form of form-js behind one interface."""

from collections.abc import Mapping
from typing import Any

import orjson

from handover_bpmn.forms import form_js, json_schema
from handover_bpmn.forms.fields import FieldFault
from handover_bpmn.forms.form_js import Resolved, is_form_js
from handover_bpmn.forms.json_schema import schema_fault

Schema = Mapping[str, Any]


def resolve(schema: Schema, data: Mapping[str, Any]) -> Resolved:
    """Return the fields of a form for the present data."""
    if is_form_js(schema):
        return form_js.resolve(schema, data)
    return Resolved(json_schema.fields_of(schema, data), is_dynamic=False)


def check(
    schema: Schema, data: Mapping[str, Any], outputs: Mapping[str, Any]
) -> tuple[dict[str, Any], list[FieldFault]]:
    """Return the result that the form makes of `outputs`, and the faults by field."""
    return (
        form_js.check(schema, data, outputs)
        if is_form_js(schema)
        else json_schema.check(schema, data, outputs)
    )


def form_fault(schema: Schema) -> str | None:
    """Return why a form that is written in a BPMN file cannot be used; None if it can."""
    if not is_form_js(schema):
        return schema_fault(schema)
    try:
        form_js.read_form(orjson.dumps(schema), "form")
    except form_js.BadForm as bad:
        return bad.detail
    return None
