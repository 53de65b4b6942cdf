"""Our extension elements: the attributes of the Task that an activity creates, and entities as events.

<handover:task definition="pick" deadline="PT2M">
  <handover:involves resource="Device:ur10-1"/>
  <handover:parameter name="pose" expression="scan.pose"/>
</handover:task>

With handlesOutcomes="true" a Task with another outcome than `ok` is completed, and the process continues with
the variable `outcome`; otherwise such a Task fails. With requirePin="true" the person who answers the Task
gives the own PIN. onPerformerLost="ask", "retry" or "wait" says what happens with a Task in progress whose
performer was killed, paused or cut off.

<handover:material entity="Material:pallet-3"/> and <handover:asset expression="carrier"/> name what the Task
uses. They are involved after the performer, and an expression may be a list of them.

A Task of people, and a start event, has a form: <handover:form ref="inspection"/> names a deployed one,
version="2" fixes its version, and <handover:form>{…}</handover:form> is a JSON Schema of the result, or a
form of form-js. The attributes assignee, candidateUsers, candidateGroups, dueDate, followUpDate and
priority are texts or `${…}`.

Instead of handover:involves, role="operator" and skills="grip place" let an agent be chosen that has them.

<handover:on type="Alert" q='severity=="critical"' variable="alert" correlation="alert.alertSource"/>

in a message, signal or conditional event: the creation or change of such an entity is the event. The
condition of a conditional event is then evaluated for each entity.

<handover:specification description="Look at ${part}" gesture="Thumbs up"/>

beside `handover:task` is written to the specification database before the Task is posted.

<handover:process title="Order ${order.number}"/>

is the title of each process: a text with `${…}`, or FEEL behind `=`.

<handover:translations language="de">
  <handover:translation source="Confirm that the cell is clear">Bestätigen …</handover:translation>
</handover:translations>

beside `handover:process` are the texts for people of another language: names and descriptions of elements,
texts of forms. A `${…}` in a source stands for any text, and is put where the translation has it.

<bpmn:subProcess handover:reserve="Device:ur10-1, role:picker skill:grip">

or, as extension elements, `<handover:reserve resource="Device:ur10-1"/>`, with `role` and `skills`, or with
an `expression`: the resources are reserved as long as a token is in the process, subprocess, lane or group.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Set
from contextlib import suppress

import orjson
from lxml import etree

from handover.formats.durations import Duration, parse_duration
from handover.messages import message
from handover.tasks.specification import FIELDS
from handover.tasks.task_life import PASSIVE_TYPES, type_of
from handover_bpmn.forms.form import form_fault
from handover_bpmn.languages import native
from handover_bpmn.languages.base import Expression, ExpressionError, Json
from handover_bpmn.languages.feel import read_feel
from handover_bpmn.languages.java import read_java
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.languages.native_grammar import is_variable_name
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
from handover_bpmn.notation.dialects.base import (
    Items,
    Mapped,
    Occurrence,
    ProcessExtension,
    Script,
    Work,
    attempt,
    native_script,
    script_or_work,
)
from handover_bpmn.notation.dialects.translations import PLACEHOLDER, read_translations
from handover_bpmn.notation.document import (
    child_text,
    extensions,
    is_none_start,
    local,
    namespace,
    text,
)
from handover_bpmn.notation.elements import referenced, warn_without_effect
from handover_bpmn.notation.faults import Findings
from handover_bpmn.references import is_reference

NAMESPACE = "urn:handover:bpmn"

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}", re.ASCII)
_DEFINITION_ID = re.compile(r"urn:ngsi-ld:TaskDefinition:[A-Za-z0-9_.:-]{1,200}", re.ASCII)
_TYPE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*|[a-z][a-z0-9+.-]*:[^\s<>\"]+", re.ASCII)

_HINTS = ("assignee", "candidateUsers", "candidateGroups", "dueDate", "followUpDate", "priority")
_PARTS = frozenset(
    {"involves", "material", "asset", "happensAt", "parameter", "output", "form", "inputSchema"}
)
_ATTRIBUTES: Mapping[str, frozenset[str]] = {
    "task": frozenset(
        {
            "definition",
            "deadline",
            "handlesOutcomes",
            "requirePin",
            "onPerformerLost",
            "role",
            "skills",
            *_HINTS,
        }
    ),
    "form": frozenset({"ref", "version"}),
    "inputSchema": frozenset(),
    "involves": frozenset({"resource", "expression"}),
    "material": frozenset({"entity", "expression"}),
    "asset": frozenset({"entity", "expression"}),
    "happensAt": frozenset({"location", "expression", "function"}),
    "parameter": frozenset({"name", "value", "expression"}),
    "output": frozenset({"name", "from"}),
    "process": frozenset({"version", "title"}),
    "retry": frozenset({"attempts", "delay", "factor", "maxDelay", "codes"}),
    "escalation": frozenset({"after", "code", "group"}),
    "specification": frozenset(FIELDS),
    "on": frozenset({"type", "idPattern", "q", "variable", "correlation"}),
    "reserve": frozenset({"resource", "expression", "role", "skills"}),
    "translations": frozenset({"language"}),
    "translation": frozenset({"source"}),
}
_EVALUATED: Mapping[str, frozenset[str]] = {
    "task": frozenset(_HINTS),
    "specification": frozenset(FIELDS),
    "on": frozenset({"idPattern", "correlation"}),
    "process": frozenset({"title"}),
    "translation": frozenset({"source"}),
}
"""Attributes that may have `${…}`, beside `expression`; in a regular expression it has another meaning."""
_RESERVING = frozenset({"process", "subProcess"})
"""Elements that may have `handover:reserve`, beside lanes and groups."""


def has_task(element: etree._Element) -> bool:
    """Return whether an activity has a `handover:task`."""
    return any(extension.tag == f"{{{NAMESPACE}}}task" for extension in extensions(element))


def reserve_elements(element: etree._Element) -> Iterator[etree._Element]:
    """Yield the extension elements `handover:reserve` of an element."""
    for extension in extensions(element):
        if extension.tag == f"{{{NAMESPACE}}}reserve":
            yield extension


def check_reserve(extension: etree._Element, found: Findings) -> None:
    """Report a `handover:reserve` that does not say in one way what it reserves."""
    _check_attributes(extension, found)
    forms = [extension.get("resource"), extension.get("expression")]
    forms.append(extension.get("role") or extension.get("skills"))
    if sum(form is not None for form in forms) != 1:
        found.fault(
            extension,
            message(
                "bpmn.reserve_one_form",
                "handover:reserve has one of resource, expression, and role with skills",
            ),
        )


class Handover:
    """The dialect of this project, and of files of no known vendor, which are read leniently."""

    spreads_outputs = False
    potential_owner = "candidateGroups"

    def __init__(self, *, is_strict: bool = True) -> None:
        self.lenient = not is_strict

    def expression(self, text: str) -> Expression:
        """Return an expression of our language, or of JUEL if it is written as `${…}`.

        Files of no known vendor may also have Java, JavaScript or FEEL.
        """
        if text.strip().startswith(("${", "#{")):
            return read_juel(text)
        try:
            return native.read(text)
        except ExpressionError:
            for read in (read_java, read_feel) if self.lenient else ():
                with suppress(ExpressionError):
                    return read(text)
            raise

    def value(self, text: str) -> Value:
        """Return the text, which is literal unless it is written as `${…}`."""
        if text.strip().startswith(("${", "#{")):
            return Value(expression=read_juel(text))
        return Value(text)

    def collection(self, text: str) -> Value:
        """Return an expression."""
        return Value(expression=self.expression(text))

    def time(self, text: str) -> str:
        """Return the text unchanged: times are those of ISO 8601 and cron."""
        return text

    def work(self, element: etree._Element, found: Findings) -> Work:
        """Return what `handover:task` says."""
        extension = extension_of(element, "task", found)
        if extension is None:
            return Work()
        definition = extension.get("definition") or ""
        if not _NAME.fullmatch(definition) and not _DEFINITION_ID.fullmatch(definition):
            found.fault(
                extension,
                f'definition="{definition}" is not a name; use A-Z, a-z, 0-9, - _ . '
                "or the id of a TaskDefinition",
            )
        parts = _parts(extension, _PARTS, found)
        involved = [_reference(part, "resource", found) for part in parts["involves"]]
        performers = tuple(each for each in involved if _passive_type(each) is None)
        role = (extension.get("role") or "").strip() or None
        skills = tuple((extension.get("skills") or "").split())
        if performers and (role or skills):
            found.fault(
                extension,
                message(
                    "bpmn.resource_and_role",
                    "a handover:task has either handover:involves or a role and skills",
                ),
            )
        return Work(
            definition=definition,
            deadline=_deadline(extension, found),
            involves=performers,
            materials=_used("Material", involved, parts["material"], found),
            assets=_used("Asset", involved, parts["asset"], found),
            happens_at=tuple(
                Place(_reference(part, "location", found), part.get("function"))
                for part in parts["happensAt"]
            ),
            parameters={
                **{part.get("name") or "": _value(part, found) for part in parts["parameter"]},
                **_written_form(parts["form"], found),
            },
            form=_form_reference(parts["form"], found),
            inputs_schema=next((_schema(part, found) for part in parts["inputSchema"]), None),
            hints={name: text for name in _HINTS if (text := (extension.get(name) or "").strip())},
            outputs=_outputs(parts["output"], found),
            handles_outcomes=_flag(extension, "handlesOutcomes", found),
            require_pin=_flag(extension, "requirePin", found),
            performer_lost=_performer_lost(extension, found),
            has_implementation=True,
            role=role,
            skills=skills,
        )

    def start_form(self, element: etree._Element, found: Findings) -> StartForm:
        """Return the `handover:form` of a start event."""
        parts = extensions_of(element, "form", found)
        return StartForm(_written_form(parts, found).get("form"), _form_reference(parts, found))

    def mapped(self, element: etree._Element, found: Findings) -> Mapped:  # noqa: ARG002 - of the interface
        """Return nothing: an activity of our dialect sees all variables."""
        return Mapped()

    def call(self, element: etree._Element, found: Findings) -> Call | None:
        """Return the called process, which gets all variables and returns all."""
        given = (element.get("calledElement") or "").strip()
        called = given if "${" in given or "#{" in given else referenced(given)
        if not called:
            found.fault(element, _no_called_element())
            return None
        process = attempt(element, lambda: self.value(called), Value(), found)
        return Call(process, all_inputs=True, all_outputs=True)

    def evaluated(
        self,
        element: etree._Element,  # noqa: ARG002 - of the interface
        found: Findings,  # noqa: ARG002
    ) -> tuple[Assignment, ...] | None:
        """Return None: tasks have no expressions."""
        return None

    def items(self, loop: etree._Element, found: Findings) -> Items:  # noqa: ARG002 - of the interface
        """Return nothing: BPMN's own elements name the collection."""
        return Items()

    def script(self, element: etree._Element, found: Findings) -> Script:
        """Return the assignments of a script in our language, or the text of another one."""
        source = child_text(element, "script")
        format_ = (element.get("scriptFormat") or "").strip()
        if format_.lower() == "handover" or (not format_ and not self.lenient):
            return Script(native_script(element, source, found))
        return Script(format=format_, text=source) if format_ else script_or_work(source)

    def occurrence(
        self, element: etree._Element, definition: etree._Element | None, found: Findings
    ) -> Occurrence:
        """Return the entities of `handover:on`."""
        extension = extension_of(element, "on", found)
        if extension is None and definition is not None:
            extension = extension_of(definition, "on", found)
        if extension is None:
            return Occurrence()
        type_ = extension.get("type") or ""
        if not _TYPE.fullmatch(type_):
            found.fault(extension, f'type="{type_}" names no entity type such as Alert or Task')
        variable = extension.get("variable", "entity")
        if not is_variable_name(variable):
            found.fault(extension, f'"{variable}" cannot be the name of a variable')
        pattern = extension.get("idPattern")
        if pattern is not None:
            attempt(extension, lambda: _pattern(pattern), None, found)
        text = extension.get("correlation")
        correlation = None if text is None else attempt(extension, lambda: native.read(text), None, found)
        if correlation is not None and correlation.names() - {variable}:
            found.fault(extension, f'the correlation reads only "{variable}"; it has no other variables')
        return Occurrence(EntityFilter(type_, pattern, extension.get("q"), variable, correlation))

    def correlation(self, declared: etree._Element, found: Findings) -> Value | None:  # noqa: ARG002
        """Return None: our dialect has no correlation of a message."""
        return None

    def process(self, element: etree._Element, found: Findings) -> ProcessExtension:
        """Return what `handover:process` says, and the translations."""
        translations = _translations(element, found)
        extension = extension_of(element, "process", found)
        if extension is None:
            return ProcessExtension(translations=translations)
        parameters: dict[str, ProcessParameter] = {}
        for part in _parts(extension, {"parameter"}, found)["parameter"]:
            name = part.get("name") or ""
            if not is_variable_name(name):
                found.fault(part, f'"{name}" cannot be the name of a variable')
            if part.get("expression") is not None:
                found.fault(part, "a parameter of the process has a value, not an expression")
            default = part.get("value")
            parameters[name] = ProcessParameter(
                name, default is None, None if default is None else _json(default)
            )
        title = extension.get("title")
        naming = None if title is None else attempt(extension, lambda: _naming(title.strip()), None, found)
        return ProcessExtension(extension.get("version"), parameters, naming, translations)

    def listeners(
        self,
        element: etree._Element,  # noqa: ARG002 - of the interface
    ) -> tuple[tuple[Assignment, ...], tuple[Assignment, ...]]:
        """Return nothing."""
        return (), ()

    def check(self, element: etree._Element, found: Findings) -> None:
        """Report our extension elements that stand where they have no meaning."""
        for attribute in element.attrib:
            if attribute == f"{{{NAMESPACE}}}reserve" and local(element) in _RESERVING:
                continue
            if attribute.startswith(f"{{{NAMESPACE}}}"):
                warn_without_effect(element, found, f"handover:{etree.QName(attribute).localname}")
        name = local(element)
        allowed = (
            {"process", "translations"} if name == "process" else {"on"} if _can_be_event(element) else set()
        )
        if name.endswith(("ask", "Event")):
            allowed = allowed | {"escalation", "retry", "specification", "task"}
        if is_none_start(element):
            allowed = allowed | {"form"}
        if name in _RESERVING:
            allowed = allowed | {"reserve"}
        for extension in extensions(element):
            if namespace(extension) == NAMESPACE and local(extension) not in allowed:
                known = " or ".join(f"handover:{each}" for each in sorted(allowed)) or "nothing of handover"
                found.fault(
                    extension,
                    f"handover:{local(extension)} is unknown here; {known} is what may stand here",
                )


