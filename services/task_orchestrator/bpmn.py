"""BPMN: reads a file and reports all its faults at once, with element, line and rule.

Unsupported elements are refused by name, not ignored: a process never does less than its model. XML entities,
DOCTYPEs and network access are disabled, so a hostile file has no effect.
"""

import re
from collections.abc import Callable, Iterator
from datetime import UTC, datetime

from lxml import etree

from handover.messages import message, text_of
from services.task_orchestrator.bpmn_rules import faults_of_flow
from services.task_orchestrator.definition import (
    HANDED_OVER,
    BadBpmn,
    Definition,
    Fault,
    Flow,
    Kind,
    Node,
    Trigger,
)
from services.task_orchestrator.extension import (
    Findings,
    read_activity,
    read_process_extension,
)
from services.task_orchestrator.languages.native import ExpressionError, read, read_script
from services.task_orchestrator.timers import due_at, is_time
from services.task_orchestrator.xml_names import BPMN, MAX_BYTES, MAX_ELEMENTS, local, qualified

_ID = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]{0,63}", re.ASCII)

_DRAWING = {
    "textAnnotation",
    "association",
    "group",
    "dataObject",
    "dataObjectReference",
    "dataStoreReference",
}
_BESIDE = {"extensionElements", "documentation"}
_IN_DEFINITIONS = {"process", "collaboration", "error", *_BESIDE}
_IN_COLLABORATION = {"participant", *_DRAWING, *_BESIDE}
_IN_NODE = {"incoming", "outgoing", *_BESIDE}
_TRIGGERS = {
    Kind.START: {Trigger.NONE},
    Kind.END: {Trigger.NONE, Trigger.ERROR, Trigger.TERMINATE},
    Kind.CATCH: {Trigger.TIMER},
    Kind.THROW: {Trigger.NONE},
    Kind.BOUNDARY: {Trigger.TIMER, Trigger.ERROR},
}
_EVENTS = frozenset(_TRIGGERS)


def read_bpmn(xml: bytes) -> Definition:
    """Return the process of the BPMN file `xml`; raise `BadBpmn` with all faults."""
    return _Reading(_tree(xml), xml).definition()


def bare_process(definition: Definition, prefix: str) -> etree._Element:
    """Return the process without diagram and lanes; `prefix` is added to the ids of its nodes."""
    root = etree.fromstring(definition.xml, _parser())
    for child in list(root):
        if child.tag != qualified("error") and child.get("id") != definition.name:
            root.remove(child)
    process = root.find(qualified("process"))
    for child in list(process):
        if child.tag in {qualified("laneSet"), qualified("extensionElements")}:
            process.remove(child)
    for child in process:
        if child.get("id") in definition.nodes:
            child.set("id", prefix + child.get("id"))
        for reference in ("sourceRef", "targetRef", "attachedToRef"):
            if child.get(reference) is not None:
                child.set(reference, prefix + child.get(reference))
    return root


def _parser() -> etree.XMLParser:
    return etree.XMLParser(
        resolve_entities=False, no_network=True, huge_tree=False, load_dtd=False, dtd_validation=False
    )


def _tree(xml: bytes) -> etree._Element:
    if len(xml) > MAX_BYTES:
        raise BadBpmn(
            [
                Fault(
                    None,
                    None,
                    message(
                        "bpmn.too_large",
                        "a BPMN file has at most {limit} bytes, not {bytes}",
                        limit=MAX_BYTES,
                        bytes=len(xml),
                    ),
                )
            ]
        )
    try:
        root = etree.fromstring(xml, _parser())
    except (etree.XMLSyntaxError, ValueError) as error:
        line = getattr(error, "lineno", None)
        raise BadBpmn(
            [
                Fault(
                    None,
                    line,
                    message("bpmn.not_xml", "this is not well-formed XML: {error}", error=text_of(error)),
                )
            ]
        ) from None
    elements = sum(1 for _ in root.iter())
    if elements > MAX_ELEMENTS:
        raise BadBpmn(
            [
                Fault(
                    None,
                    None,
                    message(
                        "bpmn.too_many_elements",
                        "a BPMN file has at most {limit} elements, not {elements}",
                        limit=MAX_ELEMENTS,
                        elements=elements,
                    ),
                )
            ]
        )
    if root.getroottree().docinfo.doctype or root.getroottree().docinfo.internalDTD is not None:
        raise BadBpmn([Fault(None, 1, message("bpmn.doctype", "a DOCTYPE is not allowed; remove it"))])
    if root.tag != qualified("definitions"):
        raise BadBpmn(
            [
                Fault(
                    None,
                    root.sourceline,
                    message(
                        "bpmn.wrong_root",
                        "the root must be bpmn:definitions, not {root}",
                        root=local(root),
                    ),
                )
            ]
        )
    return root


