"""Activities: they begin, repeat, end, and pass their results on."""

from collections.abc import Mapping
from typing import Any

from handover.messages import message
from services.task_orchestrator.execution.compensation import record_completion, report
from services.task_orchestrator.execution.graph import Graph, Plan
from services.task_orchestrator.execution.machine import MAX_CALLS, Machine, ThrownMessage
from services.task_orchestrator.execution.navigation import leave
from services.task_orchestrator.execution.propagation import register_event_subprocesses
from services.task_orchestrator.execution.state import Frame, Loop, Token, TokenState
from services.task_orchestrator.execution.waits import add_wait
from services.task_orchestrator.languages.base import Json, Variables
from services.task_orchestrator.model import (
    Assignment,
    Call,
    MessageEvent,
    MultiInstance,
    Node,
    StandardLoop,
    Value,
)

MAX_INSTANCES = 10_000


def enter_activity(machine: Machine, token: Token, node: Node) -> None:
    """Begin an activity, or the loop that repeats it; raise `RunFailed` if it cannot begin."""
    if token.body is not None:
        _begin(machine, token, node)
        return
    with machine.failures(token):
        for boundary in machine.frame_of(token).graph.boundaries.get(node.id, ()):
            add_wait(machine, token, boundary)
    if node.loop is None:
        _begin(machine, token, node)
    else:
        token.state = TokenState.LOOP
        _start_loop(machine, token, node)


def finish(machine: Machine, token: Token, node: Node) -> None:
    """Pass the results of an activity or event on, and leave it; raise `RunFailed` if that is impossible."""
    if token.loop is not None:
        _finish_loop(machine, token, node)
    else:
        _pass_results(machine, token, node)
    if token.body is not None:
        _finish_instance(machine, machine.state.tokens[token.body], token, node)
        return
    machine.clear_waits(token)
    if token.compensates is not None:
        report(machine, token)
        return
    record_completion(machine.frame_of(token), token)
    leave(machine, token)


# Begin


def _begin(machine: Machine, token: Token, node: Node) -> None:
    frame = machine.frame_of(token)
    with machine.failures(token):
        token.local.update(_evaluated(node.inputs, machine.variables(token)))
    if node.activity is not None:
        open_work(machine, token)
    elif node.scope is not None:
        _enter_scope(machine, token, frame.graph.inner[node.id])
    elif node.call is not None:
        _call(machine, token, node.call)
    elif node.script is not None:
        _run_script(machine, token, node.script)
    elif isinstance(node.event, MessageEvent):
        _exchange_message(machine, token, node, node.event)
    else:
        machine.change_state(token, TokenState.FINISHING)


def open_work(machine: Machine, token: Token) -> None:
    """Open the activity of a token for a performer: its Task can be created."""
    element = machine.element(token)
    token.visit = machine.state.visits[element] = machine.state.visits.get(element, 0) + 1
    token.state = TokenState.WORK


def _enter_scope(machine: Machine, token: Token, graph: Graph) -> None:
    frame = machine.add_frame(graph, token, variables={})
    _start_frame(machine, token, frame)


def _start_frame(machine: Machine, token: Token, frame: Frame) -> None:
    with machine.failures(token):
        register_event_subprocesses(machine, frame)
    starts = frame.graph.starts
    for start in starts:
        machine.add_token(frame, start.id)
    if not starts:
        machine.discard_frame(frame)
        machine.change_state(token, TokenState.FINISHING)


def _call(machine: Machine, token: Token, call: Call) -> None:
    variables = machine.variables(token)
    if machine.frame_of(token).prefix.count(".") >= MAX_CALLS:
        raise machine.failure(
            token,
            message(
                "process.too_many_calls",
                "more than {limit} processes call each other; the call activities form a cycle",
                limit=MAX_CALLS,
            ),
        )
    with machine.failures(token):
        given: dict[str, Any] = dict(variables) if call.all_inputs else {}
        given.update(_evaluated(call.inputs, variables))
        plan = _called(machine, call, variables)
        given = plan.definition.arguments(given)
    frame = machine.add_frame(plan.graph, token, plan=plan, variables=given)
    _start_frame(machine, token, frame)


