"""Loops: the standard loop and multi-instance activities, on tasks, subprocesses and call activities."""

from typing import Any

import pytest

from handover_bpmn.languages.native import read
from handover_bpmn.model import (
    Assignment,
    ErrorEvent,
    Kind,
    MessageEvent,
    MultiInstance,
    Node,
    Scope,
    StandardLoop,
    Value,
)
from services.task_orchestrator.tests.unit.bpmn.execution.build import (
    Driver,
    after,
    boundary,
    call,
    definition,
    end,
    node,
    scope,
    script,
    start,
    sub,
    value,
    work,
)


def around(activity: Node, *others: Any) -> Scope:
    return scope(start(), activity, work("after"), end(), ("start", activity.id, "after", "end"), *others)


def each(*, sequential: bool = False, **changes: Any) -> MultiInstance:
    return MultiInstance(sequential, collection=value("items"), item_variable="item", **changes)


def locals_of(run: Driver, element: str, name: str) -> list[Any]:
    return [found.variables[name] for found in run.run.open() if found.element == element]


# Standard loop


def test_a_standard_loop_repeats_while_its_condition_holds() -> None:
    run = Driver(around(work("a", loop=StandardLoop(read("more")))))
    for number in range(3):
        assert run.open == ["a"]
        assert locals_of(run, "a", "loopCounter") == [number]
        run.complete("a", more=number < 2)
    assert run.open == ["after"]
    assert run.variables == {"more": False}


def test_a_standard_loop_that_tests_before_may_not_run_at_all() -> None:
    content = around(work("a", loop=StandardLoop(read("n > 0"), test_before=True)))
    assert Driver(content, n=0).open == ["after"]
    run = Driver(content, n=1)
    run.complete("a", n=0)
    assert run.open == ["after"]


def test_a_standard_loop_has_a_maximum() -> None:
    run = Driver(around(work("a", loop=StandardLoop(read("true"), maximum=2))))
    run.complete("a")
    run.complete("a")
    assert run.open == ["after"]
    counted = Driver(around(work("a", loop=StandardLoop(None, maximum=2))))
    counted.complete("a")
    assert counted.open == ["a"]


@pytest.mark.parametrize("test_before", [True, False])
def test_the_counter_of_a_loop_is_the_number_of_iterations_before(*, test_before: bool) -> None:
    loop = StandardLoop(read("loopCounter < 3"), test_before=test_before)
    run = Driver(around(script("s", "n = n + 1", loop=loop)), n=0)
    assert run.variables == {"n": 3}


def test_an_endless_standard_loop_is_stopped() -> None:
    run = Driver(around(script("s", "n = n + 1", loop=StandardLoop(read("true")))), n=0)
    (incident,) = run.run.incidents()
    assert "without waiting" in incident.reason


def test_a_subprocess_loops() -> None:
    inner = scope(start("in"), work("a"), end("out"), ("in", "a", "out"))
    run = Driver(around(sub("s", inner, loop=StandardLoop(read("more")))))
    run.complete("a", more=True)
    assert run.open == ["a"]
    run.complete("a", more=False)
    assert run.open == ["after"]


# Multi-instance


def test_instances_run_in_parallel_each_with_its_item() -> None:
    run = Driver(around(work("a", loop=each())), items=["x", "y", "z"])
    assert run.open == ["a", "a", "a"]
    assert locals_of(run, "a", "item") == ["x", "y", "z"]
    assert locals_of(run, "a", "loopCounter") == [0, 1, 2]
    assert locals_of(run, "a", "nrOfInstances") == [3, 3, 3]
    assert [found.visit for found in run.run.open()] == [1, 2, 3]
    run.complete("a")
    assert locals_of(run, "a", "nrOfCompletedInstances") == [1, 1]
    assert locals_of(run, "a", "nrOfActiveInstances") == [2, 2]
    run.complete("a")
    run.complete("a")
    assert run.open == ["after"]
    assert run.variables == {"items": ["x", "y", "z"]}


def test_instances_run_one_after_the_other() -> None:
    run = Driver(around(work("a", loop=each(sequential=True))), items=["x", "y"])
    assert locals_of(run, "a", "item") == ["x"]
    run.complete("a")
    assert locals_of(run, "a", "item") == ["y"]
    run.complete("a")
    assert run.open == ["after"]


@pytest.mark.parametrize("sequential", [True, False])
def test_an_empty_collection_has_no_instances(*, sequential: bool) -> None:
    loop = each(sequential=sequential, output_collection="found", output_item=value("item"))
    run = Driver(around(work("a", loop=loop)), items=[])
    assert run.open == ["after"]
    assert run.variables == {"items": [], "found": []}


@pytest.mark.parametrize(("count", "instances"), [(2, 2), ("3", 3), (1.0, 1), (0, 0)])
def test_the_number_of_instances_is_given(count: Any, instances: int) -> None:
    loop = MultiInstance(sequential=False, cardinality=value("count"))
    run = Driver(around(work("a", loop=loop)), count=count)
    assert run.open.count("a") == instances


