"""Camunda 8: the extension elements of Zeebe, and FEEL expressions, which begin with `=`."""

import re
from collections.abc import Iterator, Mapping
from functools import partial

from lxml import etree

from handover.messages import message
from handover_bpmn.languages.base import Expression, ExpressionError
from handover_bpmn.languages.feel import read_feel
from handover_bpmn.languages.java import read_java
from handover_bpmn.languages.native_grammar import is_name
from handover_bpmn.model import Assignment, Call, FormBinding, FormReference, StartForm, Value
from handover_bpmn.notation.dialects.base import (
    WRITTEN_FORM,
    Items,
    Mapped,
    Occurrence,
    ProcessExtension,
    Script,
    Work,
    attempt,
    composed,
    named_form,
    written_form,
)
from handover_bpmn.notation.document import BPMN, child_text, extensions, flag, local, namespace, text
from handover_bpmn.notation.elements import refuse, warn_without_effect
from handover_bpmn.notation.faults import Findings

NAMESPACE = "http://camunda.org/schema/zeebe/1.0"

_ROOT = re.compile(r"\$\.(?=\w)")
"""The root of the variables in JSONPath."""
MAX_PATH = 10
"""Steps of the target of a mapping, such as `a.b`."""

_HARMLESS = frozenset(
    {
        *("taskDefinition", "taskHeaders", "ioMapping", "assignmentDefinition", "formDefinition"),
        *("calledElement", "loopCharacteristics", "subscription", "script", "userTask", "versionTag"),
        *("properties", "taskSchedule", "priorityDefinition", "userTaskForm", "conditionalFilter"),
    }
)
_HINTS: Mapping[str, Mapping[str, str]] = {
    "taskDefinition": {"type": "jobType", "retries": "retries"},
    "assignmentDefinition": {
        "assignee": "assignee",
        "candidateGroups": "candidateGroups",
        "candidateUsers": "candidateUsers",
    },
    "formDefinition": {"formKey": "formKey", "formId": "formId", "externalReference": "formKey"},
    "taskSchedule": {"dueDate": "dueDate", "followUpDate": "followUpDate"},
    "priorityDefinition": {"priority": "priority"},
}


