"""Sequence flows, gateways, scripts, incidents at them."""

import pytest

from services.task_orchestrator.tests.unit.bpmn.execution.build import (
    Driver,
    end,
    inclusive,
    parallel,
    scope,
    script,
    start,
    when,
    work,
    xor,
)


def test_a_sequence_runs_to_its_end() -> None:
    run = Driver(scope(start(), work("a"), work("b"), end(), ("start", "a", "b", "end")), n=1)
    assert run.open == ["a"]
    run.complete("a", n=2)
    assert run.open == ["b"]
    assert run.variables == {"n": 2}
    run.complete("b")
    assert run.done


def test_an_exclusive_gateway_takes_the_first_condition_that_holds() -> None:
    content = scope(
        start(),
        xor("x", default="x_c"),
        work("a"),
        work("b"),
        work("c"),
        end(),
        when("x", "a", "n > 5"),
        when("x", "b", "n > 3"),
        ("x", "c"),
        ("start", "x"),
        ("a", "end"),
        ("b", "end"),
        ("c", "end"),
    )
    assert Driver(content, n=9).open == ["a"]
    assert Driver(content, n=4).open == ["b"]
    assert Driver(content, n=1).open == ["c"]


def test_a_gateway_without_match_is_an_incident_and_keeps_the_variables() -> None:
    content = scope(
        start(),
        work("a"),
        xor("x"),
        end(),
        ("start", "a", "x"),
        when("x", "end", "n > 5"),
        when("x", "a", "n == 0"),
    )
    run = Driver(content)
    run.complete("a", n=3)
    (incident,) = run.run.incidents()
    assert incident.element == "x"
    assert "n > 5" in incident.reason
    assert run.variables == {"n": 3}
    run.run.set_variables({"n": 7}, run.now)
    run.do("retry", "x")
    assert run.done


def test_parallel_branches_are_joined() -> None:
    content = scope(
        start(),
        parallel("f"),
        work("a"),
        work("b"),
        parallel("j"),
        work("c"),
        end(),
        ("start", "f", "a", "j", "c", "end"),
        ("f", "b", "j"),
    )
    run = Driver(content)
    assert run.open == ["a", "b"]
    run.complete("a", x=1)
    assert run.open == ["b"]
    run.complete("b", y=2)
    assert run.open == ["c"]
    assert run.variables == {"x": 1, "y": 2}


def test_an_implicit_split_and_merge() -> None:
    content = scope(
        start(), work("a"), work("b"), work("c"), end(), ("start", "a", "c", "end"), ("start", "b", "c")
    )
    run = Driver(content)
    run.complete("a")
    assert run.open == ["b", "c"]
    run.complete("b")
    assert run.open == ["c", "c"]
    run.complete("c")
    run.complete("c")
    assert run.done


def test_an_inclusive_join_waits_for_the_branches_that_were_taken() -> None:
    content = scope(
        start(),
        inclusive("f", default="f_c"),
        work("a"),
        work("b"),
        work("c"),
        inclusive("j"),
        work("d"),
        end(),
        ("start", "f"),
        when("f", "a", "x"),
        when("f", "b", "y"),
        ("f", "c"),
        ("a", "j"),
        ("b", "j"),
        ("c", "j", "d", "end"),
    )
    both = Driver(content, x=True, y=True)
    both.complete("a")
    assert both.open == ["b"]
    both.complete("b")
    assert both.open == ["d"]
    one = Driver(content, x=False, y=True)
    one.complete("b")
    assert one.open == ["d"]
    none = Driver(content, x=False, y=False)
    assert none.open == ["c"]


def test_a_join_that_no_token_can_reach_is_an_incident() -> None:
    content = scope(
        start(), xor("x", default="x_b"), work("a"), work("b"), parallel("j"), end(),
        ("start", "x"), when("x", "a", "false"), ("x", "b", "j", "end"), ("a", "j"),
    )  # fmt: skip
    run = Driver(content)
    run.complete("b")
    (incident,) = run.run.incidents()
    assert incident.element == "j"
    assert "a_j" in incident.reason


def test_an_endless_loop_without_a_wait_is_stopped() -> None:
    content = scope(
        start(), xor("x"), script("s", "n = n + 1"), xor("y", default="y_x"), end(),
        ("start", "x", "s", "y", "x"), when("y", "end", "n < 0"),
    )  # fmt: skip
    run = Driver(content, n=0)
    (incident,) = run.run.incidents()
    assert "without waiting" in incident.reason


@pytest.mark.parametrize("rounds", [1_000])
def test_a_loop_of_parallel_branches_costs_the_same_in_every_round(rounds: int) -> None:
    content = scope(
        start(), xor("x"), parallel("f"), work("a"), work("b"), parallel("j"), xor("y", default="y_x"), end(),
        ("start", "x", "f", "a", "j", "y", "x"), ("f", "b", "j"), when("y", "end", "stop"),
    )  # fmt: skip
    run = Driver(content, stop=False)
    size = 0
    for number in range(rounds):
        run.complete("a")
        run.complete("b", stop=number == rounds - 1)
        if number == 10:
            size = len(run.run.snapshot())
    assert run.done
    assert size > 0
    assert len(run.run.snapshot()) < 2 * size
