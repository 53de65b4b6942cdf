"""Events: at the start and end, in between, at boundaries and in event subprocesses."""

from typing import Any

import pytest

from handover_bpmn.execution.machine import ThrownMessage, ThrownSignal, UncaughtEscalation
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.state import RunFailed, WaitType
from handover_bpmn.languages.native import read
from handover_bpmn.model import (
    Assignment,
    ConditionalEvent,
    EntityFilter,
    EscalationEvent,
    Event,
    Kind,
    LinkEvent,
    MessageEvent,
    Scope,
    SignalEvent,
    TerminateEvent,
    TimerEvent,
    TimerType,
    Value,
)
from services.task_orchestrator.tests.unit.bpmn.execution.build import (
    NOW,
    Definitions,
    Driver,
    after,
    boundary,
    catch,
    cycle,
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
)

HOT = ConditionalEvent(read("defined(heat) and heat > 50"))
AT_NINE = TimerEvent(TimerType.DATE, Value("2026-05-04T09:00:00Z"))


def occur(run: Driver, event: Event) -> None:
    """Let an event of the module's examples occur."""
    if isinstance(event, TimerEvent):
        run.wait(hours=1)
    elif isinstance(event, ConditionalEvent):
        run.run.set_variables({"heat": 51}, run.now)
        run.restore()
    else:
        assert run.deliver("go") == 1


EVENTS = pytest.mark.parametrize(
    "event", [after("PT5M"), AT_NINE, cycle("R1/PT5M"), message("go"), signal("go"), HOT]
)


def waits_for(event: Event) -> Scope:
    return scope(start(), catch("wait", event), work("a"), end(), ("start", "wait", "a", "end"))


@EVENTS
def test_a_token_waits_for_an_intermediate_event(event: Event) -> None:
    run = Driver(waits_for(event))
    assert run.open == []
    assert run.run.waiting() == ("wait",)
    occur(run, event)
    assert run.open == ["a"]
    assert run.run.next_due() is None
    run.complete("a")
    assert run.done


@EVENTS
def test_an_interrupting_boundary_event_cancels_its_activity(event: Event) -> None:
    content = scope(
        start(), work("a"), boundary("late", "a", event), work("b"), end(),
        ("start", "a", "end"), ("late", "b", "end"),
    )  # fmt: skip
    run = Driver(content)
    assert run.open == ["a"]
    occur(run, event)
    assert run.open == ["b"]
    run.complete("b")
    assert run.done
    in_time = Driver(content)
    in_time.complete("a")
    assert in_time.done
    assert in_time.run.subscriptions() == ()
    assert in_time.run.next_due() is None


@EVENTS
def test_a_boundary_event_that_does_not_interrupt_adds_a_token(event: Event) -> None:
    content = scope(
        start(), work("a"), boundary("late", "a", event, interrupting=False), work("b"), end(),
        ("start", "a", "end"), ("late", "b", "end"),
    )  # fmt: skip
    run = Driver(content)
    occur(run, event)
    assert run.open == ["a", "b"]
    run.complete("b")
    assert run.open == ["a"]
    run.complete("a")
    assert run.done


@EVENTS
@pytest.mark.parametrize("interrupting", [True, False])
def test_an_event_starts_an_event_subprocess(event: Event, *, interrupting: bool) -> None:
    handler = scope(
        start("begin", event, interrupting=interrupting), work("h"), end("over"), ("begin", "h", "over")
    )
    content = scope(start(), work("a"), end(), ("start", "a", "end"), event_sub("handler", handler))
    run = Driver(content)
    occur(run, event)
    assert run.open == (["h"] if interrupting else ["a", "h"])
    run.complete("h")
    assert run.open == ([] if interrupting else ["a"])
    if not interrupting:
        run.complete("a")
    assert run.done
    assert run.run.subscriptions() == ()
    assert run.run.next_due() is None


