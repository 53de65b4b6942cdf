"""Block-structured processes of any shape run in our engine as in SpiffWorkflow."""

from datetime import timedelta
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from services.task_orchestrator.tests.unit.bpmn.execution.build import NOW, Driver
from services.task_orchestrator.tests.unit.bpmn.execution.oracle import CODE, Oracle, whole

LEAVES = st.sampled_from(
    [("do",), ("do",), ("do",), ("script",), ("guarded",), ("late",), ("pause",)]
)  # fmt: skip


def _structured(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.one_of(
        st.tuples(st.sampled_from(["then", "then", "either"]), inner, inner),
        st.tuples(st.sampled_from(["sub", "repeat"]), SHAPES),
        st.tuples(st.just("loop"), inner),
    )


def _parallel(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.one_of(
        st.tuples(st.sampled_from(["then", "both", "any", "either"]), inner, inner),
        st.tuples(st.sampled_from(["both", "any"]), inner, inner, inner),
        st.tuples(st.sampled_from(["sub", "repeat"]), inner),
        st.tuples(st.just("loop"), LOOPED),
    )


SHAPES: st.SearchStrategy[Any] = st.deferred(lambda: st.recursive(LEAVES, _parallel, max_leaves=7))
LOOPED: st.SearchStrategy[Any] = st.deferred(lambda: st.recursive(LEAVES, _structured, max_leaves=3))
MAX_STEPS = 80


@settings(max_examples=2 * settings.default.max_examples)
@given(SHAPES, st.tuples(*[st.integers(0, 1)] * 3), st.data())
def test_a_process_runs_as_in_spiffworkflow(shape: Any, values: tuple[int, ...], data: st.DataObject) -> None:
    block = whole(shape)
    variables = {f"v{number}": value for number, value in enumerate(values)}
    ours = Driver(block.scope(), **variables)
    theirs = Oracle(block, variables, NOW)
    for _ in range(MAX_STEPS):
        assert ours.open == theirs.open
        assert ours.done == theirs.done
        assert ours.run.incidents() == ()
        if ours.done:
            break
        if not ours.open or (ours.run.next_due() is not None and data.draw(st.integers(0, 4)) == 0):
            ours.wait(minutes=10)
            theirs.wait(ours.now)
            continue
        activity = data.draw(st.sampled_from(ours.open))
        if activity.startswith("guarded") and activity[-1].isdigit() and data.draw(st.booleans()):
            assert ours.fail(activity, CODE)
            theirs.fail(activity)
        else:
            ours.complete(activity, **{f"r_{activity}": activity})
            theirs.complete(activity, **{f"r_{activity}": activity})
    if ours.done:
        assert {name: value for name, value in ours.variables.items() if name != "error"} == theirs.variables
    assert ours.now - NOW <= timedelta(minutes=10 * MAX_STEPS)
