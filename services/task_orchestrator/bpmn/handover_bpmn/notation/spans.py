"""Spans: the parts of a process that reserve resources, read into the model.

`handover:reserve` is an attribute of a process, subprocess, lane or group, or an extension element of it.
Camunda Modeler has no attributes of other vendors: there it is an extension property of that name.

BPMN does not say which elements a group has. They are those that are drawn within it completely. Elements
within a subprocess belong to the group if the subprocess does.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from lxml import etree

from handover.messages import message
from handover_bpmn.languages import native
from handover_bpmn.languages.feel import read_feel
from handover_bpmn.languages.juel import read_template
from handover_bpmn.model import Node, Scope, Span, SpanKind, Value
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.base import attempt
from handover_bpmn.notation.dialects.handover_elements import NAMESPACE, check_reserve, reserve_elements
from handover_bpmn.notation.document import BPMN, children, extensions, local, text
from handover_bpmn.notation.elements import KINDS, referenced
from handover_bpmn.notation.faults import Findings
from handover_bpmn.spans import read_needs, spans_in_parallel_instances

_ATTRIBUTE = f"{{{NAMESPACE}}}reserve"
_PROPERTY = "handover:reserve"
_DI = "http://www.omg.org/spec/BPMN/20100524/DI"
_DC = "http://www.omg.org/spec/DD/20100524/DC"
_EXPRESSION = re.compile(r"[$#]\{")
_COMMA = re.compile(r",(?![^{}]*\})")
"""A comma that is not within `${…}`."""


@dataclass(frozen=True, slots=True)
class _Bounds:
    """The rectangle of a shape, on one plane of the diagram."""

    plane: etree._Element
    left: float
    top: float
    right: float
    bottom: float

    def contains(self, other: "_Bounds") -> bool:
        return (
            self.plane is other.plane
            and self.left <= other.left
            and self.top <= other.top
            and self.right >= other.right
            and self.bottom >= other.bottom
        )

    def meets(self, other: "_Bounds") -> bool:
        return (
            self.plane is other.plane
            and self.left < other.right
            and other.left < self.right
            and self.top < other.bottom
            and other.top < self.bottom
        )


def read_spans(container: etree._Element, nodes: Mapping[str, Node], context: Context) -> tuple[Span, ...]:
    """Return the spans among the `nodes` of a process or subprocess."""
    spans = []
    if _reserves(container):
        spans.append(_span(container, SpanKind.SCOPE, frozenset(nodes), context))
    for lane in _own_lanes(container):
        if _reserves(lane):
            listed = {text(reference) for reference in lane.iter(f"{{{BPMN}}}flowNodeRef")}
            spans.append(_span(lane, SpanKind.LANE, frozenset(listed & nodes.keys()), context))
    for group in _reserving_groups(container):
        members = _members(group, container)
        if members & nodes.keys():
            spans.append(_span(group, SpanKind.GROUP, frozenset(members & nodes.keys()), context))
    return tuple(span for span in spans if span.needs)


def check_spans(process: etree._Element, scope: Scope, findings: Findings) -> None:
    """Report the spans of a process that cannot be reserved, and groups without effect."""
    for span, node in spans_in_parallel_instances(scope):
        findings.fault(
            _element(process, span.id),
            message(
                "bpmn.reserve_in_parallel_instances",
                'it is within another reservation and within "{activity}", whose instances run in parallel; '
                "make the instances sequential, or remove the outer reservation",
                activity=node.name,
            ),
        )
    for group in _reserving_groups(process):
        _check_group(group, process, findings)


def _span(element: etree._Element, kind: SpanKind, members: frozenset[str], context: Context) -> Span:
    name = " ".join((element.get("name") or _category(element) or "").split())
    id_ = element.get("id") or ""
    return Span(
        id=id_,
        name=name or id_,
        kind=kind,
        needs=tuple(_needs(element, context.findings)),
        members=members,
        line=element.sourceline or 0,
    )


# What is reserved


def _reserves(element: etree._Element) -> bool:
    return (
        element.get(_ATTRIBUTE) is not None
        or any(True for _ in reserve_elements(element))
        or any(True for _ in _properties(element))
    )


def _properties(element: etree._Element) -> Iterator[str]:
    for extension in extensions(element):
        if local(extension) == "properties":
            for property_ in children(extension):
                if property_.get("name") == _PROPERTY:
                    yield property_.get("value") or ""


def _needs(element: etree._Element, findings: Findings) -> Iterator[Value]:
    written = element.get(_ATTRIBUTE)
    for texts in ([] if written is None else [written], _properties(element)):
        for text_ in texts:
            yield from _read(element, text_, findings)
    for extension in reserve_elements(element):
        check_reserve(extension, findings)
        expression = extension.get("expression")
        if expression is not None:
            yield from _expression(extension, expression, findings)
        else:
            yield from _read(extension, _as_text(extension), findings)


def _as_text(extension: etree._Element) -> str:
    role = extension.get("role")
    words = [extension.get("resource") or "", f"role:{role}" if role else ""]
    words += [f"skill:{skill}" for skill in (extension.get("skills") or "").split()]
    return " ".join(word for word in words if word)


def _expression(element: etree._Element, expression: str, findings: Findings) -> Iterator[Value]:
    read = attempt(element, lambda: Value(expression=native.read(expression)), None, findings)
    if read is not None:
        yield read


def _read(element: etree._Element, text_: str, findings: Findings) -> Iterator[Value]:
    text_ = text_.strip()
    if text_.startswith("="):
        parts = [text_]
    elif _EXPRESSION.search(text_):
        parts = [part.strip() for part in _COMMA.split(text_)]
    else:
        parts = [text_]
    for part in parts:
        value = attempt(element, lambda part=part: _value(part), None, findings)  # type: ignore[misc]
        if value is not None:
            yield value


def _value(part: str) -> Value:
    if part.startswith("="):
        return Value(expression=read_feel(part))
    if _EXPRESSION.search(part):
        return Value(expression=read_template(part))
    read_needs(part)
    return Value(part)


# Where


def _own_lanes(container: etree._Element) -> Iterator[etree._Element]:
    for lanes in children(container, "laneSet"):
        yield from lanes.iter(f"{{{BPMN}}}lane")


def _reserving_groups(container: etree._Element) -> Iterator[etree._Element]:
    """Yield the groups of the file: those in a collaboration are around elements of its processes too."""
    root = container.getroottree().getroot()
    for group in root.iter(f"{{{BPMN}}}group"):
        if _reserves(group):
            yield group


def _bounds(root: etree._Element) -> dict[str, _Bounds]:
    bounds: dict[str, _Bounds] = {}
    for shape in root.iter(f"{{{_DI}}}BPMNShape"):
        rectangle = shape.find(f"{{{_DC}}}Bounds")
        if rectangle is None:
            continue
        try:
            left, top, width, height = (float(rectangle.get(n) or "") for n in ("x", "y", "width", "height"))
        except ValueError:
            continue
        name = referenced(shape.get("bpmnElement") or "")
        bounds.setdefault(name, _Bounds(shape.getparent(), left, top, left + width, top + height))
    return bounds


def _drawn_nodes(process: etree._Element) -> Iterator[etree._Element]:
    for element in process.iter(f"{{{BPMN}}}*"):
        if local(element) in KINDS and element.get("id"):
            yield element


def _members(group: etree._Element, process: etree._Element) -> frozenset[str]:
    """Return the nodes of a process or subprocess that are drawn within a group."""
    bounds = _bounds(group.getroottree().getroot())
    around = bounds.get(group.get("id") or "")
    if around is None:
        return frozenset()
    inside: dict[str, etree._Element] = {}
    attached: dict[str, etree._Element] = {}
    for node in _drawn_nodes(process):
        drawn = bounds.get(node.get("id"))
        if node.get("attachedToRef") is not None:
            attached[node.get("id")] = node
        elif drawn is not None and around.contains(drawn):
            inside[node.get("id")] = node
    # A boundary event is drawn on the border of its activity.
    hosts = {name: referenced(node.get("attachedToRef")) for name, node in attached.items()}
    inside |= {name: node for name, node in attached.items() if hosts[name] in inside}
    return frozenset(
        name
        for name, node in inside.items()
        if not any(parent.get("id") in inside for parent in node.iterancestors())
    )


def _check_group(group: etree._Element, process: etree._Element, findings: Findings) -> None:
    bounds = _bounds(group.getroottree().getroot())
    around = bounds.get(group.get("id") or "")
    if around is None:
        findings.warn(
            group,
            message(
                "bpmn.group_not_drawn",
                "the group reserves nothing: the file has no drawing of it, so its elements are unknown",
            ),
        )
        return
    members = _members(group, process)
    if not any(around.contains(drawn) for name, drawn in bounds.items() if name != group.get("id")):
        findings.warn(group, message("bpmn.group_empty", "the group reserves nothing: no element is in it"))
    scopes = {_element(process, name).getparent().get("id") for name in members}
    if len(scopes) > 1:
        findings.fault(
            group,
            message(
                "bpmn.group_of_several_scopes",
                "the group reserves for elements of several subprocesses; draw it around whole subprocesses",
            ),
        )
    for node in _drawn_nodes(process):
        drawn = bounds.get(node.get("id"))
        is_partly = drawn is not None and around.meets(drawn) and not around.contains(drawn)
        is_outer = drawn is not None and drawn.contains(around)
        if is_partly and not is_outer and node.get("attachedToRef") is None:
            findings.warn(
                node,
                message(
                    "bpmn.partly_in_group",
                    'it is drawn within the group "{group}" only partly, so nothing is reserved for it',
                    group=group.get("id"),
                ),
            )


def _category(element: etree._Element) -> str | None:
    """Return the name of a group: the value of the category that it refers to."""
    reference = referenced(element.get("categoryValueRef") or "")
    if not reference:
        return None
    for value in element.getroottree().getroot().iter(f"{{{BPMN}}}categoryValue"):
        if value.get("id") == reference:
            return str(value.get("value") or "")
    return None


def _element(process: etree._Element, name: str) -> etree._Element:
    """Return the element with an id; the process itself if there is none."""
    root = process.getroottree().getroot()
    return next(
        (candidate for candidate in root.iter(f"{{{BPMN}}}*") if candidate.get("id") == name), process
    )
