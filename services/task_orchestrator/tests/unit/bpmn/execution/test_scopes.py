"""Scopes: subprocesses, called processes, their variables and data objects."""

from dataclasses import replace
from datetime import datetime
from typing import Any

import pytest

from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.state import RunFailed
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.model import (
    Assignment,
    DataAssociation,
    ErrorEvent,
    Kind,
    ProcessParameter,
    TerminateEvent,
    Value,
)
from services.task_orchestrator.tests.unit.bpmn.execution.build import (
    NOW,
    Definitions,
    Driver,
    boundary,
    call,
    catch,
    definition,
    end,
    event_sub,
    message,
    node,
    parallel,
    scope,
    script,
    start,
    sub,
    throw,
    value,
    work,
)

# Subprocesses


def test_a_called_process_has_the_business_key_that_its_call_gives() -> None:
    waiting = definition(scope(start(), catch("wait", message("go")), ("start", "wait")), "called")
    content = scope(start(), call("c", "called", key=value("order")), ("start", "c"))
    run = Driver(content, waiting, order="order 7")
    (subscription,) = run.run.subscriptions()
    assert subscription.business_key == "order 7"
    without = Driver(scope(start(), call("c", "called"), ("start", "c")), waiting)
    assert without.run.subscriptions()[0].business_key is None
    key = Value(expression=read_juel("${execution.businessKey}"))
    reading = Assignment("known", key)
    asks = replace(script("s", "x = 1"), script=(reading,))
    nested = definition(scope(start(), asks, work("w"), ("start", "s", "w")), "called")
    read = Driver(content, nested, order="order 7")
    assert read.run.open()[0].variables["known"] == "order 7"


def test_a_subprocess_runs_to_its_end() -> None:
    inner = scope(
        start("in"), parallel("f"), work("a"), work("b"), end("out"), end("out2"),
        ("in", "f", "a", "out"), ("f", "b", "out2"),
    )  # fmt: skip
    run = Driver(scope(start(), sub("s", inner), work("c"), end(), ("start", "s", "c", "end")))
    run.complete("a")
    assert run.open == ["b"]
    run.complete("b")
    assert run.open == ["c"]


def test_subprocesses_are_nested() -> None:
    deepest = scope(start("i3"), work("a"), end("o3"), ("i3", "a", "o3"))
    middle = scope(start("i2"), sub("s3", deepest), end("o2"), ("i2", "s3", "o2"))
    inner = scope(start("i1"), sub("s2", middle), end("o1"), ("i1", "s2", "o1"))
    run = Driver(scope(start(), sub("s1", inner), end(), ("start", "s1", "end")))
    assert run.open == ["a"]
    run.complete("a", n=1)
    assert run.done
    assert run.variables == {"n": 1}


def test_a_subprocess_without_start_event_starts_at_all_nodes_without_incoming_flow() -> None:
    run = Driver(scope(start(), sub("s", scope(work("a"), work("b"))), end(), ("start", "s", "end")))
    assert run.open == ["a", "b"]


def test_an_empty_subprocess_passes() -> None:
    run = Driver(scope(start(), sub("s", scope()), work("a"), ("start", "s", "a")))
    assert run.open == ["a"]


def test_a_subprocess_that_starts_with_an_event_is_an_incident() -> None:
    inner = scope(start("in", message("go")), end("out"), ("in", "out"))
    run = Driver(scope(start(), sub("s", inner), end(), ("start", "s", "end")))
    assert "starts with an event" in run.run.incidents()[0].reason


def test_the_visits_of_an_element_are_counted() -> None:
    inner = scope(start("in"), work("a"), end("out"), ("in", "a", "out"))
    run = Driver(scope(start(), sub("s", inner), ("start", "s", "s")))
    for visit in (1, 2, 3):
        assert [each.visit for each in run.run.open()] == [visit]
        run.complete("a")


# Variables


def test_input_variables_are_local_and_results_go_to_the_process() -> None:
    content = scope(
        start(), work("a", inputs=(Assignment("x", value("n + 1")),)), work("b"), end(),
        ("start", "a", "b", "end"),
    )  # fmt: skip
    run = Driver(content, n=1)
    (found,) = run.run.open()
    assert dict(found.variables) == {"n": 1, "x": 2}
    run.complete("a", y=3)
    assert run.variables == {"n": 1, "y": 3}


