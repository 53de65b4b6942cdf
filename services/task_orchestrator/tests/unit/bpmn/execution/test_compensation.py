"""Compensation: which handlers run, in which order, with which variables."""

from typing import Any

import pytest

from handover_bpmn.model import (
    Assignment,
    CompensateEvent,
    ErrorEvent,
    Kind,
    MultiInstance,
    Node,
    Scope,
    Value,
)
from services.task_orchestrator.tests.unit.bpmn.execution.build import (
    Driver,
    boundary,
    end,
    event_sub,
    message,
    node,
    scope,
    script,
    start,
    sub,
    throw,
    value,
    when,
    work,
    xor,
)


def undo(activity: str, handler: Node | None = None) -> list[Node]:
    """The compensation boundary event of an activity, and its handler `undo_<activity>`."""
    found = handler or work(f"undo_{activity}", is_for_compensation=True)
    return [boundary(f"c_{activity}", activity, CompensateEvent()), found]


def compensated(*parts: Any) -> Scope:
    """A scope whose activities with a boundary event `c_<activity>` have handlers `undo_<activity>`."""
    names = [part.id for part in parts if isinstance(part, Node) and part.id.startswith("c_")]
    return scope(*parts, handlers={name: f"undo_{name.removeprefix('c_')}" for name in names})


BOTH = compensated(
    start(), work("a"), work("b"), throw("all", CompensateEvent()), work("after"), end(),
    *undo("a"), *undo("b"), ("start", "a", "b", "all", "after", "end"),
)  # fmt: skip


def test_the_last_completed_activity_is_compensated_first() -> None:
    run = Driver(BOTH)
    run.complete("a")
    run.complete("b")
    assert run.open == ["undo_b"]
    run.complete("undo_b")
    assert run.open == ["undo_a"]
    run.complete("undo_a", undone=True)
    assert run.open == ["after"]
    assert run.variables == {"undone": True}
    run.complete("after")
    assert run.done


def test_what_has_not_completed_is_not_compensated() -> None:
    content = compensated(
        start(), work("a"), xor("x", default="x_b"), work("b"), end("all", CompensateEvent()),
        *undo("a"), *undo("b"), ("start", "a", "x", "b", "all"), when("x", "all", "skip"),
    )  # fmt: skip
    run = Driver(content, skip=True)
    run.complete("a")
    run.complete("undo_a")
    assert run.done


def test_nothing_to_compensate_passes() -> None:
    assert Driver(scope(start(), throw("t", CompensateEvent()), end(), ("start", "t", "end"))).done


def test_one_activity_is_compensated_by_name_and_only_once() -> None:
    content = compensated(
        start(), work("a"), work("b"), throw("one", CompensateEvent("a")), throw("rest", CompensateEvent()),
        end(), *undo("a"), *undo("b"), ("start", "a", "b", "one", "rest", "end"),
    )  # fmt: skip
    run = Driver(content)
    run.complete("a")
    run.complete("b")
    assert run.open == ["undo_a"]
    run.complete("undo_a")
    assert run.open == ["undo_b"]
    run.complete("undo_b")
    assert run.done


def test_each_iteration_is_compensated() -> None:
    content = compensated(
        start(), work("a"), xor("x", default="x_a"), end("all", CompensateEvent()), *undo("a"),
        ("start", "a", "x", "a"), when("x", "all", "stop"),
    )  # fmt: skip
    run = Driver(content)
    for number in range(3):
        run.complete("a", stop=number == 2)
    for visit in (1, 2, 3):
        assert [(each.element, each.visit) for each in run.run.open()] == [("undo_a", visit)]
        run.complete("undo_a")
    assert run.done


def test_each_instance_is_compensated_with_its_item() -> None:
    loop = MultiInstance(sequential=True, collection=value("items"), item_variable="item")
    content = compensated(
        start(), work("a", loop=loop), end("all", CompensateEvent()), *undo("a"), ("start", "a", "all")
    )
    run = Driver(content, items=["x", "y"])
    run.complete("a")
    run.complete("a")
    for item in ("y", "x"):
        assert run.run.open()[0].variables["item"] == item
        run.complete("undo_a")
    assert run.done


