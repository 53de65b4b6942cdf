"""Listeners of Camunda 7 that set variables, and the initial values of data objects."""

import json
from collections.abc import Iterator

from lxml import etree

from handover_bpmn.languages.juel import read_juel
from handover_bpmn.languages.native_grammar import is_name
from handover_bpmn.model import Assignment, Value
from handover_bpmn.notation.dialects.camunda7_elements import children_named, own_extensions
from handover_bpmn.notation.dialects.camunda7_values import default_of_type
from handover_bpmn.notation.dialects.scripts import JAVA_LIKE, assigned_by, set_variables
from handover_bpmn.notation.document import children, local, text
from handover_bpmn.notation.elements import referenced

_DATA_TYPES = {
    **dict.fromkeys(("int", "integer", "long", "short"), "integer"),
    **dict.fromkeys(("double", "float", "decimal"), "number"),
    "boolean": "boolean",
}
"""The types of XML Schema that data objects have, as those of JSON Schema."""


def initial_values(process: etree._Element) -> Iterator[Assignment]:
    """Yield the values of data objects, which are defaults of variables in Activiti and Flowable."""
    for data in children(process, "dataObject"):
        name = data.get("name") or data.get("id") or ""
        for extension in own_extensions(data):
            if local(extension) != "value" or not is_name(name):
                continue
            type_ = referenced(data.get("itemSubjectRef") or "").lower()
            default = default_of_type(_DATA_TYPES.get(type_, "string"), text(extension))
            initial = f"${{vars:getOrDefault({name}, {json.dumps(default)})}}"
            yield Assignment(name, Value(expression=read_juel(initial)))


def listener_assignments(listener: etree._Element) -> tuple[Assignment, ...]:
    """Return the variables that a listener sets, by an expression or script; none for other listeners."""
    if listener.get("event") in {"delete", "timeout", "update"}:
        return ()
    script = next(children_named(listener, "script"), None)
    if script is not None:
        return assigned_by_script(script.get("scriptFormat") or "", text(script))
    return assigned_by(listener.get("expression") or "")


def assigned_by_script(format_: str, source: str) -> tuple[Assignment, ...]:
    """Return the variables that a script sets; none if it does anything else."""
    return (set_variables(source) or ()) if format_.lower() in JAVA_LIKE else ()
