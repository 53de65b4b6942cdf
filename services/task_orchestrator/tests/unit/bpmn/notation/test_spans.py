"""Spans that reserve resources: where they are, what they reserve, and what cannot be reserved."""

import pytest

from handover_bpmn.model import Definition, Span
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import read_bpmn
from handover_bpmn.spans import Need, evaluated_needs, find_unions, read_needs
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, gateway, path, start

DI = 'xmlns:di="http://www.omg.org/spec/BPMN/20100524/DI" xmlns:dc="http://www.omg.org/spec/DD/20100524/DC"'
STEPS = start() + activity("a") + activity("b") + activity("c") + end() + path("start", "a", "b", "c", "end")


def read(
    body: str, *, beside: str = "", shapes: dict[str, tuple[int, int, int, int]] | None = None
) -> Definition:
    drawn = "".join(
        f'<di:BPMNShape bpmnElement="{name}">'
        f'<dc:Bounds x="{x}" y="{y}" width="{w}" height="{h}"/></di:BPMNShape>'
        for name, (x, y, w, h) in (shapes or {}).items()
    )
    diagram = f"<di:BPMNDiagram {DI}><di:BPMNPlane>{drawn}</di:BPMNPlane></di:BPMNDiagram>" if shapes else ""
    xml = (
        drawing(body, beside=beside).decode().replace("</bpmn:definitions>", f"{diagram}</bpmn:definitions>")
    )
    (definition,) = read_bpmn(xml.encode()).definitions
    return definition


def spans(definition: Definition) -> dict[str, Span]:
    return {span.id: span for scope in definition.scopes() for span in scope.spans}


def group(*attributes: str, content: str = "", name: str = "cell") -> str:
    return f'<bpmn:group id="{name}" {" ".join(attributes)}>{content}</bpmn:group>'


RESERVE = 'handover:reserve="Device:ur10-1"'
A_AND_B = {"a": (0, 0, 10, 10), "b": (20, 0, 10, 10), "c": (90, 0, 10, 10), "cell": (-1, -1, 40, 20)}


@pytest.mark.parametrize(
    ("text", "needs"),
    [
        ("Device:ur10-1", [Need("Device:ur10-1")]),
        ("role:picker skill:grip skill:place", [Need(None, "picker", ("grip", "place"))]),
        ("Device:ur10-1, skill:weigh", [Need("Device:ur10-1"), Need(None, None, ("weigh",))]),
    ],
)
def test_a_text_names_resources_roles_and_skills(text: str, needs: list[Need]) -> None:
    assert list(read_needs(text)) == needs
    assert ", ".join(need.described for need in needs) == text


@pytest.mark.parametrize("text", ["", " , ", "robot", "Device:ur10-1 role:picker", "role:a role:b", "skill:"])
def test_a_text_that_names_nothing_is_a_fault(text: str) -> None:
    with pytest.raises(BadBpmn) as refused:
        read(start() + end() + path("start", "end") + f'<bpmn:subProcess id="s" handover:reserve="{text}"/>')
    assert refused.value.faults[0].element == "s"


def test_the_members_of_a_group_are_drawn_within_it_completely() -> None:
    late = '<bpmn:boundaryEvent id="late" attachedToRef="b"><bpmn:errorEventDefinition/></bpmn:boundaryEvent>'
    body = STEPS + late + end("stop") + path("late", "stop") + group(RESERVE)
    shapes = {**A_AND_B, "b": (20, 0, 15, 10), "late": (34, 5, 8, 8), "stop": (37, 0, 8, 8)}
    definition = read(body, shapes=shapes)
    assert spans(definition)["cell"].members == {"a", "b", "late"}
    partly = [warning for warning in definition.warnings if warning.element == "stop"]
    assert "only partly" in partly[0].message


def test_a_group_around_a_subprocess_has_the_subprocess_as_its_member() -> None:
    inner = start("s1") + activity("x") + end("e1") + path("s1", "x", "e1")
    body = (
        start() + f'<bpmn:subProcess id="sub">{inner}</bpmn:subProcess>' + end() + path("start", "sub", "end")
    )
    shapes = {"cell": (0, 0, 100, 100), "sub": (10, 10, 80, 80), "x": (20, 20, 5, 5)}
    assert spans(read(body + group(RESERVE), shapes=shapes))["cell"].members == {"sub"}
    crossing = {**shapes, "cell": (0, 0, 40, 100), "start": (1, 1, 5, 5)}
    with pytest.raises(BadBpmn) as refused:
        read(body + group(RESERVE), shapes=crossing)
    assert "several subprocesses" in refused.value.faults[0].message


def test_a_group_without_a_drawing_reserves_nothing_and_is_a_warning() -> None:
    definition = read(STEPS + group(RESERVE))
    assert spans(definition) == {}
    assert [warning.element for warning in definition.warnings] == ["cell"]
    empty = read(STEPS + group(RESERVE), shapes={"cell": (500, 500, 5, 5), "a": (0, 0, 5, 5)})
    assert "no element is in it" in empty.warnings[0].message


