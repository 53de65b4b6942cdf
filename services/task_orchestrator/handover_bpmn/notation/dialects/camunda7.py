"""Camunda 7: attributes and elements of its namespace, and those of its relatives with the same names.

Where its engine calls Java code (`class`, `delegateExpression`, a topic, scripts in Groovy or JavaScript), a
Task is created; its hints and the parameter `operation` name the code.
"""

import json
import re
from collections.abc import Iterator, Mapping
from functools import partial

from lxml import etree

from handover.messages import message
from handover_bpmn.languages import native
from handover_bpmn.languages.base import (
    MAX_NUMBER,
    Expression,
    ExpressionError,
    Json,
    within_limits,
)
from handover_bpmn.languages.juel import read_juel, read_template
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
from handover_bpmn.notation.dialects.scripts import JAVA_LIKE, assigned_by, set_variables
from handover_bpmn.notation.document import (
    attributes_of,
    child_text,
    children,
    extensions,
    is_none_start,
    local,
    namespace,
    text,
)
from handover_bpmn.notation.elements import referenced, warn_without_effect
from handover_bpmn.notation.faults import Findings

NAMESPACES = (
    "http://camunda.org/schema/1.0/bpmn",
    "http://activiti.org/bpmn",
    "http://flowable.org/bpmn",
    "http://operaton.org/schema/1.0/bpmn",
    "http://camunda.org/bpmn",
)

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
_FORM_TYPES: Mapping[str, Mapping[str, Json]] = {
    "string": {"type": "string"},
    "long": {"type": "integer"},
    "double": {"type": "number"},
    "boolean": {"type": "boolean"},
    "date": {"type": "string", "format": "date"},
}
_LENGTHS = {"minlength": "minLength", "maxlength": "maxLength", "min": "minimum", "max": "maximum"}
_QUOTED = re.compile(r"""'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*\"""")
_PART = re.compile(r"(?<!\bexecution)\.(?!\d)")
"""A part of a variable, which may be a bean."""
_DATA_TYPES = {
    **dict.fromkeys(("int", "integer", "long", "short"), "integer"),
    **dict.fromkeys(("double", "float", "decimal"), "number"),
    "boolean": "boolean",
}
"""The types of XML Schema that data objects have, as those of JSON Schema."""
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
        return Value(expression=read_template(text)) if _has_expression(text) else Value(text)

    def collection(self, text: str) -> Value:
        """Return a JUEL expression or the variable of this name."""
        return Value(expression=read_juel(text)) if _has_expression(text) else variable_named(text)

    def time(self, text: str) -> str:
        """Return the text unchanged: times are those of ISO 8601 and cron."""
        return text

    def work(self, element: etree._Element, found: Findings) -> Work:
        """Return what attributes and extension elements say of the Task."""
        attributes = attributes_of(element, NAMESPACES)
        hints = {name: attributes[name].strip() for name in _HINTS if attributes.get(name)}
        if "type" in hints and "topic" not in hints:
            hints.setdefault("topic", hints["type"])
        implementation = {name: hints[name] for name in _IMPLEMENTATIONS if name in hints}
        parameters: dict[str, Value] = {}
        operation = _operation(implementation)
        for extension in _ours(element):
            match local(extension):
                case "formData":
                    parameters["form"] = self._form(extension, found)
                case "field":
                    parameters[extension.get("name") or ""] = self._field(extension, found)
                case "properties":
                    properties = {each.get("name") or "": each.get("value") for each in extension}
                    parameters["properties"] = Value(properties)
                case "failedJobRetryTimeCycle":
                    hints["retry"] = text(extension)
                case "connector":
                    operation = hints["connector"] = _child_text(extension, "connectorId")
                    inputs = _connector_io(extension, "inputParameter", found)
                    parameters |= {each.target: each.value for each in inputs}
        form = self._form_reference(attributes)
        if operation and not local(element).startswith("userTask"):
            parameters["operation"] = Value(operation)
        parameters |= {each.target: each.value for each in self._inputs(element, found)}
        return Work(
            parameters=parameters,
            variable=self._result_variable(element, found),
            hints=hints,
            form=form,
            has_implementation=bool(implementation) or "connector" in hints,
        )

    def start_form(self, element: etree._Element, found: Findings) -> StartForm:
        """Return the generated or named form of a start event."""
        written = [self._form(each, found) for each in _ours(element) if local(each) == "formData"]
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

    def mapped(self, element: etree._Element, found: Findings) -> Mapped:
        """Return the variables of `inputOutput`; of an event definition those that it sends along."""
        if local(element).endswith("EventDefinition"):
            passed, everything, _ = self._passed(element, "in", found)
            if everything:
                warn_without_effect(element, found, 'camunda:in variables="all"')
            return Mapped(passed)
        connectors = [each for each in _ours(element) if local(each) == "connector"]
        outputs = [each for part in connectors for each in _connector_io(part, "outputParameter", found)]
        outputs += _io(element, "outputParameter", found)
        return Mapped(tuple(self._inputs(element, found)), tuple(outputs))

    def _form(self, form: etree._Element, found: Findings) -> Value:
        """Return the JSON Schema of a generated form; default values may be expressions."""
        properties: dict[str, Value] = {}
        required: list[str] = []
        for each in _named(form, "formField"):
            name = each.get("id") or ""
            if not name:
                found.fault(each, "a formField needs an id")
                continue
            properties[name] = self._form_field(each, name, required, found)
        members = {"type": Value("object"), "properties": composed("formData", properties)}
        if required:
            members["required"] = Value(required)
        return composed("formData", members)

    def _form_field(self, field: etree._Element, name: str, required: list[str], found: Findings) -> Value:
        type_ = field.get("type") or "string"
        schema: dict[str, Json] = dict(_FORM_TYPES.get(type_, {"type": "string"}))
        if type_ not in _FORM_TYPES and type_ != "enum":
            warn_without_effect(field, found, f'the type "{type_[:64]}" of a formField')
        if field.get("label"):
            schema["title"] = field.get("label")
        choices = list(_named(field, "value"))
        if choices:
            schema["oneOf"] = [
                {"const": choice.get("id"), "title": choice.get("name") or choice.get("id")}
                for choice in choices
            ]
        for validation in _named(field, "validation"):
            for constraint in _named(validation, "constraint"):
                if not _constrain(schema, name, constraint, required):
                    warn_without_effect(
                        field, found, f'the constraint "{(constraint.get("name") or "")[:64]}"'
                    )
        members = {key: Value(value) for key, value in schema.items()}
        given = field.get("defaultValue")
        if given is not None and _has_expression(given):
            members["default"] = attempt(field, lambda: self.value(given), Value(), found)
        elif given is not None:
            members["default"] = Value(_default_of(schema, given))
        return composed(f"formField {name}", members)

    def _field(self, field: etree._Element, found: Findings) -> Value:
        """Return the value of a field of a class."""
        given = field.get("stringValue") or field.get("expression")
        given = given or _child_text(field, "string") or _child_text(field, "expression")
        return attempt(field, lambda: self.value(given), Value(), found)

    def _inputs(self, element: etree._Element, found: Findings) -> Iterator[Assignment]:
        yield from _io(element, "inputParameter", found)

    def call(self, element: etree._Element, found: Findings) -> Call | None:
        """Return the called process with its binding, `in` and `out`."""
        attributes = attributes_of(element, NAMESPACES)
        called = (element.get("calledElement") or "").strip()
        if not called:
            what = "callActivity with caseRef (CMMN)" if attributes.get("caseRef") else ""
            found.fault(
                element,
                message(
                    "bpmn.no_called_element",
                    "the call activity names no process; set calledElement to the id of one",
                )
                if not what
                else message(
                    "bpmn.not_supported",
                    "{what} is not supported yet; {way_out}",
                    what=what,
                    way_out="call a process instead",
                ),
            )
            return None
        if not _has_expression(called):
            called = referenced(called)
        inputs, all_inputs, key = self._passed(element, "in", found)
        outputs, all_outputs, _ = self._passed(element, "out", found)
        if attributes.get("inheritVariables") == "true":  # of Activiti and Flowable
            all_inputs = True
        return Call(
            attempt(element, lambda: self.value(called), Value(), found),
            version=self._bound(element, "version", "calledElementVersion", found),
            tag=self._bound(element, "versionTag", "calledElementVersionTag", found),
            inputs=inputs,
            outputs=outputs,
            all_inputs=all_inputs,
            all_outputs=all_outputs,
            key=key,
        )

    def _bound(self, element: etree._Element, binding: str, attribute: str, found: Findings) -> Value | None:
        attributes = attributes_of(element, NAMESPACES)
        if attributes.get("calledElementBinding") != binding:
            return None
        given = (attributes.get(attribute) or "").strip()
        if not given:
            found.fault(element, f'calledElementBinding="{binding}" needs {attribute}')
            return None
        if binding == "version" and given.isdecimal():
            return Value(int(given[:9]))
        return attempt(element, lambda: self.value(given), None, found)

    def _passed(
        self, element: etree._Element, direction: str, found: Findings
    ) -> tuple[tuple[Assignment, ...], bool, Value | None]:
        """Return the assignments, whether all variables are passed, and the business key."""
        passed: list[Assignment] = []
        everything = False
        key: Value | None = None
        for part in (each for each in _ours(element) if local(each) == direction):
            business_key, source = part.get("businessKey"), part.get("source", "")
            expression = part.get("sourceExpression")
            if part.get("variables") == "all":
                everything = True
                continue
            if business_key is not None:
                key = attempt(part, partial(self.value, business_key), None, found)
                continue
            target = part.get("target") or ""
            if not is_name(target):
                found.fault(part, f'target="{target}" cannot be the name of a variable')
                continue
            reading = partial(self.value, expression) if expression else partial(variable_named, source or "")
            passed.append(Assignment(target, attempt(part, reading, Value(), found)))
        return tuple(passed), everything, key

    def evaluated(self, element: etree._Element, found: Findings) -> tuple[Assignment, ...] | None:
        """Return what an `expression` sets that calls no bean: a variable, or the result variable."""
        attributes = attributes_of(element, NAMESPACES)
        given = (attributes.get("expression") or "").strip()
        if not given or attributes.keys() & {"class", "delegateExpression", "type", "topic"}:
            return None
        variable = self._result_variable(element, found)
        assigned = assigned_by(given)
        if assigned and not variable:
            return assigned
        if variable is None or not _has_expression(given) or _PART.search(_QUOTED.sub("", given)):
            return None
        try:
            return (Assignment(variable, self.value(given)),)
        except ExpressionError:
            return None

    def items(self, loop: etree._Element, found: Findings) -> Items:
        """Return `collection` and `elementVariable`."""
        attributes = attributes_of(loop, NAMESPACES)
        collection, variable = attributes.get("collection"), attributes.get("elementVariable")
        if variable is not None and not is_name(variable):
            found.fault(loop, f'elementVariable="{variable}" cannot be the name of a variable')
        output = self._aggregated(loop, found)
        return Items(
            self._collection_of(loop, found)
            if not collection
            else attempt(loop, lambda: self.collection(collection.strip()), None, found),
            variable,
            *output,
        )

    def _collection_of(self, loop: etree._Element, found: Findings) -> Value | None:
        """Return the collection of an extension of Flowable: a JSON list, an expression or a variable."""
        part = next(_children(loop, "collection"), None)
        if part is None:
            return None
        given = text(part) or _child_text(part, "string") or _child_text(part, "expression")
        if not given:
            return None
        if given.startswith("["):
            return attempt(loop, lambda: Value(_json_list(given)), None, found)
        return attempt(loop, lambda: self.collection(given), None, found)

    def _aggregated(self, loop: etree._Element, found: Findings) -> tuple[str | None, Value | None]:
        """Return the list that aggregates variables of the instances in Flowable, and what an item holds."""
        for aggregation in _children(loop, "variableAggregation"):
            target = aggregation.get("target") or ""
            if not is_name(target):
                warn_without_effect(aggregation, found, "flowable:variableAggregation")
                continue
            members: dict[str, Value] = {}
            for part in aggregation.iterchildren("{*}variable"):
                name = part.get("target") or part.get("source") or ""
                value = self._aggregated_value(part)
                if value is None:
                    warn_without_effect(part, found, f'the variable "{name[:64]}" of a variableAggregation')
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

    def script(self, element: etree._Element, found: Findings) -> Script:
        """Return a script of JUEL or of our language; any other is work for somebody."""
        format_ = (element.get("scriptFormat") or "").strip()
        source = child_text(element, "script")
        variable = self._result_variable(element, found)
        resource = attributes_of(element, NAMESPACES).get("resource")
        if format_.lower() == "juel" or (not format_ and _has_expression(source)):
            return self._juel_script(element, source, variable, found)
        if format_.lower() == "handover":
            return Script(native_script(element, source, found))
        if not format_ and source and not resource:
            return script_or_work(source)
        assignments = () if variable or resource else _set_variables(format_, source)
        if assignments:
            found.warn(
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
        self, element: etree._Element, source: str, variable: str | None, found: Findings
    ) -> Script:
        """Return a script of JUEL, the default language of scripts."""
        assigned = assigned_by(source)
        if assigned and not variable:
            return Script(assigned)
        value = attempt(element, lambda: self.value(source), Value(), found)
        return Script((Assignment(variable, value),) if variable else ())

    def _result_variable(self, element: etree._Element, found: Findings) -> str | None:
        attributes = attributes_of(element, NAMESPACES)
        name = attributes.get("resultVariable") or attributes.get("resultVariableName")
        if name and not is_name(name):
            found.fault(element, f'resultVariable="{name}" cannot be the name of a variable')
        return name or None

    def occurrence(
        self, element: etree._Element, definition: etree._Element | None, found: Findings
    ) -> Occurrence:
        """Return the variables for code and message of a caught error or escalation."""
        attributes = {} if definition is None else attributes_of(definition, NAMESPACES)
        code = attributes.get("errorCodeVariable") or attributes.get("escalationCodeVariable")
        text_ = attributes.get("errorMessageVariable")
        for name in (code, text_):
            if name and not is_name(name):
                found.fault(element, f'"{name}" cannot be the name of a variable')
        return Occurrence(code_variable=code or None, message_variable=text_ or None)

    def correlation(self, declared: etree._Element, found: Findings) -> Value | None:  # noqa: ARG002
        """Return None: messages are correlated by the business key and variables."""
        return None

    def process(self, element: etree._Element, found: Findings) -> ProcessExtension:  # noqa: ARG002
        """Return the version tag."""
        return ProcessExtension(attributes_of(element, NAMESPACES).get("versionTag") or None)

    def check(self, element: etree._Element, found: Findings) -> None:
        """Report what has no effect, and decisions."""
        attributes = attributes_of(element, NAMESPACES)
        if local(element) == "businessRuleTask" and attributes.get("decisionRef"):
            found.fault(
                element,
                message(
                    "bpmn.not_supported",
                    "{what} is not supported yet; {way_out}",
                    what=_DECISION,
                    way_out="let a Task decide instead, with a topic or without any extension",
                ),
            )
        if local(element) == "serviceTask" and attributes.get("type") == "dmn":
            found.fault(
                element,
                message(
                    "bpmn.not_supported",
                    "{what} is not supported yet; {way_out}",
                    what="serviceTask of the type dmn (a DMN decision)",
                    way_out="let a Task decide instead, with a topic or without any extension",
                ),
            )
        for name in sorted(attributes.keys() - _HARMLESS):
            warn_without_effect(element, found, f"camunda:{name}")
        if attributes.get("calledElementBinding") == "deployment":
            warn_without_effect(element, found, 'camunda:calledElementBinding="deployment"')
        for extension in _ours(element):
            name = local(extension)
            has_no_form = local(element) == "startEvent" and not is_none_start(element)
            if (
                name not in _READ
                or (name == "formData" and has_no_form)
                or name == "potentialStarter"
                or (name in {"executionListener", "taskListener"} and not listener_assignments(extension))
            ):
                warn_without_effect(extension, found, f"camunda:{name}")

    def listeners(self, element: etree._Element) -> tuple[tuple[Assignment, ...], tuple[Assignment, ...]]:
        """Return the variables that listeners, and the data of a process, set before and after an element."""
        before = list(_initial_values(element)) if local(element) == "process" else []
        after: list[Assignment] = []
        for extension in _ours(element):
            if local(extension) not in {"executionListener", "taskListener"}:
                continue
            is_start = extension.get("event", "start") in {"start", "create", "assignment"}
            (before if is_start else after).extend(listener_assignments(extension))
        return tuple(before), tuple(after)