@EVENTS
def test_an_event_subprocess_of_a_subprocess_interrupts_only_that(event: Event) -> None:
    handler = scope(start("begin", event), work("h"), end("over"), ("begin", "h", "over"))
    inner = scope(
        start("in"), work("a"), end("out"), ("in", "a", "out"), event_sub("handler", handler)
    )  # fmt: skip
    content = scope(start(), sub("s", inner), work("b"), end(), ("start", "s", "b", "end"))
    run = Driver(content)
    occur(run, event)
    assert run.open == ["h"]
    run.complete("h")
    assert run.open == ["b"]


def test_a_message_brings_variables_and_has_a_correlation_key() -> None:
    content = scope(start(), catch("wait", message("order", "number")), end(), ("start", "wait", "end"))
    run = Driver(content, number=7)
    (found,) = run.run.subscriptions()
    assert (found.name, found.key, found.element) == ("order", 7, "wait")
    run.deliver("order", amount=3)
    assert run.done
    assert run.variables == {"number": 7, "amount": 3}


def test_a_false_correlation_key_is_a_key() -> None:
    run = Driver(waits_for(message("order", "number")), number=0)
    (found,) = run.run.subscriptions()
    assert found.key == 0


def test_a_message_that_nobody_waits_for_any_more_is_ignored() -> None:
    run = Driver(waits_for(message("go")))
    (found,) = run.run.subscriptions()
    run.deliver("go")
    run.run.deliver(found.wait, {"x": 1}, run.now)
    assert run.open == ["a"]
    assert run.variables == {}


def test_a_process_starts_at_an_event() -> None:
    content = scope(
        start("by_hand"), start("by_order", message("order")), work("a"), work("b"), end(),
        ("by_hand", "a", "end"), ("by_order", "b", "end"),
    )  # fmt: skip
    assert Driver(content).open == ["a"]
    run = Driver(content, at="by_order", results={"amount": 3}, x=1)
    assert run.open == ["b"]
    assert run.variables == {"x": 1, "amount": 3}


def test_a_process_that_starts_with_an_event_does_not_start_without_it() -> None:
    library = Definitions([definition(scope(start("s", message("order")), end(), ("s", "end")))])
    with pytest.raises(RunFailed, match="starts with an event"):
        Run.start(library.plans["p"], {}, NOW, library)
    with pytest.raises(RunFailed, match="no event"):
        Run.start(library.plans["p"], {}, NOW, library, at="other")


def test_thrown_messages_and_signals_are_effects_with_the_mapped_variables() -> None:
    content = scope(
        start(),
        throw("m", message("order", "number"), inputs=(Assignment("amount", value("number + 1")),)),
        throw("s", signal("alarm")),
        end("end", message("bye")),
        ("start", "m", "s", "end"),
    )
    run = Driver(content, number=7)
    assert run.done
    assert run.variables == {"number": 7}
    assert run.effects == [
        ThrownMessage("order", 7, {"amount": 8}, "m"),
        ThrownSignal("alarm", {}, "s"),
        ThrownMessage("bye", None, {}, "end"),
    ]


def test_a_send_task_throws_and_a_receive_task_waits() -> None:
    content = scope(
        start(), node("send", Kind.SEND_TASK, event=message("order")),
        node("receive", Kind.RECEIVE_TASK, event=message("answer")), work("a"), end(),
        boundary("late", "receive", after("PT5M")), ("start", "send", "receive", "a", "end"), ("late", "end"),
    )  # fmt: skip
    run = Driver(content)
    assert run.effects == [ThrownMessage("order", None, {}, "send")]
    run.deliver("answer", ok=True)
    assert run.open == ["a"]
    assert run.run.next_due() is None
    late = Driver(content)
    late.wait(minutes=5)
    assert late.done


def test_a_repeating_timer_occurs_as_often_as_it_says() -> None:
    content = scope(
        start(), work("a"), boundary("ask", "a", cycle("R3/PT1M"), interrupting=False), work("b"), end(),
        ("start", "a", "end"), ("ask", "b"),
    )  # fmt: skip
    run = Driver(content)
    for count in (1, 2, 3, 3):
        run.wait(minutes=1)
        assert run.open == ["a", *["b"] * count]
    assert run.run.next_due() is None


