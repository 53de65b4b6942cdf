"""Events: every kind in every place where BPMN has it, and what is refused by name."""

import pytest

from handover_bpmn.model import (
    CompensateEvent,
    ConditionalEvent,
    ErrorEvent,
    EscalationEvent,
    LinkEvent,
    MessageEvent,
    Node,
    SignalEvent,
    TerminateEvent,
    TimerEvent,
    TimerType,
)
from services.task_orchestrator.tests.unit.bpmn.notation.reading import between, faults, node, read, warnings
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, end, flow, gateway, path, start, timer

DECLARED = (
    '<bpmn:message id="m" name="order"/><bpmn:signal id="s" name="stop"/>'
    '<bpmn:error id="e" errorCode="E1"/><bpmn:error id="any"/>'
    '<bpmn:escalation id="esc" escalationCode="late"/>'
)
DEFINITIONS = {
    "message": ('<bpmn:messageEventDefinition messageRef="m"/>', MessageEvent),
    "timer": (timer("PT5M"), TimerEvent),
    "signal": ('<bpmn:signalEventDefinition signalRef="s"/>', SignalEvent),
    "error": ('<bpmn:errorEventDefinition errorRef="e"/>', ErrorEvent),
    "escalation": ('<bpmn:escalationEventDefinition escalationRef="esc"/>', EscalationEvent),
    "conditional": (
        "<bpmn:conditionalEventDefinition><bpmn:condition>x > 1</bpmn:condition>"
        "</bpmn:conditionalEventDefinition>",
        ConditionalEvent,
    ),
    "compensate": ('<bpmn:compensateEventDefinition activityRef="work"/>', CompensateEvent),
    "link": ('<bpmn:linkEventDefinition name="A"/>', LinkEvent),
    "terminate": ("<bpmn:terminateEventDefinition/>", TerminateEvent),
    "none": ("", type(None)),
    "cancel": ("<bpmn:cancelEventDefinition/>", type(None)),
}
INNER = "none message timer signal conditional error escalation compensate"
PLACES = {
    "start": ("none message timer signal conditional", '<bpmn:startEvent id="x">{}</bpmn:startEvent>'),
    "end": (
        "none message signal error escalation compensate terminate",
        '<bpmn:endEvent id="x">{}</bpmn:endEvent>',
    ),
    "catch": (
        "message timer signal conditional link",
        '<bpmn:intermediateCatchEvent id="x">{}</bpmn:intermediateCatchEvent>',
    ),
    "throw": (
        "none message signal escalation compensate link",
        '<bpmn:intermediateThrowEvent id="x">{}</bpmn:intermediateThrowEvent>',
    ),
    "boundary": (
        "message timer signal conditional error escalation compensate",
        '<bpmn:boundaryEvent id="x" attachedToRef="work">{}</bpmn:boundaryEvent>',
    ),
    "event subprocess": (
        "message timer signal conditional error escalation compensate",
        '<bpmn:subProcess id="sub" triggeredByEvent="true">'
        '<bpmn:startEvent id="x">{}</bpmn:startEvent></bpmn:subProcess>',
    ),
}


def body_of(place: str, kind: str) -> str:  # noqa: PLR0911 - one return a place
    element = PLACES[place][1].format(DEFINITIONS[kind][0])
    match place:
        case "start":
            return element + end() + path("x", "end")
        case "end":
            return ONE_STEP + element + flow("work", "x")
        case "boundary" if kind == "compensate":
            undo = '<bpmn:task id="undo" isForCompensation="true"/>'
            return ONE_STEP + element + undo + '<bpmn:association id="a" sourceRef="x" targetRef="undo"/>'
        case "boundary":
            return ONE_STEP + element + flow("x", "end")
        case "event subprocess":
            return ONE_STEP + element
    if kind == "link":
        other = "throw" if place == "catch" else "catch"
        twin = PLACES[other][1].format(DEFINITIONS[kind][0]).replace('"x"', '"y"')
        first, last = ("y", "x") if place == "catch" else ("x", "y")
        return ONE_STEP + twin + element + flow("work", first) + flow(last, "end")
    return ONE_STEP + element + flow("work", "x") + flow("x", "end")


