"""Loops: how often an activity is done."""

from lxml import etree

from handover.messages import message
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.languages.native_grammar import is_variable_name
from handover_bpmn.model import MultiInstance, StandardLoop, Value
from handover_bpmn.notation.conditions import read_condition
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.base import attempt, native_variable
from handover_bpmn.notation.document import child, child_text, flag, own_data
from handover_bpmn.notation.elements import referenced, warn_without_effect
from handover_bpmn.notation.nodes.data import associated_variable


def read_loop(element: etree._Element, context: Context) -> StandardLoop | MultiInstance | None:
    """Return the loop of an activity, if it has one."""
    standard = child(element, "standardLoopCharacteristics")
    if standard is not None:
        return _standard_loop(element, standard, context)
    multiple = child(element, "multiInstanceLoopCharacteristics")
    return None if multiple is None else _multi_instance(element, multiple, context)


def _standard_loop(element: etree._Element, loop: etree._Element, context: Context) -> StandardLoop | None:
    condition = child_text(loop, "loopCondition")
    maximum = (loop.get("loopMaximum") or "").strip()
    if maximum and not (maximum.isascii() and maximum.isdecimal() and len(maximum) < 10):
        context.findings.fault(
            element,
            message("bpmn.wrong_loop_maximum", 'loopMaximum="{given}" is no number', given=maximum[:64]),
        )
        maximum = ""
    elif not condition and not maximum and context.dialects.main.lenient:  # only a drawn marker
        warn_without_effect(element, context.findings, "a loop without loopCondition and loopMaximum")
        return None
    elif not condition and not maximum:
        context.findings.fault(
            element, message("bpmn.endless_loop", "a loop needs a loopCondition or loopMaximum")
        )
    return StandardLoop(
        read_condition(element, child(loop, "loopCondition"), context) if condition else None,
        flag(loop, "testBefore", default=False),
        int(maximum) if maximum else None,
    )


def _multi_instance(element: etree._Element, loop: etree._Element, context: Context) -> MultiInstance:
    findings, main = context.findings, context.dialects.main
    items = main.items(loop, findings)
    cardinality, completion = child_text(loop, "loopCardinality"), child_text(loop, "completionCondition")
    if loop.get("behavior") not in {None, "All"} or child(loop, "complexBehaviorDefinition") is not None:
        warn_without_effect(element, findings, "behavior of multiInstanceLoopCharacteristics")
    collection = items.collection
    if collection is None:
        name = _data_name(element, child_text(loop, "loopDataInputRef"), context)
        if "${" in name or "#{" in name:
            collection = attempt(element, lambda: main.value(name), None, findings)
        elif name:
            collection = attempt(element, lambda: native_variable(name), None, findings)
    if collection is None and not cardinality and element.get("id") not in findings.broken:
        findings.fault(
            element,
            message(
                "bpmn.no_collection",
                "a multi-instance activity needs a loopCardinality, or a loopDataInputRef that names a list",
            ),
        )
    output = items.output_collection
    if output is None:
        output = _data_name(element, child_text(loop, "loopDataOutputRef"), context) or None
    output_item = items.output_item
    if output_item is None:
        item_name = _item_name(element, child(loop, "outputDataItem"), context)
        if item_name and main.lenient:  # an instance need not set it
            output_item = Value(expression=read_juel(f"${{vars:get({item_name})}}"))
        elif item_name:
            output_item = attempt(element, lambda: native_variable(item_name), None, findings)
    return MultiInstance(
        sequential=flag(loop, "isSequential", default=False),
        cardinality=attempt(element, lambda: _number(cardinality, context), None, findings)
        if cardinality
        else None,
        collection=collection,
        item_variable=items.item_variable or _item_name(element, child(loop, "inputDataItem"), context),
        completion=read_condition(element, child(loop, "completionCondition"), context)
        if completion
        else None,
        output_collection=output,
        output_item=output_item,
        first=items.first,
    )


def _number(cardinality: str, context: Context) -> Value:
    if cardinality.isascii() and cardinality.isdecimal() and len(cardinality) < 10:
        return Value(int(cardinality))
    return Value(expression=context.dialects.main.expression(cardinality))


def _item_name(element: etree._Element, item: etree._Element | None, context: Context) -> str | None:
    if item is None:
        return None
    drawn = item.get("name") or ""
    name = drawn if is_variable_name(drawn) else item.get("id") or drawn
    if not is_variable_name(name):
        context.findings.fault(
            element,
            message("bpmn.wrong_variable", '"{name}" cannot be the name of a variable', name=name),
        )
        return None
    return str(name)


def _data_name(element: etree._Element, reference: str, context: Context) -> str:
    """Return the name of the data object, data input or variable that a loop refers to."""
    reference = referenced(reference)
    if not reference:
        return ""
    data = context.data.get(reference, reference)
    if data in context.data_names:
        return context.data_names[data]
    associated = associated_variable(element, reference, context) if reference else None
    return associated or own_data(element).get(reference) or context.properties.get(reference) or reference
