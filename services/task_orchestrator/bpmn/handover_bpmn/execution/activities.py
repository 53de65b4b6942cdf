"""Activities: they begin, repeat, end, and pass their results on."""

from collections import ChainMap
from collections.abc import Mapping
from typing import Any

from handover.errors import Problem
from handover.messages import Message, message
from handover_bpmn.execution.compensation import record_completion
from handover_bpmn.execution.graph import Graph, Plan
from handover_bpmn.execution.machine import MAX_CALLS, Machine, ThrownMessage, has_output_collection
from handover_bpmn.execution.navigation import take_flows
from handover_bpmn.execution.propagation import register_event_subprocesses
from handover_bpmn.execution.state import Frame, Loop, Token, TokenState
from handover_bpmn.execution.waits import add_wait
from handover_bpmn.languages.base import Json, Variables
from handover_bpmn.model import Assignment, Call, MessageEvent, MultiInstance, Node, StandardLoop, Value

MAX_INSTANCES = 10_000


def enter_activity(machine: Machine, token: Token, node: Node) -> None:
    """Begin an activity, or the loop that repeats it; raise `RunFailed` if it cannot begin."""
    if token.body is not None:
        _begin(machine, token, node)
        return
    boundaries = machine.frame_of(token).graph.boundaries.get(node.id)
    if boundaries:
        with machine.failures(token):
            for boundary in boundaries:
                add_wait(machine, token, boundary)
    if node.loop is None:
        _begin(machine, token, node)
    else:
        machine.change_state(token, TokenState.LOOP)
        _start_loop(machine, token, node)


def finish(machine: Machine, token: Token, node: Node) -> None:
    """Pass the results of a node on and leave it; raise `RunFailed` if that is impossible."""
    if token.loop is not None:
        _finish_loop(machine, token, node)
    else:
        _pass_results(machine, token, node)
        if token.compensates is None:
            record_completion(machine.frame_of(token), token)
    token.state = TokenState.LEAVING
    leave(machine, token, node)


def leave(machine: Machine, token: Token, node: Node) -> None:
    """Continue after a node whose results are passed on; raise `RunFailed` if that is impossible."""
    if token.body is not None:
        _finish_instance(machine, machine.state.tokens[token.body], token, node)
    elif token.compensates is not None:
        machine.remove(token)
    else:
        machine.state.clear_waits(token)
        take_flows(machine, token)


# Begin


def _begin(machine: Machine, token: Token, node: Node) -> None:
    if node.inputs:
        with machine.failures(token):
            token.local.update(_mapped(node.inputs, machine.variables(token)))
    if node.activity is not None:
        open_work(machine, token)
    elif node.scope is not None:
        _enter_scope(machine, token, machine.frame_of(token).graph.inner[node.id])
    elif node.call is not None:
        _call(machine, token, node.call)
    elif node.script is not None:
        _run_script(machine, token, node.script)
    elif isinstance(node.event, MessageEvent):
        _exchange_message(machine, token, node, node.event)
    else:
        token.state = TokenState.FINISHING


def open_work(machine: Machine, token: Token) -> None:
    """Open the activity of a token for a performer: its Task can be created."""
    element = machine.element(token)
    token.visit = machine.state.visits[element] = machine.state.visits.get(element, 0) + 1
    token.state = TokenState.WORK


def _enter_scope(machine: Machine, token: Token, graph: Graph) -> None:
    frame = machine.add_frame(graph, token, variables={})
    _start_frame(machine, token, frame)


def _start_frame(machine: Machine, token: Token, frame: Frame) -> None:
    if frame.graph.needs_event:
        raise machine.failure(token, no_plain_start(frame.scope))
    with machine.failures(token):
        register_event_subprocesses(machine, frame)
    starts = frame.graph.starts
    for start in starts:
        machine.add_token(frame, start.id)
    if not starts:
        machine.discard_frame(frame)
        token.state = TokenState.FINISHING


def no_plain_start(name: str) -> Message:
    """Return why the process or subprocess `name` cannot be started without an event."""
    return message(
        "process.no_plain_start",
        '"{definition}" starts with an event, so it cannot be started without it',
        definition=name,
    )


def _call(machine: Machine, token: Token, call: Call) -> None:
    if _call_depth(machine, token) >= MAX_CALLS:
        raise machine.failure(
            token,
            message(
                "process.too_many_calls",
                "more than {limit} processes call each other; the call activities form a cycle",
                limit=MAX_CALLS,
            ),
        )
    variables = machine.variables(token)
    try:
        with machine.failures(token):
            plan = called_plan(machine, call, variables)
            parameters = plan.definition.parameters
            passed: dict[str, Any] = {}
            if call.all_inputs:
                passed = {name: variables[name] for name in variables if not parameters or name in parameters}
            passed.update((_mapped if call.in_order else _evaluated)(call.inputs, variables))
            passed = plan.definition.arguments(passed)
            key = None if call.key is None else call.key.value(variables)
    except Problem as problem:
        raise machine.failure(token, problem.detail) from problem
    frame = machine.add_frame(plan.graph, token, plan=plan, variables=passed)
    frame.key = None if key is None else str(key)
    _start_frame(machine, token, frame)


