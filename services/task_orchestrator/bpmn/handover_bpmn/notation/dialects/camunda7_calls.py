"""Calls of Camunda 7: the called process, its version, and the variables that are passed."""

from functools import partial

from lxml import etree

from handover.messages import message
from handover_bpmn.languages.native_grammar import is_name
from handover_bpmn.model import Assignment, Call, Value
from handover_bpmn.notation.dialects.base import attempt, variable_named
from handover_bpmn.notation.dialects.camunda7_elements import NAMESPACES, has_expression, own_extensions
from handover_bpmn.notation.dialects.camunda7_values import text_value
from handover_bpmn.notation.document import attributes_of, local
from handover_bpmn.notation.elements import referenced
from handover_bpmn.notation.faults import Findings


def read_call(element: etree._Element, findings: Findings) -> Call | None:
    """Return the called process with its binding, `in` and `out`."""
    attributes = attributes_of(element, NAMESPACES)
    called = (element.get("calledElement") or "").strip()
    if not called:
        what = "callActivity with caseRef (CMMN)" if attributes.get("caseRef") else ""
        findings.fault(
            element,
            message(
                "bpmn.no_called_element",
                "the call activity names no process; set calledElement to the id of one",
            )
            if not what
            else message(
                "bpmn.not_supported",
                "{what} is not supported yet; {way_out}",
                what=what,
                way_out="call a process instead",
            ),
        )
        return None
    if not has_expression(called):
        called = referenced(called)
    inputs, all_inputs, key = passed_variables(element, "in", findings)
    outputs, all_outputs, _ = passed_variables(element, "out", findings)
    if attributes.get("inheritVariables") == "true":  # of Activiti and Flowable
        all_inputs = True
    return Call(
        attempt(element, lambda: text_value(called), Value(), findings),
        version=_bound(element, "version", "calledElementVersion", findings),
        tag=_bound(element, "versionTag", "calledElementVersionTag", findings),
        inputs=inputs,
        outputs=outputs,
        all_inputs=all_inputs,
        all_outputs=all_outputs,
        key=key,
    )


def _bound(element: etree._Element, binding: str, attribute: str, findings: Findings) -> Value | None:
    attributes = attributes_of(element, NAMESPACES)
    if attributes.get("calledElementBinding") != binding:
        return None
    bound = (attributes.get(attribute) or "").strip()
    if not bound:
        findings.fault(element, f'calledElementBinding="{binding}" needs {attribute}')
        return None
    if binding == "version" and bound.isdecimal():
        return Value(int(bound[:9]))
    return attempt(element, lambda: text_value(bound), None, findings)


def passed_variables(
    element: etree._Element, direction: str, findings: Findings
) -> tuple[tuple[Assignment, ...], bool, Value | None]:
    """Return the assignments, whether all variables are passed, and the business key."""
    passed: list[Assignment] = []
    everything = False
    key: Value | None = None
    for part in (extension for extension in own_extensions(element) if local(extension) == direction):
        business_key, source = part.get("businessKey"), part.get("source", "")
        expression = part.get("sourceExpression")
        if part.get("variables") == "all":
            everything = True
            continue
        if business_key is not None:
            key = attempt(part, partial(text_value, business_key), None, findings)
            continue
        target = part.get("target") or ""
        if not is_name(target):
            findings.fault(part, f'target="{target}" cannot be the name of a variable')
            continue
        reading = partial(text_value, expression) if expression else partial(variable_named, source or "")
        passed.append(Assignment(target, attempt(part, reading, Value(), findings)))
    return tuple(passed), everything, key