class Zeebe:
    """The dialect of Camunda 8."""

    spreads_outputs = True
    lenient = True
    potential_owner = "candidateGroups"

    def expression(self, text: str) -> Expression:
        """Return a FEEL expression; `=` before it may be left out where only an expression can stand.

        Conditions of releases before FEEL (`$.total >= 5 && approved == true`) are read too.
        """
        try:
            return read_feel(text)
        except ExpressionError:
            if text.strip().startswith("="):
                raise
            try:
                return read_java(_ROOT.sub("", text))
            except ExpressionError:
                pass
            raise

    def value(self, text: str) -> Value:
        """Return the value of a FEEL expression if the text begins with `=`, else the text."""
        if text.strip().startswith("="):
            return Value(expression=self.expression(text))
        return Value(text)

    def collection(self, text: str) -> Value:
        """Return a FEEL expression."""
        return Value(expression=self.expression(text))

    def time(self, text: str) -> str:
        """Return the text unchanged: times are those of ISO 8601 and cron."""
        return text

    def work(self, element: etree._Element, findings: Findings) -> Work:
        """Return what the extension elements say of the Task."""
        hints: dict[str, str] = {}
        parameters: dict[str, Value] = {}
        form: FormReference | None = None
        for extension in _ours(element):
            for attribute, hint in _HINTS.get(local(extension), {}).items():
                if extension.get(attribute):
                    hints[hint] = extension.get(attribute) or ""
            if local(extension) == "formDefinition":
                form = _form_reference(extension)
                parameters |= self._written_form(element, extension, findings)
            elif local(extension) == "taskHeaders":
                headers = {
                    header.get("key") or "": header.get("value") for header in _parts(extension, "header")
                }
                parameters["headers"] = Value(headers)
            elif local(extension) == "properties":
                properties = {
                    property_.get("name") or "": property_.get("value")
                    for property_ in _parts(extension, "property")
                }
                parameters["properties"] = Value(properties)
        if "jobType" in hints:
            parameters["operation"] = attempt(
                element, lambda: self.value(hints["jobType"]), Value(), findings
            )
        parameters |= {
            assignment.target: assignment.value for assignment in self._io(element, "input", findings)
        }
        return Work(parameters=parameters, hints=hints, has_implementation="jobType" in hints, form=form)

    def start_form(self, element: etree._Element, findings: Findings) -> StartForm:
        """Return the form of a start event."""
        for definition in _named(element, "formDefinition"):
            written = self._written_form(element, definition, findings).get("form")
            return StartForm(written, _form_reference(definition))
        return StartForm()

    def _written_form(
        self, element: etree._Element, definition: etree._Element, findings: Findings
    ) -> dict[str, Value]:
        """Return a form that the process contains (`camunda-forms:bpmn:…`) as the parameter `form`."""
        key = definition.get("formKey") or ""
        if not key.startswith(WRITTEN_FORM):
            return {}
        process = next(element.iterancestors(f"{{{BPMN}}}process"), None)
        for form in () if process is None else _named(process, "userTaskForm"):
            if form.get("id") == key.removeprefix(WRITTEN_FORM):
                return written_form(element, text(form), findings)
        return {}

    def mapped(self, element: etree._Element, findings: Findings) -> Mapped:
        """Return the variables of `ioMapping`; of a call activity they belong to the call."""
        if local(element) == "callActivity":
            return Mapped()
        return Mapped(self._io(element, "input", findings), self._io(element, "output", findings))

    def _io(self, element: etree._Element, name: str, findings: Findings) -> tuple[Assignment, ...]:
        """Return the assignments of a mapping; targets such as `a.b` become an object `a`."""
        values: dict[str, Value | dict[str, object]] = {}
        for group in _named(element, "ioMapping"):
            for part in _parts(group, name):
                source, target = part.get("source") or "", (part.get("target") or "").strip()
                path = target.split(".")
                if len(path) > MAX_PATH or not all(is_name(step) for step in path):
                    findings.fault(part, f'target="{target[:100]}" cannot be the name of a variable')
                    continue
                value = attempt(part, partial(self.value, source), Value(), findings)
                _put(values, path, value)
        return tuple(Assignment(target, _assembled(target, value)) for target, value in values.items())

    def call(self, element: etree._Element, findings: Findings) -> Call | None:
        """Return the process of `calledElement`."""
        called = next(_named(element, "calledElement"), None)
        name = "" if called is None else (called.get("processId") or "").strip()
        if called is None or not name:
            findings.fault(
                element,
                message(
                    "bpmn.no_called_element",
                    "the call activity names no process; set calledElement to the id of one",
                ),
            )
            return None
        tag = called.get("versionTag") if called.get("bindingType") == "versionTag" else None
        outputs = self._io(element, "output", findings)
        return Call(
            attempt(element, lambda: self.value(name), Value(), findings),
            tag=None if tag is None else Value(tag),
            inputs=self._io(element, "input", findings),
            outputs=outputs,
            all_inputs=flag(called, "propagateAllParentVariables", default=True),
            all_outputs=flag(called, "propagateAllChildVariables", default=True) and not outputs,
            in_order=True,
        )

    def evaluated(
        self,
        element: etree._Element,  # noqa: ARG002 - of the interface
        findings: Findings,  # noqa: ARG002
    ) -> tuple[Assignment, ...] | None:
        """Return None: tasks have no expressions."""
        return None

    def items(self, loop: etree._Element, findings: Findings) -> Items:
        """Return what `loopCharacteristics` names."""
        extension = next(_named(loop, "loopCharacteristics"), None)
        if extension is None:
            return Items(first=1)
        collection, item = extension.get("inputCollection"), extension.get("inputElement")
        output, output_item = extension.get("outputCollection"), extension.get("outputElement")
        for name in (item, output):
            if name and not is_name(name):
                findings.fault(loop, f'"{name}" cannot be the name of a variable')
        return Items(
            attempt(loop, lambda: self.collection(collection), None, findings) if collection else None,
            item or None,
            output or None,
            attempt(loop, lambda: self.collection(output_item), None, findings) if output_item else None,
            first=1,
        )

    def script(self, element: etree._Element, findings: Findings) -> Script:
        """Return the FEEL expression of `zeebe:script`; any other script is work for somebody."""
        extension = next(_named(element, "script"), None)
        if extension is None:
            format_ = element.get("scriptFormat") or ""
            return Script(format=format_, text=child_text(element, "script"))
        variable = extension.get("resultVariable") or ""
        if not is_name(variable):
            findings.fault(element, f'resultVariable="{variable}" cannot be the name of a variable')
        source = extension.get("expression") or ""
        value = attempt(element, lambda: self.collection(source), Value(), findings)
        return Script((Assignment(variable, value), *self._io(element, "output", findings)))

    def occurrence(
        self,
        element: etree._Element,  # noqa: ARG002 - of the interface
        definition: etree._Element | None,  # noqa: ARG002
        findings: Findings,  # noqa: ARG002
    ) -> Occurrence:
        """Return nothing: codes of caught errors are not kept."""
        return Occurrence()

    def correlation(self, declared: etree._Element, findings: Findings) -> Value | None:
        """Return the correlation key of `subscription`."""
        for subscription in _named(declared, "subscription"):
            key = subscription.get("correlationKey")
            if key:
                return attempt(declared, partial(self.value, key), None, findings)
        return None

    def process(self, element: etree._Element, findings: Findings) -> ProcessExtension:  # noqa: ARG002
        """Return the version tag."""
        return ProcessExtension(
            next((tag.get("value") or None for tag in _named(element, "versionTag")), None)
        )

    def listeners(
        self,
        element: etree._Element,  # noqa: ARG002 - of the interface
    ) -> tuple[tuple[Assignment, ...], tuple[Assignment, ...]]:
        """Return nothing."""
        return (), ()

    def check(self, element: etree._Element, findings: Findings) -> None:
        """Report what has no effect, and decisions."""
        for extension in _ours(element):
            name = local(extension)
            if name == "calledDecision":
                refuse(
                    element,
                    "businessRuleTask with calledDecision (a DMN decision)",
                    "let a Task decide instead, with a taskDefinition or without any extension",
                    findings,
                )
            elif name not in _HARMLESS:
                warn_without_effect(extension, findings, f"zeebe:{name}")