def _call_depth(machine: Machine, token: Token) -> int:
    """Return how many call activities enclose a token."""
    depth = 0
    frame = machine.frame_of(token)
    while (host := machine.host(frame)) is not None:
        depth += frame.process is not None
        frame = machine.frame_of(host)
    return depth


def called_plan(machine: Machine, call: Call, variables: Variables) -> Plan:
    """Return the process that a call runs; raise `ExpressionError`, `ValueError` or `RunFailed`."""
    name = call.process.value(variables)
    version = None if call.version is None else _whole_number(call.version.value(variables))
    if call.version is not None and version is None:
        raise ValueError("the version of a called process is a number")
    tag = None if call.tag is None else str(call.tag.value(variables))
    return machine.library.find(str(name), version, tag)


def _whole_number(value: Json) -> int | None:
    if isinstance(value, str) and value.strip().isdecimal():
        return int(value)
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _run_script(machine: Machine, token: Token, script: tuple[Assignment, ...]) -> None:
    """Evaluate the assignments one after the other; each sees the variables that those before it set."""
    values: dict[str, Any] = {}
    variables = machine.variables(token)
    if len(script) > 1:
        variables = ChainMap(values, variables)
    with machine.failures(token):
        for line in script:
            values[line.target] = line.value.value(variables)
    token.results = values
    token.state = TokenState.FINISHING


def _exchange_message(machine: Machine, token: Token, node: Node, event: MessageEvent) -> None:
    """Wait for the message of a receive task, or throw that of a send task."""
    if node.kind.value == "receiveTask":
        with machine.failures(token):
            add_wait(machine, token, node)
        token.state = TokenState.WAITING
        return
    throw_message(machine, token, event)
    token.state = TokenState.FINISHING


def throw_message(machine: Machine, token: Token, event: MessageEvent) -> None:
    """Send a message with the local variables of a token."""
    variables = machine.variables(token)
    with machine.failures(token):
        name = str(event.name.value(variables))
        key = None if event.correlation is None else event.correlation.value(variables)
    machine.effects.append(ThrownMessage(name, key, dict(token.local), machine.element(token)))


# Results


def _evaluated(assignments: tuple[Assignment, ...], variables: Variables) -> dict[str, Json]:
    return {assignment.target: assignment.value.value(variables) for assignment in assignments}


def _mapped(assignments: tuple[Assignment, ...], variables: Variables) -> dict[str, Json]:
    """Return what mappings yield, in their order: each sees the values of those before it."""
    values: dict[str, Json] = {}
    visible = ChainMap(values, variables)  # type: ignore[arg-type]  # only the first is written to
    for assignment in assignments:
        values[assignment.target] = assignment.value.value(visible)
    return values


def _pass_results(machine: Machine, token: Token, node: Node) -> None:
    results = token.results
    if results is None and not node.outputs and not node.data_outputs:
        return
    results = unmapped = results or {}
    if node.call is not None:
        evaluate = _mapped if node.call.in_order else _evaluated
        with machine.failures(token):
            returned = evaluate(node.call.outputs, results)
        results = {**results, **returned} if node.call.all_outputs else returned
    values = results
    if node.outputs:
        with machine.failures(token):
            values = _mapped(node.outputs, ChainMap(results, machine.variables(token)))
    set_results(machine, token, node, values, unmapped=unmapped)
    frame = machine.frame_of(token)
    for association in node.data_outputs:
        owner = machine.data_owner(frame, association.data)
        owner[association.data] = results if association.name is None else results.get(association.name)
    token.results = None


def set_results(
    machine: Machine,
    token: Token,
    node: Node,
    values: Mapping[str, Any],
    *,
    unmapped: Mapping[str, Any] | None = None,
) -> None:
    """Set the variables that an activity yields: `values`, made from the results `unmapped`.

    An instance of a loop sees both in the output of its collection and in the condition of the loop. With an
    output collection its results stay local; what a mapping names and the output does not read is set
    outside.
    """
    if token.body is None:
        machine.set_variables(machine.frame_of(token), values)
        return
    outside = values
    if has_output_collection(node):
        assert isinstance(node.loop, MultiInstance)  # noqa: S101 - only it has one
        is_mapped = node.outputs or (node.call is not None and node.call.outputs)
        read = None if node.loop.output_item is None else node.loop.output_item.expression
        kept = frozenset() if read is None else read.names()
        names = {*values} - kept - {*token.local} if is_mapped else set()
        outside = {name: values[name] for name in names}
    token.local.update({**(unmapped or {}), **values})
    machine.set_variables(machine.frame_of(token), outside)


# Loops


def _start_loop(machine: Machine, token: Token, node: Node) -> None:
    if isinstance(node.loop, StandardLoop):
        token.loop = Loop(total=None)
        if node.loop.test_before and not _is_continued(machine, token, node.loop):
            token.state = TokenState.FINISHING
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
        token.state = TokenState.FINISHING
        return
    if not node.loop.sequential:
        machine.check_steps(token, len(machine.queue) + len(items))
    for _ in items[:1] if node.loop.sequential else items:
        _start_next(machine, token, node.loop)
    if not node.loop.sequential:
        token.loop.items = None  # each instance has its own


