"""Dialect: the interface to the extension elements of one vendor, in the terms of the model."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import orjson
from lxml import etree

from handover.formats.durations import Duration
from handover.messages import message, text_of
from handover_bpmn.forms.form import form_fault
from handover_bpmn.languages import native
from handover_bpmn.languages.base import Expression, ExpressionError, Json, Variables
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.languages.native_grammar import is_name, is_variable_name
from handover_bpmn.model import (
    Assignment,
    Call,
    EntityFilter,
    FormBinding,
    FormReference,
    PerformerLost,
    Place,
    ProcessParameter,
    StartForm,
    Value,
)
from handover_bpmn.notation.faults import Findings

Read = TypeVar("Read")


@dataclass(frozen=True, slots=True)
class Work:
    """What the extension elements of an activity say of its Task."""

    definition: str | None = None
    deadline: Duration | None = None
    involves: tuple[Value, ...] = ()
    happens_at: tuple[Place, ...] = ()
    parameters: Mapping[str, Value] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    variable: str | None = None
    """The variable for all results; if None, a dialect that spreads them does so."""
    handles_outcomes: bool = False
    require_pin: bool = False
    performer_lost: PerformerLost = PerformerLost.ASK
    hints: Mapping[str, str] = field(default_factory=dict)
    has_implementation: bool = False
    """Whether somebody has to do it: a send task or message event is then a Task, not a message."""
    form: FormReference | None = None
    inputs_schema: Json = None
    role: str | None = None
    skills: tuple[str, ...] = ()
    materials: tuple[Value, ...] = ()
    assets: tuple[Value, ...] = ()


@dataclass(frozen=True, slots=True)
class Mapped:
    """Variables that an activity gets before its start and sets at its end."""

    inputs: tuple[Assignment, ...] = ()
    outputs: tuple[Assignment, ...] = ()


@dataclass(frozen=True, slots=True)
class Items:
    """What extension elements say of a multi-instance activity."""

    collection: Value | None = None
    item_variable: str | None = None
    output_collection: str | None = None
    output_item: Value | None = None
    first: int = 0
    """The `loopCounter` of the first instance."""


@dataclass(frozen=True, slots=True)
class Script:
    """A script task: `assignments`, or a Task for somebody who can run the text."""

    assignments: tuple[Assignment, ...] | None = None
    format: str = ""
    text: str = ""
    variable: str | None = None


@dataclass(frozen=True, slots=True)
class Occurrence:
    """What extension elements say of an event."""

    on: EntityFilter | None = None
    code_variable: str | None = None
    message_variable: str | None = None


@dataclass(frozen=True, slots=True)
class ProcessExtension:
    """What extension elements say of a process."""

    label: str | None = None
    parameters: Mapping[str, ProcessParameter] = field(default_factory=dict)
    naming: Expression | None = None
    """Yields the title of a process."""
    translations: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """The texts of the file in other languages: by language (BCP 47), then by the text of the file."""


class Dialect(Protocol):
    """The extension elements and the expression language of a vendor.

    The methods report faults and warnings at the elements, and return what can be read nevertheless.
    """

    spreads_outputs: bool
    """Whether each result of a Task becomes a variable of its own name."""

    lenient: bool
    """Whether a gateway's only flow without a condition is its default, and times without zone are UTC."""

    potential_owner: str
    """The hint for the name in a `potentialOwner`: groups, or in jBPM persons."""

    def expression(self, text: str) -> Expression:
        """Return an expression; raise `ExpressionError` if it is invalid."""
        ...

    def value(self, text: str) -> Value:
        """Return a literal text or an expression; raise `ExpressionError` if it is invalid."""
        ...

    def collection(self, text: str) -> Value:
        """Return an expression or the variable of this name; raise `ExpressionError`."""
        ...

    def time(self, text: str) -> str:
        """Return a literal time of a timer in the form of ISO 8601 or cron, any other text unchanged."""
        ...

    def work(self, element: etree._Element, findings: Findings) -> Work:
        """Return what an activity, or a message event, says of its Task."""
        ...

    def start_form(self, element: etree._Element, findings: Findings) -> StartForm:
        """Return the form of a none start event."""
        ...

    def mapped(self, element: etree._Element, findings: Findings) -> Mapped:
        """Return the variables that an activity or event gets and sets."""
        ...

    def call(self, element: etree._Element, findings: Findings) -> Call | None:
        """Return the process that a call activity runs; None, with a fault, if it names none."""
        ...

    def evaluated(self, element: etree._Element, findings: Findings) -> tuple[Assignment, ...] | None:
        """Return what the expression of a task sets; None if the task is work for somebody."""
        ...

    def items(self, loop: etree._Element, findings: Findings) -> Items:
        """Return what a multi-instance loop runs over."""
        ...

    def script(self, element: etree._Element, findings: Findings) -> Script:
        """Return what a script task does."""
        ...

    def occurrence(
        self, element: etree._Element, definition: etree._Element | None, findings: Findings
    ) -> Occurrence:
        """Return what an event says beside BPMN; `definition` is its event definition."""
        ...

    def correlation(self, declared: etree._Element, findings: Findings) -> Value | None:
        """Return the correlation key of a declared message."""
        ...

    def process(self, element: etree._Element, findings: Findings) -> ProcessExtension:
        """Return what a process says."""
        ...

    def listeners(self, element: etree._Element) -> tuple[tuple[Assignment, ...], tuple[Assignment, ...]]:
        """Return the variables that listeners set before and after an element or sequence flow."""
        ...

    def check(self, element: etree._Element, findings: Findings) -> None:
        """Report extension elements and attributes that have no effect, and those that are refused."""
        ...


