"""Incidents: at every stage, what an engineer does about them, and failures of the engine itself."""

from collections.abc import Iterator
from typing import Any

import orjson
import pytest

from handover_bpmn.execution import advance, events, propagation
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.state import RunFailed, TokenState
from handover_bpmn.languages.native import read
from handover_bpmn.model import Assignment, ConditionalEvent, Kind, Scope, TimerEvent, TimerType
from services.task_orchestrator.tests.unit.bpmn.execution.build import (
    NOW,
    Definitions,
    Driver,
    after,
    boundary,
    catch,
    definition,
    end,
    event_sub,
    inclusive,
    message,
    node,
    parallel,
    scope,
    script,
    start,
    sub,
    value,
    when,
    work,
    xor,
)

SEQUENCE = scope(start(), work("a"), work("b"), end(), ("start", "a", "b", "end"))


def stages(run: Driver) -> list[tuple[str, TokenState]]:
    return [(each.element, each.stage) for each in run.run.incidents()]


# Retry


def test_a_failed_activity_is_tried_again_with_a_new_visit() -> None:
    run = Driver(SEQUENCE)
    assert not run.fail("a", "E", "jammed")
    assert run.open == []
    (incident,) = run.run.incidents()
    assert (incident.reason, incident.visit, incident.since) == ("jammed", 1, NOW)
    assert run.run.visit(incident.token) is None
    run.do("retry", "a")
    assert [(each.token, each.visit) for each in run.run.open()] == [(incident.token, 2)]
    assert run.run.incidents() == ()


def test_an_activity_whose_task_cannot_be_created_is_an_incident() -> None:
    run = Driver(SEQUENCE)
    run.run.refuse(run.token("a"), "no performer", run.now)
    run.restore()
    assert stages(run) == [("a", TokenState.WORK)]


def test_an_incident_does_not_stop_its_neighbours() -> None:
    content = scope(
        start(), parallel("f"), work("a"), work("b"), catch("t", after("PT1M")), work("c"), end(),
        ("start", "f", "a", "end"), ("f", "b", "end"), ("f", "t", "c", "end"),
    )  # fmt: skip
    run = Driver(content)
    run.fail("a")
    run.complete("b")
    run.wait(minutes=1)
    assert run.open == ["c"]
    run.complete("c")
    assert not run.done
    run.do("retry", "a")
    run.complete("a")
    assert run.done


def test_boundary_events_continue_during_an_incident() -> None:
    content = scope(
        start(), work("a"), boundary("late", "a", after("PT5M")), work("b"), ("start", "a"), ("late", "b")
    )
    run = Driver(content)
    run.fail("a")
    run.wait(minutes=5)
    assert run.open == ["b"]
    assert run.run.incidents() == ()


def test_a_catch_event_that_cannot_wait_is_an_incident() -> None:
    content = scope(
        start(), catch("t", TimerEvent(TimerType.DURATION, value("pause"))), work("a"), ("start", "t", "a")
    )
    for pause in ("soon", 5, None, "P9999Y", "P99999Y"):
        run = Driver(content, pause=pause)
        assert stages(run) == [("t", TokenState.READY)]
        run.run.set_variables({"pause": "PT1M"}, run.now)
        run.do("retry", "t")
        run.wait(minutes=1)
        assert run.open == ["a"]


def test_an_event_based_gateway_that_cannot_wait_leaves_no_waits() -> None:
    content = scope(
        start(),
        node("which", Kind.EVENT_BASED),
        catch("m", message("go")),
        catch("n", message("x", "missing")),
        ("start", "which", "m"),
        ("which", "n"),
    )
    run = Driver(content)
    assert stages(run) == [("which", TokenState.READY)]
    assert run.run.subscriptions() == ()
    run.run.set_variables({"missing": 1}, run.now)
    run.do("retry", "which")
    assert len(run.run.subscriptions()) == 2


