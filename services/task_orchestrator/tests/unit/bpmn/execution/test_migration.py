"""Migration of a run: what continues unchanged, what differs, and what prevents it."""

from dataclasses import replace
from datetime import timedelta
from typing import Any

import orjson
from hypothesis import event, given, settings
from hypothesis import strategies as st

from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.migration import Finding
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.state import Library
from handover_bpmn.model import (
    CompensateEvent,
    Kind,
    Node,
    ProcessParameter,
    Scope,
)
from services.task_orchestrator.tests.unit.bpmn.execution.build import (
    NOW,
    Definitions,
    Driver,
    after,
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
    signal,
    start,
    sub,
    throw,
    value,
    when,
    work,
    xor,
)
from services.task_orchestrator.tests.unit.bpmn.execution.random_runs import (
    CALLED,
    act_randomly,
    check,
    content_of,
)
from services.task_orchestrator.tests.unit.bpmn.execution.test_oracle import SHAPES


class Versions(Library):
    """A library with several versions of "p", and other definitions."""

    def __init__(self, *others: Any) -> None:
        self.plans: dict[int, Plan] = {}
        self._others = Definitions(others)

    def add(self, content: Scope, version: int, **changes: Any) -> Plan:
        self.plans[version] = Plan(replace(definition(content), **changes), version)
        return self.plans[version]

    def plan(self, name: str, version: int) -> Plan:
        return self.plans[version] if name == "p" else self._others.plan(name, version)

    def find(self, name: str, version: int | None, tag: str | None) -> Plan:
        return self._others.find(name, version, tag)


class Migrated(Driver):
    """A run that is migrated to a second version of its definition."""

    def __init__(self, content: Scope, *others: Any, **variables: Any) -> None:
        super().__init__(content, *others, **variables)
        self.versions = Versions(*others)
        self.versions.add(content, 1)
        self.version = 1

    def restore(self) -> None:
        if hasattr(self, "versions"):
            self.effects += self.run.effects
            self.run = Run.resume(self.versions.plans[self.version], self.run.snapshot(), self.versions)
        else:
            super().restore()

    def migrate(
        self,
        content: Scope,
        mapping: dict[str, str] | None = None,
        values: dict[str, Any] | None = None,
        **changes: Any,
    ) -> list[Finding]:
        self.restore()
        before = self.run.snapshot()
        plan = self.versions.add(content, self.version + 1, **changes)
        found = self.run.migrate(plan, mapping or {}, values or {}, self.now)
        if obstacles(found):
            assert self.run.snapshot() == before
        else:
            self.version += 1
        self.restore()
        return found


def obstacles(found: list[Finding]) -> list[str]:
    return [each.element for each in found if each.is_obstacle]


def warnings(found: list[Finding]) -> dict[str, str]:
    return {each.element: str(each.reason) for each in found if not each.is_obstacle}


LINE = scope(start(), work("a"), work("b"), end(), ("start", "a", "b", "end"))


def test_an_open_activity_stays_open_and_the_new_version_follows() -> None:
    run = Migrated(LINE)
    token = run.token("a")
    longer = scope(start(), work("a"), work("check"), work("b"), end(), ("start", "a", "check", "b", "end"))
    assert run.migrate(longer) == []
    assert (run.token("a"), run.run.visit(token)) == (token, 1)
    run.complete("a")
    assert run.open == ["check"]


def test_a_renamed_element_is_mapped_and_its_visits_count_on() -> None:
    run = Migrated(LINE)
    renamed = scope(start(), work("x"), work("b"), end(), ("start", "x", "b", "end"))
    assert obstacles(run.migrate(renamed)) == ["a"]
    assert obstacles(run.migrate(renamed, {"a": "x"})) == []
    run.fail("x")
    run.do("retry", "x")
    (opened,) = run.run.open()
    assert (opened.element, opened.visit) == ("x", 2)