def _translations(process: etree._Element, found: Findings) -> dict[str, dict[str, str]]:
    groups = {
        extension: _parts(extension, {"translation"}, found)["translation"]
        for extension in extensions_of(process, "translations", found)
    }
    return read_translations(groups, process, found)


def _can_be_event(element: etree._Element) -> bool:
    name = local(element)
    return name.endswith(("Event", "EventDefinition")) or name == "receiveTask"


def _no_called_element() -> str:
    return message(
        "bpmn.no_called_element", "the call activity names no process; set calledElement to the id of one"
    )


def _naming(title: str) -> Expression:
    """Return the expression of a title, a text with `${…}` or, behind `=`, FEEL."""
    if title.startswith("="):
        return read_feel(title[1:])
    if "${" in title or "#{" in title:
        return read_juel(title)
    raise ExpressionError(
        message(
            "bpmn.title_is_constant",
            'title="{title}" would name every process the same; write an expression, such as '
            '"{title} ${{order}}", or leave it out: then processes are numbered',
            title=title[:100],
        )
    )


def _pattern(text: str) -> None:
    try:
        re.compile(text)
    except (re.error, RecursionError, OverflowError):
        raise ValueError(f'idPattern="{text[:100]}" is no regular expression') from None


def extension_of(element: etree._Element, name: str, found: Findings) -> etree._Element | None:
    """Return our extension element `name` of an element, if it has one, and report unknown attributes."""
    named = [each for each in extensions(element) if each.tag == f"{{{NAMESPACE}}}{name}"]
    if len(named) > 1:
        found.fault(named[1], f"one handover:{name} is enough")
    if named:
        _check_attributes(named[0], found)
    return named[0] if named else None


