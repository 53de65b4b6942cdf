"""Task data: the data inputs and outputs of an activity that are associated with variables (clause 10.4).

Properties of a process are variables here. A data input that is assigned a value, or associated with a
property, is a parameter of the Task; a data output that is associated with a property sets it. Associations
with data objects belong to the engine; `read_data` reads them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from lxml import etree

from handover_bpmn.languages.native_grammar import is_variable_name
from handover_bpmn.model import DataAssociation, Value
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.base import attempt, native_variable
from handover_bpmn.notation.document import assigned_text, child, child_text, children, local, own_data
from handover_bpmn.notation.elements import referenced, warn_without_effect


@dataclass(frozen=True, slots=True)
class TaskData:
    """Parameters of a Task, and the variables that its results set."""

    parameters: Mapping[str, Value] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)


def collect_properties(process: etree._Element, context: Context) -> None:
    """Collect the names that a process declares as variables: properties, its own data, loop items."""
    for name in ("property", "inputDataItem", "outputDataItem"):
        for element in process.iter(f"{{*}}{name}"):
            _declare(element, context)
    specification = child(process, "ioSpecification")
    if specification is not None:
        for element in children(specification, "dataInput", "dataOutput"):
            context.properties[element.get("id") or ""] = element.get("id") or ""


def _declare(element: etree._Element, context: Context) -> None:
    id_, name = element.get("id") or "", element.get("name") or ""
    variable = name if is_variable_name(name) else id_
    if id_ and is_variable_name(variable):
        context.properties[id_] = variable


def read_task_data(element: etree._Element, context: Context) -> TaskData:
    """Return what the data associations of an activity with variables say of its Task."""
    names = own_data(element)
    parameters: dict[str, Value] = {}
    outputs: dict[str, str] = {}
    for association in children(element, "dataInputAssociation", "dataOutputAssociation"):
        if not has_variable(association, context) or is_of_loop(element, association):
            continue
        if local(association) == "dataInputAssociation":
            target = referenced(child_text(association, "targetRef"))
            name = names.get(target) or target
            if name:
                parameters[name] = _input(association, context)
        else:
            source = referenced(child_text(association, "sourceRef"))
            variable = context.properties[referenced(child_text(association, "targetRef"))]
            outputs[names.get(source) or source or variable] = variable
            if "#{" in assigned_text(association):
                warn_without_effect(association, context.findings, "the assignment of a data output")
    return TaskData(parameters, outputs)


def _input(association: etree._Element, context: Context) -> Value:
    source = referenced(child_text(association, "sourceRef"))
    findings = context.findings
    if source in context.properties:
        return attempt(association, lambda: native_variable(context.properties[source]), Value(), findings)
    assigned = assigned_text(association)
    return attempt(association, lambda: context.dialects.main.value(assigned), Value(), findings)


def has_variable(association: etree._Element, context: Context) -> bool:
    """Return whether an association of an activity reads a variable or an assigned value, or sets one."""
    if local(association) == "dataOutputAssociation":
        return referenced(child_text(association, "targetRef")) in context.properties
    source = referenced(child_text(association, "sourceRef"))
    return source in context.properties or (not source and child(association, "assignment") is not None)


def is_of_loop(element: etree._Element, association: etree._Element) -> bool:
    """Return whether an association carries the collection of a multi-instance activity."""
    loop = child(element, "multiInstanceLoopCharacteristics")
    if loop is None:
        return False
    ends = {referenced(child_text(association, name)) for name in ("sourceRef", "targetRef")} - {""}
    return not ends.isdisjoint(
        referenced(child_text(loop, name)) for name in ("loopDataInputRef", "loopDataOutputRef")
    )


def associated_variable(element: etree._Element, data: str, context: Context) -> str | None:
    """Return the variable or data object that the data input or output `data` is associated with."""
    for association in children(element, "dataInputAssociation", "dataOutputAssociation"):
        is_input = local(association) == "dataInputAssociation"
        inner, outer = ("targetRef", "sourceRef") if is_input else ("sourceRef", "targetRef")
        if referenced(child_text(association, inner)) == data:
            other = referenced(child_text(association, outer))
            object_ = context.data.get(other, other)
            return context.properties.get(other) or context.data_names.get(object_) or other or None
    return None


def read_data(
    element: etree._Element, context: Context, *, is_event: bool = False
) -> tuple[tuple[DataAssociation, ...], tuple[DataAssociation, ...]]:
    """Return the data objects that an activity or event reads and writes.

    The Task of an activity has the associations with variables; at an event they have no effect.
    """
    names = own_data(element)
    inputs: list[DataAssociation] = []
    outputs: list[DataAssociation] = []
    for association in children(element, "dataInputAssociation", "dataOutputAssociation"):
        is_input = local(association) == "dataInputAssociation"
        source = referenced(child_text(association, "sourceRef"))
        target = referenced(child_text(association, "targetRef"))
        outer, inner = (source, target) if is_input else (target, source)
        data = context.data.get(outer, outer)
        if data not in context.data_names:
            if is_event or not has_variable(association, context):
                warn_without_effect(association, context.findings)
            continue
        for part in ("transformation", "assignment"):
            if child(association, part) is not None:
                warn_without_effect(association, context.findings, f"{part} of a {local(association)}")
        if is_input:
            inputs.append(DataAssociation(data, names.get(inner) or context.data_names[data]))
        else:
            outputs.append(DataAssociation(data, names.get(inner)))
    return tuple(inputs), tuple(outputs)