def _initial_values(process: etree._Element) -> Iterator[Assignment]:
    """Yield the values of data objects, which are defaults of variables in Activiti and Flowable."""
    for data in children(process, "dataObject"):
        name = data.get("name") or data.get("id") or ""
        for extension in _ours(data):
            if local(extension) != "value" or not is_name(name):
                continue
            type_ = referenced(data.get("itemSubjectRef") or "").lower()
            default = _default(_DATA_TYPES.get(type_, "string"), text(extension))
            given = f"${{vars:getOrDefault({name}, {json.dumps(default)})}}"
            yield Assignment(name, Value(expression=read_juel(given)))


def listener_assignments(listener: etree._Element) -> tuple[Assignment, ...]:
    """Return the variables that a listener sets, by an expression or script; none for other listeners."""
    if listener.get("event") in {"delete", "timeout", "update"}:
        return ()
    script = next(_named(listener, "script"), None)
    if script is not None:
        return _set_variables(script.get("scriptFormat") or "", text(script))
    return assigned_by(listener.get("expression") or "")


def _set_variables(format_: str, source: str) -> tuple[Assignment, ...]:
    return (set_variables(source) or ()) if format_.lower() in JAVA_LIKE else ()


def _json_list(given: str) -> Json:
    try:
        found = json.loads(given, parse_constant=lambda _: None)
    except (ValueError, RecursionError):
        raise ValueError("the collection is no JSON list") from None
    return within_limits(found)


