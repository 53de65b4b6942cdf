"""Any input is read, or refused as `BadBpmn`; what is read is a whole model."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lxml import etree

import handover_processes
from handover_bpmn.model import Kind, Scope
from handover_bpmn.notation.dialects import camunda7_elements, handover_elements, zeebe
from handover_bpmn.notation.document import BPMN
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import read_bpmn
from services.task_orchestrator.tests.unit.bpmn.notation.reading import extended, file
from services.task_orchestrator.tests.unit.drawing import end, flow, gateway, path, start

SHIPPED = (Path(handover_processes.__file__).parent / "processes" / "bin_picking.bpmn").read_bytes()

CAMUNDA = file(
    start()
    + extended(
        "serviceTask",
        "<camunda:inputOutput><camunda:inputParameter name='a'>${n}</camunda:inputParameter>"
        "<camunda:outputParameter name='b'><camunda:list><camunda:value>1</camunda:value></camunda:list>"
        "</camunda:outputParameter></camunda:inputOutput>"
        "<camunda:executionListener event='end' expression=\"${execution.setVariable('n', 1)}\"/>",
        attributes="camunda:topic='pick'",
        inner="<bpmn:multiInstanceLoopCharacteristics camunda:collection='${parts}'/>",
    )
    + gateway("g")
    + end()
    + path("start", "x", "g", "end")
    + flow("g", "x", "${n == 1}")
    + "<bpmn:subProcess id='s' triggeredByEvent='true'><bpmn:startEvent id='t'><bpmn:errorEventDefinition/>"
    "</bpmn:startEvent></bpmn:subProcess>"
)
ZEEBE = file(
    start()
    + extended(
        "callActivity",
        "<zeebe:calledElement processId='q'/><zeebe:ioMapping><zeebe:input source='=a' target='b.c'/>"
        "<zeebe:output source='=b' target='a'/></zeebe:ioMapping>",
    )
    + "<bpmn:receiveTask id='r' messageRef='m'/>"
    + end()
    + path("start", "x", "r", "end"),
    beside="<bpmn:message id='m' name='n'><bpmn:extensionElements><zeebe:subscription correlationKey='=k'/>"
    "</bpmn:extensionElements></bpmn:message>",
)

NAMES = [
    *(kind.value for kind in Kind),
    *("process", "collaboration", "participant", "messageFlow", "message", "signal", "error", "lane"),
    *("laneSet", "sequenceFlow", "conditionExpression", "extensionElements", "transaction", "association"),
    *("dataObject", "dataObjectReference", "dataInputAssociation", "sourceRef", "targetRef", "script"),
    *("timerEventDefinition", "timeCycle", "timeDate", "timeDuration", "messageEventDefinition"),
    *("linkEventDefinition", "compensateEventDefinition", "conditionalEventDefinition", "condition"),
    *(
        "standardLoopCharacteristics",
        "multiInstanceLoopCharacteristics",
        "loopCardinality",
        "eventDefinitionRef",
    ),
]
EXTENSIONS = [
    *(
        f"{{{handover_elements.NAMESPACE}}}{name}"
        for name in ("task", "on", "process", "involves", "parameter")
    ),
    *(
        f"{{{camunda7_elements.NAMESPACES[0]}}}{name}"
        for name in (
            "inputOutput",
            "inputParameter",
            "formData",
            "formField",
            "in",
            "connector",
            "map",
            "list",
        )
    ),
    *(
        f"{{{zeebe.NAMESPACE}}}{name}"
        for name in ("ioMapping", "input", "output", "calledElement", "loopCharacteristics", "script")
    ),
]
ATTRIBUTES = [
    *("id", "name", "sourceRef", "targetRef", "attachedToRef", "messageRef", "processRef", "default", "type"),
    *("isExecutable", "triggeredByEvent", "calledElement", "source", "target", "expression", "definition"),
    *("dataObjectRef", "variable", "scriptFormat", "key", "isForCompensation", "processId", "value", "event"),
    f"{{{camunda7_elements.NAMESPACES[0]}}}topic",
    f"{{{camunda7_elements.NAMESPACES[0]}}}collection",
    f"{{{zeebe.NAMESPACE}}}x",
]
TEXTS = st.one_of(
    st.sampled_from(
        [
            "a",
            "b",
            "c",
            "p",
            "true",
            "false",
            "",
            "${a}",
            "${",
            "= a",
            "=",
            "a.b",
            "a-b",
            "PT5M",
            "R3/PT1M",
            "1",
        ]
    ),
    st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), max_size=12),
)
TAGS = st.one_of(st.sampled_from([f"{{{BPMN}}}{name}" for name in NAMES]), st.sampled_from(EXTENSIONS))
TREES = st.recursive(
    st.tuples(TAGS, st.dictionaries(st.sampled_from(ATTRIBUTES), TEXTS, max_size=4), TEXTS, st.just([])),
    lambda inner: st.tuples(
        TAGS,
        st.dictionaries(st.sampled_from(ATTRIBUTES), TEXTS, max_size=4),
        TEXTS,
        st.lists(inner, max_size=5),
    ),
    max_leaves=25,
)


def built(tree: tuple) -> etree._Element:  # type: ignore[type-arg]
    tag, attributes, text, inner = tree
    element = etree.Element(tag)
    for name, value in attributes.items():
        element.set(name, value)
    element.text = text
    element.extend(built(each) for each in inner)
    return element


def check(xml: bytes) -> None:
    """Read `xml`; each flow of what can be read connects two nodes of its scope."""
    refused: BadBpmn | None = None
    try:
        found = read_bpmn(xml)
    except BadBpmn as bad:
        refused = bad
    if refused is not None:
        assert refused.body()["faults"]
        return
    for definition in found.definitions:
        for scope in definition.scopes():
            check_scope(scope)


def check_scope(scope: Scope) -> None:
    for flow_ in scope.flows.values():
        assert flow_.source in scope.nodes
        assert flow_.target in scope.nodes
    for name, node in scope.nodes.items():
        assert node.id == name
        assert node.default is None or node.default in scope.flows
        assert node.kind is not Kind.BOUNDARY_EVENT or node.attached_to in scope.nodes
        assert node.kind is not Kind.CALL_ACTIVITY or node.call is not None or node.activity is not None
        assert node.kind is not Kind.SUB_PROCESS or node.scope is not None


@settings(deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(xml: bytes) -> None:
    check(xml)


@pytest.mark.nightly
@settings(
    deadline=None, max_examples=300, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
@given(st.lists(TREES, max_size=6), st.booleans())
def test_any_elements_are_read_or_refused(trees: list[tuple], is_process: bool) -> None:  # type: ignore[type-arg]
    root = etree.Element(f"{{{BPMN}}}definitions")
    parent = root
    if is_process:
        parent = etree.SubElement(root, f"{{{BPMN}}}process", id="p", isExecutable="true")
    parent.extend(built(tree) for tree in trees)
    check(etree.tostring(root))


@settings(deadline=None, max_examples=200)
@given(
    st.sampled_from([SHIPPED, CAMUNDA, ZEEBE]),
    st.lists(st.tuples(st.floats(0, 1), st.integers(0, 20), st.binary(max_size=6)), max_size=3),
)
def test_a_file_with_damaged_bytes_is_read_or_refused(
    xml: bytes, damages: list[tuple[float, int, bytes]]
) -> None:
    for place, length, bytes_ in damages:
        at = int(place * len(xml))
        xml = xml[:at] + bytes_ + xml[at + length :]
    check(xml)


@pytest.mark.nightly
@settings(deadline=None, max_examples=300)
@given(st.sampled_from([SHIPPED, CAMUNDA, ZEEBE]), st.data())
def test_a_file_with_changed_elements_is_read_or_refused(xml: bytes, data: st.DataObject) -> None:
    root = etree.fromstring(xml)
    for _ in range(data.draw(st.integers(1, 4))):
        elements = list(root.iter("{*}*"))
        element = data.draw(st.sampled_from(elements))
        other = data.draw(st.sampled_from(elements))
        match data.draw(st.sampled_from(["remove", "move", "copy", "attribute", "text", "tag"])):
            case "remove" if element.getparent() is not None:
                element.getparent().remove(element)
            case "move" if element not in other.iterancestors() and element is not other:
                other.append(element)
            case "copy":
                other.append(built((element.tag, dict(element.attrib), element.text, [])))
            case "attribute":
                names = sorted(
                    {*element.attrib, *data.draw(st.lists(st.sampled_from(ATTRIBUTES), max_size=1))}
                )
                if names:
                    element.set(data.draw(st.sampled_from(names)), data.draw(TEXTS))
            case "text":
                element.text = data.draw(TEXTS)
            case "tag":
                element.tag = data.draw(TAGS)
    check(etree.tostring(root))


def test_a_data_object_and_a_reference_to_another_may_have_the_same_id() -> None:
    data = '<bpmn:dataObject id="b"/><bpmn:dataObjectReference id="b" dataObjectRef="a"/>'
    (definition,) = read_bpmn(file(start() + data + end() + path("start", "end"))).definitions
    assert set(definition.scope.data_objects) == {"a", "b"}