def test_an_event_subprocess_that_cannot_wait_is_an_incident_of_its_scope() -> None:
    handler = scope(start("begin", message("go", "missing")), work("h"), ("begin", "h"))
    inner = scope(start("in"), work("a"), end("out"), ("in", "a", "out"), event_sub("e", handler))
    run = Driver(scope(start(), sub("s", inner), ("start", "s")))
    assert stages(run) == [("s", TokenState.READY)]
    run.run.set_variables({"missing": 1}, run.now)
    run.do("retry", "s")
    assert run.open == ["a"]
    assert len(run.run.subscriptions()) == 1


def test_an_event_subprocess_within_one_that_cannot_wait_is_an_incident_beside_its_tokens() -> None:
    deeper = scope(start("begin2", message("stop", "missing")), work("h2"), ("begin2", "h2"))
    handler = scope(start("begin", message("go")), work("h"), ("begin", "h"), event_sub("e2", deeper))
    run = Driver(scope(start(), work("a"), ("start", "a"), event_sub("e", handler)))
    run.deliver("go")
    assert run.open == ["h"]
    assert stages(run) == [("e", TokenState.SCOPE)]
    run.run.set_variables({"missing": 1}, run.now)
    run.do("retry", "e")
    assert [each.name for each in run.run.subscriptions()] == ["stop"]
    assert run.run.incidents() == ()
    run.complete("h")
    assert run.done


def test_a_process_whose_event_subprocess_cannot_wait_does_not_start() -> None:
    handler = scope(start("begin", message("go", "missing")), work("h"), ("begin", "h"))
    content = scope(start(), work("a"), ("start", "a"), event_sub("e", handler))
    library = Definitions([definition(content)])
    with pytest.raises(RunFailed, match="missing"):
        Run.start(library.plans["p"], {}, NOW, library)


def test_a_gateway_after_an_activity_fails_without_repeating_the_activity() -> None:
    outputs = (Assignment("n", value("n + 1")),)
    content = scope(
        start(), work("a", outputs=outputs), work("b"), work("c"), ("start", "a"), when("a", "b", "x > 1"),
        when("a", "c", "x > 2"),
    )  # fmt: skip
    run = Driver(content, n=0, x=0)
    run.complete("a", result=7)
    assert stages(run) == [("a", TokenState.LEAVING)]
    assert run.variables["n"] == 1
    run.run.set_variables({"x": 2}, run.now)
    run.do("retry", "a")
    assert run.open == ["b"]
    assert run.variables["n"] == 1


def test_a_join_that_is_never_complete_is_complete_after_a_token_was_moved_there() -> None:
    content = scope(
        start(), xor("x", default="x_b"), work("a"), parallel("f"), work("b"), work("d"), parallel("j"),
        work("c"), end(),
        ("start", "f", "x", "b", "j", "c", "end"), when("x", "a", "false"), ("a", "j"), ("f", "d", "end"),
    )  # fmt: skip
    run = Driver(content)
    run.complete("b")
    assert run.run.incidents() == ()
    run.run.move(run.token("d"), "a", run.now)
    run.restore()
    run.complete("a")
    assert run.open == ["c"]

    stalled = Driver(content)
    stalled.complete("d")
    stalled.complete("b")
    assert stages(stalled) == [("j", TokenState.JOINED)]
    stalled.do("retry", "j")
    assert stages(stalled) == [("j", TokenState.JOINED)]
    stalled.do("skip", "j", {"x": 1})
    assert stalled.open == ["c"]
    assert stalled.variables == {"x": 1}


def test_a_token_that_is_moved_to_a_join_counts_for_a_branch_that_is_missing() -> None:
    content = scope(
        start(), parallel("f"), work("a"), work("b"), parallel("j"), work("c"),
        ("start", "f", "a", "j", "c"), ("f", "b", "j"),
    )  # fmt: skip
    run = Driver(content)
    run.complete("a")
    run.run.move(run.token("b"), "j", run.now)
    run.restore()
    assert run.open == ["c"]