def test_output_mappings_replace_the_results() -> None:
    outputs = (Assignment("total", value("a + n")), Assignment("copy", value("local")))
    content = scope(
        start(), work("a", inputs=(Assignment("local", Value(5)),), outputs=outputs), end(),
        ("start", "a", "end"),
    )  # fmt: skip
    run = Driver(content, n=1)
    run.complete("a", a=2)
    assert run.variables == {"n": 1, "total": 3, "copy": 5}


def test_variables_of_a_subprocess_with_a_local_variable_of_that_name_stay_there() -> None:
    inner = scope(
        start("in"), script("s1", "x = x + 1\ny = x"), work("a"), script("s2", "x = x + 1\nz = x"),
        end("out"), ("in", "s1", "a", "s2", "out"),
    )  # fmt: skip
    content = scope(
        start(),
        sub("s", inner, inputs=(Assignment("x", Value(10)),), outputs=(Assignment("result", value("x")),)),
        end(),
        ("start", "s", "end"),
    )
    run = Driver(content, x=1)
    assert run.run.open()[0].variables["x"] == 11
    run.complete("a", x=20)
    assert run.done
    assert run.variables == {"x": 1, "y": 11, "z": 21, "result": 21}


def test_an_engineer_sets_variables_where_the_token_sees_them() -> None:
    inner = scope(start("in"), work("a"), end("out"), ("in", "a", "out"))
    content = scope(
        start(), sub("s", inner, inputs=(Assignment("x", Value(10)),)), end(), ("start", "s", "end")
    )
    run = Driver(content, x=1, y=1)
    run.run.set_variables({"x": 2, "y": 2, "z": 2}, run.now, token=run.token("a"))
    run.restore()
    assert run.run.open()[0].variables["x"] == 2
    assert run.variables == {"x": 1, "y": 2, "z": 2}


def test_an_input_mapping_that_fails_is_an_incident_and_leaves_nothing_behind() -> None:
    content = scope(
        start(),
        work("a", inputs=(Assignment("x", Value(1)), Assignment("y", value("missing")))),
        boundary("go", "a", message("go")),
        end(),
        ("start", "a", "end"),
        ("go", "end"),
    )
    run = Driver(content)
    assert run.run.subscriptions() == ()
    run.run.set_variables({"missing": 5}, run.now)
    run.do("retry", "a")
    assert run.open == ["a"]
    assert len(run.run.subscriptions()) == 1


def test_an_output_mapping_that_fails_keeps_the_results_for_a_retry() -> None:
    outputs = (Assignment("total", value("a + missing")),)
    run = Driver(scope(start(), work("a", outputs=outputs), work("b"), ("start", "a", "b")))
    run.complete("a", a=2)
    assert run.open == []
    run.run.set_variables({"missing": 5}, run.now)
    run.do("retry", "a")
    assert run.open == ["b"]
    assert run.variables == {"missing": 5, "total": 7}


def test_a_script_sees_what_it_has_set_and_a_failed_one_sets_nothing() -> None:
    run = Driver(scope(start(), script("s", "x = 1\ny = x + n"), end(), ("start", "s", "end")))
    assert run.variables == {}
    run.run.set_variables({"n": 1}, run.now)
    run.do("retry", "s")
    assert run.variables == {"n": 1, "x": 1, "y": 2}


# Data objects


def data_content(**changes: Any) -> Any:
    return scope(
        start(),
        work("a", data_outputs=(DataAssociation("d1", "part"), DataAssociation("d2", None)), **changes),
        work("b", data_inputs=(DataAssociation("d1", "piece"), DataAssociation("d2", None))),
        end(),
        ("start", "a", "b", "end"),
        data_objects={"d1": "Part", "d2": "All"},
    )


def test_data_objects_are_no_variables() -> None:
    run = Driver(data_content())
    run.complete("a", part=7, other=8)
    (found,) = run.run.open()
    assert dict(found.data) == {"piece": 7, "d2": {"part": 7, "other": 8}}
    assert "d1" not in found.variables
    assert run.variables == {"part": 7, "other": 8}


def test_data_objects_get_the_results_even_if_the_variables_are_mapped() -> None:
    run = Driver(data_content(outputs=(Assignment("x", value("part")),)))
    run.complete("a", part=7)
    assert run.run.open()[0].data["piece"] == 7
    assert run.variables == {"x": 7}


def test_a_data_object_of_the_process_is_used_in_a_subprocess() -> None:
    inner = scope(
        start("in"), work("a", data_outputs=(DataAssociation("d", "x"), DataAssociation("own", "x"))),
        end("out"), ("in", "a", "out"), data_objects={"own": "own"},
    )  # fmt: skip
    content = scope(
        start(), sub("s", inner),
        work("b", data_inputs=(DataAssociation("d", "x"), DataAssociation("own", "y"))),
        ("start", "s", "b"), data_objects={"d": "d"},
    )  # fmt: skip
    run = Driver(content)
    run.complete("a", x=3)
    assert dict(run.run.open()[0].data) == {"x": 3, "y": None}