def _has_expression(text: str) -> bool:
    return "${" in text or "#{" in text


def _ours(element: etree._Element) -> Iterator[etree._Element]:
    for extension in extensions(element):
        if namespace(extension) in NAMESPACES:
            yield extension


def _children(element: etree._Element, name: str) -> Iterator[etree._Element]:
    return (each for each in _ours(element) if local(each) == name)


def _named(element: etree._Element, name: str) -> Iterator[etree._Element]:
    for part in element.iterchildren("{*}*"):
        if local(part) == name and namespace(part) in NAMESPACES:
            yield part


def _child_text(element: etree._Element, name: str) -> str:
    return next((text(part) for part in _named(element, name)), "")


def _operation(implementation: Mapping[str, str]) -> str:
    """Return the name of the operation: the topic, or the last part of a class or of an expression."""
    for name in _IMPLEMENTATIONS:
        if name in implementation:
            given = implementation[name].strip()
            if _has_expression(given):
                return given.strip("#${} \t\r\n")
            return given.rpartition(".")[2] if name == "class" else given
    return ""


def _io(element: etree._Element, name: str, found: Findings) -> Iterator[Assignment]:
    for group in (each for each in _ours(element) if local(each) == "inputOutput"):
        yield from _assignments(group, name, found)


def _connector_io(connector: etree._Element, name: str, found: Findings) -> Iterator[Assignment]:
    for group in _named(connector, "inputOutput"):
        yield from _assignments(group, name, found)


