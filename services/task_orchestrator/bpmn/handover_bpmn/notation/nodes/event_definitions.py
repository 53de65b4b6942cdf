"""Events: the event definition of a flow node, read into the model."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum, auto

from lxml import etree

from handover.messages import message, text_of
from handover_bpmn.languages import native
from handover_bpmn.languages.base import Expression, ExpressionError, Json, Variables, quote_names
from handover_bpmn.model import (
    CompensateEvent,
    ConditionalEvent,
    ErrorEvent,
    EscalationEvent,
    Event,
    Kind,
    LinkEvent,
    MessageEvent,
    SignalEvent,
    TerminateEvent,
    TimerEvent,
    TimerType,
    Value,
)
from handover_bpmn.notation.conditions import read_condition
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.base import Dialect, Occurrence, attempt
from handover_bpmn.notation.document import child, children, flag, is_bpmn, local, text
from handover_bpmn.notation.elements import message_of, referenced, refuse, warn_without_effect
from handover_bpmn.timing.timers import due_at, is_time, parse_cycle


class _Place(Enum):
    """Where an event definition may stand."""

    START = auto()
    """A start event of a process or subprocess."""
    HANDLER = auto()
    """A boundary event, or the start event of an event subprocess."""
    CATCH = auto()
    THROW = auto()
    END = auto()


_PLACES: Mapping[Kind, _Place] = {
    Kind.BOUNDARY_EVENT: _Place.HANDLER,
    Kind.CATCH_EVENT: _Place.CATCH,
    Kind.THROW_EVENT: _Place.THROW,
    Kind.END_EVENT: _Place.END,
}
_NONE_PLACES = frozenset({_Place.START, _Place.THROW, _Place.END})
"""Where an event needs no event definition."""
_ZONELESS = re.compile(r"(\d{4}-\d\d-\d\d)(T\d\d:\d\d(?::\d\d(?:[.,]\d+)?)?)?(?=/|\Z)", re.ASCII)
"""A moment without a time zone, also within a cycle."""
_EXAMPLES: Mapping[TimerType, str] = {
    TimerType.DATE: "2026-05-01T08:00:00Z",
    TimerType.DURATION: "PT5M",
    TimerType.CYCLE: "R3/PT1M or 0 0 8 * * ?",
}


def definitions_of(element: etree._Element, context: Context) -> list[etree._Element]:
    """Return the event definitions of an event, with those that it refers to."""
    definitions = [
        part for part in children(element) if is_bpmn(part) and local(part).endswith("EventDefinition")
    ]
    for reference in children(element, "eventDefinitionRef"):
        declared = context.declared.event_definitions.get(referenced(text(reference)))
        if declared is None:
            context.findings.fault(
                element,
                message(
                    "bpmn.unknown_event_definition",
                    'eventDefinitionRef "{reference}" names no event definition of this file',
                    reference=text(reference),
                ),
            )
        else:
            definitions.append(declared)
    return definitions


def read_event(
    element: etree._Element, kind: Kind, context: Context, *, in_event_subprocess: bool = False
) -> Event | None:
    """Return the event of an event node; None for a none event, or with a fault."""
    definitions = definitions_of(element, context)
    if len(definitions) > 1:
        what = "parallelMultiple" if flag(element, "parallelMultiple", default=False) else "multiple"
        refuse(
            element,
            f"a {kind.value} with several event definitions ({what})",
            "draw one event for each",
            context.findings,
        )
        return None
    definition = definitions[0] if definitions else None
    name = "" if definition is None else local(definition).removesuffix("EventDefinition")
    place = _place(kind, in_event_subprocess=in_event_subprocess)
    type_ = EVENT_TYPES.get(name)
    is_allowed = place in _NONE_PLACES if definition is None else type_ is not None and place in type_.places
    if not is_allowed:
        if name == "" and element.get("id") in context.findings.broken:
            return None
        _refuse_event(element, kind, name, place, context)
        return None
    dialect = context.dialects.of(element)
    if definition is None or type_ is None:
        dialect.occurrence(element, None, context.findings)
        return None
    occurrence = dialect.occurrence(element, definition, context.findings)
    if occurrence.on is not None and name not in {"message", "signal", "conditional"}:
        context.findings.fault(element, "handover:on stands in message, signal and conditional events")
    event = type_.read(_Source(element, definition, occurrence, dialect, context))
    if kind is Kind.START_EVENT and not in_event_subprocess and isinstance(event, TimerEvent):
        _warn_of_variables(element, event, context)
    return event


def _warn_of_variables(element: etree._Element, event: TimerEvent, context: Context) -> None:
    """Warn that the timer which starts a process cannot read variables, which do not exist yet."""
    names = frozenset() if event.value.expression is None else event.value.expression.names()
    if names:
        context.findings.warn(
            element,
            message(
                "bpmn.start_timer_reads_variables",
                "it starts no process: its time reads {names}, and there are no variables before the start",
                names=quote_names(names),
            ),
        )


def _place(kind: Kind, *, in_event_subprocess: bool) -> _Place:
    if kind is Kind.START_EVENT:
        return _Place.HANDLER if in_event_subprocess else _Place.START
    return _PLACES[kind]


def _refuse_event(element: etree._Element, kind: Kind, name: str, place: _Place, context: Context) -> None:
    if name == "cancel":
        refuse(
            element,
            f"{kind.value} with cancelEventDefinition",
            "use an error event instead",
            context.findings,
        )
        return
    supported = [f"{event}EventDefinition" for event, type_ in EVENT_TYPES.items() if place in type_.places]
    if place in _NONE_PLACES:
        supported.append("none")
    context.findings.fault(
        element,
        message(
            "bpmn.wrong_event",
            "a {kind} with {event} is not supported; supported: {known}",
            kind=kind.value,
            event=f"{name}EventDefinition" if name else "no event definition",
            known=" or ".join(supported),
        ),
    )


@dataclass(frozen=True, slots=True)
class _Source:
    """An event with its event definition, and what its dialect says of it."""

    element: etree._Element
    definition: etree._Element
    occurrence: Occurrence
    dialect: Dialect
    context: Context


def _error(source: _Source) -> ErrorEvent:
    occurrence = source.occurrence
    return ErrorEvent(_code(source, "error"), occurrence.code_variable, occurrence.message_variable)


def _escalation(source: _Source) -> EscalationEvent:
    return EscalationEvent(_code(source, "escalation"), source.occurrence.code_variable)


def _conditional(source: _Source) -> ConditionalEvent | None:
    condition, on = child(source.definition, "condition"), source.occurrence.on
    if on is not None and not text(condition):
        return ConditionalEvent(native.read("true"), on)
    if not text(condition):
        source.context.findings.fault(source.element, "an expression is empty")
        return None
    expression = read_condition(source.element, condition, source.context)
    return None if expression is None else ConditionalEvent(expression, on)


def _compensation(source: _Source) -> CompensateEvent:
    if not flag(source.definition, "waitForCompletion", default=True):
        warn_without_effect(source.element, source.context.findings, 'waitForCompletion="false"')
    return CompensateEvent(referenced(source.definition.get("activityRef") or "") or None)


def _link(source: _Source) -> LinkEvent:
    name = (source.definition.get("name") or source.element.get("name") or "").strip()
    if not name:
        source.context.findings.fault(
            source.element,
            message("bpmn.link_without_name", "a link event needs a name; name both ends alike"),
        )
    return LinkEvent(name)


def read_message(element: etree._Element, occurrence: Occurrence, context: Context) -> MessageEvent:
    """Return the message of an event, or of a send or receive task.

    Its name is that of `messageRef`, of the message flow, or the drawn name with a warning.
    """
    findings = context.findings
    reference = _message_reference(element)
    name = message_of(element, context.declared) or context.collaboration.names.get(element.get("id") or "")
    if reference and reference not in context.declared.messages:
        findings.fault(
            element,
            message(
                "bpmn.unknown_message",
                'messageRef "{reference}" names no bpmn:message of this file',
                reference=reference,
            ),
        )
    elif name is None and occurrence.on is None:
        name = _drawn_name(element)
        findings.warn(
            element,
            message(
                "bpmn.message_by_name",
                'it refers to no message; the message is called "{name}", like the element',
                name=name,
            ),
        )
    declared = context.declared.messages.get(reference)
    correlation = None if declared is None else context.dialects.main.correlation(declared, findings)
    text_ = name or _drawn_name(element)
    value = attempt(element, lambda: context.dialects.main.value(text_), Value(text_), findings)
    return MessageEvent(value, correlation, occurrence.on)


def _message_reference(element: etree._Element) -> str:
    references = [element.get("messageRef")]
    references += [definition.get("messageRef") for definition in children(element, "messageEventDefinition")]
    return next((referenced(reference) for reference in references if reference), "")


def _drawn_name(element: etree._Element) -> str:
    return " ".join((element.get("name") or "").split()) or element.get("id") or ""


def _signal_name(source: _Source) -> Value:
    element, context = source.element, source.context
    reference = referenced(source.definition.get("signalRef") or "")
    declared = context.declared.signals.get(reference)
    name = _drawn_name(element)
    if declared is not None:
        name = declared.get("name") or reference
    elif reference:
        name = _undeclared(source, "signal", reference) or name
    else:
        context.findings.warn(
            element,
            message(
                "bpmn.signal_by_name",
                'it refers to no signal; the signal is called "{name}", like the element',
                name=name,
            ),
        )
    return attempt(element, lambda: context.dialects.main.value(name), Value(name), context.findings)


def _code(source: _Source, what: str) -> str | None:
    declared = source.context.declared
    reference = referenced(source.definition.get(f"{what}Ref") or "")
    if not reference:
        return None
    declaration = (declared.errors if what == "error" else declared.escalations).get(reference)
    if declaration is None:
        return _undeclared(source, what, reference)
    return declaration.get(f"{what}Code") or None


def _undeclared(source: _Source, what: str, reference: str) -> str | None:
    """Return a reference to nothing of the file as the name; None, with a fault, in our own dialect."""
    if source.dialect.lenient:
        source.context.findings.warn(
            source.element,
            message(
                "bpmn.reference_as_name",
                '{what}Ref "{reference}" names no bpmn:{what} of this file; it is read as its name',
                what=what,
                reference=reference,
            ),
        )
        return reference
    source.context.findings.fault(
        source.element,
        message(
            "bpmn.unknown_reference",
            '{what}Ref "{reference}" names no bpmn:{what} of this file',
            what=what,
            reference=reference,
        ),
    )
    return None


def _timer(source: _Source) -> TimerEvent | None:
    findings = source.context.findings
    times = list(children(source.definition, *(timer.value for timer in TimerType)))
    time = text(times[0]) if len(times) == 1 else ""
    if not time:
        findings.fault(
            source.element,
            message("bpmn.wrong_timer", "a timer has one timeDuration, timeDate or timeCycle"),
        )
        return None
    type_ = TimerType(local(times[0]))
    time = source.dialect.time(time)
    if source.dialect.lenient and (zoned := _in_utc(time)) != time:
        findings.warn(
            source.element,
            message("bpmn.time_without_zone", '"{time}" has no time zone and is read as UTC', time=time),
        )
        time = zoned
    try:
        return TimerEvent(type_, _time(type_, time, source.dialect))
    except (ExpressionError, ValueError) as error:
        findings.fault(source.element, text_of(error))
        return None


def _in_utc(time: str) -> str:
    """Return a time with UTC as the zone of those moments in it that have none."""
    return _ZONELESS.sub(lambda moment: f"{moment[1]}{moment[2] or 'T00:00:00'}Z", time.strip())


@dataclass(frozen=True, slots=True)
class _TimeInUtc:
    """An expression of a time; one without a time zone is in UTC."""

    text: str
    expression: Expression

    def value(self, variables: Variables) -> Json:
        time = self.expression.value(variables)
        return _in_utc(time) if isinstance(time, str) else time

    def names(self) -> frozenset[str]:
        return self.expression.names()


def _time(type_: TimerType, time: str, dialect: Dialect) -> Value:
    if is_time(time):
        if type_ is TimerType.CYCLE:
            parse_cycle(time)
        else:
            due_at(time, datetime.now(UTC))
        return Value(time)
    value = dialect.value(time)
    if value.expression is not None:
        if not dialect.lenient:
            return value
        return Value(expression=_TimeInUtc(value.expression.text, value.expression))
    if dialect.lenient:
        raise ValueError(
            message(
                "bpmn.no_time",
                '"{time}" is no {type}; write it like {example}',
                time=time[:64],
                type=type_.value,
                example=_EXAMPLES[type_],
            )
        )
    return Value(expression=dialect.expression(time))


@dataclass(frozen=True, slots=True)
class EventType:
    """How an event definition is read, and which events may have it."""

    read: Callable[[_Source], Event | None]
    places: frozenset[_Place]


_EVERYWHERE = frozenset(_Place)
_CAUGHT = frozenset({_Place.START, _Place.HANDLER, _Place.CATCH})

EVENT_TYPES: Mapping[str, EventType] = {
    "message": EventType(
        lambda source: read_message(source.element, source.occurrence, source.context), _EVERYWHERE
    ),
    "timer": EventType(_timer, _CAUGHT),
    "signal": EventType(lambda source: SignalEvent(_signal_name(source), source.occurrence.on), _EVERYWHERE),
    "error": EventType(_error, frozenset({_Place.HANDLER, _Place.END})),
    "escalation": EventType(_escalation, frozenset({_Place.HANDLER, _Place.THROW, _Place.END})),
    "conditional": EventType(_conditional, _CAUGHT),
    "compensate": EventType(_compensation, frozenset({_Place.HANDLER, _Place.THROW, _Place.END})),
    "link": EventType(_link, frozenset({_Place.CATCH, _Place.THROW})),
    "terminate": EventType(lambda _: TerminateEvent(), frozenset({_Place.END})),
}
"""The event definitions by the name of their elements, without `EventDefinition`."""