def _called(machine: Machine, call: Call, variables: Variables) -> Plan:
    name = call.process.value(variables)
    version = None if call.version is None else int(call.version.value(variables))
    tag = None if call.tag is None else str(call.tag.value(variables))
    return machine.library.find(str(name), version, tag)


def _run_script(machine: Machine, token: Token, script: tuple[Assignment, ...]) -> None:
    """Evaluate the assignments one after the other; each sees the variables that those before it set."""
    values: dict[str, Any] = {}
    with machine.failures(token):
        for line in script:
            values[line.target] = line.value.value({**machine.variables(token), **values})
    token.results = values
    machine.change_state(token, TokenState.FINISHING)


def _exchange_message(machine: Machine, token: Token, node: Node, event: MessageEvent) -> None:
    """Wait for the message of a receive task, or throw that of a send task."""
    if node.kind.value == "receiveTask":
        with machine.failures(token):
            add_wait(machine, token, node)
        token.state = TokenState.WAITING
        return
    throw_message(machine, token, event)
    machine.change_state(token, TokenState.FINISHING)


def throw_message(machine: Machine, token: Token, event: MessageEvent) -> None:
    """Send a message with the local variables of a token."""
    variables = machine.variables(token)
    with machine.failures(token):
        name = str(event.name.value(variables))
        key = None if event.correlation is None else event.correlation.value(variables)
    machine.effects.append(ThrownMessage(name, key, dict(token.local), machine.element(token)))


# Results


def _evaluated(assignments: tuple[Assignment, ...], variables: Variables) -> dict[str, Json]:
    return {each.target: each.value.value(variables) for each in assignments}


def _pass_results(machine: Machine, token: Token, node: Node) -> None:
    frame = machine.frame_of(token)
    results = token.results or {}
    if node.call is not None and token.results is not None:
        with machine.failures(token):
            mapped = _evaluated(node.call.outputs, results)
        results = {**results, **mapped} if node.call.all_outputs else mapped
    values = results
    if node.outputs:
        with machine.failures(token):
            values = _evaluated(node.outputs, {**machine.variables(token), **results})
    for association in node.data_outputs:
        owner = machine.data_owner(frame, association.data)
        owner[association.data] = results if association.name is None else results.get(association.name)
    token.results = None  # so that a retry does not overwrite what was mended meanwhile
    loop = node.loop
    if token.body is not None and isinstance(loop, MultiInstance) and loop.output_collection is not None:
        token.local.update(values)
    else:
        machine.set_variables(frame, values)


# Loops


def _start_loop(machine: Machine, token: Token, node: Node) -> None:
    if isinstance(node.loop, StandardLoop):
        token.loop = Loop(total=None)
        if node.loop.test_before and not _goes_on(machine, token, node.loop):
            machine.change_state(token, TokenState.FINISHING)
            return
        _start_instance(machine, token, {})
        return
    assert node.loop is not None  # noqa: S101 - the caller has checked it
    items = _items(machine, token, node.loop)
    token.loop = Loop(total=len(items), items=items)
    if node.loop.output_collection is not None:
        token.loop.outputs = [None] * len(items)
    _count_instances(token)
    if not items:
        machine.change_state(token, TokenState.FINISHING)
        return
    for _ in items[:1] if node.loop.sequential else items:
        _start_next(machine, token, node.loop)
    if not node.loop.sequential:
        token.loop.items = None  # each instance has its own