def extensions_of(element: etree._Element, name: str, found: Findings) -> list[etree._Element]:
    """Return our extension elements `name` of an element, and report unknown attributes."""
    named = [each for each in extensions(element) if each.tag == f"{{{NAMESPACE}}}{name}"]
    for each in named:
        _check_attributes(each, found)
    return named


def _parts(extension: etree._Element, names: Set[str], found: Findings) -> dict[str, list[etree._Element]]:
    parts: dict[str, list[etree._Element]] = {name: [] for name in names}
    for part in extension.iterchildren("{*}*"):
        if namespace(part) == NAMESPACE and local(part) in names:
            _check_attributes(part, found)
            parts[local(part)].append(part)
        else:
            found.fault(part, f"{local(part)} is unknown here; known are {', '.join(sorted(names))}")
    for name in ("parameter", "output"):
        times = Counter(part.get("name") for part in parts.get(name, []))
        for twice in (each for each, number in times.items() if number > 1):
            found.fault(extension, f'the {name} "{twice}" is given twice')
    return parts


def _check_attributes(element: etree._Element, found: Findings) -> None:
    known = _ATTRIBUTES[local(element)]
    for name in element.attrib:
        if name not in known:
            found.fault(
                element,
                f'handover:{local(element)} has no attribute "{name}"; it has {", ".join(sorted(known))}',
            )
        elif name != "expression" and name not in _EVALUATED.get(local(element), ()):
            _check_literal(element, name, known, found)