def test_inclusive_joins_that_wait_for_each_other_are_incidents() -> None:
    content = scope(
        start(), parallel("f"), inclusive("j1"), inclusive("j2"), work("a"), work("b"), end(),
        ("start", "f", "j1", "a", "j2"), ("f", "j2", "b", "j1"), when("j2", "end", "false"),
    )  # fmt: skip
    run = Driver(content)
    assert len(run.run.incidents()) == 2


# Skip, move, cancel


def test_a_skipped_activity_leaves_with_the_given_variables() -> None:
    run = Driver(SEQUENCE)
    run.run.skip(run.token("a"), {"x": 1}, run.now)
    run.restore()
    assert run.open == ["b"]
    assert run.variables == {"x": 1}


def test_a_skipped_subprocess_leaves_with_its_tokens_and_waits() -> None:
    handler = scope(start("begin", message("go")), work("h"), ("begin", "h"))
    inner = scope(start("in"), work("a"), ("in", "a"), event_sub("e", handler))
    run = Driver(
        scope(start(), sub("s", inner), boundary("m", "s", message("m")), work("b"), ("start", "s", "b"))
    )
    token = str(next(each.id for each in run.run._state.tokens.values() if each.node == "s"))
    run.run.skip(token, {}, run.now)
    run.restore()
    assert run.open == ["b"]
    assert run.run.subscriptions() == ()


def test_an_event_based_gateway_is_not_skipped_but_moved() -> None:
    content = scope(
        start(),
        node("which", Kind.EVENT_BASED),
        catch("m", message("go")),
        catch("n", message("x")),
        work("a"),
        ("start", "which", "m", "a"),
        ("which", "n", "a"),
    )
    run = Driver(content)
    (token,) = run.run._state.tokens
    with pytest.raises(RunFailed, match="gateway"):
        run.run.skip(str(token), {}, run.now)
    run.run.move(str(token), "a", run.now)
    run.restore()
    assert run.open == ["a"]
    assert run.run.subscriptions() == ()


def test_a_token_is_moved_within_its_scope() -> None:
    run = Driver(SEQUENCE)
    run.fail("a")
    run.do("move", "a", "b")
    assert run.open == ["b"]
    with pytest.raises(RunFailed, match="no element"):
        run.run.move(run.token("b"), "nowhere", run.now)
    assert run.open == ["b"]


def test_a_boundary_event_is_no_place_for_a_token() -> None:
    run = Driver(scope(start(), work("a"), boundary("m", "a", message("go")), ("start", "a")))
    with pytest.raises(RunFailed):
        run.run.move(run.token("a"), "m", run.now)


def test_a_cancelled_token_ends_its_scope_if_it_was_the_last() -> None:
    inner = scope(start("in"), parallel("f"), work("a"), work("b"), ("in", "f", "a"), ("f", "b"))
    run = Driver(scope(start(), sub("s", inner), work("c"), ("start", "s", "c")))
    for activity in ("a", "b", "c"):
        run.fail(activity)
        run.do("cancel_token", activity)
    assert run.done


def test_a_cancelled_token_completes_an_inclusive_join() -> None:
    content = scope(
        start(), parallel("f"), work("a"), work("b"), inclusive("j"), work("c"),
        ("start", "f", "a", "j", "c"), ("f", "b", "j"),
    )  # fmt: skip
    run = Driver(content)
    run.complete("a")
    run.run.cancel_token(run.token("b"), run.now)
    run.restore()
    assert run.open == ["c"]


def test_what_is_impossible_is_refused_and_changes_nothing() -> None:
    run = Driver(SEQUENCE)
    token = run.token("a")
    before = run.run.snapshot()
    for act in (
        lambda: run.run.retry(token, run.now),
        lambda: run.run.retry("77", run.now),
        lambda: run.run.complete("77", {}, run.now),
        lambda: run.run.complete("x", {}, run.now),
        lambda: run.run.cancel_token("", run.now),
    ):
        with pytest.raises(RunFailed):
            act()
    assert run.run.snapshot() == before
    assert run.run.element("x") is None
    assert run.run.element(token) == "a"
    run.fail("a")
    with pytest.raises(RunFailed, match="nobody works"):
        run.run.complete(token, {}, run.now)


