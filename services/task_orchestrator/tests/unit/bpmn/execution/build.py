"""Builds processes for tests of the engine, and drives them."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import Any

from handover_bpmn.definitions import Definitions
from handover_bpmn.execution.run import Run
from handover_bpmn.languages.native import read, read_script
from handover_bpmn.model import (
    Activity,
    Assignment,
    Call,
    Definition,
    Event,
    Flow,
    Kind,
    MessageEvent,
    Node,
    Scope,
    SignalEvent,
    TimerEvent,
    TimerType,
    Value,
)

NOW = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)


def node(name: str, kind: Kind, **changes: Any) -> Node:
    return Node(name, kind, name, **changes)


def start(name: str = "start", event: Event | None = None, **changes: Any) -> Node:
    return node(name, Kind.START_EVENT, event=event, **changes)


def end(name: str = "end", event: Event | None = None) -> Node:
    return node(name, Kind.END_EVENT, event=event)


def work(name: str, **changes: Any) -> Node:
    """An activity for a performer; each result becomes a variable."""
    activity = Activity(
        name, name, None, None, name, None, (), (), {}, {}, variable=name, spreads_outputs=True
    )
    return node(name, Kind.USER_TASK, activity=activity, **changes)


def script(name: str, text: str, **changes: Any) -> Node:
    lines = tuple(Assignment(target, Value(expression=value)) for target, value in read_script(text))
    return node(name, Kind.SCRIPT_TASK, script=lines, **changes)


def xor(name: str, default: str | None = None) -> Node:
    return node(name, Kind.EXCLUSIVE, default=default)


def parallel(name: str) -> Node:
    return node(name, Kind.PARALLEL)


def inclusive(name: str, default: str | None = None) -> Node:
    return node(name, Kind.INCLUSIVE, default=default)


def catch(name: str, event: Event) -> Node:
    return node(name, Kind.CATCH_EVENT, event=event)


def throw(name: str, event: Event | None, **changes: Any) -> Node:
    return node(name, Kind.THROW_EVENT, event=event, **changes)


def boundary(name: str, host: str, event: Event, *, interrupting: bool = True) -> Node:
    return node(name, Kind.BOUNDARY_EVENT, event=event, attached_to=host, interrupting=interrupting)


def sub(name: str, scope: Scope, **changes: Any) -> Node:
    return node(name, Kind.SUB_PROCESS, scope=replace(scope, id=name), **changes)


def event_sub(name: str, scope: Scope) -> Node:
    return sub(name, scope, triggered_by_event=True)


def call(name: str, process: str, **changes: Any) -> Node:
    return node(name, Kind.CALL_ACTIVITY, call=Call(Value(process), **changes))


def after(duration: str) -> TimerEvent:
    return TimerEvent(TimerType.DURATION, Value(duration))


def cycle(text: str) -> TimerEvent:
    return TimerEvent(TimerType.CYCLE, Value(text))


def message(name: str, correlation: str | None = None) -> MessageEvent:
    key = None if correlation is None else Value(expression=read(correlation))
    return MessageEvent(Value(name), key)


def signal(name: str) -> SignalEvent:
    return SignalEvent(Value(name))


def value(text: str) -> Value:
    return Value(expression=read(text))


def scope(*parts: Node | tuple[str, ...] | Flow, **changes: Any) -> Scope:
    """A scope of nodes and paths: a tuple of names is a chain of sequence flows `source_target`."""
    nodes = {part.id: part for part in parts if isinstance(part, Node)}
    flows = {part.id: part for part in parts if isinstance(part, Flow)}
    for part in parts:
        if isinstance(part, tuple):
            for source, target in pairwise(part):
                flows[f"{source}_{target}"] = Flow(f"{source}_{target}", source, target)
    return Scope("p", nodes, flows, **changes)


def when(source: str, target: str, condition: str) -> Flow:
    return Flow(f"{source}_{target}", source, target, read(condition))


def definition(content: Scope, name: str = "p") -> Definition:
    return Definition(name, name, None, None, {}, replace(content, id=name), b"")


class Driver:
    """A run that is restored from its snapshot before each step, as after a restart."""

    def __init__(
        self,
        content: Scope,
        *others: Definition,
        at: str | None = None,
        results: dict[str, Any] | None = None,
        **variables: Any,
    ) -> None:
        self.library = Definitions([definition(content), *others])
        self.now = NOW
        self.effects: list[Any] = []
        self.run = Run.start(self.library.plans["p"], variables, NOW, self.library, at=at, results=results)
        self.restore()

    def restore(self) -> None:
        self.effects += self.run.effects
        self.run = Run.resume(self.library.plans["p"], self.run.snapshot(), self.library)

    @property
    def open(self) -> list[str]:
        return sorted(each.element for each in self.run.open())

    def token(self, element: str) -> str:
        return next(each.token for each in self.run.open() if each.element == element)

    def incident(self, element: str) -> str:
        return next(each.token for each in self.run.incidents() if each.element == element)

    def complete(self, element: str, **results: Any) -> None:
        self.run.complete(self.token(element), results, self.now)
        self.restore()

    def fail(self, element: str, code: str | None = None, reason: str = "broken") -> bool:
        caught = self.run.fail(self.token(element), code, reason, self.now)
        self.restore()
        return caught

    def wait(self, **time: float) -> None:
        self.now += timedelta(**time)
        self.run.advance(self.now)
        self.restore()

    def deliver(self, name: str, **variables: Any) -> int:
        found = [each for each in self.run.subscriptions() if each.name == name]
        for each in found:
            self.run.deliver(each.wait, variables, self.now)
        self.restore()
        return len(found)

    def do(self, act: str, element: str, *arguments: Any) -> None:
        getattr(self.run, act)(self.incident(element), *arguments, self.now)
        self.restore()

    @property
    def variables(self) -> dict[str, Any]:
        return self.run.variables()

    @property
    def done(self) -> bool:
        return self.run.completed