def test_a_missing_element_another_kind_and_another_scope_are_obstacles() -> None:
    run = Migrated(LINE)
    (gone,) = run.migrate(scope(start(), work("b"), end(), ("start", "b", "end")))
    assert "no element" in gone.reason
    other = scope(start(), script("a", "x = 1"), work("b"), end(), ("start", "a", "b", "end"))
    (kind,) = run.migrate(other)
    assert "userTask" in kind.reason
    assert "scriptTask" in kind.reason
    inner = scope(start("in"), work("a"), ("in", "a"))
    (moved,) = run.migrate(scope(start(), sub("s", inner), end(), ("start", "s", "end")))
    assert 'in the scope "s"' in moved.reason
    assert run.open == ["a"]


def test_a_mapping_of_unknown_elements_is_an_obstacle() -> None:
    run = Migrated(LINE)
    assert obstacles(run.migrate(LINE, {"nothing": "a"})) == ["nothing"]
    assert obstacles(run.migrate(LINE, {"a": "nothing"})) == ["a", "a"]


def test_a_changed_activity_is_reported_and_its_task_stays() -> None:
    run = Migrated(LINE)
    a = work("a")
    assert a.activity is not None
    changed = replace(a, activity=replace(a.activity, role="welder"))
    found = run.migrate(scope(start(), changed, work("b"), end(), ("start", "a", "b", "end")))
    assert "open Task stays" in warnings(found)["a"]
    assert run.open == ["a"]


def guarded(*events: Node) -> Scope:
    ends = [end(f"after_{each.id}") for each in events]
    paths = [(each.id, f"after_{each.id}") for each in events]
    return scope(start(), work("a"), *events, *ends, end(), ("start", "a", "end"), *paths)


def test_a_timer_keeps_its_due_date_unless_it_has_changed() -> None:
    run = Migrated(guarded(boundary("late", "a", after("PT10M"))))
    run.now = NOW + timedelta(minutes=4)
    assert run.migrate(guarded(boundary("late", "a", after("PT10M")))) == []
    assert run.run.next_due() == NOW + timedelta(minutes=10)
    found = run.migrate(guarded(boundary("late", "a", after("PT20M"))))
    assert "from now on" in warnings(found)["late"]
    assert run.run.next_due() == NOW + timedelta(minutes=24)


def test_a_boundary_event_may_come_and_go() -> None:
    run = Migrated(guarded())
    found = run.migrate(guarded(boundary("stop", "a", message("stop"))))
    assert "waits for this event from now on" in warnings(found)["stop"]
    assert run.deliver("stop") == 1
    assert run.done
    run = Migrated(guarded(boundary("stop", "a", message("stop"))))
    assert "no longer waits" in warnings(run.migrate(guarded()))["stop"]
    assert run.deliver("stop") == 0
    assert run.open == ["a"]


def test_an_event_that_cannot_be_awaited_is_an_obstacle() -> None:
    run = Migrated(guarded())
    late = boundary("late", "a", replace(after(""), value=value("nowhere")))
    assert obstacles(run.migrate(guarded(late))) == ["late"]
    assert run.open == ["a"]


def test_an_event_subprocess_of_the_new_version_is_awaited() -> None:
    handler = event_sub("h", scope(start("h_in", signal("go")), work("h_a"), ("h_in", "h_a")))
    run = Migrated(LINE)
    run.migrate(scope(start(), work("a"), work("b"), end(), handler, ("start", "a", "b", "end")))
    run.deliver("go")
    assert run.open == ["h_a"]
    # It runs and has interrupted the process, so another event subprocess has nothing to wait for.
    more = event_sub("m", scope(start("m_in", signal("more")), work("m_a"), ("m_in", "m_a")))
    assert run.migrate(scope(start(), work("a"), end(), handler, more, ("start", "a", "end"))) == []
    assert run.deliver("more") == 0


def test_an_intermediate_event_keeps_its_message_or_takes_the_new_one() -> None:
    def waiting(name: str) -> Scope:
        return scope(start(), catch("wait", message(name)), work("a"), ("start", "wait", "a"))

    run = Migrated(waiting("one"))
    assert run.migrate(waiting("one")) == []
    run.migrate(waiting("two"))
    assert run.deliver("one") == 0
    assert run.deliver("two") == 1
    assert run.open == ["a"]


def branches(*names: str) -> Scope:
    return scope(
        start(), parallel("fork"), *map(work, names), parallel("join"), work("last"), end(),
        ("start", "fork"), *(("fork", name, "join") for name in names), ("join", "last", "end"),
    )  # fmt: skip


