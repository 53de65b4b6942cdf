"""The structure of BPMN: definitions of a file, contents of a scope, pools and message flows."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from lxml import etree

from handover.messages import message
from handover_bpmn.model import REFUSED, Kind
from handover_bpmn.notation.document import children, flag, is_bpmn, local, namespace, text
from handover_bpmn.notation.faults import Findings

KINDS: Mapping[str, Kind] = {kind.value: kind for kind in Kind}

HARMLESS = frozenset(
    {
        *("documentation", "extensionElements", "laneSet", "textAnnotation", "association", "group"),
        *("dataObject", "dataObjectReference", "auditing", "monitoring", "property"),
        *("ioSpecification", "inputSet", "outputSet"),
    }
)
WITHOUT_EFFECT = frozenset(
    {
        *("dataStoreReference", "correlationSubscription", "supports", "resourceRole"),
        *("performer", "humanPerformer", "potentialOwner", "ioBinding", "rendering"),
        *("supportedInterfaceRef", "dataStore", "itemDefinition", "interface", "endPoint"),
        *("partnerEntity", "partnerRole", "correlationProperty", "import", "extension", "relationship"),
        *("choreography", "globalChoreographyTask", "conversation", "globalConversation", "category"),
        "globalScriptTask",
        *("conversationNode", "callConversation", "subConversation", "conversationLink", "correlationKey"),
        *("conversationAssociation", "participantAssociation", "messageFlowAssociation"),
        *("choreographyRef", "partnerEntityRef", "partnerRoleRef"),
    }
)
_GLOBAL_TASKS = frozenset({"globalTask", "globalUserTask", "globalManualTask", "globalBusinessRuleTask"})
_DEFINITIONS = frozenset(
    {
        *("process", "collaboration", "message", "error", "signal", "escalation"),
        *("documentation", "extensionElements"),
    }
)
_DIAGRAMS = frozenset({"http://www.omg.org/spec/BPMN/20100524/DI"})
_COLLABORATION = HARMLESS | {"participant", "messageFlow"}


def warn_without_effect(element: etree._Element, findings: Findings, what: str | None = None) -> None:
    """Add the warning that an element, or `what` of it, has no effect on the execution."""
    findings.warn(
        element,
        message("bpmn.no_effect", "{element} has no effect on the execution", element=what or local(element)),
    )


def warn_unknown_extension(element: etree._Element, findings: Findings) -> None:
    """Add the warning that an extension of an unknown vendor is ignored."""
    findings.warn(
        element,
        message(
            "bpmn.unknown_extension",
            'extensions of "{vendor}" are unknown here and have no effect',
            vendor=namespace(element),
        ),
    )


def refuse(element: etree._Element, what: str, way_out: str, findings: Findings) -> None:
    """Add the fault that something is not supported yet."""
    findings.fault(
        element,
        message("bpmn.not_supported", "{what} is not supported yet; {way_out}", what=what, way_out=way_out),
    )


def check_other(element: etree._Element, parent: str, findings: Findings) -> None:
    """Report an element that nothing else reads: without effect, of a vendor, or unknown."""
    name = local(element)
    if not is_bpmn(element):
        warn_unknown_extension(element, findings)
    elif name in HARMLESS:
        return
    elif name in WITHOUT_EFFECT:
        warn_without_effect(element, findings)
    else:
        refuse(element, f"{name} in a {parent}", "remove it", findings)


@dataclass
class Declarations:
    """What a file declares for all processes: messages, errors, signals, escalations, event definitions."""

    messages: dict[str, etree._Element] = field(default_factory=dict)
    errors: dict[str, etree._Element] = field(default_factory=dict)
    signals: dict[str, etree._Element] = field(default_factory=dict)
    escalations: dict[str, etree._Element] = field(default_factory=dict)
    event_definitions: dict[str, etree._Element] = field(default_factory=dict)
    resources: dict[str, str] = field(default_factory=dict)
    """Resource -> its name."""
    global_tasks: set[str] = field(default_factory=set)
    """Tasks that call activities may call instead of a process."""

    @classmethod
    def of(cls, root: etree._Element, findings: Findings) -> "Declarations":
        """Return the declarations of a file, and report what else its root has."""
        declared = cls()
        tables = {
            "message": declared.messages,
            "error": declared.errors,
            "signal": declared.signals,
            "escalation": declared.escalations,
        }
        for element in children(root):
            name = local(element)
            if is_bpmn(element) and name in tables:
                tables[name][element.get("id") or ""] = element
            elif is_bpmn(element) and name in _GLOBAL_TASKS:
                declared.global_tasks.add(element.get("id") or "")
            elif is_bpmn(element) and name.endswith("EventDefinition"):
                declared.event_definitions[element.get("id") or ""] = element
            elif is_bpmn(element) and name == "resource":
                declared.resources[element.get("id") or ""] = element.get("name") or ""
            elif not is_bpmn(element) and namespace(element) not in _DIAGRAMS:
                warn_unknown_extension(element, findings)
            elif is_bpmn(element) and name not in _DEFINITIONS:
                check_other(element, "definitions", findings)
        return declared


def referenced(reference: str) -> str:
    """Return the local part of a reference, which is a qualified name."""
    return reference.strip().rpartition(":")[2]


@dataclass
class Contents:
    """The elements of a process or subprocess."""

    nodes: list[tuple[etree._Element, Kind]] = field(default_factory=list)
    refused: list[etree._Element] = field(default_factory=list)
    flows: list[etree._Element] = field(default_factory=list)

    @classmethod
    def of(cls, container: etree._Element, findings: Findings) -> "Contents":
        """Return the contents of `container`, and report unknown elements."""
        contents = cls()
        for element in children(container):
            name = local(element)
            if not is_bpmn(element):
                warn_unknown_extension(element, findings)
            elif name in KINDS:
                contents.nodes.append((element, KINDS[name]))
            elif name == "sequenceFlow":
                contents.flows.append(element)
            elif name in REFUSED:
                contents.refused.append(element)
                refuse(element, name, REFUSED[name], findings)
            elif name in HARMLESS or name in WITHOUT_EFFECT:
                check_other(element, local(container), findings)
            elif name not in _NODE_PARTS:
                contents.refused.append(element)
                refuse(element, name, f"supported are {', '.join(KINDS)}", findings)
        return contents


_NODE_PARTS = frozenset(
    {
        *("incoming", "outgoing", "standardLoopCharacteristics", "multiInstanceLoopCharacteristics"),
        *("dataInputAssociation", "dataOutputAssociation"),
        *("resourceRole", "performer", "humanPerformer", "potentialOwner"),
    }
)
"""Children of a subprocess that belong to it as an activity."""


def data_object_of(reference: etree._Element) -> str:
    """Return the id of the data object that a data object reference stands for."""
    return referenced(reference.get("dataObjectRef") or "") or reference.get("id") or ""


def lanes(process: etree._Element) -> dict[str, str]:
    """Return the lane of each node; of nested lanes the innermost."""
    names: dict[str, str] = {}
    for lane in process.iter("{*}lane"):
        name = lane.get("name") or lane.get("id") or ""
        for reference in children(lane, "flowNodeRef"):
            names[text(reference)] = name
    return names


def executable_processes(
    root: etree._Element, findings: Findings, *, unless_denied: bool = False
) -> list[etree._Element]:
    """Return the processes that are to be run; the only process of a file need not say so.

    With `unless_denied` none of them needs to, as in Activiti, Flowable and jBPM.
    """
    processes = list(children(root, "process"))
    default = len(processes) == 1 or unless_denied
    executable = [process for process in processes if flag(process, "isExecutable", default=default)]
    if not executable:
        findings.fault(
            processes[0] if processes else root,
            message(
                "bpmn.no_executable_process",
                "no process of the {processes} in the file is executable; "
                'set isExecutable="true" at the one to run',
                processes=len(processes),
            ),
        )
    for process in processes:
        if process not in executable and executable:
            findings.warn(
                process,
                message(
                    "bpmn.not_executable",
                    'this process is not run; set isExecutable="true" if it should be',
                ),
            )
    return executable


@dataclass
class Collaboration:
    """Pools and message flows; `names` has the message name that each end of a message flow uses."""

    titles: dict[str, str] = field(default_factory=dict)
    """Process -> the name of its pool."""
    names: dict[str, str] = field(default_factory=dict)
    connected: set[str] = field(default_factory=set)
    """The ends of message flows between two nodes that both run."""

    @classmethod
    def of(
        cls,
        root: etree._Element,
        executable: list[etree._Element],
        declared: Declarations,
        findings: Findings,
    ) -> "Collaboration":
        """Return the collaboration of a file; message flows between other pools are warnings."""
        collaboration = cls()
        running = {
            node.get("id"): node
            for process in executable
            for node in process.iter("{*}*")
            if is_bpmn(node) and local(node) in KINDS
        }
        flows: list[etree._Element] = []
        for element in children(root, "collaboration"):
            for part in children(element):
                name = local(part)
                if is_bpmn(part) and name == "messageFlow":
                    flows.append(part)
                elif is_bpmn(part) and name == "participant":
                    process = referenced(part.get("processRef") or "")
                    collaboration.titles[process] = part.get("name") or ""
                elif not is_bpmn(part) or name not in _COLLABORATION:
                    check_other(part, "collaboration", findings)
        collaboration._read_flows(flows, running, declared, findings)
        return collaboration

    def _read_flows(
        self,
        flows: list[etree._Element],
        running: Mapping[str | None, etree._Element],
        declared: Declarations,
        findings: Findings,
    ) -> None:
        """Give the ends of message flows that are connected with each other one message name."""
        ends_of = [(flow, [end for end in map(referenced, _ends(flow)) if end in running]) for flow in flows]
        groups = _Groups()
        for flow, inside in ends_of:
            if len(inside) == 2:
                self.connected.update(inside)
                groups.join(*inside)
            else:
                findings.warn(
                    flow,
                    message(
                        "bpmn.message_flow_outside",
                        "the message flow has no effect, since one of its ends is not run here",
                    ),
                )
        members: dict[str, list[tuple[etree._Element, list[str]]]] = {}
        for flow, inside in ends_of:
            if inside:
                members.setdefault(groups.of(inside[0]), []).append((flow, inside))
        for group in members.values():
            self._name(group, running, declared, findings)

    def _name(
        self,
        members: list[tuple[etree._Element, list[str]]],
        running: Mapping[str | None, etree._Element],
        declared: Declarations,
        findings: Findings,
    ) -> None:
        own = {end: message_of(running[end], declared) for _, ends in members for end in ends}
        named = sorted({name for name in own.values() if name})
        flow = members[0][0]
        by_flow = declared.messages.get(referenced(flow.get("messageRef") or ""))
        derived = by_flow.get("name") if by_flow is not None else None
        chosen = named[0] if named else derived or flow.get("id") or "message"
        if len(named) > 1:
            findings.warn(
                flow,
                message(
                    "bpmn.different_messages",
                    "its ends have different messages ({names}), so nothing goes along this message flow; "
                    "use one message at both ends",
                    names=", ".join(named),
                ),
            )
        self.names.update({end: name or chosen for end, name in own.items()})


def _ends(flow: etree._Element) -> list[str]:
    return [flow.get("sourceRef") or "", flow.get("targetRef") or ""]


class _Groups:
    """Sets of nodes that are joined (union-find with path halving)."""

    def __init__(self) -> None:
        self._parents: dict[str, str] = {}

    def of(self, name: str) -> str:
        """Return the representative of the set of `name`."""
        while (parent := self._parents.get(name, name)) != name:
            self._parents[name] = name = self._parents.get(parent, parent)
        return name

    def join(self, first: str, other: str) -> None:
        """Join the sets of two nodes."""
        self._parents[self.of(first)] = self.of(other)


def message_of(node: etree._Element, declared: Declarations) -> str | None:
    """Return the name of the message that a node refers to, if it refers to one that has a name."""
    references = [node.get("messageRef")]
    references += [definition.get("messageRef") for definition in children(node, "messageEventDefinition")]
    for reference in references:
        declaration = declared.messages.get(referenced(reference or ""))
        if declaration is not None and declaration.get("name"):
            return str(declaration.get("name"))
    return None