def subprocess_content(*parts: Any, loop: Any = None, **changes: Any) -> Scope:
    inner = compensated(
        start("in"), work("a"), work("b"), end("out"), *undo("a"), *undo("b"), ("in", "a", "b", "out"), *parts
    )
    return scope(
        start(), sub("s", inner, loop=loop, **changes), work("c"), end("all", CompensateEvent()),
        ("start", "s", "c", "all"),
    )  # fmt: skip


def test_a_completed_subprocess_is_compensated_as_a_whole() -> None:
    run = Driver(subprocess_content(inputs=(Assignment("x", Value(5)),)))
    for activity in ("a", "b", "c"):
        run.complete(activity)
    assert run.open == ["undo_b"]
    assert run.run.open()[0].variables["x"] == 5
    run.complete("undo_b", x=6)
    assert run.open == ["undo_a"]
    assert run.run.open()[0].variables["x"] == 6
    run.complete("undo_a")
    assert run.done
    assert run.variables == {}


def test_a_running_subprocess_is_not_compensated() -> None:
    content = subprocess_content()
    run = Driver(content)
    run.complete("a")
    run.run.move(run.token("b"), "out", run.now)
    run.complete("c")
    assert run.open == ["undo_a"]


def test_each_instance_of_a_subprocess_is_compensated() -> None:
    run = Driver(subprocess_content(loop=MultiInstance(sequential=True, cardinality=Value(2))))
    for activity in ("a", "b", "a", "b", "c"):
        run.complete(activity)
    for handler in ("undo_b", "undo_a", "undo_b", "undo_a"):
        assert run.open == [handler]
        run.complete(handler)
    assert run.done


def test_nested_subprocesses_are_compensated() -> None:
    inner = compensated(start("in"), work("a"), end("out"), *undo("a"), ("in", "a", "out"))
    outer = compensated(
        start("in2"), sub("s2", inner), work("b"), end("out2"), *undo("b"), ("in2", "s2", "b", "out2")
    )
    run = Driver(scope(start(), sub("s", outer), end("all", CompensateEvent("s")), ("start", "s", "all")))
    for activity in ("a", "b", "undo_b", "undo_a"):
        assert run.open == [activity]
        run.complete(activity)
    assert run.done


def test_the_handler_of_a_subprocess_replaces_those_within() -> None:
    inner = compensated(start("in"), work("a"), end("out"), *undo("a"), ("in", "a", "out"))
    content = compensated(
        start(), sub("s", inner), end("all", CompensateEvent()), *undo("s"), ("start", "s", "all")
    )
    run = Driver(content)
    run.complete("a")
    assert run.open == ["undo_s"]
    run.complete("undo_s")
    assert run.done


def test_a_compensation_event_subprocess_decides_what_is_compensated() -> None:
    own = scope(
        start("begin", CompensateEvent()), work("prepare"), throw("only_a", CompensateEvent("a")),
        end("over"), ("begin", "prepare", "only_a", "over"),
    )  # fmt: skip
    run = Driver(subprocess_content(event_sub("own", own)))
    for activity in ("a", "b", "c", "prepare", "undo_a"):
        assert run.open == [activity]
        run.complete(activity)
    assert run.done


def test_a_handler_may_be_a_subprocess_or_a_script() -> None:
    handler = sub(
        "undo_a",
        scope(start("in"), work("h1"), work("h2"), end("out"), ("in", "h1", "h2", "out")),
        is_for_compensation=True,
    )
    content = compensated(
        start(), work("a"), work("b"), end("all", CompensateEvent()), *undo("a", handler),
        *undo("b", script("undo_b", "x = 1", is_for_compensation=True)), ("start", "a", "b", "all"),
    )  # fmt: skip
    run = Driver(content)
    for activity in ("a", "b", "h1", "h2"):
        assert run.open == [activity]
        run.complete(activity)
    assert run.done
    assert run.variables == {"x": 1}