def _assignments(group: etree._Element, name: str, found: Findings) -> Iterator[Assignment]:
    for part in _named(group, name):
        target = part.get("name") or ""
        if not is_name(target):
            found.fault(part, f'{name} "{target}" cannot be the name of a variable')
            continue
        value = _content(part, f"{name} {target}", found)
        if value is not None:
            yield Assignment(target, value)


def _content(part: etree._Element, what: str, found: Findings) -> Value | None:
    """Return the value of a parameter, entry or list item: text, list, map, or a script that nobody runs."""
    for inner in part.iterchildren("{*}*"):
        match local(inner):
            case "list":
                items = [_content(each, what, found) for each in inner.iterchildren("{*}*")]
                members = {str(nth): item for nth, item in enumerate(items) if item is not None}
                return composed(what, members, is_list=True)
            case "map":
                entries = {
                    each.get("key") or "": _content(each, what, found) for each in _named(inner, "entry")
                }
                return composed(what, {key: value for key, value in entries.items() if value is not None})
            case "script":
                return _foreign_script(inner, what, found)
    given = text(part)
    if local(part) == "script":
        return _foreign_script(part, what, found)
    if not _has_expression(given):
        return Value(given or None)
    return attempt(part, lambda: Value(expression=read_template(given)), Value(), found)


