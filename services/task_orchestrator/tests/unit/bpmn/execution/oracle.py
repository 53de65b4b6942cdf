"""SpiffWorkflow as an oracle: it runs the same block-structured process as our engine, from bare BPMN XML.

Its gateways merge tokens of earlier iterations of a loop, so a loop of gateways contains parallel and
inclusive blocks only within a subprocess, which is a workflow of its own there.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from itertools import count
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from lxml import etree
from SpiffWorkflow.bpmn.parser.BpmnParser import BpmnParser
from SpiffWorkflow.bpmn.script_engine import PythonScriptEngine, TaskDataEnvironment
from SpiffWorkflow.bpmn.specs.control import BoundaryEventSplit
from SpiffWorkflow.bpmn.specs.defaults import BoundaryEvent
from SpiffWorkflow.bpmn.specs.event_definitions import ErrorEventDefinition
from SpiffWorkflow.bpmn.specs.event_definitions.timer import TimerEventDefinition
from SpiffWorkflow.bpmn.workflow import BpmnWorkflow
from SpiffWorkflow.task import Task
from SpiffWorkflow.util.task import TaskState

from handover_bpmn.languages.native import read
from handover_bpmn.model import ErrorEvent, Flow, Kind, Node, Scope, StandardLoop
from handover_bpmn.timing.timers import due_at
from services.task_orchestrator.tests.unit.bpmn.execution.build import (
    after,
    boundary,
    catch,
    end,
    node,
    script,
    start,
    work,
)

BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"
CODE = "E"


@dataclass
class Block:
    """A part of a process with one way in and one way out, for both engines."""

    first: str
    last: str
    nodes: list[Node] = field(default_factory=list)
    xml: list[str] = field(default_factory=list)
    flows: list[Flow] = field(default_factory=list)

    def add(self, found: Node, content: str = "", **attributes: str) -> str:
        if found.default is not None:
            attributes["default"] = found.default
        listed = "".join(f" {name}={quoteattr(value)}" for name, value in attributes.items())
        self.nodes.append(found)
        self.xml.append(f'<{found.kind.value} id="{found.id}"{listed}>{content}</{found.kind.value}>')
        return found.id

    def include(self, *others: "Block") -> None:
        for other in others:
            self.nodes += other.nodes
            self.xml += other.xml
            self.flows += other.flows

    def connect(self, source: str, target: str, condition: str | None = None) -> None:
        expression = None if condition is None else read(condition)
        self.flows.append(Flow(f"{source}_{target}", source, target, expression))

    def scope(self) -> Scope:
        return Scope("p", {each.id: each for each in self.nodes}, {each.id: each for each in self.flows})

    def content(self) -> str:
        return "".join(self.xml) + "".join(_flow(each) for each in self.flows)


def _flow(flow: Flow) -> str:
    condition = ""
    if flow.condition is not None:
        condition = f"<conditionExpression>{escape(flow.condition.text)}</conditionExpression>"
    ends = f'sourceRef="{flow.source}" targetRef="{flow.target}"'
    return f'<sequenceFlow id="{flow.id}" {ends}>{condition}</sequenceFlow>'


def build(shape: Any, numbers: Iterator[int]) -> Block:
    """Build the block of a shape; its names are unique within `numbers`."""
    kind, *parts = shape
    name = f"{kind}{next(numbers)}"
    block = Block(name, name)
    match kind:
        case "do":
            block.add(work(name))
        case "script":
            text = f"s_{name} = v0 + {len(name)}"
            block.add(script(name, text), f"<script>{escape(text)}</script>")
        case "pause":
            block.add(catch(name, after("PT10M")), _timer())
        case "guarded" | "late":
            _build_boundary(block, name, is_error=kind == "guarded")
        case "then":
            first, second = (build(part, numbers) for part in parts)
            block.include(first, second)
            block.connect(first.last, second.first)
            block.first, block.last = first.first, second.last
        case "loop":
            _build_loop(block, name, build(parts[0], numbers))
        case "sub" | "repeat":
            _build_subprocess(block, name, build(parts[0], numbers), is_loop=kind == "repeat")
        case _:
            _build_branches(block, name, kind, [build(part, numbers) for part in parts])
    return block


def _timer() -> str:
    return "<timerEventDefinition><timeDuration>PT10M</timeDuration></timerEventDefinition>"


def _build_boundary(block: Block, name: str, *, is_error: bool) -> None:
    event = ErrorEvent(CODE) if is_error else after("PT10M")
    content = '<errorEventDefinition errorRef="error_E"/>' if is_error else _timer()
    block.add(work(name))
    block.add(boundary(f"{name}_event", name, event), content, attachedToRef=name)
    block.add(work(f"{name}_handler"))
    block.last = block.add(node(f"{name}_merge", Kind.EXCLUSIVE))
    block.connect(name, block.last)
    block.connect(f"{name}_event", f"{name}_handler")
    block.connect(f"{name}_handler", block.last)


def _build_loop(block: Block, name: str, body: Block) -> None:
    """A loop of gateways that runs its body twice."""
    block.include(body)
    for line in (f"c_{name} = 0", f"c_{name} = c_{name} + 1"):
        found = script(f"{name}_{'init' if line.endswith('= 0') else 'count'}", line)
        block.add(found, f"<script>{escape(line)}</script>")
    block.add(node(f"{name}_in", Kind.EXCLUSIVE))
    block.add(node(f"{name}_out", Kind.EXCLUSIVE, default=f"{name}_out_{name}_done"))
    block.add(node(f"{name}_done", Kind.EXCLUSIVE))
    block.connect(f"{name}_init", f"{name}_in")
    block.connect(f"{name}_in", body.first)
    block.connect(body.last, f"{name}_count")
    block.connect(f"{name}_count", f"{name}_out")
    block.connect(f"{name}_out", f"{name}_in", f"c_{name} < 2")
    block.connect(f"{name}_out", f"{name}_done")
    block.first, block.last = f"{name}_init", f"{name}_done"


def _build_subprocess(block: Block, name: str, body: Block, *, is_loop: bool) -> None:
    _enclose(body, f"{name}_start", f"{name}_end")
    loop, xml = None, ""
    if is_loop:
        loop = StandardLoop(read("v0 >= 0"), maximum=2)
        xml = (
            '<standardLoopCharacteristics loopMaximum="2">'
            "<loopCondition>v0 &gt;= 0</loopCondition></standardLoopCharacteristics>"
        )
    inner = body.scope()
    block.add(
        node(name, Kind.SUB_PROCESS, scope=Scope(name, inner.nodes, inner.flows), loop=loop),
        xml + body.content(),
    )


def _enclose(block: Block, first: str, last: str) -> None:
    block.add(start(first))
    block.add(end(last))
    block.connect(first, block.first)
    block.connect(block.last, last)


def _build_branches(block: Block, name: str, kind: str, branches: list[Block]) -> None:
    gateway = {"either": Kind.EXCLUSIVE, "both": Kind.PARALLEL, "any": Kind.INCLUSIVE}[kind]
    first, *others = branches
    default = None if kind == "both" else f"{name}_in_{branches[-1].first}"
    block.include(*branches)
    block.add(node(f"{name}_in", gateway, default=default))
    block.add(node(f"{name}_out", gateway))
    conditions = {"both": None, "either": "v0 > 0", "any": "v0 > 0"}
    block.connect(f"{name}_in", first.first, conditions[kind])
    for number, other in enumerate(others, start=1):
        is_default = other is branches[-1]
        block.connect(f"{name}_in", other.first, None if is_default or kind == "both" else f"v{number} > 0")
    for branch in branches:
        block.connect(branch.last, f"{name}_out")
    block.first, block.last = f"{name}_in", f"{name}_out"


def whole(shape: Any) -> Block:
    """Return the process of a shape; its conditions use the variables v0, v1 and v2."""
    block = build(shape, count(1))
    _enclose(block, "start", "end")
    return block


class _Timer(TimerEventDefinition):  # type: ignore[misc]
    """A timer with the clock of the oracle."""

    clock: "Oracle"

    def has_fired(self, my_task: Task) -> bool:
        due = my_task.internal_data.setdefault("due", due_at("PT10M", self.clock.now))
        if due <= self.clock.now:
            my_task.internal_data["event_fired"] = True
        return bool(my_task.internal_data.get("event_fired", False))

    def reset(self, my_task: Task) -> None:
        my_task.internal_data.pop("due", None)
        super().reset(my_task)


class Oracle:
    """The run of a block in SpiffWorkflow."""

    def __init__(self, block: Block, variables: dict[str, Any], now: datetime) -> None:
        self.now = now
        parser = BpmnParser()
        parser.add_bpmn_xml(
            etree.fromstring(
                f'<definitions xmlns="{BPMN}" targetNamespace="x"><error id="error_E" errorCode="{CODE}"/>'
                f'<process id="p" isExecutable="true">{block.content()}</process></definitions>'
            )
        )
        spec, inner = parser.get_spec("p"), parser.get_subprocess_specs("p")
        for each in (spec, *inner.values()):
            for found in each.task_specs.values():
                if isinstance(getattr(found, "event_definition", None), TimerEventDefinition):
                    found.event_definition = _Timer(found.name, "PT10M")
                    found.event_definition.clock = self
        self._workflow = BpmnWorkflow(spec, inner, script_engine=PythonScriptEngine(TaskDataEnvironment()))
        self._workflow.task_tree.data = dict(variables)
        self._advance()

    def _advance(self) -> None:
        self._workflow.refresh_timers()
        self._workflow.do_engine_steps()
        self._workflow.refresh_timers()
        self._workflow.do_engine_steps()

    def _tasks(self) -> list[Task]:
        return [each for each in self._workflow.get_tasks(state=TaskState.READY) if each.task_spec.manual]

    def _task(self, name: str) -> Task:
        return next(each for each in self._tasks() if each.task_spec.name == name)

    @property
    def open(self) -> list[str]:
        return sorted(each.task_spec.name for each in self._tasks())

    @property
    def done(self) -> bool:
        return bool(self._workflow.is_completed())

    @property
    def variables(self) -> dict[str, Any]:
        return dict(self._workflow.data)

    def complete(self, name: str, **results: Any) -> None:
        found = self._task(name)
        found.data.update(results)
        found.run()
        self._advance()

    def fail(self, name: str) -> None:
        found = self._task(name)
        assert isinstance(found.parent.task_spec, BoundaryEventSplit)
        (catcher,) = [
            each
            for each in found.parent.children
            if isinstance(each.task_spec, BoundaryEvent)
            and isinstance(each.task_spec.event_definition, ErrorEventDefinition)
        ]
        catcher.internal_data["event_fired"] = True
        catcher.task_spec._update(catcher)
        self._advance()

    def wait(self, now: datetime) -> None:
        self.now = now
        self._advance()