@pytest.mark.parametrize(
    "variables", [{"items": 3}, {"items": None}, {}, {"items": [0] * 10_001}, {"items": {"a": 1}}]
)
def test_what_is_no_collection_is_an_incident(variables: dict[str, Any]) -> None:
    run = Driver(around(work("a", loop=each())), **variables)
    run.run.set_variables({"items": [1]}, run.now)
    run.do("retry", "a")
    assert locals_of(run, "a", "item") == [1]


@pytest.mark.parametrize("count", [-1, True, "many", 1.5, 10_001, None])
def test_what_is_no_number_of_instances_is_an_incident(count: Any) -> None:
    loop = MultiInstance(sequential=False, cardinality=value("count"))
    run = Driver(around(work("a", loop=loop)), count=count)
    assert run.incident("a")


@pytest.mark.parametrize("sequential", [True, False])
def test_outputs_are_collected_in_the_order_of_the_items(*, sequential: bool) -> None:
    loop = each(sequential=sequential, output_collection="found", output_item=value("result * 10"))
    run = Driver(around(work("a", loop=loop)), items=[1, 2, 3])
    while run.open != ["after"]:
        last = [each for each in run.run.open() if each.element == "a"][-1]
        run.run.complete(last.token, {"result": last.variables["item"]}, run.now)
        run.restore()
    assert run.variables == {"items": [1, 2, 3], "found": [10, 20, 30]}


@pytest.mark.parametrize("sequential", [True, False])
def test_a_completion_condition_cancels_the_other_instances(*, sequential: bool) -> None:
    loop = each(
        sequential=sequential,
        completion=read("nrOfCompletedInstances >= 2 or bad"),
        output_collection="found",
        output_item=value("bad"),
    )
    run = Driver(around(work("a", loop=loop)), items=[1, 2, 3])
    run.complete("a", bad=False)
    run.complete("a", bad=False)
    assert run.open == ["after"]
    assert run.variables["found"] == [False, False, None]


@pytest.mark.parametrize(
    "condition",
    [
        "numberOfCompletedInstances == 2",
        "numberOfInstances - numberOfActiveInstances - numberOfTerminatedInstances == 2",
    ],
)
def test_a_completion_condition_may_use_the_names_of_bpmn(condition: str) -> None:
    run = Driver(around(work("a", loop=each(completion=read(condition)))), items=[1, 2, 3])
    run.complete("a")
    assert run.open == ["a", "a"]
    run.complete("a")
    assert run.open == ["after"]


def test_a_completion_condition_that_fails_is_an_incident_of_the_instance() -> None:
    run = Driver(around(work("a", loop=each(completion=read("enough")))), items=[1, 2])
    run.complete("a", x=1)
    assert run.open == ["a"]
    assert run.variables["x"] == 1
    run.run.set_variables({"enough": True, "x": 2}, run.now)
    run.do("retry", "a")
    assert run.open == ["after"]
    assert run.variables["x"] == 2


@pytest.mark.parametrize("sequential", [True, False])
def test_a_multi_instance_subprocess(*, sequential: bool) -> None:
    inner = scope(start("in"), script("s", "m = item * 10"), work("a"), end("out"), ("in", "s", "a", "out"))
    loop = each(sequential=sequential, output_collection="found", output_item=value("m + n"))
    run = Driver(around(sub("sub", inner, loop=loop)), items=[1, 2])
    for number in (5, 6):
        first = run.run.open()[0]
        run.run.complete(first.token, {"n": number}, run.now)
        run.restore()
    assert run.open == ["after"]
    assert run.variables == {"items": [1, 2], "found": [15, 26]}


def test_parallel_instances_of_a_subprocess_with_an_output_collection_share_no_variables() -> None:
    inner = scope(start("in"), work("a"), work("b"), end("out"), ("in", "a", "b", "out"))
    loop = each(output_collection="found", output_item=value("m"))
    run = Driver(around(sub("sub", inner, loop=loop)), items=[1, 2])
    for activity in ("a", "b"):
        for found in [each for each in run.run.open() if each.element == activity]:
            results = {"m": found.variables["item"]} if activity == "a" else {}
            run.run.complete(found.token, results, run.now)
            run.restore()
    assert run.variables == {"items": [1, 2], "found": [1, 2]}


def test_a_multi_instance_call_activity() -> None:
    called = definition(scope(start(), work("b"), end(), ("start", "b", "end")), "called")
    loop = each(output_collection="found", output_item=value("y"))
    activity = call(
        "c", "called", inputs=(Assignment("x", value("item")),), outputs=(Assignment("y", value("x + z")),)
    )
    run = Driver(around(node("c", Kind.CALL_ACTIVITY, call=activity.call, loop=loop)), called, items=[1, 2])
    assert [(each.element, each.visit) for each in run.run.open()] == [("c.b", 1), ("c.b", 2)]
    run.complete("c.b", z=10)
    run.complete("c.b", z=20)
    assert run.open == ["after"]
    assert run.variables == {"items": [1, 2], "found": [11, 22]}