def _form_reference(definition: etree._Element) -> FormReference | None:
    form_id, key = definition.get("formId"), definition.get("formKey") or ""
    if not form_id:
        return named_form(key)
    is_bound = definition.get("bindingType") == "deployment"
    return FormReference(form_id, FormBinding.DEPLOYMENT if is_bound else FormBinding.LATEST)


def _ours(element: etree._Element) -> Iterator[etree._Element]:
    for extension in extensions(element):
        if namespace(extension) == NAMESPACE:
            yield extension


def _named(element: etree._Element, name: str) -> Iterator[etree._Element]:
    for extension in _ours(element):
        if local(extension) == name:
            yield extension


def _parts(group: etree._Element, name: str) -> Iterator[etree._Element]:
    yield from group.iterchildren(f"{{{NAMESPACE}}}{name}")


def _put(values: dict[str, Value | dict[str, object]], path: list[str], value: Value) -> None:
    inner: dict[str, object] = values  # type: ignore[assignment]  # the same tree at every level
    for step in path[:-1]:
        below = inner.get(step)
        if not isinstance(below, dict):
            below = inner[step] = {}
        inner = below
    inner[path[-1]] = value


def _assembled(target: str, value: object) -> Value:
    if isinstance(value, Value):
        return value
    assert isinstance(value, dict)  # noqa: S101 - for the type checker
    return composed(target, {name: _assembled(name, part) for name, part in value.items()})