def test_a_cycle_without_end_skips_what_was_missed() -> None:
    content = scope(
        start(), work("a"), boundary("ask", "a", cycle("R/PT1M"), interrupting=False), work("b"), end(),
        ("start", "a", "end"), ("ask", "b"),
    )  # fmt: skip
    run = Driver(content)
    run.wait(minutes=1000, seconds=30)
    assert run.open == ["a", "b"]
    run.wait(seconds=30)
    assert run.open == ["a", "b", "b"]


def test_timers_occur_in_the_order_of_their_moments() -> None:
    content = scope(
        start(), parallel("f"), catch("second", after("PT2M")), catch("first", after("PT1M")),
        script("x", 'order = order + ["x"]'), script("y", 'order = order + ["y"]'), end(),
        ("start", "f", "second", "x", "end"), ("f", "first", "y", "end"),
    )  # fmt: skip
    run = Driver(content, order=[])
    run.wait(minutes=3)
    assert run.variables == {"order": ["y", "x"]}
    assert run.done


def test_a_timer_may_be_an_expression() -> None:
    event = TimerEvent(TimerType.DURATION, value("pause"))
    run = Driver(waits_for(event), pause="PT1M")
    run.wait(minutes=1)
    assert run.open == ["a"]


def test_a_condition_that_is_true_already_does_not_wait() -> None:
    assert Driver(waits_for(HOT), heat=60).open == ["a"]


def test_a_condition_occurs_each_time_that_it_becomes_true() -> None:
    content = scope(
        start(), work("a"), boundary("hot", "a", HOT, interrupting=False), work("b"), end(),
        ("start", "a", "end"), ("hot", "b"),
    )  # fmt: skip
    run = Driver(content, heat=0)
    for heat, count in ((60, 1), (70, 1), (10, 1), (51, 2)):
        run.run.set_variables({"heat": heat}, run.now)
        run.restore()
        assert run.open == ["a", *["b"] * count]


def test_a_condition_is_evaluated_when_an_activity_completes() -> None:
    content = scope(
        start(), parallel("f"), work("a"), catch("hot", HOT), work("b"), end(),
        ("start", "f", "a", "end"), ("f", "hot", "b", "end"),
    )  # fmt: skip
    run = Driver(content)
    run.complete("a", heat=99)
    assert run.open == ["b"]


def test_conditions_that_make_each_other_true_for_ever_are_stopped() -> None:
    toggle = scope(
        start("on", ConditionalEvent(read("x == 1")), interrupting=False),
        script("off", "x = 0"), script("again", "x = 1"), end("over"),
        ("on", "off", "again", "over"),
    )  # fmt: skip
    content = scope(start(), work("a"), end(), ("start", "a", "end"), event_sub("e", toggle))
    run = Driver(content, x=0)
    run.run.set_variables({"x": 1}, run.now)
    run.restore()
    assert run.open == ["a"]


def test_an_event_based_gateway_takes_the_first_event() -> None:
    content = scope(
        start(), node("which", Kind.EVENT_BASED), catch("order", message("order")),
        node("answer", Kind.RECEIVE_TASK, event=message("answer")), catch("late", after("PT5M")),
        work("a"), work("b"), work("c"), end(),
        ("start", "which", "order", "a", "end"), ("which", "answer", "b", "end"),
        ("which", "late", "c", "end"),
    )  # fmt: skip
    by_order = Driver(content)
    by_order.deliver("order", n=1)
    assert by_order.open == ["a"]
    assert by_order.variables == {"n": 1}
    assert by_order.run.subscriptions() == ()
    by_answer = Driver(content)
    by_answer.deliver("answer", m=1)
    assert by_answer.open == ["b"]
    assert by_answer.variables == {"m": 1}
    late = Driver(content)
    late.wait(minutes=5)
    assert late.open == ["c"]


def test_a_link_continues_at_the_event_of_its_name() -> None:
    content = scope(
        start(), throw("to", LinkEvent("x")), throw("also_to", LinkEvent("x")), parallel("f"),
        catch("from", LinkEvent("x")), work("a"), end(),
        ("start", "f", "to"), ("f", "also_to"), ("from", "a", "end"),
    )  # fmt: skip
    run = Driver(content)
    assert run.open == ["a", "a"]


