"""Activities: the Task, call, loop and data of an activity, read into the model."""

from dataclasses import replace

from lxml import etree

from handover.messages import message
from handover_bpmn.languages.base import Expression, ExpressionError
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.model import Activity, Kind, Value
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.base import Script, Work
from handover_bpmn.notation.dialects.handover_elements import has_task
from handover_bpmn.notation.document import documentation
from handover_bpmn.notation.elements import refuse
from handover_bpmn.notation.names import definition_of
from handover_bpmn.notation.nodes.data import read_task_data
from handover_bpmn.notation.nodes.performers import RESOURCE_ROLES, performer_hints
from handover_bpmn.notation.nodes.retries import read_retry
from handover_bpmn.notation.nodes.task_extensions import read_escalations, read_specification


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