# Call activities

CALLED = definition(
    scope(start(), work("b"), script("s", "y = x + 1"), end(), ("start", "b", "s", "end")), "called"
)


def caller(**changes: Any) -> Any:
    return scope(start(), call("c", "called", **changes), work("a"), end(), ("start", "c", "a", "end"))


def test_a_call_activity_maps_variables_in_and_out() -> None:
    content = caller(
        inputs=(Assignment("x", value("n * 2")),), outputs=(Assignment("result", value("y + z")),)
    )
    run = Driver(content, CALLED, n=5)
    (found,) = run.run.open()
    assert (found.element, dict(found.variables)) == ("c.b", {"x": 10})
    run.complete("c.b", z=1)
    assert run.open == ["a"]
    assert run.variables == {"n": 5, "result": 12}


def test_a_call_activity_passes_all_variables() -> None:
    run = Driver(caller(all_inputs=True, all_outputs=True), CALLED, x=5)
    run.complete("c.b", z=1)
    assert run.variables == {"x": 5, "y": 6, "z": 1}


def test_a_call_activity_passes_nothing_by_itself() -> None:
    run = Driver(caller(inputs=(Assignment("x", Value(1)),)), CALLED, secret=5)
    assert "secret" not in run.run.open()[0].variables
    run.complete("c.b")
    assert run.variables == {"secret": 5}


def test_all_variables_are_those_that_the_called_process_has_as_parameters() -> None:
    called = replace(CALLED, parameters={"x": ProcessParameter("x", required=True)})
    run = Driver(caller(all_inputs=True), called, x=1, other=2)
    assert dict(run.run.open()[0].variables) == {"x": 1}


def test_a_missing_parameter_is_an_incident_at_the_call() -> None:
    called = replace(CALLED, parameters={"x": ProcessParameter("x", required=True)})
    run = Driver(caller(all_inputs=True), called)
    (incident,) = run.run.incidents()
    assert incident.element == "c"
    assert '"x"' in incident.reason
    run.run.set_variables({"x": 1}, run.now)
    run.do("retry", "c")
    assert run.open == ["c.b"]


def test_outputs_that_fail_are_an_incident_even_if_the_process_has_no_variables() -> None:
    called = definition(scope(start(), work("b"), end(), ("start", "b", "end")), "called")
    run = Driver(caller(outputs=(Assignment("result", value("y")),)), called)
    run.complete("c.b")
    assert run.incident("c")
    run.do("retry", "c")
    assert run.incident("c")
    run.run.skip(run.incident("c"), {"result": 1}, run.now)
    assert run.open == ["a"]
    assert run.variables == {"result": 1}


class Versions(Definitions):
    """A process with two versions, of which the first has the tag "old"."""

    def __init__(self, main: Any, *versions: Any) -> None:
        super().__init__([main])
        self.versions = [Plan(each, number) for number, each in enumerate(versions, start=1)]

    def plan(self, name: str, version: int) -> Plan:
        return super().plan(name, version) if name == "p" else self.versions[version - 1]

    def find(self, name: str, version: int | None, tag: str | None) -> Plan:
        if name == "p":
            return super().find(name, version, tag)
        if tag is not None:
            version = {"old": 1}.get(tag)
            if version is None:
                raise RunFailed(f'there is no version "{tag}"')
        return self.versions[(version or len(self.versions)) - 1]


@pytest.mark.parametrize(
    ("changes", "element"),
    [
        ({}, "c.new"),
        ({"version": Value(1)}, "c.old"),
        ({"version": Value("1")}, "c.old"),
        ({"version": value("n")}, "c.new"),
        ({"tag": Value("old")}, "c.old"),
    ],
)
def test_a_version_is_called(changes: dict[str, Any], element: str) -> None:
    old = definition(scope(start(), work("old"), ("start", "old")), "called")
    new = definition(scope(start(), work("new"), ("start", "new")), "called")
    library = Versions(definition(caller(**changes)), old, new)
    run = Run.start(library.plans["p"], {"n": 2}, NOW, library)
    restored = Run.resume(library.plans["p"], run.snapshot(), library)
    assert [each.element for each in restored.open()] == [element]