def test_a_multi_instance_script_and_a_multi_instance_receive_task() -> None:
    run = Driver(around(script("s", "n = n + item", loop=each())), items=[1, 2, 3], n=0)
    assert run.variables["n"] == 6
    receive = node(
        "r", Kind.RECEIVE_TASK, loop=each(), event=MessageEvent(Value("answer"), value("item"))
    )  # fmt: skip
    waiting = Driver(around(receive), items=["x", "y"])
    assert [each.key for each in waiting.run.subscriptions()] == ["x", "y"]
    assert waiting.deliver("answer") == 2
    assert waiting.open == ["after"]


def test_nested_multi_instances() -> None:
    inner = scope(
        start("in"),
        work("a", loop=MultiInstance(sequential=False, collection=value("item"), item_variable="cell")),
        end("out"),
        ("in", "a", "out"),
    )
    run = Driver(around(sub("s", inner, loop=each())), items=[[1, 2], [3]])
    assert locals_of(run, "a", "cell") == [1, 2, 3]
    for _ in range(3):
        run.complete("a")
    assert run.open == ["after"]


def test_nested_multi_instances_are_limited_in_number() -> None:
    inner = scope(
        start("in"), work("a", loop=MultiInstance(sequential=False, cardinality=Value(10_000))), end("out"),
        ("in", "a", "out"),
    )  # fmt: skip
    run = Driver(around(sub("s", inner, loop=MultiInstance(sequential=False, cardinality=Value(20)))))
    assert any("without waiting" in incident.reason for incident in run.run.incidents())


# Around the body


def test_boundary_events_belong_to_all_instances() -> None:
    content = around(
        work("a", loop=each()), boundary("late", "a", after("PT5M")), boundary("bad", "a", ErrorEvent()),
        work("b"), ("late", "b"), ("bad", "b"),
    )  # fmt: skip
    late = Driver(content, items=[1, 2])
    assert late.run.next_due() is not None
    late.wait(minutes=5)
    assert late.open == ["b"]
    bad = Driver(content, items=[1, 2])
    assert bad.fail("a", "E")
    assert bad.open == ["b"]
    assert bad.run.next_due() is None


def test_a_failed_instance_stops_only_itself() -> None:
    run = Driver(around(work("a", loop=each())), items=[1, 2])
    run.fail("a")
    assert run.open == ["a"]
    run.complete("a")
    assert run.open == []
    run.do("retry", "a")
    assert run.open == ["a"]
    assert locals_of(run, "a", "item") == [1]
    run.complete("a")
    assert run.open == ["after"]


@pytest.mark.parametrize("sequential", [True, False])
def test_a_cancelled_instance_is_not_waited_for(*, sequential: bool) -> None:
    run = Driver(around(work("a", loop=each(sequential=sequential))), items=[1, 2])
    run.run.cancel_token(run.token("a"), run.now)
    run.restore()
    assert locals_of(run, "a", "item") == [2]
    run.run.cancel_token(run.token("a"), run.now)
    run.restore()
    assert run.open == ["after"]


def test_a_cancelled_iteration_ends_the_loop() -> None:
    run = Driver(around(work("a", loop=StandardLoop(read("true")))))
    run.run.cancel_token(run.token("a"), run.now)
    run.restore()
    assert run.open == ["after"]


def test_a_skipped_instance_counts_as_completed() -> None:
    loop = each(output_collection="found", output_item=value("r"))
    run = Driver(around(work("a", loop=loop)), items=[1, 2])
    run.complete("a", r=1)
    run.fail("a")
    run.run.skip(run.incident("a"), {"r": 2}, run.now)
    run.restore()
    assert run.open == ["after"]
    assert run.variables["found"] == [1, 2]


def test_an_engineer_changes_the_item_of_an_instance() -> None:
    run = Driver(around(work("a", loop=each())), items=[1, 2])
    run.fail("a")
    run.run.set_variables({"item": 9}, run.now, token=run.incident("a"))
    run.do("retry", "a")
    assert locals_of(run, "a", "item") == [9, 2]
    assert run.variables == {"items": [1, 2]}


def test_an_input_mapping_sees_the_item() -> None:
    inputs = (Assignment("label", value('"part " + item')),)
    run = Driver(around(work("a", loop=each(), inputs=inputs)), items=["x", "y"])
    assert locals_of(run, "a", "label") == ["part x", "part y"]


def test_ten_thousand_instances() -> None:
    loop = MultiInstance(sequential=False, cardinality=Value(10_000))
    run = Driver(around(work("a", loop=loop)))
    assert len(run.run.open()) == 10_000
    run.run.move(run.token("a"), "after", run.now)
    assert run.open == ["after"]
