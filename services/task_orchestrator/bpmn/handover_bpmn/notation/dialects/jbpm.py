"""jBPM: attributes and elements of its namespace; Java and MVEL expressions that have the form of JUEL.

Data comes and goes by the data associations of BPMN itself. Work items, Java services and business rules
become Tasks; hints and the parameter `operation` name them.
"""

import re
from collections.abc import Iterator, Mapping
from functools import partial

from lxml import etree

from handover.messages import message
from handover_bpmn.languages.base import Expression
from handover_bpmn.languages.java import read_java
from handover_bpmn.languages.juel import read_template
from handover_bpmn.languages.native_grammar import is_name
from handover_bpmn.model import Assignment, Call, StartForm, Value
from handover_bpmn.notation.dialects.base import (
    Items,
    Mapped,
    Occurrence,
    ProcessExtension,
    Script,
    Work,
    attempt,
    native_script,
    variable_named,
)
from handover_bpmn.notation.dialects.scripts import JAVA_LIKE, set_variables
from handover_bpmn.notation.document import (
    assigned_text,
    attributes_of,
    child_text,
    children,
    extensions,
    local,
    namespace,
    own_data,
)
from handover_bpmn.notation.elements import referenced, refuse, warn_without_effect
from handover_bpmn.notation.faults import Findings

NAMESPACES = ("http://www.jboss.org/drools", "http://www.jboss.org/drools/flow/gpd")

_HARMLESS = frozenset(
    {
        *("packageName", "version", "adHoc", "taskName", "ruleFlowGroup", "dtype", "priority", "selectable"),
        *("serviceimplementation", "serviceinterface", "serviceoperation", "boundaryca", "dockerinfo"),
        *("displayName", "icon", "bgcolor", "color_bgcolor", "msgref", "signalref", "uniqueId", "msgtype"),
        *("itemType", "x", "y", "width", "height", "calledElementByName", "bordercolor", "erefname"),
        *("waitForCompletion", "independent", "import", "global", "customDescription", "customSLADueDate"),
    }
)
_HINTS: Mapping[str, str] = {
    "GroupId": "candidateGroups",
    "ActorId": "assignee",
    "SwimlaneActorId": "assignee",
    "Priority": "priority",
    "DueDate": "dueDate",
}
"""The data inputs of a human task that say who does it, and when."""

_DURATION = re.compile(
    r"\s*(?:(\d{1,6})d)?\s*(?:(\d{1,6})h)?\s*(?:(\d{1,6})m(?!s))?\s*(?:(\d{1,6})s)?\s*(?:(\d{1,3})ms)?\s*",
    re.ASCII,
)


