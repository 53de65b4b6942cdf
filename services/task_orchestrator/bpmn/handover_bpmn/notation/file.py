"""File: a BPMN file with all its executable processes."""

from dataclasses import dataclass, replace

from lxml import etree

from handover.messages import message
from handover_bpmn.model import REFUSED, Activity, Definition, Fault, Node, Scope, StartForm
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.choice import Dialects
from handover_bpmn.notation.document import BPMN, documentation, is_none_start, local, parse
from handover_bpmn.notation.elements import (
    KINDS,
    Collaboration,
    Declarations,
    executable_processes,
    lanes,
)
from handover_bpmn.notation.faults import BadBpmn, Findings
from handover_bpmn.notation.names import process_name
from handover_bpmn.notation.nodes.data import collect_properties
from handover_bpmn.notation.rules import check_process, fault_of_size
from handover_bpmn.notation.scopes import collect_associations, collect_data, read_scope
from handover_bpmn.notation.spans import check_spans

MAX_PROCESSES = 100


@dataclass(frozen=True, slots=True)
class BpmnFile:
    """The executable processes of a file, and what has no effect in it."""

    definitions: tuple[Definition, ...]
    warnings: tuple[Fault, ...] = ()


def read_bpmn(xml: bytes, *, is_deployed: bool = False) -> BpmnFile:
    """Return the processes of a BPMN file; raise `BadBpmn` with all faults of all processes.

    A file that `is_deployed` stays executable although a later release has more rules.
    """
    root = parse(xml)
    findings = Findings(is_deployed=is_deployed)
    declared = Declarations.of(root, findings)
    dialects = Dialects(root)
    executable = executable_processes(root, findings, unless_denied=dialects.runs_undeclared)
    if len(executable) > MAX_PROCESSES:  # each of them is stored with the whole file
        findings.fault(
            executable[MAX_PROCESSES],
            message(
                "bpmn.too_many_processes",
                "a file has at most {limit} executable processes, not {processes}; split it",
                limit=MAX_PROCESSES,
                processes=len(executable),
            ),
        )
        raise BadBpmn(findings.faults, findings.warnings)
    collaboration = Collaboration.of(root, executable, declared, findings)
    ids: set[str] = set()
    definitions = []
    beside = findings.warnings
    for process in executable:
        own = Findings(is_deployed=is_deployed)
        context = Context(dialects, declared, collaboration, own, ids if dialects.is_ours else set())
        definition = _definition(process, context, xml)
        findings.add(own.faults, own.warnings)
        definitions.append(replace(definition, warnings=(*beside, *own.warnings)))
    if findings.faults:
        raise BadBpmn(findings.faults, findings.warnings)
    return BpmnFile(tuple(definitions), findings.warnings)


def _definition(process: etree._Element, context: Context, xml: bytes) -> Definition:
    findings = context.findings
    id_ = context.id(process)
    if process.get("processType") not in {None, "", "None", "Public", "Private"}:
        findings.fault(process, message("bpmn.wrong_process_type", "processType is None, Public or Private"))
    context.lanes = lanes(process)
    collect_associations(process, context)
    collect_data(process, context)
    collect_properties(process, context)
    context.dialects.check(process, findings)
    ours = context.dialects.handover.process(process, findings)
    label = ours.label or context.dialects.main.process(process, findings).label
    too_large = _fault_of_size(process)
    scope = Scope(id_, {}, {}) if too_large is not None else read_scope(process, context)
    if too_large is not None:
        findings.add([too_large])
    else:
        checked = check_process(scope, process.sourceline or 0, findings.broken)
        findings.add(checked.faults, checked.warnings)
        check_spans(process, scope, findings)
    if context.dialects.main.spreads_outputs and _mentions(scope, "outcome"):
        scope = _handling_outcomes(scope)
    title = process.get("name") or context.collaboration.titles.get(id_) or id_
    return Definition(
        name=process_name(id_),
        title=" ".join(title.split()),
        label=label,
        description=documentation(process),
        parameters=ours.parameters,
        scope=replace(scope, id=process_name(id_)),
        xml=xml,
        start_form=_start_form(process, context),
        naming=ours.naming,
        translations=ours.translations,
    )


def _start_form(process: etree._Element, context: Context) -> StartForm:
    """Return the form of the none start event; ours counts before that of another dialect."""
    for element in filter(is_none_start, process):
        for dialect in (context.dialects.handover, context.dialects.main):
            if form := dialect.start_form(element, context.findings):
                return form
    return StartForm()


def _fault_of_size(process: etree._Element) -> Fault | None:
    names = [local(element) for element in process.iter(f"{{{BPMN}}}*")]
    nodes = sum(name in KINDS or name in REFUSED for name in names)
    return fault_of_size(process.get("id") or "", process.sourceline or 0, nodes, names.count("sequenceFlow"))


def _mentions(scope: Scope, name: str) -> bool:
    """Return whether a condition of a process reads this variable."""
    return any(
        flow.condition is not None and name in flow.condition.names()
        for inner in scope.walk()
        for flow in inner.flows.values()
    )


def _handling_outcomes(scope: Scope) -> Scope:
    """Let the activities of a process that reads `outcome` complete with every outcome."""

    def handling(activity: Activity | None) -> Activity | None:
        return (
            replace(activity, handles_outcomes=True)
            if activity is not None and activity.spreads_outputs
            else activity
        )

    def changed(node: Node) -> Node:
        inner = None if node.scope is None else _handling_outcomes(node.scope)
        return replace(node, activity=handling(node.activity), scope=inner)

    return replace(scope, nodes={name: changed(node) for name, node in scope.nodes.items()})