def test_a_join_that_loses_a_branch_continues() -> None:
    run = Migrated(branches("a", "b", "c"))
    run.complete("a")
    run.complete("b")
    assert obstacles(run.migrate(branches("a", "b"))) == ["c"]
    run.run.cancel_token(run.token("c"), run.now)
    run.restore()
    assert run.migrate(branches("a", "b")) == []
    assert run.open == ["last"]


def test_a_join_counts_the_flow_that_a_token_came_by_under_its_new_name() -> None:
    run = Migrated(branches("a", "b"))
    run.complete("a")
    mapping = {"b": "x", "b_join": "x_join", "fork_b": "fork_x"}
    assert obstacles(run.migrate(branches("a", "x"), mapping)) == []
    assert run.open == ["x"]
    run.complete("x")
    assert run.open == ["last"]


def test_a_subprocess_and_the_tokens_within_it_are_renamed_together() -> None:
    inner = scope(start("in"), work("a"), work("b"), ("in", "a", "b"))
    run = Migrated(scope(start(), sub("s", inner), end(), ("start", "s", "end")))
    renamed = scope(start("in"), work("x"), work("b"), ("in", "x", "b"))
    after_ = scope(start(), sub("t", renamed), end(), ("start", "t", "end"))
    assert obstacles(run.migrate(after_, {"s": "t", "a": "x"})) == []
    run.complete("x")
    run.complete("b")
    assert run.done


def test_a_called_process_continues_in_its_version() -> None:
    called = definition(scope(start(), work("q"), end(), ("start", "q", "end")), "called")
    run = Migrated(scope(start(), call("c", "called"), work("b"), ("start", "c", "b")), called)
    other = scope(start(), call("d", "another"), work("b"), ("start", "d", "b"))
    found = run.migrate(other, {"c": "d"})
    assert "called process that runs continues" in warnings(found)["c"]
    run.complete("d.q")
    assert run.open == ["b"]


def test_parameters_of_the_new_version_are_defaults_or_have_to_be_given() -> None:
    parameters = {"bin": ProcessParameter("bin", True), "speed": ProcessParameter("speed", False, 3)}
    run = Migrated(LINE)
    (missing,) = run.migrate(LINE, parameters=parameters)
    assert missing.is_obstacle
    assert missing.name == "bin"
    assert run.variables == {}
    assert run.migrate(LINE, values={"bin": "bin-2"}, parameters=parameters) == []
    assert run.variables == {"bin": "bin-2", "speed": 3}


def test_a_variable_that_only_the_new_version_reads_is_reported() -> None:
    def choosing(condition: str) -> Scope:
        return scope(
            start(), work("a"), xor("which", "which_end"), work("b"), end(),
            ("start", "a", "which", "end"), when("which", "b", condition), ("b", "end"),
        )  # fmt: skip

    run = Migrated(choosing("old > 1"))
    assert '"weight" is read' in warnings(run.migrate(choosing("weight > 1")))["which"]
    assert run.migrate(choosing("weight > 1"), values={"weight": 3}) == []


def test_completed_activities_are_compensated_under_their_new_names() -> None:
    def undoing(name: str) -> Scope:
        return scope(
            start(), work(name), boundary("c", name, CompensateEvent()),
            work("undo", is_for_compensation=True), work("b"), throw("all", CompensateEvent()), end(),
            ("start", name, "b", "all", "end"), handlers={"c": "undo"},
        )  # fmt: skip

    run = Migrated(undoing("a"))
    run.complete("a")
    assert run.migrate(undoing("x"), {"a": "x"}) == []
    run.complete("b")
    assert run.open == ["undo"]


@settings(max_examples=2 * settings.default.max_examples)
@given(SHAPES, st.data())
def test_migration_to_an_identical_definition_changes_nothing(shape: Any, data: st.DataObject) -> None:
    variables = data.draw(st.sampled_from([{}, {"v0": 1, "v1": 1, "v2": 0}]))
    content = content_of(shape, data.draw)
    run = _advanced(content, data, variables)
    before = orjson.loads(run.run.snapshot())
    assert run.migrate(content) == []
    present = orjson.loads(run.run.snapshot())
    assert present["frames"][0].pop("process") == ["p", 2]
    assert before["frames"][0].pop("process") == ["p", 1]
    assert present == before
    event("ended" if not before["tokens"] else "alive")