def _check_literal(element: etree._Element, name: str, known: Set[str], found: Findings) -> None:
    """Report an expression where a literal stands, which would be handed over as that text."""
    given = str(element.get(name)).strip()
    if given.startswith('"') or not ("${" in given or "#{" in given or given.startswith("=")):
        return
    if "expression" not in known or _is_of_process(element):
        text = message(
            "bpmn.expression_not_evaluated",
            '{name}="{given}" is an expression, and {name} is not evaluated; write the value itself',
            name=name,
            given=given[:100],
        )
    else:
        text = message(
            "bpmn.expression_as_literal",
            '{name}="{given}" is an expression where a literal stands; write expression="{inner}" instead',
            name=name,
            given=given[:100],
            inner=_as_expression(given)[:100],
        )
    found.fault_of_deployment(element, text)


def _as_expression(given: str) -> str:
    """Return the native expression for a literal: `x` for `${x}` and `= x`, `'Turn ' + x` for `Turn ${x}`."""
    inner = given.removeprefix("=").strip()
    if inner != given or inner.startswith(("{", "[")):
        return inner
    return " + ".join(
        part[2:-1].strip() if PLACEHOLDER.fullmatch(part) else _quoted(part)
        for part in PLACEHOLDER.split(inner)
        if part
    )


