"""Camunda 7: attributes and elements of its namespace, and those of its relatives with the same names.

Where its engine calls Java code (`class`, `delegateExpression`, a topic, scripts in Groovy or JavaScript), a
Task is created; its hints and the parameter `operation` name the code.
"""

import json
import re
from collections.abc import Iterator, Mapping

from lxml import etree

from handover.messages import message
from handover_bpmn.languages import native
from handover_bpmn.languages.base import Expression, ExpressionError, Json, within_limits
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.languages.native_grammar import is_name, is_variable_name
from handover_bpmn.model import Assignment, Call, FormBinding, FormReference, StartForm, Value
from handover_bpmn.notation.dialects.base import (
    Items,
    Mapped,
    Occurrence,
    ProcessExtension,
    Script,
    Work,
    attempt,
    composed,
    named_form,
    native_script,
    script_or_work,
    variable_named,
)
from handover_bpmn.notation.dialects.camunda7_calls import passed_variables, read_call
from handover_bpmn.notation.dialects.camunda7_elements import (
    NAMESPACES,
    extensions_named,
    has_expression,
    own_child_text,
    own_extensions,
)
from handover_bpmn.notation.dialects.camunda7_forms import read_form
from handover_bpmn.notation.dialects.camunda7_listeners import (
    assigned_by_script,
    initial_values,
    listener_assignments,
)
from handover_bpmn.notation.dialects.camunda7_values import connector_input_output, input_output, text_value
from handover_bpmn.notation.dialects.scripts import assigned_by
from handover_bpmn.notation.document import attributes_of, child_text, is_none_start, local, text
from handover_bpmn.notation.elements import warn_without_effect
from handover_bpmn.notation.faults import Findings

_HINTS = (
    *("assignee", "candidateUsers", "candidateGroups", "dueDate", "followUpDate", "priority", "formKey"),
    *("formRef", "topic", "type", "class", "delegateExpression", "expression", "taskPriority", "owner"),
)
_IMPLEMENTATIONS = ("topic", "class", "delegateExpression", "expression", "type")
_HARMLESS = frozenset(
    {
        *("historyTimeToLive", "isStartableInTasklist", "modelerTemplate", "modelerTemplateVersion"),
        *("modelerTemplateIcon", "diagramRelationId", "versionTag", "formRefBinding", "formRefVersion"),
        *(
            "elementVariable",
            "collection",
            "resultVariable",
            "resultVariableName",
            "resource",
            "errorCodeVariable",
        ),
        *("errorMessageVariable", "escalationCodeVariable", "calledElementBinding", "calledElementVersion"),
        *("calledElementVersionTag", "decisionRef", "errorCodeMessage", "inheritVariables"),
        *("autoStoreVariables", "calledElementType", *_HINTS),
    }
)
"""Attributes that are read, or that say nothing of the execution."""

_READ = frozenset(
    {
        *("inputOutput", "formData", "in", "out", "failedJobRetryTimeCycle", "properties", "connector"),
        *("potentialStarter", "executionListener", "taskListener", "formProperty", "field"),
        *("collection", "variableAggregation", "value"),
    }
)
_QUOTED = re.compile(r"""'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*\"""")
_PART = re.compile(r"(?<!\bexecution)\.(?!\d)")
"""A part of a variable, which may be a bean."""
_DECISION = "businessRuleTask with decisionRef (a DMN decision)"