@settings(max_examples=2 * settings.default.max_examples)
@given(SHAPES, SHAPES, st.data())
def test_invariants_hold_after_any_migration(shape: Any, other: Any, data: st.DataObject) -> None:
    run = _advanced(content_of(shape, data.draw), data, {"v0": 1, "v1": 0, "v2": 1, "done": 0})
    if not run.run._state.tokens:
        return
    names = sorted(_places(run.run.plan.definition.scope))
    target = content_of(other, data.draw)
    mapping = data.draw(st.dictionaries(st.sampled_from(names), st.sampled_from(sorted(_places(target)))))
    found = run.migrate(target, mapping)
    event("refused" if obstacles(found) else "migrated")
    check(run.run, {})


@settings(max_examples=2 * settings.default.max_examples)
@given(SHAPES, st.data())
def test_a_migrated_run_does_what_it_would_have_done(shape: Any, data: st.DataObject) -> None:
    content = content_of(shape, data.draw)
    one = _advanced(content, data, {"v0": 1, "v1": 0, "v2": 1, "done": 0})
    other = Migrated(content, CALLED)
    other.run, other.now = Run.resume(one.run.plan, one.run.snapshot(), other.versions), one.now
    names = {*_places(content), *(flow for each in content.walk() for flow in each.flows)}
    assert other.migrate(_renamed(content), {name: f"n_{name}" for name in names}) == []
    for _ in range(30):
        assert [_new_path(each) for each in one.open] == other.open
        assert one.variables == other.variables
        if not one.open:
            break
        element = data.draw(st.sampled_from(one.open))
        results = {"done": data.draw(st.integers(0, 3))}
        one.complete(element, **results)
        other.complete(_new_path(element), **results)
    assert one.done == other.done


def _advanced(content: Scope, data: st.DataObject, variables: dict[str, Any]) -> Migrated:
    run = Migrated(content, CALLED, **variables)
    for _ in act_randomly(run, data, max_acts=15):
        pass
    return run


def _places(content: Scope) -> set[str]:
    return {name for each in content.walk() for name in each.nodes}


def _new_path(element: str) -> str:
    return f"n_{element}"


def _renamed(content: Scope) -> Scope:
    """The same scope, whose elements have other ids."""

    def of_node(found: Node) -> Node:
        thrown = found.event
        if isinstance(thrown, CompensateEvent) and thrown.activity is not None:
            thrown = CompensateEvent(f"n_{thrown.activity}")
        return replace(
            found,
            id=f"n_{found.id}",
            event=thrown,
            default=found.default and f"n_{found.default}",
            attached_to=found.attached_to and f"n_{found.attached_to}",
            scope=None if found.scope is None else replace(_renamed(found.scope), id=f"n_{found.id}"),
        )

    flows = [
        replace(each, id=f"n_{each.id}", source=f"n_{each.source}", target=f"n_{each.target}")
        for each in content.flows.values()
    ]
    return replace(
        content,
        nodes={f"n_{name}": of_node(found) for name, found in content.nodes.items()},
        flows={each.id: each for each in flows},
        handlers={f"n_{name}": f"n_{handler}" for name, handler in content.handlers.items()},
    )


def test_an_event_based_gateway_waits_for_the_events_of_the_new_version() -> None:
    def choosing(*names: str) -> Scope:
        catches = [catch(name, message(name)) for name in names]
        paths = [("which", name, f"a_{name}") for name in names]
        return scope(
            start(), node("which", Kind.EVENT_BASED), *catches, *(work(f"a_{name}") for name in names),
            ("start", "which"), *paths,
        )  # fmt: skip

    run = Migrated(choosing("one", "two"))
    found = warnings(run.migrate(choosing("one", "three")))
    assert set(found) == {"two", "three"}
    assert run.deliver("two") == 0
    run.deliver("three")
    assert run.open == ["a_three"]
