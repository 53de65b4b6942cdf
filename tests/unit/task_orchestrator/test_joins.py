"""Joins: tokens side by side come together once a round, and each brings what it has changed."""

from itertools import permutations
from typing import Any

import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.task_orchestrator.bpmn import read_bpmn
from services.task_orchestrator.engine import Plan, Run, RunFailed
from tests.unit.task_orchestrator.drawing import NOW, activity, drawing, end, flow, gateway, path, start
from tests.unit.task_orchestrator.shapes import SHAPES, whole


def round_trip(kind: str) -> Plan:
    """Return a loop in which `a` and `b` are done side by side, then `c`, which says whether to go on."""
    given = "True" if kind == "inclusive" else None
    body = start() + gateway("in") + gateway("fork", kind) + activity("a") + activity("b")
    body += gateway("join", kind) + activity("c") + gateway("out", default="out_end") + end()
    body += path("start", "in", "fork") + flow("fork", "a", given) + flow("fork", "b", given)
    body += path("a", "join", "c", "out", "end") + flow("b", "join") + flow("out", "in", "c.again")
    return Plan(read_bpmn(drawing(body)))


def do(run: Run, element: str, **results: Any) -> None:
    (open_,) = [open_ for open_ in run.open() if open_.element == element]
    run.complete(open_.token, {element: results}, NOW)


def opened(run: Run) -> list[str]:
    return sorted(f"{open_.element}-{open_.visit}" for open_ in run.open())


@pytest.mark.parametrize("kind", ["parallel", "inclusive"])
def test_in_a_loop_every_iteration_waits_for_all_tokens_in_any_order(kind: str) -> None:
    run = round_trip(kind).start({}, NOW)
    for n, order in enumerate(["ab", "ab", "ba", "ba", "ab"], 1):
        do(run, order[0], n=n)
        assert opened(run) == [f"{order[1]}-{n}"]
        do(run, order[1], n=n)
        assert opened(run) == [f"c-{n}"]
        do(run, "c", again=True)


@pytest.mark.parametrize("kind", ["parallel", "inclusive"])
def test_nothing_of_an_earlier_round_is_left_in_the_results(kind: str) -> None:
    run = round_trip(kind).start({}, NOW)
    for n, order in enumerate(["ab", "ba", "ab"], 1):
        for name in order:
            do(run, name, **{f"round{n}": True})
        seen = run.open()[0].variables
        assert seen["a"] == seen["b"] == {f"round{n}": True}
        do(run, "c", again=True)


@pytest.mark.parametrize("order", [*permutations("abc")])
def test_a_variable_has_the_value_of_the_branch_that_changed_it(order: tuple[str, ...]) -> None:
    body = start() + gateway("fork", "parallel") + gateway("join", "parallel") + activity("last") + end()
    body += path("start", "fork") + path("join", "last", "end")
    for name in "abc":
        body += activity(name) + path("fork", name, "join")
    run = Plan(read_bpmn(drawing(body))).start({"a": 0, "b": 0, "other": {"old": 1}}, NOW)
    for name in order:
        do(run, name, by=name)
    assert run.variables() == {name: {"by": name} for name in "abc"} | {"other": {"old": 1}}


def test_an_inclusive_gateway_goes_on_when_the_other_way_has_ended_elsewhere() -> None:
    body = start() + gateway("fork", "inclusive") + activity("a") + activity("b") + activity("last")
    body += gateway("which", default="which_stop") + gateway("join", "inclusive") + end() + end("stop")
    body += path("start", "fork") + flow("fork", "a", "True") + flow("fork", "b", "True")
    body += path("a", "join", "last", "end") + path("b", "which", "stop") + flow("which", "join", "b.on")
    run = Plan(read_bpmn(drawing(body))).start({}, NOW)
    do(run, "a")
    assert opened(run) == ["b-1"]
    do(run, "b", on=False)
    assert opened(run) == ["last-1"]


def test_a_snapshot_of_another_format_is_refused() -> None:
    plan = round_trip("parallel")
    snapshot = orjson.loads(plan.start({}, NOW).snapshot())
    with pytest.raises(RunFailed, match="format 2"):
        plan.resume(orjson.dumps({**snapshot, "version": 2}))


@settings(max_examples=3 * settings.default.max_examples)
@given(shape=SHAPES, go=st.booleans(), choices=st.data())
def test_for_any_model_no_activity_is_open_twice_and_the_last_result_counts(
    shape: Any, go: bool, choices: st.DataObject
) -> None:
    plan = Plan(read_bpmn(drawing(whole(shape))))
    run = plan.start({"go": go}, NOW)
    results: dict[str, Any] = {}
    for n in range(60):
        if run.completed:
            break
        if choices.draw(st.integers(0, 3)) == 0:
            run = plan.resume(run.snapshot())
        elements = [open_.element for open_ in run.open()]
        assert elements, "nobody is asked for anything, and yet it has not ended"
        assert len(elements) == len(set(elements))
        open_ = choices.draw(st.sampled_from(run.open()))
        results[open_.element] = {"ok": n < 20 and choices.draw(st.booleans()), f"n{n}": n}
        run.complete(open_.token, {open_.element: results[open_.element]}, NOW)
    if run.completed:
        assert {name: value for name, value in run.variables().items() if name != "go"} == results