@pytest.mark.parametrize("kind", DEFINITIONS)
@pytest.mark.parametrize("place", PLACES)
def test_each_event_is_read_where_bpmn_has_it_and_refused_elsewhere(place: str, kind: str) -> None:
    body = body_of(place, kind)
    if kind in PLACES[place][0].split():
        definition = read(body, beside=DECLARED)
        event = next(each for each in definition.nodes() if each.id == "x").event
        assert isinstance(event, DEFINITIONS[kind][1])
    else:
        found = [each for each in faults(body, beside=DECLARED) if '"x"' in each]
        assert len(found) == 1
        assert "is not supported" in found[0]


def event_of(definition: str, kind: str = "intermediateCatchEvent") -> Node:
    element = f'<bpmn:{kind} id="x">{definition}</bpmn:{kind}>'
    body = ONE_STEP + element + flow("work", "x") + (flow("x", "end") if kind != "endEvent" else "")
    return read(body, beside=DECLARED).scope.nodes["x"]


def test_names_and_codes_come_from_the_declarations() -> None:
    message = event_of(DEFINITIONS["message"][0]).event
    assert isinstance(message, MessageEvent)
    assert message.name.value({}) == "order"
    signal = event_of(DEFINITIONS["signal"][0], "intermediateThrowEvent").event
    assert isinstance(signal, SignalEvent)
    assert signal.name.value({}) == "stop"
    assert event_of(DEFINITIONS["error"][0], "endEvent").event == ErrorEvent("E1")
    any_error = '<bpmn:errorEventDefinition errorRef="any"/>'
    assert event_of(any_error, "endEvent").event == ErrorEvent()
    assert event_of("<bpmn:errorEventDefinition/>", "endEvent").event == ErrorEvent()
    assert event_of(DEFINITIONS["escalation"][0], "endEvent").event == EscalationEvent("late")


@pytest.mark.parametrize(
    ("definition", "reason"),
    [
        ('<bpmn:messageEventDefinition messageRef="no"/>', 'messageRef "no" names no bpmn:message'),
        ('<bpmn:signalEventDefinition signalRef="no"/>', 'signalRef "no" names no bpmn:signal'),
        ("<bpmn:timerEventDefinition/>", "a timer has one timeDuration, timeDate or timeCycle"),
        (timer("P5X"), "no ISO 8601 duration"),
        (timer("P1M").replace("timeDuration", "timeCycle"), "P1M"),
        (timer("R/PT0.001S").replace("timeDuration", "timeCycle"), "R/PT0.001S"),
        (timer("1 +"), "is not an expression"),
        ("<bpmn:conditionalEventDefinition/>", "an expression is empty"),
        ("<bpmn:eventDefinitionRef>no</bpmn:eventDefinitionRef>", 'eventDefinitionRef "no" names no event'),
        (timer("PT1M") * 2, "several event definitions (multiple) is not supported"),
    ],
)
def test_a_wrong_event_is_one_fault(definition: str, reason: str) -> None:
    element = f'<bpmn:intermediateCatchEvent id="x">{definition}</bpmn:intermediateCatchEvent>'
    found = faults(between(element))
    assert len(found) == 1, found
    assert reason in found[0]


def test_parallel_multiple_is_refused_by_name() -> None:
    both = timer("PT1M") + '<bpmn:signalEventDefinition signalRef="s"/>'
    element = f'<bpmn:intermediateCatchEvent id="x" parallelMultiple="true">{both}'
    found = faults(between(element + "</bpmn:intermediateCatchEvent>"), beside=DECLARED)
    assert "(parallelMultiple) is not supported yet; draw one event for each" in found[0]


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("timeDuration", "PT5M"),
        ("timeDate", "2026-05-01T08:00:00+02:00"),
        ("timeCycle", "R3/PT1M"),
        ("timeCycle", "R/2026-05-01T08:00:00Z/P1D"),
        ("timeCycle", "0 0/5 8-17 ? * MON-FRI"),
    ],
)
def test_a_timer_has_a_date_a_duration_or_a_cycle(kind: str, text: str) -> None:
    definition = f"<bpmn:timerEventDefinition><bpmn:{kind}>{text}</bpmn:{kind}></bpmn:timerEventDefinition>"
    timer_event = event_of(definition).event
    assert isinstance(timer_event, TimerEvent)
    assert timer_event.type is TimerType(kind)
    assert timer_event.value.value({}) == text


