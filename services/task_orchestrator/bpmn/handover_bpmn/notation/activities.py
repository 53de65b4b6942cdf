"""Activities: the Task, call, loop and data of an activity, read into the model."""

from dataclasses import replace

from lxml import etree

from handover.messages import message
from handover_bpmn.languages.base import Expression, ExpressionError
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.languages.native_grammar import is_variable_name
from handover_bpmn.model import (
    Activity,
    DataAssociation,
    Kind,
    MultiInstance,
    StandardLoop,
    Value,
)
from handover_bpmn.notation.conditions import read_condition
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.base import Script, Work, attempt, native_variable
from handover_bpmn.notation.dialects.handover_elements import has_task
from handover_bpmn.notation.document import (
    child,
    child_text,
    children,
    documentation,
    flag,
    local,
    own_data,
)
from handover_bpmn.notation.elements import referenced, refuse, warn_without_effect
from handover_bpmn.notation.escalations import read_escalations
from handover_bpmn.notation.names import definition_of
from handover_bpmn.notation.performers import RESOURCE_ROLES, performer_hints
from handover_bpmn.notation.retries import read_retry
from handover_bpmn.notation.specifications import read_specification
from handover_bpmn.notation.task_data import (
    associated_variable,
    has_variable,
    read_task_data,
)


def read_activity(element: etree._Element, context: Context, *, script: Script | None = None) -> Activity:
    """Return the activity for whose Task nothing but the element itself is needed."""
    findings = context.findings
    main, handover = context.dialects.main, context.dialects.handover
    work = main.work(element, findings)
    spreads = main.spreads_outputs
    if main is not handover and has_task(element):
        ours = handover.work(element, findings)
        hints = {**work.hints, **ours.hints}
        work, spreads = _with_form(ours, work), False
    else:
        hints = dict(work.hints)
    hints = {**performer_hints(element, context), **hints}
    data = read_task_data(element, context)
    parameters = {**data.parameters, **work.parameters}
    outputs = {**data.outputs, **work.outputs}
    if script is not None:
        parameters |= {"script": Value(script.text), "scriptFormat": Value(script.format)}
        work = _with_variable(work, script)
    if work.variable is not None:
        spreads = False
    id_ = element.get("id") or ""
    variable = work.variable or ("" if spreads or outputs else context.variable(element, None))
    return Activity(
        id=id_,
        name=_drawn_name(element) or id_,
        description=documentation(element),
        lane=context.lanes.get(id_),
        definition=work.definition
        if work.definition is not None
        else definition_of(id_, element.get("name") or ""),
        deadline=work.deadline,
        involves=work.involves,
        happens_at=work.happens_at,
        parameters=parameters,
        outputs=outputs,
        variable=variable,
        handles_outcomes=work.handles_outcomes,
        require_pin=work.require_pin,
        performer_lost=work.performer_lost,
        hints=hints,
        role=work.role,
        skills=work.skills,
        materials=work.materials,
        assets=work.assets,
        form=work.form,
        inputs_schema=work.inputs_schema,
        spreads_outputs=spreads and not outputs,
        retry=read_retry(element, hints, context),
        escalations=read_escalations(element, findings),
        specification=read_specification(element, context),
        texts=_texts(element, context),
    )


def _with_form(ours: Work, theirs: Work) -> Work:
    """Return our Task with the form of the other dialect, unless it has one."""
    if ours.form is not None or "form" in ours.parameters:
        return ours
    written = {name: value for name, value in theirs.parameters.items() if name == "form"}
    return replace(ours, form=theirs.form, parameters={**written, **ours.parameters})


def _with_variable(work: Work, script: Script) -> Work:
    if script.variable is None:
        return work
    return replace(work, variable=script.variable)


def _texts(element: etree._Element, context: Context) -> dict[str, Expression]:
    """Return the expressions in the drawn texts that people read; one that cannot be read is a warning."""
    drawn = {"name": _drawn_name(element), "description": documentation(element) or ""}
    expressions: dict[str, Expression] = {}
    for name, drawn_text in drawn.items():
        if "${" not in drawn_text and "#{" not in drawn_text:
            continue
        try:
            expressions[name] = read_juel(drawn_text)
        except ExpressionError as error:
            context.findings.warn(
                element,
                message(
                    "bpmn.text_not_evaluated",
                    "its {name} is shown as it is drawn, since an expression in it cannot be read: {error}",
                    name=name,
                    error=str(error),
                ),
            )
    return expressions


def _drawn_name(element: etree._Element) -> str:
    return " ".join((element.get("name") or "").split())


def warn_foreign_script(element: etree._Element, script: Script, context: Context) -> None:
    """Add the warning that a script in another language becomes a Task."""
    context.findings.warn(
        element,
        message(
            "bpmn.foreign_script",
            "a {format} script is not run here: it becomes a Task, with the script among its parameters",
            format=script.format or "foreign",
        ),
    )


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


def check_quantities(element: etree._Element, context: Context) -> None:
    """Refuse activities that need or make several tokens."""
    for name in ("startQuantity", "completionQuantity"):
        if (element.get(name) or "1").strip() != "1":
            refuse(element, f'{name}="{element.get(name)}"', "use a parallel gateway", context.findings)


ACTIVITY_PARTS = frozenset(
    {
        *("incoming", "outgoing", "standardLoopCharacteristics", "multiInstanceLoopCharacteristics"),
        *("dataInputAssociation", "dataOutputAssociation", "ioSpecification", *RESOURCE_ROLES),
    }
)
TASKS = frozenset({Kind.TASK, Kind.USER_TASK, Kind.MANUAL_TASK, Kind.SERVICE_TASK, Kind.BUSINESS_RULE_TASK})
