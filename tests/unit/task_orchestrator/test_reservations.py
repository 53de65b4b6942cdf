"""Reservations over a span of activities: held from the first to the last, and never a deadlock."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from datamodels.entities import TaskStatus
from services.task_orchestrator.allocation.agents import Agent
from tests.unit.task_orchestrator.cell_driver import SharedCell, performer, urn
from tests.unit.task_orchestrator.drawing import drawing, end, flow, gateway, start


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
        f'<di:BPMNShape id="{name}_shape" bpmnElement="{name}"><dc:Bounds x="{1000 * left - edge}" y="{-edge}" '
        f'width="{1000 * (right - left) + 2 * edge}" height="{2 * edge}"/></di:BPMNShape>'
    )


def file_of(shape: Any, name: str, lane: tuple[str, list[int]] | None = None) -> bytes:
    drawn = draw(shape, count(1))
    body = start() + drawn.body + end() + flow("start", drawn.first) + flow(drawn.last, "end")
    if lane is not None:
        needs, chosen = lane
        members = {drawn.nodes[each % len(drawn.nodes)][0] for each in chosen}
        listed = "".join(f"<bpmn:flowNodeRef>{each}</bpmn:flowNodeRef>" for each in sorted(members))
        body += f'<bpmn:laneSet><bpmn:lane id="lane" handover:reserve="{needs}">{listed}</bpmn:lane></bpmn:laneSet>'
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
    stuck = [
        f"{name}: {[(each.element, str(each.reason)) for each in (*record.unallocated, *record.incidents)]}"
        for name, record in ((name, process.record) for name, process in cell.processes.items())
        if record.status is not TaskStatus.COMPLETED
    ]
    assert not stuck, "\n".join(stuck)
    assert not cell.held()
    assert not cell.allocator.reservations.held
    assert not cell.allocator.reservations.waiting