class _Reading:
    """One pass over a file, with its elements and faults."""

    def __init__(self, root: etree._Element, xml: bytes) -> None:
        self.root = root
        self.xml = xml
        self.found = Findings()
        self.nodes: dict[str, Node] = {}
        self.flows: dict[str, Flow] = {}
        self.errors: dict[str, str | None] = {}
        self.ids: set[str] = set()

    def definition(self) -> Definition:
        process = self._process()
        if process is None:
            raise BadBpmn(self.found.faults)
        self._read_errors()
        name = self._id(process)
        if process.get("processType") not in {None, "None", "Public", "Private"}:
            self.found.fault(process, "processType is None, Public or Private")
        lanes = _lanes(process)
        elements = {}
        for element in _children(process):
            kind = self._kind(element)
            if kind is not None:
                node = self._read_node(element, kind)
                elements[node.id] = element
        self.found.faults += faults_of_flow(name, self.nodes, self.flows, process.sourceline or 0)
        activities = {}
        for node in self.nodes.values():
            if node.kind in HANDED_OVER:
                activity = read_activity(elements[node.id], lanes.get(node.id), self.found)
                if activity is not None:
                    activities[node.id] = activity
        label, parameters = read_process_extension(process, self.found)
        if self.found.faults:
            raise BadBpmn(sorted(self.found.faults, key=lambda fault: fault.line or 0))
        title = process.get("name") or name
        described = _documentation(process)
        return Definition(
            name=name,
            title=title,
            label=label,
            description=described,
            parameters=parameters,
            activities=activities,
            nodes=dict(self.nodes),
            flows=dict(self.flows),
            xml=self.xml,
        )

    def _process(self) -> etree._Element | None:
        for element in _children(self.root):
            if element.tag.startswith(f"{{{BPMN}}}") and local(element) not in _IN_DEFINITIONS:
                self.found.fault(element, f"{local(element)} is not supported yet; remove it")
        for collaboration in self.root.iterchildren(qualified("collaboration")):
            for element in _children(collaboration):
                if local(element) not in _IN_COLLABORATION:
                    self.found.fault(element, f"{local(element)} is not supported yet; remove it")
        processes = list(self.root.iterchildren(qualified("process")))
        executable = [p for p in processes if p.get("isExecutable", "true") == "true"]
        if len(executable) != 1:
            rule = f"a file has exactly one executable process, this one has {len(executable)}"
            self.found.fault(executable[1] if executable else self.root, f'{rule} (isExecutable="true")')
            return None
        return executable[0]

    def _read_errors(self) -> None:
        for error in self.root.iterchildren(qualified("error")):
            self.errors[self._id(error)] = error.get("errorCode") or None

    def _id(self, element: etree._Element) -> str:
        found = element.get("id") or ""
        if not _ID.fullmatch(found):
            self.found.fault(
                element,
                f"{local(element)} needs an id of A-Z, a-z, 0-9, - _ . (at most 64 characters)",
            )
        elif found in self.ids:
            self.found.fault(element, f'the id "{found}" is used twice')
        self.ids.add(found)
        return found

    def _kind(self, element: etree._Element) -> Kind | None:
        name = local(element)
        if element.tag == qualified(name):
            if name == "sequenceFlow":
                self._read_flow(element)
                return None
            if name in _DRAWING or name in _BESIDE or name == "laneSet":
                return None
            if name in {kind.value for kind in Kind}:
                return Kind(name)
        self.found.fault(element, f"{name} is not supported yet; supported are {_supported()}")
        return None

    def _read_flow(self, element: etree._Element) -> None:
        conditions = list(element.iterchildren(qualified("conditionExpression")))
        condition = (conditions[0].text or "").strip() if conditions else None
        flow = Flow(
            id=self._id(element),
            line=element.sourceline or 0,
            source=element.get("sourceRef") or "",
            target=element.get("targetRef") or "",
            condition=condition,
        )
        if condition is not None:
            self._check(element, lambda: read(condition))
        self.flows[flow.id] = flow

    def _read_node(self, element: etree._Element, kind: Kind) -> Node:
        trigger, event = self._trigger(element, kind)
        for child in _children(element):
            name = local(child)
            allowed = child.tag == qualified(name) and (
                name in _IN_NODE or child is event or (kind is Kind.SCRIPT and name == "script")
            )
            if not allowed:
                self.found.fault(element, f"{name} in a {kind.value} is not supported yet; remove it")
        if kind is Kind.SCRIPT:
            script = element.findtext(qualified("script")) or ""
            self._check(element, lambda: read_script(script))
            if not script.strip():
                self.found.fault(element, "a scriptTask needs a script of lines `name = expression`")
        if element.get("isForCompensation", "false") == "true":
            self.found.fault(element, "compensation is not supported yet; remove isForCompensation")
        node = Node(
            id=self._id(element),
            line=element.sourceline or 0,
            kind=kind,
            name=element.get("name") or element.get("id") or "",
            trigger=trigger,
            error_code=self._error_code(element, event) if trigger is Trigger.ERROR else None,
            attached_to=element.get("attachedToRef"),
            interrupting=element.get("cancelActivity", "true") == "true",
            default=element.get("default"),
        )
        if trigger is Trigger.TIMER and event is not None:
            self._read_timer(element, event)
        self.nodes[node.id] = node
        return node

    def _trigger(self, element: etree._Element, kind: Kind) -> tuple[Trigger, etree._Element | None]:
        if kind not in _EVENTS:
            return Trigger.NONE, None
        events = [child for child in _children(element) if local(child).endswith("EventDefinition")]
        if len(events) > 1:
            self.found.fault(element, "an event has one event definition at most")
        named = local(events[0]) if events else Trigger.NONE.value
        known = {trigger.value: trigger for trigger in _TRIGGERS[kind]}
        if named not in known:
            allowed = " or ".join(sorted(known))
            self.found.fault(
                element, f"a {kind.value} with {named} is not supported yet; supported: {allowed}"
            )
            return Trigger.NONE, events[0] if events else None
        return known[named], events[0] if events else None

    def _error_code(self, element: etree._Element, event: etree._Element | None) -> str | None:
        reference = event.get("errorRef") if event is not None else None
        if reference is None:
            return None
        if reference not in self.errors:
            self.found.fault(element, f'errorRef "{reference}" names no bpmn:error of this file')
            return None
        return self.errors[reference]

    def _read_timer(self, element: etree._Element, event: etree._Element) -> None:
        times = [child for child in _children(event) if local(child) in {"timeDuration", "timeDate"}]
        others = [child for child in _children(event) if child not in times]
        text = (times[0].text or "").strip() if len(times) == 1 else ""
        if others or not text:
            self.found.fault(
                element, "a timer has one timeDuration or one timeDate; a timeCycle is not supported yet"
            )
        elif is_time(text):
            self._check(element, lambda: due_at(text, datetime.now(UTC)))
        else:
            self._check(element, lambda: read(text))

    def _check(self, element: etree._Element, reading: Callable[[], object]) -> None:
        try:
            reading()
        except (ExpressionError, ValueError) as error:
            self.found.fault(element, str(error))


def _lanes(process: etree._Element) -> dict[str, str]:
    lanes: dict[str, str] = {}
    for lane in process.iter(qualified("lane")):
        for reference in lane.iterchildren(qualified("flowNodeRef")):
            lanes[(reference.text or "").strip()] = lane.get("name") or lane.get("id") or ""
    return lanes


def _children(element: etree._Element) -> Iterator[etree._Element]:
    yield from element.iterchildren("{*}*")


def _documentation(element: etree._Element) -> str | None:
    return (element.findtext(qualified("documentation")) or "").strip() or None


def _supported() -> str:
    return ", ".join(kind.value for kind in Kind)