def test_compensation_is_thrown_by_an_event_subprocess_for_its_scope() -> None:
    handler = scope(
        start("begin", ErrorEvent()), throw("all", CompensateEvent()), work("report"), end("over"),
        ("begin", "all", "report", "over"),
    )  # fmt: skip
    content = compensated(
        start(), work("a"), work("b"), end(), *undo("a"), ("start", "a", "b", "end"), event_sub("h", handler)
    )
    run = Driver(content)
    run.complete("a")
    assert run.fail("b")
    assert run.open == ["undo_a"]
    run.complete("undo_a")
    assert run.open == ["report"]
    run.complete("report")
    assert run.done


def test_an_event_subprocess_compensates_its_own_activities_too() -> None:
    handler = compensated(
        start("begin", message("go")), work("h"), end("all", CompensateEvent()), *undo("h"),
        ("begin", "h", "all"),
    )  # fmt: skip
    content = compensated(
        start(), work("a"), work("b"), end(), *undo("a"), ("start", "a", "b", "end"), event_sub("e", handler)
    )
    run = Driver(content)
    run.complete("a")
    run.deliver("go")
    for activity in ("h", "undo_h", "undo_a"):
        assert run.open == [activity]
        run.complete(activity)
    assert run.done


def test_a_failed_handler_is_an_incident_and_compensation_continues_after_it() -> None:
    run = Driver(BOTH)
    run.complete("a")
    run.complete("b")
    run.fail("undo_b")
    run.do("retry", "undo_b")
    assert run.open == ["undo_b"]
    run.fail("undo_b")
    run.run.cancel_token(run.incident("undo_b"), run.now)
    run.restore()
    assert run.open == ["undo_a"]
    run.fail("undo_a")
    run.do("skip", "undo_a", {})
    assert run.open == ["after"]


def test_an_error_of_a_handler_continues_at_its_boundary_event_beside_the_compensation() -> None:
    content = compensated(
        start(), work("a"), work("b"), throw("all", CompensateEvent()), work("after"), *undo("a"), *undo("b"),
        boundary("e", "undo_b", ErrorEvent()), work("help"), ("start", "a", "b", "all", "after"),
        ("e", "help"),
    )  # fmt: skip
    run = Driver(content)
    run.complete("a")
    run.complete("b")
    assert run.fail("undo_b")
    assert run.open == ["help", "undo_a"]
    run.complete("undo_a")
    assert run.open == ["after", "help"]


@pytest.mark.parametrize("act", ["cancel_token", "skip", "move"])
def test_a_compensating_event_is_left_by_an_engineer(act: str) -> None:
    run = Driver(BOTH)
    run.complete("a")
    run.complete("b")
    token = str(next(each.id for each in run.run._state.tokens.values() if each.node == "all"))
    arguments = {"cancel_token": (), "skip": ({},), "move": ("after",)}[act]
    getattr(run.run, act)(token, *arguments, run.now)
    run.restore()
    if act == "skip":
        assert run.open == ["after"]
        return
    assert "undo_b" in run.open
    for activity in ("undo_b", *(["after"] if act == "move" else [])):
        run.complete(activity)
    assert run.done


def test_an_interrupted_compensation_is_cancelled_with_its_scope() -> None:
    inner = compensated(start("in"), work("a"), end("all", CompensateEvent()), *undo("a"), ("in", "a", "all"))
    content = scope(
        start(), sub("s", inner), boundary("go", "s", message("go")), work("b"), ("start", "s"), ("go", "b")
    )
    run = Driver(content)
    run.complete("a")
    run.deliver("go")
    assert run.open == ["b"]


def test_a_task_for_compensation_does_not_start_by_itself() -> None:
    content = scope(work("a"), node("h", Kind.USER_TASK, is_for_compensation=True))
    assert Driver(content).open == ["a"]