def test_a_link_that_nothing_catches_is_an_incident() -> None:
    run = Driver(scope(start(), throw("to", LinkEvent("x")), ("start", "to")))
    assert run.run.incidents()[0].element == "to"


def test_an_inclusive_join_waits_for_a_token_that_comes_by_a_link() -> None:
    content = scope(
        start(), parallel("f"), work("a"), work("b"), throw("to", LinkEvent("x")),
        catch("from", LinkEvent("x")), node("j", Kind.INCLUSIVE), work("c"), end(),
        ("start", "f", "a", "j", "c", "end"), ("f", "b", "to"), ("from", "j"),
    )  # fmt: skip
    run = Driver(content)
    run.complete("a")
    assert run.open == ["b"]
    run.complete("b")
    assert run.open == ["c"]


def test_a_terminate_event_ends_its_scope_with_all_that_runs_in_it() -> None:
    deeper = scope(start("in2"), work("deep"), end("out2"), ("in2", "deep", "out2"))
    inner = scope(
        start("in"), parallel("f"), work("a"), work("b"), sub("deeper", deeper), catch("m", message("go")),
        end("stop", TerminateEvent()), end("out"),
        ("in", "f", "a", "stop"), ("f", "b", "out"), ("f", "deeper", "out"), ("f", "m", "out"),
    )  # fmt: skip
    content = scope(start(), sub("s", inner), work("c"), end(), ("start", "s", "c", "end"))
    run = Driver(content)
    assert run.open == ["a", "b", "deep"]
    run.complete("a")
    assert run.open == ["c"]
    assert run.run.subscriptions() == ()


def test_a_terminate_event_of_the_process_ends_it() -> None:
    content = scope(
        start(), parallel("f"), work("a"), work("b"), end("stop", TerminateEvent()), end(),
        ("start", "f", "a", "stop"), ("f", "b", "end"),
    )  # fmt: skip
    run = Driver(content)
    run.complete("a")
    assert run.done
    assert run.run.failure is None


def escalating(**changes: Any) -> Scope:
    inner = scope(
        start("in"), throw("up", EscalationEvent("E1")), work("a"), end("out"), ("in", "up", "a", "out")
    )
    return scope(
        start(), sub("s", inner), boundary("up_there", "s", EscalationEvent("E1"), **changes), work("b"),
        end(), ("start", "s", "end"), ("up_there", "b", "end"),
    )  # fmt: skip


def test_an_escalation_is_caught_and_interrupts_or_not() -> None:
    assert Driver(escalating(interrupting=False)).open == ["a", "b"]
    run = Driver(escalating(interrupting=True))
    assert run.open == ["b"]
    assert run.variables["escalation"] == {"activity": "up", "code": "E1"}


def test_an_escalation_starts_an_event_subprocess() -> None:
    handler = scope(
        start("begin", EscalationEvent(None, code_variable="code"), interrupting=False), work("h"),
        end("over"), ("begin", "h", "over"),
    )  # fmt: skip
    content = scope(
        start(), throw("up", EscalationEvent("E1")), work("a"), end("end", EscalationEvent("E2")),
        ("start", "up", "a", "end"), event_sub("e", handler),
    )  # fmt: skip
    run = Driver(content)
    assert run.open == ["a", "h"]
    assert run.variables["code"] == "E1"
    run.complete("a")
    assert run.open == ["h", "h"]
    assert run.variables["code"] == "E2"


def test_an_escalation_that_nothing_catches_is_an_effect_and_the_process_continues() -> None:
    content = scope(
        start(), throw("up", EscalationEvent("E1")), work("a"), end(), ("start", "up", "a", "end")
    )
    run = Driver(content)
    assert run.effects == [UncaughtEscalation("E1", "up")]
    assert run.open == ["a"]


