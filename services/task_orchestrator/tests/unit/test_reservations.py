"""Reservations over a span of activities: held from the first to the last, and never a deadlock."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_datamodels.entities import TaskStatus
from handover_processes.allocation.agents import UNLIMITED, Agent, Agents
from handover_processes.process import interventions
from handover_processes.records.processes import Act, ActKind
from handover_processes.records.step import Step
from services.task_orchestrator.tests.unit.cell_driver import SharedCell, performer, urn
from services.task_orchestrator.tests.unit.drawing import boundary, drawing, end, flow, gateway, path, start


def agent(name: str, *roles: str, **values: Any) -> Agent:
    return Agent(urn(name), roles=frozenset(roles), **values)


CELL = {
    "a": agent("a", "robot", "mover"),
    "b": agent("b", "robot"),
    "c": agent("c", "tool", "mover"),
}
ACTIVITY_NEEDS = ["Device:a", "Device:b", "Device:c", "role:robot", "role:tool", "role:mover"]
SPAN_NEEDS = [
    *("Device:a", "Device:c", "role:robot", "role:mover"),
    *("Device:a, role:tool", "role:robot, role:robot", "role:robot, Device:c", "role:mover, role:robot"),
]


def work(name: str, need: str) -> str:
    if need.startswith("role:"):
        task = f'<handover:task definition="{name}" role="{need[5:]}"/>'
    else:
        task = f'<handover:task definition="{name}"><handover:involves resource="{need}"/></handover:task>'
    extensions = f"<bpmn:extensionElements>{task}</bpmn:extensionElements>"
    return f'<bpmn:serviceTask id="{name}">{extensions}</bpmn:serviceTask>'


@dataclass
class Drawn:
    """A piece of a drawing with one way in and one way out, and where its nodes are drawn."""

    body: str
    first: str
    last: str
    nodes: list[tuple[str, int, int]] = field(default_factory=list)
    """The nodes of this scope, each with the first and last column of its shape."""
    groups: list[tuple[str, int, int, int]] = field(default_factory=list)
    """Needs, columns and depth of groups."""
    shapes: list[tuple[str, int, int, int]] = field(default_factory=list)


def draw(shape: Any, numbers: Iterator[int], depth: int = 0) -> Drawn:
    kind, *parts = shape
    number = next(numbers)
    name = f"{kind}{number}"

    def node(named: str, body: str) -> Drawn:
        column = next(numbers)
        return Drawn(body, named, named, [(named, column, column)], [], [(named, column, column, depth)])

    def joined(*pieces: Drawn, body: str, first: str, last: str) -> Drawn:
        return Drawn(
            body,
            first,
            last,
            [each for piece in pieces for each in piece.nodes],
            [each for piece in pieces for each in piece.groups],
            [each for piece in pieces for each in piece.shapes],
        )

    if kind == "do":
        return node(name, work(name, parts[0]))
    if kind == "then":
        one, other = (draw(part, numbers, depth) for part in parts)
        body = one.body + other.body + flow(one.last, other.first)
        return joined(one, other, body=body, first=one.first, last=other.last)
    if kind == "both":
        split = node(f"{name}_split", gateway(f"{name}_split", "parallel"))
        one, other = (draw(part, numbers, depth) for part in parts)
        join = node(f"{name}_join", gateway(f"{name}_join", "parallel"))
        body = split.body + one.body + other.body + join.body
        for each in (one, other):
            body += flow(split.first, each.first) + flow(each.last, join.first)
        return joined(split, one, other, join, body=body, first=split.first, last=join.last)
    if kind == "group":
        needs, low, high, inner = parts
        piece = draw(inner, numbers, depth)
        ends = sorted((low % len(piece.nodes), high % len(piece.nodes)))
        left, right = piece.nodes[ends[0]][1], piece.nodes[ends[1]][2]
        piece.groups.append((needs, left, right, depth))
        return piece
    assert kind == "sub"
    needs, inner = parts
    left = next(numbers)
    piece = draw(inner, numbers, depth + 1)
    right = next(numbers)
    content = start(f"{name}in") + piece.body + end(f"{name}out")
    content += flow(f"{name}in", piece.first) + flow(piece.last, f"{name}out")
    reserve = f' handover:reserve="{needs}"' if needs else ""
    body = f'<bpmn:subProcess id="{name}"{reserve}>{content}</bpmn:subProcess>'
    shapes = [*piece.shapes, (name, left, right, depth)]
    return Drawn(body, name, name, [(name, left, right)], piece.groups, shapes)


def bounds(name: str, left: int, right: int, depth: int, margin: int) -> str:
    edge = margin + 5 * (20 - depth)
    return (
        f'<di:BPMNShape id="{name}_shape" bpmnElement="{name}"><dc:Bounds x="{1000 * left - edge}" '
        f'y="{-edge}" width="{1000 * (right - left) + 2 * edge}" height="{2 * edge}"/></di:BPMNShape>'
    )


def file_of(shape: Any, name: str, lane: tuple[str, list[int]] | None = None) -> bytes:
    drawn = draw(shape, count(1))
    body = start() + drawn.body + end() + flow("start", drawn.first) + flow(drawn.last, "end")
    if lane is not None:
        needs, chosen = lane
        members = {drawn.nodes[each % len(drawn.nodes)][0] for each in chosen}
        listed = "".join(f"<bpmn:flowNodeRef>{each}</bpmn:flowNodeRef>" for each in sorted(members))
        lane_body = f'<bpmn:lane id="lane" handover:reserve="{needs}">{listed}</bpmn:lane>'
        body += f"<bpmn:laneSet>{lane_body}</bpmn:laneSet>"
    shapes = "".join(bounds(*each, margin=0) for each in drawn.shapes)
    for number, (needs, left, right, depth) in enumerate(drawn.groups):
        body += f'<bpmn:group id="group{number}" handover:reserve="{needs}"/>'
        shapes += bounds(f"group{number}", left, right, depth, margin=2)
    xml = drawing(body, name=name).decode()
    diagram = (
        '<di:BPMNDiagram xmlns:di="http://www.omg.org/spec/BPMN/20100524/DI" '
        f'xmlns:dc="http://www.omg.org/spec/DD/20100524/DC"><di:BPMNPlane>{shapes}</di:BPMNPlane></di:BPMNDiagram>'
    )
    return xml.replace("</bpmn:definitions>", f"{diagram}</bpmn:definitions>").encode()


NEEDS = st.sampled_from(SPAN_NEEDS)
SHAPES = st.recursive(
    st.tuples(st.just("do"), st.sampled_from(ACTIVITY_NEEDS)),
    lambda inner: (
        st.tuples(st.just("then"), inner, inner)
        | st.tuples(st.just("both"), inner, inner)
        | st.tuples(st.just("sub"), NEEDS | st.just(""), inner)
        | st.tuples(st.just("group"), NEEDS, st.integers(0, 9), st.integers(0, 9), inner)
    ),
    max_leaves=6,
)
LANES = st.none() | st.tuples(NEEDS, st.lists(st.integers(0, 9), min_size=1, max_size=3))


@given(st.lists(st.tuples(SHAPES, LANES), min_size=1, max_size=3), st.data())
def test_all_processes_complete_and_nobody_works_for_two_holders(
    shapes: list[tuple[Any, Any]], data: st.DataObject
) -> None:
    files = [file_of(shape, f"p{number}", lane) for number, (shape, lane) in enumerate(shapes)]
    cell = SharedCell(*files, **CELL)
    for number in [*range(len(files)), *range(len(files))]:
        cell.start(f"p{number}")
    while opened := cell.open():
        held = cell.held()
        assert len({agent for _, agent in held}) == len(held), "an agent has two holders"
        holders = {agent.rpartition(":")[2]: name for name, agent in held}
        performers = [performer(task) for _, task in opened]
        assert len(set(performers)) == len(performers), "an agent has two Tasks"
        for name, task in opened:
            assert holders.get(performer(task), name) == name, "an agent works for another process"
        if data.draw(st.integers(0, 9)) == 0:
            cell.restart()
        name, task = opened[data.draw(st.integers(0, 99)) % len(opened)]
        cell.report_task(name, task)
    records = {name: process.record for name, process in cell.processes.items()}
    stuck = [
        f"{name}: {record.unallocated} {record.incidents}"
        for name, record in records.items()
        if record.status is not TaskStatus.COMPLETED
    ]
    assert not stuck, "\n".join(stuck)
    assert not cell.held()
    assert not cell.allocator.reservations.held
    assert not cell.allocator.reservations.waiting


def reserving(needs: str, *activities: str, name: str = "p", more: str = "") -> bytes:
    """Return a process with a subprocess that reserves `needs` for `activities` in sequence."""
    names = [each.partition(" ")[0] for each in activities]
    content = start("begin") + "".join(work(*each.split(" ", 1)) for each in activities) + end("finish")
    content += path("begin", *names, "finish")
    body = f'<bpmn:subProcess id="cell" name="Cell" handover:reserve="{needs}">{content}</bpmn:subProcess>'
    return drawing(start() + body + end() + path("start", "cell", "end") + more, name=name)


TWO_STEPS = reserving("role:robot", "scan role:robot", "pick role:robot")


def test_the_robot_that_scanned_picks_and_another_process_waits_for_a_robot() -> None:
    cell = SharedCell(TWO_STEPS, a=agent("a", "robot"), b=agent("b", "robot"))
    first, second, third = (cell.start("p") for _ in range(3))
    assert [cell.works(each) for each in (first, second, third)] == [{"scan": "a"}, {"scan": "b"}, {}]
    (waiting,) = cell.processes[third].record.unallocated
    assert waiting.reason == f"a is held by {first} since 2026-05-04T08:00:00Z; " + (
        f"b is held by {second} since 2026-05-04T08:00:01Z"
    )
    cell.report(second, "scan")
    cell.report(first, "scan")
    assert (cell.works(first), cell.works(second)) == ({"pick": "a"}, {"pick": "b"})
    cell.report(second, "pick")
    assert cell.works(third) == {"scan": "b"}
    assert cell.processes[third].record.reservations[0].agents == (urn("b"),)


def test_reservations_are_served_in_the_order_of_arrival_also_after_a_restart() -> None:
    cell = SharedCell(TWO_STEPS, a=agent("a", "robot"))
    names = [cell.start("p") for _ in range(4)]
    order = []
    while opened := cell.open():
        ((name, task),) = opened
        order.append(name)
        cell.restart()
        cell.report_task(name, task)
    assert order == [name for name in names for _ in range(2)]


def test_a_reservation_of_a_higher_priority_is_served_before_an_earlier_one() -> None:
    urgent = TWO_STEPS.replace(b"<handover:task ", b'<handover:task priority="${priority}" ')
    cell = SharedCell(urgent, a=agent("a", "robot"))
    first, usual, express = (cell.start("p", priority=priority) for priority in (50, 50, 90))
    order = []
    while opened := cell.open():
        ((name, task),) = opened
        order.append(name)
        cell.report_task(name, task)
    assert order == [first, first, express, express, usual, usual]


def test_a_fixed_robot_gets_one_task_at_a_time_and_a_person_all() -> None:
    body = start() + work("weld", "Device:a") + end() + path("start", "weld", "end")
    sign = start() + work("sign", "Person:ada") + end() + path("start", "sign", "end")
    ada = Agent("urn:ngsi-ld:Person:demo:ada", is_person=True, limit=UNLIMITED)
    cell = SharedCell(drawing(body), drawing(sign, name="q"), a=agent("a"))
    cell.allocator.rules.agents = Agents({**cell.allocator.rules.agents.by_id, ada.id: ada})
    first, second = cell.start("p"), cell.start("p")
    assert (cell.works(first), cell.works(second)) == ({"weld": "a"}, {})
    assert [each.reason for each in cell.processes[second].record.unallocated] == ["a is busy"]
    cell.report(first, "weld")
    assert cell.works(second) == {"weld": "a"}
    assert [cell.works(cell.start("q")) for _ in range(2)] == [{"sign": "ada"}] * 2


def test_a_reserved_robot_is_not_given_to_an_activity_of_another_process() -> None:
    plain = start() + work("weld", "Device:a") + end() + path("start", "weld", "end")
    cell = SharedCell(TWO_STEPS, drawing(plain, name="q"), a=agent("a", "robot"))
    first, other = cell.start("p"), cell.start("q")
    cell.report(first, "scan")
    assert cell.works(other) == {}
    cell.report(first, "pick")
    assert cell.works(other) == {"weld": "a"}


def test_cancel_and_an_error_that_leaves_the_span_release_the_robot() -> None:
    event = "<bpmn:errorEventDefinition/>"
    caught = boundary("failed", "cell", event) + work("tidy", "role:robot") + end("stop")
    caught += path("failed", "tidy", "stop")
    file = reserving("Device:a", "scan role:robot", "pick role:robot", more=caught)
    cell = SharedCell(file, a=agent("a", "robot"), b=agent("b", "robot"))
    first, second = cell.start("p"), cell.start("p")
    cell.report(first, "scan", "failed")
    assert cell.works(second) == {"scan": "a"}
    assert cell.works(first) == {"tidy": "b"}, "the span was left"
    third = cell.start("p")
    interventions.cancel(cell.processes[second], "Ada", Step(1), cell.now)
    cell.settle()
    assert cell.works(third) == {}, "the cancelled Task may still move the robot"
    (task,) = cell.processes[second].tasks.values()
    cell.report_task(second, task, "failed")
    assert cell.works(third) == {"scan": "a"}


def test_an_incident_keeps_the_robot_until_an_engineer_releases_it() -> None:
    cell = SharedCell(TWO_STEPS, a=agent("a", "robot"))
    first, second = cell.start("p"), cell.start("p")
    cell.report(first, "scan", "failed", reason="no part")
    cell.restart()
    assert cell.held() == [(first, urn("a"))]
    assert cell.works(second) == {}
    process = cell.processes[first]
    (held,) = process.record.reservations
    act = Act(cell.now, ActKind.RELEASE, "Ada", why="the gripper is empty")
    interventions.release_reservation(process, act, held.key, Step(1), cell.now)
    cell.settle()
    assert cell.works(second) == {"scan": "a"}
    assert process.record.acts == (replace(act, element="cell"),)
    (incident,) = process.record.incidents
    interventions.mend(process, Act(cell.now, ActKind.RETRY, "Ada"), incident.token, Step(1), cell.now)
    cell.settle()
    assert cell.works(first) == {}, "the next activity reserves again"
    cell.report(second, "scan")
    cell.report(second, "pick")
    assert cell.works(first) == {"scan": "a"}
    with pytest.raises(Problem) as unknown:
        interventions.release_reservation(process, act, "7.other", Step(1), cell.now)
    assert unknown.value.status == 404


def test_nested_spans_are_reserved_at_the_outermost_entry() -> None:
    inner = start("i") + work("weigh", "role:scale") + end("j") + path("i", "weigh", "j")
    nested = f'<bpmn:subProcess id="inner" handover:reserve="role:scale">{inner}</bpmn:subProcess>'
    outer = start("o") + work("scan", "role:robot") + nested + end("x") + path("o", "scan", "inner", "x")
    body = f'<bpmn:subProcess id="outer" handover:reserve="role:robot">{outer}</bpmn:subProcess>'
    scale_first = reserving("role:scale", "weigh role:scale", name="q")
    file = drawing(start() + body + end() + path("start", "outer", "end"))
    cell = SharedCell(file, scale_first, a=agent("a", "robot"), s=agent("s", "scale"))
    holder, waiting = cell.start("q"), cell.start("p")
    assert cell.held() == [(holder, urn("s"))], "the robot is not held while the scale is waited for"
    cell.report(holder, "weigh")
    assert sorted(cell.held()) == [(waiting, urn("a")), (waiting, urn("s"))]


def test_a_called_process_shares_what_its_caller_has_reserved_and_gets_no_more() -> None:
    call = '<bpmn:callActivity id="call" calledElement="{}"/>'
    caller = start() + call.format("p") + end() + path("start", "call", "end")
    reserve = '<bpmn:extensionElements><handover:reserve resource="Device:a"/></bpmn:extensionElements>'
    more = reserving("role:robot, role:scale", "weigh role:scale", name="q")
    cell = SharedCell(
        TWO_STEPS,
        more,
        drawing(reserve + caller, name="good"),
        drawing(reserve + start() + call.format("q") + end() + path("start", "call", "end"), name="bad"),
        a=agent("a", "robot"),
        b=agent("b", "robot"),
        s=agent("s", "scale"),
    )
    good, bad = cell.start("good"), cell.start("bad")
    assert cell.works(good) == {"call.scan": "a"}
    cell.restart()
    cell.report(good, "call.scan")
    assert cell.works(good) == {"call.pick": "a"}
    cell.report(good, "call.pick")
    (incident,) = cell.processes[bad].record.incidents
    assert "needs more than" in incident.reason
    assert cell.processes[good].record.status is TaskStatus.COMPLETED


def test_a_missing_variable_of_a_reservation_is_an_incident_that_can_be_mended() -> None:
    cell = SharedCell(reserving("${robot}", "scan role:robot"), a=agent("a", "robot"))
    name = cell.start("p")
    (incident,) = cell.processes[name].record.incidents
    assert "robot" in incident.reason
    act = Act(cell.now, ActKind.RETRY, "Ada", values={"robot": "Device:a"})
    interventions.mend(cell.processes[name], act, incident.token, Step(1), cell.now)
    assert cell.works(name) == {"scan": "a"}


def test_an_activity_without_a_performer_goes_to_the_agent_of_its_lane() -> None:
    member = "<bpmn:flowNodeRef>scan</bpmn:flowNodeRef>"
    lane = f'<bpmn:lane id="cell" handover:reserve="role:robot">{member}</bpmn:lane>'
    body = start() + '<bpmn:serviceTask id="scan"/><bpmn:userTask id="check"/>' + end()
    body += f"<bpmn:laneSet>{lane}</bpmn:laneSet>" + path("start", "scan", "check", "end")
    cell = SharedCell(drawing(body), a=agent("a", "robot"))
    name = cell.start("p")
    assert cell.works(name) == {"scan": "a"}
    cell.report(name, "scan")
    assert cell.works(name) == {"check": ""}
    assert not cell.held(), "no token can return to the lane"


def test_a_paused_process_keeps_what_it_holds_and_gives_up_its_place() -> None:
    cell = SharedCell(TWO_STEPS, a=agent("a", "robot"))
    first, second, third = (cell.start("p") for _ in range(3))
    interventions.pause(cell.processes[second], Act(cell.now, ActKind.PAUSE, "Ada"), Step(1), cell.now)
    cell.restart()
    cell.report(first, "scan")
    cell.report(first, "pick")
    assert (cell.works(second), cell.works(third)) == ({}, {"scan": "a"})
    interventions.resume_work(cell.processes[second], Act(cell.now, ActKind.RESUME, "Ada"), Step(1), cell.now)
    cell.report(third, "scan")
    cell.report(third, "pick")
    assert cell.works(second) == {"scan": "a"}
