"""Random runs: processes of all elements, random acts on them, and what holds after every act."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from hypothesis import event
from hypothesis import strategies as st

from handover_bpmn.execution.run import Run
from handover_bpmn.execution.state import Frame, RunFailed, State, Token, TokenState
from handover_bpmn.languages.native import read
from handover_bpmn.model import (
    CompensateEvent,
    Kind,
    LinkEvent,
    MultiInstance,
    Node,
    Scope,
    StandardLoop,
    TerminateEvent,
    Value,
)
from services.task_orchestrator.tests.unit.bpmn.execution.build import (
    Driver,
    after,
    boundary,
    call,
    catch,
    definition,
    end,
    event_sub,
    message,
    node,
    scope,
    signal,
    start,
    sub,
    throw,
    work,
)
from services.task_orchestrator.tests.unit.bpmn.execution.oracle import CODE, whole

LOOPS = st.sampled_from(
    [
        None,
        None,
        None,
        MultiInstance(sequential=False, cardinality=Value(2)),
        MultiInstance(sequential=True, cardinality=Value(2)),
        MultiInstance(sequential=False, cardinality=Value(3), completion=read("done > 1")),
        StandardLoop(read("done < 2"), maximum=3),
    ]
)
ACTS = (
    "complete",
    "complete",
    "complete",
    "fail",
    "retry",
    "skip",
    "move",
    "cancel",
    "deliver",
    "wait",
    "set",
)
CALLED = definition(
    scope(start(), work("b"), end("stop", TerminateEvent()), ("start", "b", "stop"),
          event_sub("e", scope(start("begin", signal("go"), interrupting=False), work("h"), ("begin", "h")))),
    "called",
)  # fmt: skip
INNER = scope(
    start("x_in"), work("x_a"), boundary("x_c", "x_a", CompensateEvent()),
    work("x_undo", is_for_compensation=True),
    node("x_which", Kind.EVENT_BASED), catch("x_m", message("go")), catch("x_t", after("PT10M")),
    throw("x_all", CompensateEvent()), end("x_out"),
    ("x_in", "x_a", "x_which", "x_m", "x_all", "x_out"), ("x_which", "x_t", "x_out"),
    handlers={"x_c": "x_undo"},
)  # fmt: skip
OUTER = scope(
    start("begin", message("go"), interrupting=False), sub("x", INNER), call("c", "called"),
    throw("to", LinkEvent("l")), catch("from", LinkEvent("l")), end("over", CompensateEvent()),
    ("begin", "x", "c", "to"), ("from", "over"),
)  # fmt: skip


def content_of(shape: Any, draw: Any) -> Scope:
    """The process of a shape, in which activities loop, with an event subprocess of many other elements."""
    content = _with_loops(whole(shape).scope(), draw)
    handler = event_sub("handler", OUTER)
    return replace(content, nodes={**content.nodes, handler.id: handler})


def _with_loops(content: Scope, draw: Any) -> Scope:
    nodes: dict[str, Node] = {}
    for name, found in content.nodes.items():
        inner = None if found.scope is None else _with_loops(found.scope, draw)
        loops = found.activity is not None or found.scope is not None
        nodes[name] = replace(found, scope=inner, loop=draw(LOOPS) if loops else None)
    return replace(content, nodes=nodes)


def check(run: Run, used: dict[int, str]) -> None:
    state = run._state
    assert Run.resume(run.plan, run.snapshot(), run._library).snapshot() == run.snapshot()
    _check_index(run)
    _check_ids(state, used)
    for frame in state.frames.values():
        assert frame is state.root or (
            frame.host in state.tokens and state.tokens[frame.host].child == frame.id
        )
        assert frame.tokens or frame is state.root or _host(state, frame).state is TokenState.COMPENSATING
    for token in state.tokens.values():
        assert state.frames[token.frame].tokens[token.id] is token
        _check_token(state, token)
    for wait in state.waits.values():
        owner: Token | Frame = state.frames[wait.frame] if wait.token is None else state.tokens[wait.token]
        assert wait.id in owner.waits
    owners = [*state.tokens.values(), *state.frames.values()]
    assert sorted(wait for owner in owners for wait in owner.waits) == sorted(state.waits)
    assert set(state.conditions) <= set(state.waits)
    if state.completed or state.failure is not None:
        assert not state.tokens
        assert not state.waits
        assert list(state.frames) == [state.root.id]
    else:
        assert run.open() or run.incidents() or any(each.token is not None for each in state.waits.values())


def _check_index(run: Run) -> None:
    """Check that nothing has changed without being noted: the snapshot and the index have every record."""
    state = run._state
    working = {str(each.id): each.visit for each in state.tokens.peek_all() if each.state is TokenState.WORK}
    assert run.open_visits() == working
    assert sorted(each.token for each in run.incidents()) == sorted(
        str(each.id) for each in state.tokens.peek_all() if each.incident is not None
    )
    places = {state.frames[each.frame].prefix + each.node for each in state.tokens.peek_all()}
    places |= {state.frames[each.frame].prefix + each.node for each in state.waits.peek_all()}
    assert set(run.waiting()) == places
    dues = [each.due for each in state.waits.peek_all() if each.due is not None and each.stopped is None]
    assert run.next_due() == min(dues, default=None)
    state.touch_all()
    assert state.snapshot() == run.snapshot()


def _host(state: State, frame: Frame) -> Token:
    assert frame.host in state.tokens
    return state.tokens[frame.host]


def _check_ids(state: State, used: dict[int, str]) -> None:
    """Check that ids are unique, and were never used for something else."""
    present = [
        *((each.id, f"token at {each.node}") for each in state.tokens.values()),
        *((each.id, f"frame of {each.scope}") for each in state.frames.values()),
        *((each.id, f"wait for {each.node}") for each in state.waits.values()),
    ]
    assert len(dict(present)) == len(present)
    for number, what in present:
        assert used.setdefault(number, what) == what
        assert number < state.next_id


def _check_token(state: State, token: Token) -> None:
    graph = state.frames[token.frame].graph
    assert token.node in graph.nodes
    assert token.body is None or token.id in state.tokens[token.body].inner
    match token.state:
        case TokenState.SCOPE:
            assert token.child in state.frames
        case TokenState.LOOP:
            assert token.inner
        case TokenState.WAITING:
            assert token.waits
        case TokenState.JOINED:
            assert token.via in {flow.id for flow in graph.incoming[token.node]}
        case TokenState.COMPENSATING:
            assert any(each.compensates == token.id for each in state.tokens.values())
        case TokenState.INCIDENT:
            assert token.incident is not None
        case _:
            assert token.state is TokenState.WORK


def act_randomly(run: Driver, data: st.DataObject, *, max_acts: int) -> Iterator[str]:
    """Apply random acts until the process has ended; yield each after it was applied or refused."""
    for act in data.draw(st.lists(st.sampled_from(ACTS), max_size=max_acts)):
        if not run.run._state.tokens:
            return
        try:
            _act(run, act, data.draw)
        except RunFailed:
            event(f"{act} refused")
        yield act
        run.restore()


def _act(run: Driver, act: str, draw: Any) -> None:
    state = run.run._state
    tokens = [str(token) for token in state.tokens]
    incidents = [each.token for each in run.run.incidents()]
    working = [each.token for each in run.run.open()]
    match act:
        case "complete" if working:
            run.run.complete(draw(st.sampled_from(working)), {"done": draw(st.integers(0, 3))}, run.now)
        case "fail" if working:
            run.run.fail(draw(st.sampled_from(working)), draw(st.sampled_from([CODE, None])), "why", run.now)
        case "retry" if incidents:
            run.run.retry(draw(st.sampled_from(incidents)), run.now)
        case "skip":
            run.run.skip(draw(st.sampled_from(tokens)), {"done": 1}, run.now)
        case "move":
            token = draw(st.sampled_from(tokens))
            places = sorted(state.frames[state.tokens[int(token)].frame].graph.nodes)
            run.run.move(token, draw(st.sampled_from(places)), run.now)
        case "cancel":
            run.run.cancel_token(draw(st.sampled_from(tokens)), run.now)
        case "deliver":
            for each in run.run.subscriptions()[:1]:
                run.run.deliver(each.wait, {"brought": 1}, run.now)
        case "wait":
            run.wait(minutes=10)
        case "set":
            run.run.set_variables({"v0": 1, "v1": 0, "done": 1}, run.now)