class Camunda7:
    """The dialect of Camunda 7."""

    spreads_outputs = True
    lenient = True
    potential_owner = "candidateGroups"

    def expression(self, text: str) -> Expression:
        """Return a JUEL expression; `true` and `false` may stand alone."""
        return native.read(text) if text.strip() in {"true", "false"} else read_juel(text)

    def value(self, text: str) -> Value:
        """Return a text, which may contain JUEL expressions."""
        return text_value(text)

    def collection(self, text: str) -> Value:
        """Return a JUEL expression or the variable of this name."""
        return Value(expression=read_juel(text)) if has_expression(text) else variable_named(text)

    def time(self, text: str) -> str:
        """Return the text unchanged: times are those of ISO 8601 and cron."""
        return text

    def work(self, element: etree._Element, findings: Findings) -> Work:
        """Return what attributes and extension elements say of the Task."""
        attributes = attributes_of(element, NAMESPACES)
        hints = {name: attributes[name].strip() for name in _HINTS if attributes.get(name)}
        if "type" in hints and "topic" not in hints:
            hints.setdefault("topic", hints["type"])
        implementation = {name: hints[name] for name in _IMPLEMENTATIONS if name in hints}
        parameters: dict[str, Value] = {}
        operation = _operation(implementation)
        for extension in own_extensions(element):
            match local(extension):
                case "formData":
                    parameters["form"] = read_form(extension, findings)
                case "field":
                    parameters[extension.get("name") or ""] = self._field(extension, findings)
                case "properties":
                    properties = {
                        property_.get("name") or "": property_.get("value") for property_ in extension
                    }
                    parameters["properties"] = Value(properties)
                case "failedJobRetryTimeCycle":
                    hints["retry"] = text(extension)
                case "connector":
                    operation = hints["connector"] = own_child_text(extension, "connectorId")
                    inputs = connector_input_output(extension, "inputParameter", findings)
                    parameters |= {assignment.target: assignment.value for assignment in inputs}
        form = self._form_reference(attributes)
        if operation and not local(element).startswith("userTask"):
            parameters["operation"] = Value(operation)
        parameters |= {assignment.target: assignment.value for assignment in self._inputs(element, findings)}
        return Work(
            parameters=parameters,
            variable=self._result_variable(element, findings),
            hints=hints,
            form=form,
            has_implementation=bool(implementation) or "connector" in hints,
        )

    def start_form(self, element: etree._Element, findings: Findings) -> StartForm:
        """Return the generated or named form of a start event."""
        written = [
            read_form(extension, findings)
            for extension in own_extensions(element)
            if local(extension) == "formData"
        ]
        reference = self._form_reference(attributes_of(element, NAMESPACES))
        return StartForm(written[0] if written else None, reference)

    def _form_reference(self, attributes: Mapping[str, str]) -> FormReference | None:
        name = attributes.get("formRef")
        if not name:
            return named_form(attributes.get("formKey") or "")
        binding, version = attributes.get("formRefBinding"), attributes.get("formRefVersion") or ""
        if binding == "version" and version.isascii() and version.isdecimal():
            return FormReference(name, FormBinding.VERSION, int(version[:9]))
        is_bound = binding == "deployment"
        return FormReference(name, FormBinding.DEPLOYMENT if is_bound else FormBinding.LATEST)

    def mapped(self, element: etree._Element, findings: Findings) -> Mapped:
        """Return the variables of `inputOutput`; of an event definition those that it sends along."""
        if local(element).endswith("EventDefinition"):
            passed, everything, _ = passed_variables(element, "in", findings)
            if everything:
                warn_without_effect(element, findings, 'camunda:in variables="all"')
            return Mapped(passed)
        connectors = [extension for extension in own_extensions(element) if local(extension) == "connector"]
        outputs = [
            assignment
            for part in connectors
            for assignment in connector_input_output(part, "outputParameter", findings)
        ]
        outputs += input_output(element, "outputParameter", findings)
        return Mapped(tuple(self._inputs(element, findings)), tuple(outputs))

    def _field(self, field: etree._Element, findings: Findings) -> Value:
        """Return the value of a field of a class."""
        content = field.get("stringValue") or field.get("expression")
        content = content or own_child_text(field, "string") or own_child_text(field, "expression")
        return attempt(field, lambda: self.value(content), Value(), findings)

    def _inputs(self, element: etree._Element, findings: Findings) -> Iterator[Assignment]:
        yield from input_output(element, "inputParameter", findings)

    def call(self, element: etree._Element, findings: Findings) -> Call | None:
        """Return the called process with its binding, `in` and `out`."""
        return read_call(element, findings)

    def evaluated(self, element: etree._Element, findings: Findings) -> tuple[Assignment, ...] | None:
        """Return what an `expression` sets that calls no bean: a variable, or the result variable."""
        attributes = attributes_of(element, NAMESPACES)
        formula = (attributes.get("expression") or "").strip()
        if not formula or attributes.keys() & {"class", "delegateExpression", "type", "topic"}:
            return None
        variable = self._result_variable(element, findings)
        assigned = assigned_by(formula)
        if assigned and not variable:
            return assigned
        if variable is None or not has_expression(formula) or _PART.search(_QUOTED.sub("", formula)):
            return None
        try:
            return (Assignment(variable, self.value(formula)),)
        except ExpressionError:
            return None

    def items(self, loop: etree._Element, findings: Findings) -> Items:
        """Return `collection` and `elementVariable`."""
        attributes = attributes_of(loop, NAMESPACES)
        collection, variable = attributes.get("collection"), attributes.get("elementVariable")
        if variable is not None and not is_name(variable):
            findings.fault(loop, f'elementVariable="{variable}" cannot be the name of a variable')
        output = self._aggregated(loop, findings)
        return Items(
            self._collection_of(loop, findings)
            if not collection
            else attempt(loop, lambda: self.collection(collection.strip()), None, findings),
            variable,
            *output,
        )

    def _collection_of(self, loop: etree._Element, findings: Findings) -> Value | None:
        """Return the collection of an extension of Flowable: a JSON list, an expression or a variable."""
        part = next(extensions_named(loop, "collection"), None)
        if part is None:
            return None
        listed = text(part) or own_child_text(part, "string") or own_child_text(part, "expression")
        if not listed:
            return None
        if listed.startswith("["):
            return attempt(loop, lambda: Value(_json_list(listed)), None, findings)
        return attempt(loop, lambda: self.collection(listed), None, findings)

    def _aggregated(self, loop: etree._Element, findings: Findings) -> tuple[str | None, Value | None]:
        """Return the list that aggregates variables of the instances in Flowable, and what an item holds."""
        for aggregation in extensions_named(loop, "variableAggregation"):
            target = aggregation.get("target") or ""
            if not is_name(target):
                warn_without_effect(aggregation, findings, "flowable:variableAggregation")
                continue
            members: dict[str, Value] = {}
            for part in aggregation.iterchildren("{*}variable"):
                name = part.get("target") or part.get("source") or ""
                value = self._aggregated_value(part)
                if value is None:
                    warn_without_effect(
                        part, findings, f'the variable "{name[:64]}" of a variableAggregation'
                    )
                elif name:
                    members[name] = value
            return target, composed("variableAggregation", members)
        return None, None

    def _aggregated_value(self, part: etree._Element) -> Value | None:
        source = part.get("source") or ""
        try:
            if source and is_variable_name(source):
                return Value(expression=read_juel(f"${{vars:get({source})}}"))
            return self.value(part.get("sourceExpression") or part.get("targetExpression") or "")
        except ExpressionError:
            return None

    def script(self, element: etree._Element, findings: Findings) -> Script:
        """Return a script of JUEL or of our language; any other is work for somebody."""
        format_ = (element.get("scriptFormat") or "").strip()
        source = child_text(element, "script")
        variable = self._result_variable(element, findings)
        resource = attributes_of(element, NAMESPACES).get("resource")
        if format_.lower() == "juel" or (not format_ and has_expression(source)):
            return self._juel_script(element, source, variable, findings)
        if format_.lower() == "handover":
            return Script(native_script(element, source, findings))
        if not format_ and source and not resource:
            return script_or_work(source)
        assignments = () if variable or resource else assigned_by_script(format_, source)
        if assignments:
            findings.warn(
                element,
                message(
                    "bpmn.script_read_as_juel",
                    "the {language} script only sets variables and is read as JUEL; "
                    "check that it means the same",
                    language=format_,
                ),
            )
            return Script(assignments)
        return Script(format=format_, text=source or resource or "", variable=variable)

    def _juel_script(
        self, element: etree._Element, source: str, variable: str | None, findings: Findings
    ) -> Script:
        """Return a script of JUEL, the default language of scripts."""
        assigned = assigned_by(source)
        if assigned and not variable:
            return Script(assigned)
        value = attempt(element, lambda: self.value(source), Value(), findings)
        return Script((Assignment(variable, value),) if variable else ())

    def _result_variable(self, element: etree._Element, findings: Findings) -> str | None:
        attributes = attributes_of(element, NAMESPACES)
        name = attributes.get("resultVariable") or attributes.get("resultVariableName")
        if name and not is_name(name):
            findings.fault(element, f'resultVariable="{name}" cannot be the name of a variable')
        return name or None

    def occurrence(
        self, element: etree._Element, definition: etree._Element | None, findings: Findings
    ) -> Occurrence:
        """Return the variables for code and message of a caught error or escalation."""
        attributes = {} if definition is None else attributes_of(definition, NAMESPACES)
        code = attributes.get("errorCodeVariable") or attributes.get("escalationCodeVariable")
        text_ = attributes.get("errorMessageVariable")
        for name in (code, text_):
            if name and not is_name(name):
                findings.fault(element, f'"{name}" cannot be the name of a variable')
        return Occurrence(code_variable=code or None, message_variable=text_ or None)

    def correlation(self, declared: etree._Element, findings: Findings) -> Value | None:  # noqa: ARG002
        """Return None: messages are correlated by the business key and variables."""
        return None

    def process(self, element: etree._Element, findings: Findings) -> ProcessExtension:  # noqa: ARG002
        """Return the version tag."""
        return ProcessExtension(attributes_of(element, NAMESPACES).get("versionTag") or None)

    def check(self, element: etree._Element, findings: Findings) -> None:
        """Report what has no effect, and decisions."""
        attributes = attributes_of(element, NAMESPACES)
        if local(element) == "businessRuleTask" and attributes.get("decisionRef"):
            findings.fault(
                element,
                message(
                    "bpmn.not_supported",
                    "{what} is not supported yet; {way_out}",
                    what=_DECISION,
                    way_out="let a Task decide instead, with a topic or without any extension",
                ),
            )
        if local(element) == "serviceTask" and attributes.get("type") == "dmn":
            findings.fault(
                element,
                message(
                    "bpmn.not_supported",
                    "{what} is not supported yet; {way_out}",
                    what="serviceTask of the type dmn (a DMN decision)",
                    way_out="let a Task decide instead, with a topic or without any extension",
                ),
            )
        for name in sorted(attributes.keys() - _HARMLESS):
            warn_without_effect(element, findings, f"camunda:{name}")
        if attributes.get("calledElementBinding") == "deployment":
            warn_without_effect(element, findings, 'camunda:calledElementBinding="deployment"')
        for extension in own_extensions(element):
            name = local(extension)
            has_no_form = local(element) == "startEvent" and not is_none_start(element)
            if (
                name not in _READ
                or (name == "formData" and has_no_form)
                or name == "potentialStarter"
                or (name in {"executionListener", "taskListener"} and not listener_assignments(extension))
            ):
                warn_without_effect(extension, findings, f"camunda:{name}")

    def listeners(self, element: etree._Element) -> tuple[tuple[Assignment, ...], tuple[Assignment, ...]]:
        """Return the variables that listeners, and the data of a process, set before and after an element."""
        before = list(initial_values(element)) if local(element) == "process" else []
        after: list[Assignment] = []
        for extension in own_extensions(element):
            if local(extension) not in {"executionListener", "taskListener"}:
                continue
            is_start = extension.get("event", "start") in {"start", "create", "assignment"}
            (before if is_start else after).extend(listener_assignments(extension))
        return tuple(before), tuple(after)


def _json_list(text_: str) -> Json:
    try:
        items = json.loads(text_, parse_constant=lambda _: None)
    except (ValueError, RecursionError):
        raise ValueError("the collection is no JSON list") from None
    return within_limits(items)


def _operation(implementation: Mapping[str, str]) -> str:
    """Return the name of the operation: the topic, or the last part of a class or of an expression."""
    for name in _IMPLEMENTATIONS:
        if name in implementation:
            name_ = implementation[name].strip()
            if has_expression(name_):
                return name_.strip("#${} \t\r\n")
            return name_.rpartition(".")[2] if name == "class" else name_
    return ""