def _foreign_script(script: etree._Element, what: str, found: Findings) -> Value | None:
    format_ = script.get("scriptFormat") or ""
    given = text(script) or script.get("resource") or ""
    if format_.lower() == "juel":
        return attempt(script, lambda: Value(expression=read_template(given)), Value(), found)
    found.warn(
        script,
        message(
            "bpmn.foreign_value_script",
            "the {format} script of {what} is not run here: its value is null; use an expression",
            format=format_,
            what=what,
        ),
    )
    return Value(None)


def _constrain(schema: dict[str, Json], name: str, constraint: etree._Element, required: list[str]) -> bool:
    """Add a constraint to the JSON Schema of a field; return whether it has an effect."""
    rule, config = constraint.get("name") or "", constraint.get("config") or ""
    if rule == "required":
        if config != "false":
            required.append(name)
            if schema.get("type") == "string":
                schema.setdefault("minLength", 1)
    elif rule == "readonly":
        if config != "false":
            schema["readOnly"] = True
    elif rule in _LENGTHS:
        number = _default("number", config)
        if isinstance(number, int | float):
            schema[_LENGTHS[rule]] = number
    else:
        return False
    return True


def _default_of(schema: Mapping[str, Json], given: str) -> Json:
    """Return the default of a field; a date may be written as dd/MM/yyyy."""
    parts = given.split("/")
    if schema.get("format") == "date" and len(parts) == 3 and all(part.isdecimal() for part in parts):
        day, month, year = parts
        return f"{year:0>4}-{month:0>2}-{day:0>2}"
    return _default(str(schema["type"]), given)


def _default(type_: str, given: str) -> Json:
    if type_ == "boolean":
        return given.strip().lower() == "true"
    if type_ in {"integer", "number"}:
        try:
            number = float(given)
        except ValueError:
            return given
        if abs(number) <= MAX_NUMBER:
            return int(number) if number == int(number) else number
    return given