# Failures of the engine, and variables that cannot be stored


class Broken(Exception):
    pass


@pytest.fixture
def broken(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Break the function that each test names, until it calls `undo`."""
    with monkeypatch.context() as patch:
        yield patch


def breaks(*_: Any, **__: Any) -> None:
    raise Broken("a bug")


def test_a_failure_of_the_engine_restores_the_state_and_can_be_retried(broken: pytest.MonkeyPatch) -> None:
    run = Driver(SEQUENCE)
    run.run.set_variables({"x": 1}, run.now)  # no snapshot was asked for after it
    token = run.token("a")
    broken.setattr(advance, "enter", breaks)
    run.complete("a", n=1)
    (incident,) = run.run.incidents()
    assert (incident.token, incident.element, incident.stage) == (token, "a", TokenState.FINISHING)
    assert "a bug" in incident.reason
    assert run.variables == {"x": 1}
    broken.undo()
    run.do("retry", "a")
    assert run.open == ["b"]
    assert run.variables == {"x": 1, "n": 1}


def test_a_retry_that_fails_again_keeps_the_incident(broken: pytest.MonkeyPatch) -> None:
    run = Driver(SEQUENCE)
    broken.setattr(advance, "enter", breaks)
    run.complete("a", n=1)
    with pytest.raises(RunFailed, match="a bug"):
        run.run.retry(run.incident("a"), run.now)
    assert run.incident("a")
    broken.undo()
    run.do("retry", "a")
    assert run.variables == {"n": 1}


def test_a_process_whose_start_fails_has_an_incident_at_its_start(broken: pytest.MonkeyPatch) -> None:
    broken.setattr(advance, "enter", breaks)
    run = Driver(SEQUENCE)
    assert stages(run) == [("start", TokenState.READY)]
    broken.undo()
    run.do("retry", "start")
    assert run.open == ["a"]


def test_an_event_whose_processing_fails_waits_for_a_retry(broken: pytest.MonkeyPatch) -> None:
    content = scope(
        start(),
        work("a"),
        boundary("late", "a", after("PT5M")),
        boundary("m", "a", message("go")),
        work("b"),
        ("start", "a"),
        ("late", "b"),
        ("m", "b"),
    )
    run = Driver(content)
    broken.setattr(propagation, "start_boundary", breaks)
    broken.setattr(events, "start_boundary", breaks)
    run.wait(minutes=5)
    assert run.open == ["a"]
    assert stages(run) == [("a", TokenState.WORK)]
    assert run.run.next_due() is None
    run.deliver("go", n=1)
    assert run.run.subscriptions() == ()
    broken.undo()
    run.do("retry", "a")
    assert run.open == ["b"]


def test_an_activity_with_a_failed_event_can_complete(broken: pytest.MonkeyPatch) -> None:
    run = Driver(
        scope(start(), work("a"), boundary("late", "a", after("PT5M")), work("b"), ("start", "a", "b"))
    )
    broken.setattr(events, "start_boundary", breaks)
    run.wait(minutes=5)
    run.complete("a")
    assert run.open == ["b"]
    assert run.run.incidents() == ()


def test_a_failed_message_is_processed_with_its_variables_by_a_retry(broken: pytest.MonkeyPatch) -> None:
    run = Driver(scope(start(), catch("m", message("go")), work("a"), ("start", "m", "a")))
    broken.setattr(advance, "enter", breaks)
    run.deliver("go", n=1)
    assert stages(run) == [("m", TokenState.WAITING)]
    broken.undo()
    run.do("retry", "m")
    assert run.open == ["a"]
    assert run.variables == {"n": 1}


def test_a_failed_start_of_an_event_subprocess_is_retried(broken: pytest.MonkeyPatch) -> None:
    handler = scope(start("begin", message("go"), interrupting=False), work("h"), ("begin", "h"))
    for content in (
        scope(start(), work("a"), ("start", "a"), event_sub("e", handler)),
        scope(
            start(),
            sub("s", scope(start("in"), work("a"), ("in", "a"), event_sub("e", handler))),
            ("start", "s"),
        ),
    ):
        run = Driver(content)
        broken.setattr(advance, "enter", breaks)
        run.deliver("go", n=1)
        broken.undo()
        (incident,) = run.run.incidents()
        run.run.retry(incident.token, run.now)
        run.restore()
        assert run.open == ["a", "h"]
        assert run.variables == {"n": 1}


@pytest.mark.parametrize("huge", ["x" * 5_000_000, object()])
def test_results_that_cannot_be_stored_are_an_incident_without_them(huge: object) -> None:
    run = Driver(SEQUENCE)
    run.run.set_variables({"x": 1}, run.now)
    run.complete("a", n=huge)
    assert stages(run) == [("a", TokenState.WORK)]
    assert run.variables == {"x": 1}
    run.do("retry", "a")
    run.complete("a", n=1)
    assert run.open == ["b"]


def test_other_variables_that_cannot_be_stored_are_refused() -> None:
    content = scope(start(), catch("m", message("go")), work("a"), ("start", "m", "a"))
    run = Driver(content)
    (found,) = run.run.subscriptions()
    with pytest.raises(RunFailed, match="bytes"):
        run.run.deliver(found.wait, {"n": "x" * 5_000_000}, run.now)
    with pytest.raises(RunFailed, match="bytes"):
        run.run.set_variables({"n": "x" * 5_000_000}, run.now)
    assert run.variables == {}
    assert len(run.run.subscriptions()) == 1


def test_effects_of_a_step_that_failed_are_not_sent(broken: pytest.MonkeyPatch) -> None:
    content = scope(
        start(),
        work("a"),
        node("send", Kind.SEND_TASK, event=message("x")),
        work("b"),
        ("start", "a", "send", "b"),
    )
    run = Driver(content)
    original = advance.enter

    def breaks_at_b(machine: Any, token: Any, found: Any) -> None:
        if found.id == "b":
            raise Broken
        original(machine, token, found)

    broken.setattr(advance, "enter", breaks_at_b)
    run.complete("a")
    assert run.effects == []
    broken.undo()
    run.do("retry", "a")
    assert len(run.effects) == 1


def test_a_condition_that_cannot_be_evaluated_is_not_true() -> None:
    run = Driver(scope(start(), catch("c", ConditionalEvent(read("x > 1"))), work("a"), ("start", "c", "a")))
    run.run.set_variables({"x": "text"}, run.now)
    assert run.open == []
    run.run.set_variables({"x": 2}, run.now)
    assert run.open == ["a"]


def test_a_snapshot_of_another_format_is_refused() -> None:
    run = Driver(SEQUENCE)
    content = orjson.loads(run.run.snapshot())
    content["version"] = 2
    with pytest.raises(RunFailed, match="format 2"):
        Run.resume(run.library.plans["p"], orjson.dumps(content), run.library)


def test_variables_of_open_activities_do_not_change_later() -> None:
    run = Driver(SEQUENCE, n=1)
    (found,) = run.run.open()
    run.run.set_variables({"n": 2}, run.now)
    assert found.variables == {"n": 1}


def test_a_script_in_an_endless_cycle_of_scopes_is_stopped() -> None:
    inner: Scope = scope(start("in"), script("s", "n = n + 1"), end("out"), ("in", "s", "out"))
    run = Driver(scope(start(), sub("s", inner), ("start", "s", "s")), n=0)
    assert "without waiting" in run.run.incidents()[0].reason