def test_a_timer_may_be_an_expression() -> None:
    event = event_of(timer("patience")).event
    assert isinstance(event, TimerEvent)
    assert event.value.value({"patience": "PT3M"}) == "PT3M"


def test_an_event_may_refer_to_an_event_definition_of_the_file() -> None:
    shared = timer("PT5M").replace("<bpmn:timerEventDefinition>", '<bpmn:timerEventDefinition id="five">')
    element = '<bpmn:intermediateCatchEvent id="x"><bpmn:eventDefinitionRef>five</bpmn:eventDefinitionRef>'
    event = node(element + "</bpmn:intermediateCatchEvent>", beside=shared).event
    assert isinstance(event, TimerEvent)


@pytest.mark.parametrize(("attribute", "interrupts"), [("", True), ('cancelActivity="false"', False)])
def test_a_boundary_event_interrupts_or_not(attribute: str, interrupts: bool) -> None:
    body = ONE_STEP + flow("x", "end")
    body += (
        f'<bpmn:boundaryEvent id="x" attachedToRef="work" {attribute}>{timer("PT1M")}</bpmn:boundaryEvent>'
    )
    found = read(body).scope.nodes["x"]
    assert (found.attached_to, found.interrupting) == ("work", interrupts)


def test_the_start_of_an_event_subprocess_interrupts_or_not() -> None:
    start_event = f'<bpmn:startEvent id="s" isInterrupting="false">{timer("PT1M")}</bpmn:startEvent>'
    sub = f'<bpmn:subProcess id="x" triggeredByEvent="true">{start_event}</bpmn:subProcess>'
    found = read(ONE_STEP + sub).scope.nodes["x"]
    assert found.triggered_by_event
    assert found.scope is not None
    assert not found.scope.nodes["s"].interrupting


def test_a_process_has_several_start_events() -> None:
    body = ONE_STEP + f'<bpmn:startEvent id="t">{timer("PT1M")}</bpmn:startEvent>' + flow("t", "work")
    assert warnings(body) == []


def test_a_message_or_signal_that_is_not_declared_is_called_like_its_event() -> None:
    element = (
        '<bpmn:intermediateCatchEvent id="x" name="Order received"><bpmn:messageEventDefinition/>'
        "</bpmn:intermediateCatchEvent>"
    )
    event = node(element).event
    assert isinstance(event, MessageEvent)
    assert event.name.value({}) == "Order received"
    assert 'the message is called "Order received"' in warnings(between(element))[0]
    signal = node(element.replace("message", "signal")).event
    assert isinstance(signal, SignalEvent)
    assert signal.name.value({}) == "Order received"


def test_an_event_based_gateway_awaits_events_and_receive_tasks() -> None:
    receive = '<bpmn:receiveTask id="r" messageRef="m"/>'
    late = f'<bpmn:intermediateCatchEvent id="t">{timer("PT1M")}</bpmn:intermediateCatchEvent>'
    body = start() + gateway("g", "eventBased") + receive + late + end()
    body += path("start", "g", "r", "end") + path("g", "t", "end")
    assert warnings(body, beside=DECLARED) == []


@pytest.mark.parametrize(
    ("attribute", "what"),
    [
        ('eventGatewayType="Parallel"', "a parallel eventBased"),
        ('instantiate="true"', "that starts the"),
    ],
)
def test_event_based_gateways_that_the_engine_lacks_are_refused_by_name(attribute: str, what: str) -> None:
    receive = '<bpmn:receiveTask id="r" messageRef="m"/>'
    body = start() + f'<bpmn:eventBasedGateway id="g" {attribute}/>' + receive + path("start", "g", "r")
    assert what in faults(body, beside=DECLARED)[0]