def test_a_group_in_a_collaboration_and_an_extension_property_are_read() -> None:
    properties = (
        '<c:properties><c:property name="handover:reserve" value="${robot}, role:tool"/></c:properties>'
    )
    content = f"<bpmn:extensionElements>{properties}</bpmn:extensionElements>"
    camunda = 'xmlns:c="http://camunda.org/schema/1.0/bpmn"'
    pool = '<bpmn:participant id="pool" processRef="p"/>'
    beside = f'<bpmn:collaboration id="co">{pool}{group(camunda, content=content)}</bpmn:collaboration>'
    span = spans(read(STEPS, beside=beside, shapes=A_AND_B))["cell"]
    assert evaluated_needs(span, {"robot": "Device:ur10-2"}) == (Need("Device:ur10-2"), Need(None, "tool"))


def test_extension_elements_and_lanes_reserve() -> None:
    reserve = (
        '<bpmn:extensionElements><handover:reserve expression="robots"/>'
        '<handover:reserve role="picker" skills="grip place"/></bpmn:extensionElements>'
    )
    refs = "<bpmn:flowNodeRef>a</bpmn:flowNodeRef><bpmn:flowNodeRef>c</bpmn:flowNodeRef>"
    lane = f'<bpmn:laneSet><bpmn:lane id="robot" name="Robot">{reserve}{refs}</bpmn:lane></bpmn:laneSet>'
    definition = read(STEPS + lane)
    span = spans(definition)["robot"]
    assert (span.name, span.members, definition.warnings) == ("Robot", {"a", "c"}, ())
    needs = evaluated_needs(span, {"robots": ["Device:a", "Device:b"]})
    assert needs == (Need("Device:a"), Need("Device:b"), Need(None, "picker", ("grip", "place")))
    (union,) = find_unions(definition.scope)["p"]
    assert union.held == {"start", "a", "b", "c"}, "b leads back to the lane"
    assert union.entry == {"a", "c"}


@pytest.mark.parametrize("attributes", ["", 'resource="Device:a" role="x"', 'resource="Device:a" place="b"'])
def test_a_reserve_element_says_in_one_way_what_it_reserves(attributes: str) -> None:
    reserve = f"<bpmn:extensionElements><handover:reserve {attributes}/></bpmn:extensionElements>"
    with pytest.raises(BadBpmn):
        read(reserve + STEPS)


def test_groups_that_overlap_are_reserved_together_and_others_alone() -> None:
    other = group('handover:reserve="role:tool"', name="other")
    apart = {**A_AND_B, "other": (80, -5, 30, 30)}
    unions = find_unions(read(STEPS + group(RESERVE) + other, shapes=apart).scope)["p"]
    assert sorted(union.id for union in unions) == ["cell", "other"]
    across = {**A_AND_B, "other": (15, -5, 100, 30)}
    (union,) = find_unions(read(STEPS + group(RESERVE) + other, shapes=across).scope)["p"]
    assert union.entry == {"a", "b", "c"}


def test_a_join_within_a_group_makes_what_it_waits_for_part_of_the_extent() -> None:
    body = (
        start() + gateway("split", "parallel") + activity("a") + activity("b") + gateway("join", "parallel")
    )
    body += end() + path("start", "split", "a", "join", "end") + path("split", "b", "join") + group(RESERVE)
    shapes = {"a": (0, 0, 5, 5), "join": (10, 0, 5, 5), "b": (0, 50, 5, 5), "cell": (-1, -1, 20, 10)}
    (union,) = find_unions(read(body, shapes=shapes).scope)["p"]
    assert union.entry == {"a", "join"}
    assert "b" in union.extent


def test_a_reservation_in_parallel_instances_within_another_one_is_refused() -> None:
    count = "<bpmn:loopCardinality>2</bpmn:loopCardinality>"
    tag = "bpmn:multiInstanceLoopCharacteristics"
    many = f'<{tag} isSequential="{{}}">{count}</{tag}>'
    inner = start("s1") + activity("x") + end("e1") + path("s1", "x", "e1")
    sub = '<bpmn:subProcess id="sub" handover:reserve="role:tool">{}' + inner + "</bpmn:subProcess>"
    rest = start() + end() + path("start", "sub", "end")
    outer = f"<bpmn:extensionElements><handover:reserve resource='Device:a'/></bpmn:extensionElements>{rest}"
    assert spans(read(outer + sub.format(many.format("true")))).keys() == {"p", "sub"}
    assert spans(read(rest + sub.format(many.format("false")))).keys() == {"sub"}
    with pytest.raises(BadBpmn) as refused:
        read(outer + sub.format(many.format("false")))
    (fault,) = refused.value.faults
    assert (fault.element, "sequential" in fault.message) == ("sub", True)