def _items(machine: Machine, token: Token, loop: MultiInstance) -> list[Json]:
    variables = machine.variables(token)
    with machine.failures(token):
        if loop.collection is not None:
            collection = loop.collection.value(variables)
            if not isinstance(collection, list):
                raise ValueError(
                    f"the collection of a multi-instance activity is a list, not {collection!r:.80}"
                )
            items = list(collection)
        else:
            items = list(range(_count(loop.cardinality or Value(0), variables)))
        if len(items) > MAX_INSTANCES:
            raise ValueError(f"an activity has at most {MAX_INSTANCES} instances, not {len(items)}")
    return items


def _count(cardinality: Value, variables: Mapping[str, Json]) -> int:
    number = cardinality.value(variables)
    count = _whole_number(number)
    if count is None or not 0 <= count <= MAX_INSTANCES:
        raise ValueError(f"the number of instances is 0 to {MAX_INSTANCES}, not {number!r:.80}")
    return count


def _start_next(machine: Machine, body: Token, loop: MultiInstance) -> None:
    assert body.loop is not None and body.loop.items is not None  # noqa: S101, PT018 - as `_start_loop` set
    item = body.loop.items[body.loop.started]
    _start_instance(machine, body, {} if loop.item_variable is None else {loop.item_variable: item})
    _count_instances(body)


def _start_instance(machine: Machine, body: Token, local: dict[str, Json]) -> None:
    assert body.loop is not None  # noqa: S101 - as `_start_loop` set
    instance = machine.add_token(machine.frame_of(body), body.node)
    instance.body, instance.index = body.id, body.loop.started
    loop = machine.node(body).loop
    first = loop.first if isinstance(loop, MultiInstance) else 0
    instance.local = {**local, "loopCounter": body.loop.started + first}
    body.inner[instance.id] = None
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
        is_continued = _is_continued(machine, instance, node.loop)
        machine.remove(instance)
        if is_continued:
            _start_instance(machine, body, {})
        else:
            machine.change_state(body, TokenState.FINISHING)
        return
    loop = body.loop
    assert loop is not None and isinstance(node.loop, MultiInstance)  # noqa: S101, PT018 - the other kind
    completed = loop.completed + 1
    output, is_enough = None, False
    if node.loop.output_item is not None or node.loop.completion is not None:
        active = len(body.inner) - 1
        counts = {
            "nrOfActiveInstances": active,
            "nrOfCompletedInstances": completed,
            "numberOfInstances": loop.total,
            "numberOfActiveInstances": active,
            "numberOfCompletedInstances": completed,
            "numberOfTerminatedInstances": 0,
        }  # both of BPMN 2.0 (Table 10.30) and of Camunda 7
        with machine.failures(instance):
            variables = machine.variables(instance)
            if node.loop.output_item is not None:
                output = node.loop.output_item.value(variables)
            if node.loop.completion is not None:
                is_enough = bool(node.loop.completion.value(ChainMap(counts, variables)))
    if loop.outputs is not None:
        loop.outputs[instance.index] = output
    loop.completed = completed
    machine.remove(instance)
    _continue_multi_instance(machine, body, node.loop, is_enough=is_enough)


def _continue_multi_instance(machine: Machine, body: Token, loop: MultiInstance, *, is_enough: bool) -> None:
    assert body.loop is not None  # noqa: S101 - as `_start_loop` set
    _count_instances(body)
    if is_enough:
        for other in list(body.inner):
            machine.remove(machine.state.tokens[other])
    elif loop.sequential and body.loop.started != body.loop.total:
        _start_next(machine, body, loop)
    if not body.inner:
        machine.change_state(body, TokenState.FINISHING)


def cancel_instance(machine: Machine, instance: Token) -> None:
    """Cancel an instance of a loop; a multi-instance activity continues with the others."""
    assert instance.body is not None  # noqa: S101 - only called for an instance
    body, loop = machine.state.tokens[instance.body], machine.node(instance).loop
    machine.remove(instance)
    if isinstance(loop, MultiInstance):
        _continue_multi_instance(machine, body, loop, is_enough=False)
    else:
        machine.change_state(body, TokenState.FINISHING)


def _is_continued(machine: Machine, token: Token, loop: StandardLoop) -> bool:
    """Return whether another iteration follows; `loopCounter` is the number of those before it."""
    body = token if token.body is None else machine.state.tokens[token.body]
    started = 0 if body.loop is None else body.loop.started
    if loop.maximum is not None and started >= loop.maximum:
        return False
    if loop.condition is None:
        return loop.maximum is not None
    with machine.failures(token):
        variables = ChainMap({"loopCounter": started}, machine.variables(token))
        return bool(loop.condition.value(variables))


def _finish_loop(machine: Machine, token: Token, node: Node) -> None:
    loop = token.loop
    if loop is not None and isinstance(node.loop, MultiInstance) and node.loop.output_collection is not None:
        machine.set_variables(machine.frame_of(token), {node.loop.output_collection: loop.outputs or []})