class Jbpm:
    """The dialect of jBPM."""

    spreads_outputs = False
    lenient = True
    potential_owner = "candidateUsers"

    def expression(self, text: str) -> Expression:
        """Return an expression of Java or MVEL that has the form of JUEL; `#{x}` stands for a variable."""
        return read_java(text)

    def value(self, text: str) -> Value:
        """Return a text, which may contain `#{…}`."""
        return Value(expression=read_template(text)) if "#{" in text or "${" in text else Value(text)

    def collection(self, text: str) -> Value:
        """Return an expression or the variable of this name."""
        return Value(expression=self.expression(text))

    def time(self, text: str) -> str:
        """Return durations such as `1d2h30m` and `500ms` in the form of ISO 8601."""
        duration = _DURATION.fullmatch(text)
        if duration is None or not any(duration.groups()):
            return text
        days, hours, minutes, seconds, milliseconds = (int(group or 0) for group in duration.groups())
        return f"P{days}DT{hours}H{minutes}M{seconds}.{milliseconds:03d}S"

    def start_form(self, element: etree._Element, findings: Findings) -> StartForm:  # noqa: ARG002 - of the interface
        """Return nothing: the forms of jBPM are not part of its files."""
        return StartForm()

    def work(self, element: etree._Element, findings: Findings) -> Work:
        """Return the work item, service or rules of an activity, and who does a human task."""
        attributes = attributes_of(element, NAMESPACES)
        hints: dict[str, str] = {}
        for name, text_ in _assigned_inputs(element).items():
            if name in _HINTS and text_:
                hints[_HINTS[name]] = text_
        operation = ""
        if local(element) == "businessRuleTask":
            operation = attributes.get("ruleFlowGroup", "")
        elif local(element) in {"serviceTask", "sendTask"}:
            operation = attributes.get("serviceoperation") or referenced(element.get("operationRef") or "")
        if local(element) != "userTask":
            operation = operation or attributes.get("taskName", "")
        if operation:
            hints["topic"] = operation
        parameters = (
            {"operation": attempt(element, lambda: self.value(operation), Value(), findings)}
            if operation
            else {}
        )
        return Work(parameters=parameters, hints=hints, has_implementation=bool(operation))

    def mapped(self, element: etree._Element, findings: Findings) -> Mapped:  # noqa: ARG002 - of the interface
        """Return nothing: data comes and goes by data associations."""
        return Mapped()

    def call(self, element: etree._Element, findings: Findings) -> Call | None:
        """Return the called process, with the variables of its data associations."""
        attributes = attributes_of(element, NAMESPACES)
        called = (element.get("calledElement") or attributes.get("calledElementByName") or "").strip()
        if not called:
            findings.fault(
                element,
                message(
                    "bpmn.no_called_element",
                    "the call activity names no process; set calledElement to the id of one",
                ),
            )
            return None
        inputs, outputs = self._passed(element, findings)
        return Call(
            attempt(element, lambda: self.value(called), Value(), findings), inputs=inputs, outputs=outputs
        )

    def _passed(
        self, element: etree._Element, findings: Findings
    ) -> tuple[tuple[Assignment, ...], tuple[Assignment, ...]]:
        """Return what the data associations of a call activity pass to the called process, and back."""
        names = own_data(element)
        inputs: list[Assignment] = []
        outputs: list[Assignment] = []
        for association in children(element, "dataInputAssociation", "dataOutputAssociation"):
            source = referenced(child_text(association, "sourceRef"))
            target = referenced(child_text(association, "targetRef"))
            is_input = local(association) == "dataInputAssociation"
            variable = names.get(target, target) if is_input else target
            if not is_name(variable):
                findings.fault(association, f'"{variable}" cannot be the name of a variable')
                continue
            if is_input and not source:
                reading = partial(self.value, assigned_text(association))
            else:
                reading = partial(variable_named, source if is_input else names.get(source, source))
            value = attempt(association, reading, Value(), findings)
            (inputs if is_input else outputs).append(Assignment(variable, value))
        return tuple(inputs), tuple(outputs)

    def evaluated(
        self,
        element: etree._Element,  # noqa: ARG002 - of the interface
        findings: Findings,  # noqa: ARG002
    ) -> tuple[Assignment, ...] | None:
        """Return None: tasks have no expressions."""
        return None

    def items(self, loop: etree._Element, findings: Findings) -> Items:  # noqa: ARG002 - of the interface
        """Return nothing: BPMN's own elements name the collection."""
        return Items()

    def script(self, element: etree._Element, findings: Findings) -> Script:
        """Return the variables that a script sets; any other script is work for somebody."""
        format_ = (element.get("scriptFormat") or "").strip()
        source = child_text(element, "script")
        if format_.lower() == "handover":
            return Script(native_script(element, source, findings))
        similar = format_.lower() in {"", *JAVA_LIKE}
        assignments = set_variables(source) if similar and source else None
        if assignments is None:
            return Script(format=format_ or "java", text=source)
        findings.warn(
            element,
            message(
                "bpmn.script_read_as_juel",
                "the {language} script only sets variables and is read as JUEL; check that it means the same",
                language=format_ or "java",
            ),
        )
        return Script(assignments)

    def occurrence(
        self,
        element: etree._Element,  # noqa: ARG002 - of the interface
        definition: etree._Element | None,  # noqa: ARG002
        findings: Findings,  # noqa: ARG002
    ) -> Occurrence:
        """Return nothing."""
        return Occurrence()

    def correlation(self, declared: etree._Element, findings: Findings) -> Value | None:  # noqa: ARG002
        """Return None: jBPM has no correlation of a message."""
        return None

    def process(self, element: etree._Element, findings: Findings) -> ProcessExtension:  # noqa: ARG002
        """Return the version."""
        return ProcessExtension(attributes_of(element, NAMESPACES).get("version") or None)

    def listeners(self, element: etree._Element) -> tuple[tuple[Assignment, ...], tuple[Assignment, ...]]:
        """Return the variables that the scripts at entry and exit set."""
        before: list[Assignment] = []
        after: list[Assignment] = []
        for extension in _listeners(element):
            assigned = set_variables(_script_of(extension)) or ()
            (before if local(extension) == "onEntry-script" else after).extend(assigned)
        return tuple(before), tuple(after)

    def check(self, element: etree._Element, findings: Findings) -> None:
        """Report what has no effect, and decisions."""
        if local(element) == "businessRuleTask" and (element.get("implementation") or "").endswith("/dmn"):
            refuse(
                element,
                "businessRuleTask with a DMN decision",
                "let a Task decide instead, with a ruleFlowGroup or without any extension",
                findings,
            )
        for name in sorted(attributes_of(element, NAMESPACES).keys() - _HARMLESS):
            warn_without_effect(element, findings, f"drools:{name}")
        for extension in extensions(element):
            if namespace(extension) not in NAMESPACES or local(extension) == "metaData":
                continue
            if local(extension) not in _SCRIPTS or set_variables(_script_of(extension)) is None:
                warn_without_effect(extension, findings, f"drools:{local(extension)}")


_SCRIPTS = frozenset({"onEntry-script", "onExit-script"})


def _listeners(element: etree._Element) -> Iterator[etree._Element]:
    for extension in extensions(element):
        if namespace(extension) in NAMESPACES and local(extension) in _SCRIPTS:
            yield extension


def _script_of(listener: etree._Element) -> str:
    return next(((part.text or "").strip() for part in listener.iterchildren("{*}script")), "")


def _assigned_inputs(element: etree._Element) -> Mapping[str, str]:
    """Return the texts that are assigned to data inputs, by the name of the data input."""
    names = own_data(element)
    inputs: dict[str, str] = {}
    for association in children(element, "dataInputAssociation"):
        target = referenced(child_text(association, "targetRef"))
        if target in names:
            inputs[names[target]] = assigned_text(association)
    return inputs