@pytest.mark.parametrize("changes", [{"version": Value("latest")}, {"version": value("n")}])
def test_what_is_no_version_is_an_incident(changes: dict[str, Any]) -> None:
    assert Driver(caller(**changes), CALLED, n=None).incident("c")


def test_a_process_that_does_not_exist_is_an_incident() -> None:
    run = Driver(caller())
    (incident,) = run.run.incidents()
    assert incident.element == "c"
    assert '"called"' in incident.reason


def test_a_called_process_that_starts_with_an_event_is_an_incident() -> None:
    called = definition(scope(start("s", message("go")), end(), ("s", "end")), "called")
    run = Driver(caller(), called)
    assert "starts with an event" in run.run.incidents()[0].reason


def test_processes_that_call_each_other_for_ever_are_an_incident() -> None:
    cycle = definition(scope(start(), call("again", "called"), ("start", "again")), "called")
    run = Driver(caller(), cycle)
    (incident,) = run.run.incidents()
    assert "cycle" in incident.reason
    assert run.open == []


def test_ids_with_dots_do_not_count_as_calls() -> None:
    name = "a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s.t.u.v"
    once = Driver(scope(start(), call(name, "other"), ("start", name)), replace(CALLED, name="other"))
    assert once.open == [f"{name}.b"]


def test_calls_within_calls_have_nested_names() -> None:
    middle = definition(scope(start(), call("d", "called"), ("start", "d")), "middle")
    run = Driver(scope(start(), call("c", "middle"), end(), ("start", "c", "end")), middle, CALLED, x=1)
    assert run.open == ["c.d.b"]
    assert run.run.waiting() == ("c", "c.d", "c.d.b")


def test_a_terminate_event_ends_only_the_called_process() -> None:
    called = definition(
        scope(
            start(),
            parallel("f"),
            work("b"),
            end("stop", TerminateEvent()),
            ("start", "f", "b"),
            ("f", "stop"),
        ),
        "called",
    )
    assert Driver(caller(), called).open == ["a"]


def test_a_cancelled_call_activity_takes_its_process_along() -> None:
    content = scope(
        start(), call("c", "called"), boundary("go", "c", message("go")), work("a"),
        ("start", "c"), ("go", "a"),
    )  # fmt: skip
    run = Driver(content, CALLED, x=1)
    run.deliver("go")
    assert run.open == ["a"]


def test_an_error_of_a_called_process_is_caught_at_the_call() -> None:
    called = definition(scope(start(), end("bad", ErrorEvent("E1")), ("start", "bad")), "called")
    content = scope(
        start(),
        call("c", "called"),
        boundary("e", "c", ErrorEvent("E1")),
        work("a"),
        ("start", "c"),
        ("e", "a"),
    )
    run = Driver(content, called)
    assert run.open == ["a"]
    assert run.variables["error"]["code"] == "E1"


def test_an_event_subprocess_of_a_called_process() -> None:
    handler = scope(start("begin", message("go")), throw("t", None), work("h"), ("begin", "t", "h"))
    called = definition(
        scope(start(), work("b"), end(), ("start", "b", "end"), event_sub("e", handler)), "called"
    )
    run = Driver(caller(), called)
    assert [each.element for each in run.run.subscriptions()] == ["c.begin"]
    run.deliver("go")
    assert run.open == ["c.h"]
    run.complete("c.h")
    assert run.open == ["a"]


def test_a_task_without_work_passes() -> None:
    kinds = (Kind.TASK, Kind.MANUAL_TASK, Kind.USER_TASK, Kind.SERVICE_TASK, Kind.BUSINESS_RULE_TASK)
    for kind in kinds:
        assert Driver(scope(start(), node("t", kind), end(), ("start", "t", "end"))).done


def test_expressions_read_the_time_of_the_step_and_the_execution_but_no_variable_shows_them() -> None:
    both = Assignment("key", Value(expression=read_juel("${execution.processBusinessKey}")))
    element = Assignment("element", Value(expression=read_juel("${execution.currentActivityId}")))
    moment = Assignment("moment", Value(expression=read_juel("${now()}")))
    content = scope(start(), work("a", inputs=(both, element, moment)), end(), ("start", "a", "end"))
    library = Definitions([definition(content)])
    identity = {"processBusinessKey": "order 7"}
    run = Run.start(library.plans["p"], {}, NOW, library, identity=identity)
    (opened,) = run.open()
    assert opened.variables["key"] == "order 7"
    assert opened.variables["element"] == "a"
    assert datetime.fromisoformat(opened.variables["moment"]) == NOW
    assert set(opened.variables) == {"key", "element", "moment"}
    assert run.variables() == {}