def _quoted(text: str) -> str:
    escaped = text.replace("\\", r"\\").replace("'", r"\'")
    return f"'{escaped}'"


def _is_of_process(parameter: etree._Element) -> bool:
    """Return whether a parameter is one of a process, whose default value is no expression."""
    parent = parameter.getparent()
    return parent is not None and local(parent) == "process"


def _deadline(extension: etree._Element, found: Findings) -> Duration | None:
    text = extension.get("deadline")
    return None if text is None else attempt(extension, lambda: parse_duration(text.strip()), None, found)


def _performer_lost(extension: etree._Element, found: Findings) -> PerformerLost:
    text = extension.get("onPerformerLost", PerformerLost.ASK)
    if text in set(PerformerLost):
        return PerformerLost(text)
    found.fault(extension, f'onPerformerLost="{text[:64]}" is none of {", ".join(PerformerLost)}')
    return PerformerLost.ASK


def _form_reference(parts: list[etree._Element], found: Findings) -> FormReference | None:
    for part in parts:
        name, version = part.get("ref"), part.get("version")
        if name is None:
            continue
        if version is None:
            return FormReference(name)
        if not version.isascii() or not version.isdecimal() or len(version) > 9:
            found.fault(part, f'version="{version[:64]}" is no number')
            return None
        return FormReference(name, FormBinding.VERSION, int(version))
    return None


