"""What can be seen of the inside of a run: its tokens, and the variables that only a part of it sees."""

import pytest

from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.state import Library, RunFailed
from services.task_orchestrator.tests.unit.bpmn.notation.reading import between, extended, file, read
from services.task_orchestrator.tests.unit.cell_driver import definitions
from services.task_orchestrator.tests.unit.drawing import NOW, activity, end, flow, gateway, path, start
from services.task_orchestrator.tests.unit.process_driver import OneDefinition

JOB = extended("serviceTask", '<zeebe:taskDefinition type="pick"/>', name="job")
EACH = (
    "<bpmn:multiInstanceLoopCharacteristics><bpmn:extensionElements>"
    '<zeebe:loopCharacteristics inputCollection="=items" inputElement="item" outputCollection="found" '
    'outputElement="=weight"/></bpmn:extensionElements></bpmn:multiInstanceLoopCharacteristics>'
)
CALLED = '<zeebe:calledElement processId="called"/>'
INPUT = '<zeebe:ioMapping><zeebe:input source="=item" target="part"/></zeebe:ioMapping>'


def running(element: str) -> tuple[Run, Library]:
    library = definitions(file(between(element)), file(between(JOB, "job"), name="called"))
    return Run.start(library.plans["p"], {"items": ["a", "b"], "other": 1}, NOW, library), library


def test_two_tokens_at_one_element_are_two() -> None:
    body = start() + gateway("split", "parallel") + gateway("merge") + activity("work") + end()
    body += path("start", "split", "merge", "work", "end") + flow("split", "merge").replace("_", "_2_")
    plan = Plan(read(body.replace('id="split_2_merge"', 'id="again"')))
    run = Run.start(plan, {}, NOW, OneDefinition(plan))
    assert [(each.element, each.state.value) for each in run.tokens()] == [("work", "work")] * 2
    assert len({each.token for each in run.tokens()}) == 2


@pytest.mark.parametrize("kind", ["serviceTask", "subProcess", "callActivity"])
def test_inner_variables_are_seen_and_set_where_they_are(kind: str) -> None:
    inner = {"subProcess": start("in") + JOB + path("in", "job")}.get(kind, "")
    extensions = {"serviceTask": '<zeebe:taskDefinition type="pick"/>', "callActivity": CALLED}.get(kind, "")
    run, library = running(extended(kind, extensions + INPUT, inner=EACH + inner))
    scopes = {each.scope: each for each in run.inner_scopes()}
    instances = [each for each in scopes.values() if each.kind == "instance"]
    assert [(each.instance, each.variables["item"]) for each in instances] == [
        ("1/2: a", "a"),
        ("2/2: b", "b"),
    ]
    assert all(scopes[each.outer or ""].kind == "activity" for each in instances)  # the body of the loop
    within = [each for each in scopes.values() if each.kind in {"subProcess", "calledProcess"}]
    assert [scopes[each.outer or ""].instance for each in within] == (
        [] if kind == "serviceTask" else ["1/2: a", "2/2: b"]
    )
    mapped = within if kind == "callActivity" else instances
    assert [each.variables["part"] for each in mapped] == ["a", "b"]
    changed = (within or instances)[0]
    assert run.set_scope_variables(changed.scope, {"weight": 3, "other": 2}, NOW) == "x"
    first, second = sorted(run.open_visits(), key=int)
    assert run.open_activity(first).variables["other"] == 2
    assert run.open_activity(second).variables["other"] == 1
    assert run.variables()["other"] == 1
    resumed = Run.resume(run.plan, run.snapshot(), library)
    assert resumed.inner_scopes() == run.inner_scopes()


def test_a_scope_that_is_over_cannot_be_set() -> None:
    run, _ = running(JOB.replace('id="job"', 'id="x"'))
    for scope in ("99", "0", "x", "", str(run.tokens()[0].token) + "0", "²"):
        with pytest.raises(RunFailed, match="there is no scope"):
            run.set_scope_variables(scope, {"a": 1}, NOW)
