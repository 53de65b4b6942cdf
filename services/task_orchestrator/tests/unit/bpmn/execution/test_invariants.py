"""What holds after every step, whatever performers, events and engineers do to a process."""

from typing import Any

from hypothesis import event, given, settings
from hypothesis import strategies as st

from services.task_orchestrator.tests.unit.bpmn.execution.build import Driver
from services.task_orchestrator.tests.unit.bpmn.execution.random_runs import (
    CALLED,
    act_randomly,
    check,
    content_of,
)
from services.task_orchestrator.tests.unit.bpmn.execution.test_oracle import SHAPES


@settings(max_examples=3 * settings.default.max_examples)
@given(SHAPES, st.data())
def test_invariants_hold_after_every_act(shape: Any, data: st.DataObject) -> None:
    variables = data.draw(st.sampled_from([{}, {"v0": 1, "v1": 1, "v2": 0}, {"v0": 0, "v1": 0, "done": 0}]))
    run = Driver(content_of(shape, data.draw), CALLED, **variables)
    used: dict[int, str] = {}
    check(run.run, used)
    for _ in act_randomly(run, data, max_acts=25):
        check(run.run, used)
    event("ended" if not run.run._state.tokens else "alive")