def attempt(
    element: etree._Element, reading: Callable[[], Read], otherwise: Read, findings: Findings
) -> Read:
    """Return what `reading` returns; `otherwise`, with a fault at `element`, if it raises."""
    try:
        return reading()
    except (ExpressionError, ValueError) as error:
        findings.fault(element, text_of(error))
        return otherwise


WRITTEN_FORM = "camunda-forms:bpmn:"
_FORM_FILES = ("camunda-forms:deployment:", "embedded:deployment:")


def named_form(key: str) -> FormReference | None:
    """Return the form of a `formKey` that names a file of the deployment; None for all others."""
    for prefix in _FORM_FILES:
        if key.startswith(prefix) and key.endswith(".form"):
            return FormReference(key.removeprefix(prefix), FormBinding.DEPLOYMENT, is_file=True)
    return None


def written_form(element: etree._Element, text: str, findings: Findings) -> dict[str, Value]:
    """Return the form that a file contains as JSON as the parameter `form`."""
    try:
        schema = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        findings.fault(element, message("form.not_json", "the form is no JSON: {error}", error=str(error)))
        return {}
    fault = form_fault(schema) if isinstance(schema, dict) else "a form is a JSON object"
    if fault is not None:
        findings.fault(element, fault)
        return {}
    return {"form": Value(schema)}


def native_variable(name: str) -> Value:
    """Return the value of a variable; raise `ExpressionError` if `name` cannot be one."""
    if not is_variable_name(name):
        raise ExpressionError(f'"{name}" cannot be the name of a variable')
    return Value(expression=native.read(name))


def variable_named(name: str) -> Value:
    """Return the value of a variable of another language; raise `ExpressionError` if `name` cannot be one."""
    if is_variable_name(name):
        return native_variable(name)
    if not is_name(name):
        raise ExpressionError(f'"{name}" cannot be the name of a variable')
    return Value(expression=read_juel(f"${{execution.getVariable('{name}')}}"))


def native_script(element: etree._Element, text: str, findings: Findings) -> tuple[Assignment, ...]:
    """Return the assignments of a script in our language; none, with a fault, if it is invalid."""
    if not text.strip():
        findings.fault(element, "a scriptTask needs a script of lines `name = expression`")
    nothing: tuple[tuple[str, Expression], ...] = ()
    steps = attempt(element, lambda: native.read_script(text), nothing, findings)
    return tuple(Assignment(name, Value(expression=expression)) for name, expression in steps)


def script_or_work(source: str) -> Script:
    """Return a script of no declared language: assignments of ours, else work for somebody."""
    try:
        steps = native.read_script(source)
    except ExpressionError:
        return Script(text=source)
    if not steps:
        return Script(text=source)
    return Script(tuple(Assignment(name, Value(expression=expression)) for name, expression in steps))


@dataclass(frozen=True, slots=True)
class ObjectExpression:
    """An object of values, or, if it has keys from "0", a list of them."""

    text: str
    members: Mapping[str, Value]
    is_list: bool = False

    def value(self, variables: Variables) -> Json:
        """Return the object or list."""
        values = {name: member.value(variables) for name, member in self.members.items()}
        return list(values.values()) if self.is_list else values

    def names(self) -> frozenset[str]:
        """Return the names of the variables that its values read."""
        variables: frozenset[str] = frozenset()
        for member in self.members.values():
            if member.expression is not None:
                variables |= member.expression.names()
        return variables


def composed(text: str, members: Mapping[str, Value], *, is_list: bool = False) -> Value:
    """Return an object or list of values; a literal if all of them are."""
    expression = ObjectExpression(text, members, is_list)
    if any(member.expression is not None for member in members.values()):
        return Value(expression=expression)
    return Value(literal=expression.value({}))