def _written_form(parts: list[etree._Element], found: Findings) -> dict[str, Value]:
    """Return the form that is written in the file as the parameter `form`."""
    if len(parts) > 1:
        found.fault(parts[1], "one handover:form is enough")
    if not parts or parts[0].get("ref") is not None:
        return {}
    return {"form": Value(_schema(parts[0], found))}


def _schema(part: etree._Element, found: Findings) -> Json:
    schema = _json(text(part))
    if not isinstance(schema, dict):
        found.fault(part, f"handover:{local(part)} contains a JSON object")
        return None
    fault = form_fault(schema)
    if fault is not None:
        found.fault(part, fault)
    return schema


def _flag(extension: etree._Element, name: str, found: Findings) -> bool:
    text = extension.get(name, "false")
    if text not in {"true", "false"}:
        found.fault(extension, f'{name}="{text}" is neither true nor false')
    return bool(text == "true")


def _reference(part: etree._Element, attribute: str, found: Findings) -> Value:
    literal, expression = part.get(attribute), part.get("expression")
    if (literal is None) == (expression is None):
        found.fault(part, f"handover:{local(part)} has either {attribute} or expression")
        return Value()
    if expression is not None:
        return _expression(part, expression, found)
    if not is_reference(literal):
        found.fault(
            part, f'{attribute}="{literal}" names no entity; write Type:id such as Device:glove-1, or a URN'
        )
    return Value(literal)


def _used(
    type_: str, involved: Iterable[Value], parts: Iterable[etree._Element], found: Findings
) -> tuple[Value, ...]:
    """Return the entities of a type that a Task uses, by elements of their own or by handover:involves."""
    used = [each for each in involved if _passive_type(each) == type_]
    for part in parts:
        value = _reference(part, "entity", found)
        if value.expression is None and is_reference(value.literal) and _type_of(value) not in {type_, None}:
            found.fault(
                part,
                message(
                    "bpmn.wrong_used_type",
                    '"{entity}" is no {type}; write {type}:id',
                    entity=value.literal,
                    type=type_,
                ),
            )
        used.append(value)
    return tuple(used)


def _passive_type(value: Value) -> str | None:
    type_ = _type_of(value)
    return type_ if type_ in PASSIVE_TYPES else None


def _type_of(value: Value) -> str | None:
    """Return the entity type of a literal reference, as far as it names one."""
    if not isinstance(value.literal, str):
        return None
    return type_of(value.literal) if value.literal.startswith("urn:") else value.literal.partition(":")[0]


def _value(part: etree._Element, found: Findings) -> Value:
    value, expression = part.get("value"), part.get("expression")
    if not part.get("name"):
        found.fault(part, "a parameter needs a name")
    if (value is None) == (expression is None):
        found.fault(part, "a parameter has either value or expression")
        return Value()
    return _expression(part, expression, found) if expression is not None else Value(_json(value or ""))


def _expression(part: etree._Element, text: str, found: Findings) -> Value:
    return attempt(part, lambda: Value(expression=native.read(text)), Value(), found)


def _outputs(parts: list[etree._Element], found: Findings) -> dict[str, str]:
    outputs: dict[str, str] = {}
    for part in parts:
        name = part.get("name") or ""
        if not is_variable_name(name):
            found.fault(part, f'"{name}" cannot be the name of a variable')
        outputs[name] = part.get("from") or name
    return outputs


def _json(text: str) -> Json:
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:
        return text