def test_an_open_activity_escalates() -> None:
    content = scope(
        start(), work("a"), boundary("up", "a", EscalationEvent(None), interrupting=False), work("b"), end(),
        ("start", "a", "end"), ("up", "b", "end"),
    )  # fmt: skip
    run = Driver(content)
    run.run.escalate(run.token("a"), "overdue", {"activity": "a"}, run.now)
    run.restore()
    assert run.open == ["a", "b"]
    assert run.variables == {"escalation": {"activity": "a"}}


def test_events_of_a_cancelled_subprocess_are_not_waited_for() -> None:
    handler = scope(start("begin", message("go")), end("over"), ("begin", "over"))
    inner = scope(
        start("in"), catch("m", message("go")), end("out"), ("in", "m", "out"), event_sub("h", handler)
    )
    content = scope(
        start(), sub("s", inner), boundary("late", "s", after("PT5M")), work("b"), end(),
        ("start", "s", "end"), ("late", "b", "end"),
    )  # fmt: skip
    run = Driver(content)
    assert len(run.run.subscriptions()) == 2
    run.wait(minutes=5)
    assert run.open == ["b"]
    assert run.run.subscriptions() == ()


def test_none_events_pass() -> None:
    content = scope(
        start(), throw("milestone", None), node("nothing", Kind.TASK), when("nothing", "end", "true"), end(),
        ("start", "milestone", "nothing"),
    )  # fmt: skip
    assert Driver(content).done


def test_the_name_of_a_message_may_be_an_expression() -> None:
    event = MessageEvent(value('"order-" + customer'))
    run = Driver(waits_for(event), customer="7")
    assert run.deliver("order-7") == 1
    assert run.open == ["a"]


OVEN = EntityFilter("Device", variable="oven")


def judge(run: Driver, entity: str, **attributes: Any) -> bool:
    """Let a run evaluate its conditions for an entity; without attributes it is no longer selected."""
    variables = {"oven": {"id": entity, **attributes}} if attributes else None
    found = [run.run.judge(each.wait, entity, variables, run.now) for each in run.run.entity_waits()]
    run.restore()
    return any(found)


def test_a_condition_about_entities_occurs_each_time_that_it_becomes_true_for_one() -> None:
    event = ConditionalEvent(read("oven.heat > limit"), OVEN)
    content = scope(
        start(), work("a"), boundary("hot", "a", event, interrupting=False), work("b"), end(),
        ("start", "a", "end"), ("hot", "b"),
    )  # fmt: skip
    run = Driver(content, limit=50)
    steps = (("x", 60, 1), ("x", 70, 1), ("y", 60, 2), ("x", 10, 2), ("x", 51, 3), ("y", 61, 3))
    for entity, heat, count in steps:
        judge(run, entity, heat=heat)
        assert run.open == ["a", *["b"] * count]
    judge(run, "y")
    assert judge(run, "y", heat=60)
    assert run.variables["oven"] == {"id": "y", "heat": 60}
    assert not judge(run, "z", colour="red")


def test_a_condition_about_entities_does_not_occur_by_variables() -> None:
    run = Driver(waits_for(ConditionalEvent(read("true"), OVEN)))
    run.run.set_variables({"oven": {"heat": 60}}, run.now)
    run.restore()
    assert run.open == []
    assert judge(run, "x", heat=1)
    assert run.open == ["a"]
    assert run.run.entity_waits() == ()


def test_events_with_entities_are_waited_for_wherever_they_are() -> None:
    message_ = MessageEvent(Value("m"), value("order"), OVEN)
    condition = ConditionalEvent(read("true"), OVEN)
    content = scope(
        start(), parallel("f"), catch("message", message_), work("a"),
        boundary("signal", "a", SignalEvent(Value("s"), OVEN)), catch("timer", after("PT1H")), end(),
        event_sub("noted", scope(start("note", condition), end("e"), ("note", "e"))),
        ("start", "f", "message", "end"), ("f", "a", "end"), ("f", "timer", "end"), ("signal", "end"),
    )  # fmt: skip
    run = Driver(content, order=7)
    found = {each.element: (each.type, each.key) for each in run.run.entity_waits()}
    assert found == {
        "message": (WaitType.MESSAGE, 7),
        "signal": (WaitType.SIGNAL, None),
        "note": (WaitType.CONDITION, None),
    }
