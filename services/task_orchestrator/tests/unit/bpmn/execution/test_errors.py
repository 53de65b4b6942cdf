"""Errors: where they are caught, and what happens to those that nothing catches."""

import pytest

from handover_bpmn.model import ErrorEvent, Node, Scope
from services.task_orchestrator.tests.unit.bpmn.execution.build import (
    Driver,
    boundary,
    call,
    definition,
    end,
    event_sub,
    parallel,
    scope,
    start,
    sub,
    work,
)


def on_error(name: str, code: str | None, activity: str) -> Node:
    return event_sub(
        name, scope(start(f"{name}_begin", ErrorEvent(code)), work(activity), (f"{name}_begin", activity))
    )


def layers(*catchers: str) -> Scope:
    """A task in a subprocess in a called process; of its possible catchers only those named."""
    inner = scope(
        start("in"), work("a"), end("out"), ("in", "a", "out"),
        *([boundary("at_task", "a", ErrorEvent("E")), work("by_task"), ("at_task", "by_task")]
          if "task" in catchers else []),
        *([on_error("in_sub", "E", "by_in_sub")] if "in_sub" in catchers else []),
    )  # fmt: skip
    return scope(
        start(), sub("s", inner), work("other"), parallel("f"), end(), ("start", "f", "s", "end"),
        ("f", "other", "end"),
        *([boundary("at_sub", "s", ErrorEvent("E")), work("by_sub"), ("at_sub", "by_sub")]
          if "sub" in catchers else []),
        *([on_error("in_process", "E", "by_in_process")] if "in_process" in catchers else []),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("catchers", "open_"),
    [
        (("task", "in_sub", "sub", "in_process"), ["by_task", "other"]),
        (("in_sub", "sub", "in_process"), ["by_in_sub", "other"]),
        (("sub", "in_process"), ["by_sub", "other"]),
        (("in_process",), ["by_in_process"]),
        ((), ["other"]),
    ],
)
def test_an_error_is_caught_at_the_nearest_level(catchers: tuple[str, ...], open_: list[str]) -> None:
    run = Driver(layers(*catchers))
    assert run.fail("a", "E", "jammed") == bool(catchers)
    assert run.open == open_
    if catchers:
        assert run.variables["error"] == {"activity": "a", "code": "E", "reason": "jammed"}
        assert run.run.incidents() == ()
    else:
        (incident,) = run.run.incidents()
        assert (incident.reason, incident.details) == ("jammed", {"code": "E", "task": None})


def test_an_error_with_another_code_is_not_caught() -> None:
    run = Driver(layers("task", "in_sub", "sub", "in_process"))
    assert not run.fail("a", "F")
    assert not Driver(layers("task")).fail("a", None)


def test_a_code_comes_before_an_event_that_catches_all() -> None:
    content = scope(
        start(), work("a"), boundary("any", "a", ErrorEvent()), boundary("e", "a", ErrorEvent("E")),
        work("by_any"), work("by_e"), ("start", "a"), ("any", "by_any"), ("e", "by_e"),
    )  # fmt: skip
    for code, activity in (("E", "by_e"), ("F", "by_any"), (None, "by_any")):
        run = Driver(content)
        assert run.fail("a", code)
        assert run.open == [activity]


def test_variables_get_the_code_and_the_reason() -> None:
    event = ErrorEvent(None, code_variable="code", message_variable="why")
    run = Driver(scope(start(), work("a"), boundary("e", "a", event), work("b"), ("start", "a"), ("e", "b")))
    run.fail("a", "E7", "jammed")
    assert run.variables == {
        "code": "E7",
        "why": "jammed",
        "error": {"activity": "a", "code": "E7", "reason": "jammed"},
    }


def test_an_error_end_event_is_caught_by_the_boundary_of_its_subprocess() -> None:
    inner = scope(
        start("in"), parallel("f"), work("a"), work("b"), end("bad", ErrorEvent("E")),
        ("in", "f", "a", "bad"), ("f", "b"),
    )  # fmt: skip
    run = Driver(
        scope(
            start(),
            sub("s", inner),
            boundary("e", "s", ErrorEvent("E")),
            work("c"),
            end(),
            ("start", "s", "end"),
            ("e", "c", "end"),
        )
    )
    run.complete("a")
    assert run.open == ["c"]
    run.complete("c")
    assert run.done


def test_an_error_end_event_that_nothing_catches_ends_the_process_failed() -> None:
    called = definition(
        scope(
            start(),
            parallel("f"),
            work("b"),
            end("bad", ErrorEvent("E")),
            ("start", "f", "b", "bad"),
            ("f", "b"),
        ),
        "called",
    )
    content = scope(start(), parallel("f"), call("c", "called"), work("a"), ("start", "f", "c"), ("f", "a"))
    run = Driver(content, called)
    run.complete("c.b")
    assert run.open == []
    assert not run.done
    assert run.run.failure is not None
    assert "bad" in run.run.failure
    assert run.run.waiting() == ()


def test_an_error_within_an_event_subprocess_goes_to_the_outer_scope() -> None:
    handler = scope(start("begin", ErrorEvent("E")), end("again", ErrorEvent("E")), ("begin", "again"))
    inner = scope(start("in"), work("a"), ("in", "a"), event_sub("h", handler))
    content = scope(
        start(), sub("s", inner), boundary("e", "s", ErrorEvent("E")), work("b"), ("start", "s"), ("e", "b")
    )
    run = Driver(content)
    assert run.fail("a", "E")
    assert run.open == ["b"]


def test_an_error_in_a_handler_for_errors_that_nothing_catches_is_an_incident() -> None:
    run = Driver(scope(start(), work("a"), ("start", "a"), on_error("h", "E", "b")))
    assert run.fail("a", "E")
    assert not run.fail("b", "E")
    assert run.incident("b")