def _items(machine: Machine, token: Token, loop: MultiInstance) -> list[Json]:
    variables = machine.variables(token)
    with machine.failures(token):
        if loop.collection is not None:
            found = loop.collection.value(variables)
            if not isinstance(found, list):
                raise ValueError(f"the collection of a multi-instance activity is a list, not {found!r:.80}")
            items = list(found)
        else:
            items = list(range(_count(loop.cardinality or Value(0), variables)))
        if len(items) > MAX_INSTANCES:
            raise ValueError(f"an activity has at most {MAX_INSTANCES} instances, not {len(items)}")
    return items


def _count(cardinality: Value, variables: Mapping[str, Json]) -> int:
    found = cardinality.value(variables)
    if isinstance(found, str) and found.strip().isdecimal():
        found = int(found)
    if isinstance(found, float) and found.is_integer():
        found = int(found)
    if isinstance(found, bool) or not isinstance(found, int) or not 0 <= found <= MAX_INSTANCES:
        raise ValueError(f"the number of instances is 0 to {MAX_INSTANCES}, not {found!r:.80}")
    return found


def _start_next(machine: Machine, body: Token, loop: MultiInstance) -> None:
    assert body.loop is not None and body.loop.items is not None  # noqa: S101, PT018 - as `_start_loop` set
    item = body.loop.items[body.loop.started]
    _start_instance(machine, body, {} if loop.item_variable is None else {loop.item_variable: item})
    _count_instances(body)


def _start_instance(machine: Machine, body: Token, local: dict[str, Json]) -> None:
    assert body.loop is not None  # noqa: S101 - as `_start_loop` set
    instance = machine.add_token(machine.frame_of(body), body.node)
    instance.body, instance.index = body.id, body.loop.started
    instance.local = {**local, "loopCounter": body.loop.started}
    body.inner.append(instance.id)
    body.loop.started += 1


def _count_instances(body: Token) -> None:
    assert body.loop is not None  # noqa: S101 - as `_start_loop` set
    body.local.update(
        nrOfInstances=body.loop.total,
        nrOfActiveInstances=len(body.inner),
        nrOfCompletedInstances=body.loop.completed,
    )


def _finish_instance(machine: Machine, body: Token, instance: Token, node: Node) -> None:
    if isinstance(node.loop, StandardLoop):
        goes_on = _goes_on(machine, instance, node.loop)
        machine.remove(instance)
        if goes_on:
            _start_instance(machine, body, {})
        else:
            machine.change_state(body, TokenState.FINISHING)
        return
    loop = body.loop
    assert loop is not None and isinstance(node.loop, MultiInstance)  # noqa: S101, PT018 - the other kind
    completed = loop.completed + 1
    counts = {"nrOfActiveInstances": len(body.inner) - 1, "nrOfCompletedInstances": completed}
    with machine.failures(instance):
        variables = machine.variables(instance)
        output = None if node.loop.output_item is None else node.loop.output_item.value(variables)
        condition = node.loop.completion
        is_enough = condition is not None and bool(condition.value({**variables, **counts}))
    if loop.outputs is not None:
        loop.outputs[instance.index] = output
    loop.completed = completed
    machine.remove(instance)
    _count_instances(body)
    if is_enough or completed == loop.total:
        for other in list(body.inner):
            machine.remove(machine.state.tokens[other])
        machine.change_state(body, TokenState.FINISHING)
    elif node.loop.sequential:
        _start_next(machine, body, node.loop)


def _goes_on(machine: Machine, token: Token, loop: StandardLoop) -> bool:
    body = token if token.body is None else machine.state.tokens[token.body]
    started = 0 if body.loop is None else body.loop.started
    if loop.maximum is not None and started >= loop.maximum:
        return False
    if loop.condition is None:
        return loop.maximum is not None
    with machine.failures(token):
        return bool(loop.condition.value(machine.variables(token)))


def _finish_loop(machine: Machine, token: Token, node: Node) -> None:
    loop = token.loop
    if isinstance(node.loop, MultiInstance) and node.loop.output_collection is not None and loop is not None:
        machine.set_variables(machine.frame_of(token), {node.loop.output_collection: loop.outputs or []})
