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
from contextlib import suppress

from lxml import etree

from handover.formats.durations import Duration, parse_duration
from handover.messages import message
from handover_bpmn.languages import native
from handover_bpmn.languages.base import Expression, ExpressionError
from handover_bpmn.languages.feel import read_feel
from handover_bpmn.languages.java import read_java
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.languages.native_grammar import is_variable_name
from handover_bpmn.model import (
    Assignment,
    Call,
    EntityFilter,
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
from handover_bpmn.notation.dialects.handover_elements import (
    HINTS,
    NAMESPACE,
    RESERVING,
    extension_of,
    extensions_of,
    parts_of,
)
from handover_bpmn.notation.dialects.handover_values import (
    boolean,
    form_in_file,
    form_reference,
    json_or_text,
    json_schema,
    passive_type,
    read_outputs,
    read_reference,
    read_value,
    used_entities,
)
from handover_bpmn.notation.dialects.translations import read_translations
from handover_bpmn.notation.document import child_text, extensions, is_none_start, local, namespace
from handover_bpmn.notation.elements import referenced, warn_without_effect
from handover_bpmn.notation.faults import Findings

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}", re.ASCII)
_DEFINITION_ID = re.compile(r"urn:ngsi-ld:TaskDefinition:[A-Za-z0-9_.:-]{1,200}", re.ASCII)
_TYPE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*|[a-z][a-z0-9+.-]*:[^\s<>\"]+", re.ASCII)
_PARTS = frozenset(
    {"involves", "material", "asset", "happensAt", "parameter", "output", "form", "inputSchema"}
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

    def work(self, element: etree._Element, findings: Findings) -> Work:
        """Return what `handover:task` says."""
        extension = extension_of(element, "task", findings)
        if extension is None:
            return Work()
        definition = extension.get("definition") or ""
        if not _NAME.fullmatch(definition) and not _DEFINITION_ID.fullmatch(definition):
            findings.fault(
                extension,
                f'definition="{definition}" is not a name; use A-Z, a-z, 0-9, - _ . '
                "or the id of a TaskDefinition",
            )
        parts = parts_of(extension, _PARTS, findings)
        involved = [read_reference(part, "resource", findings) for part in parts["involves"]]
        performers = tuple(entity for entity in involved if passive_type(entity) is None)
        role = (extension.get("role") or "").strip() or None
        skills = tuple((extension.get("skills") or "").split())
        if performers and (role or skills):
            findings.fault(
                extension,
                message(
                    "bpmn.resource_and_role",
                    "a handover:task has either handover:involves or a role and skills",
                ),
            )
        return Work(
            definition=definition,
            deadline=_deadline(extension, findings),
            involves=performers,
            materials=used_entities("Material", involved, parts["material"], findings),
            assets=used_entities("Asset", involved, parts["asset"], findings),
            happens_at=tuple(
                Place(read_reference(part, "location", findings), part.get("function"))
                for part in parts["happensAt"]
            ),
            parameters={
                **{part.get("name") or "": read_value(part, findings) for part in parts["parameter"]},
                **form_in_file(parts["form"], findings),
            },
            form=form_reference(parts["form"], findings),
            inputs_schema=next((json_schema(part, findings) for part in parts["inputSchema"]), None),
            hints={name: text for name in HINTS if (text := (extension.get(name) or "").strip())},
            outputs=read_outputs(parts["output"], findings),
            handles_outcomes=boolean(extension, "handlesOutcomes", findings),
            require_pin=boolean(extension, "requirePin", findings),
            performer_lost=_performer_lost(extension, findings),
            has_implementation=True,
            role=role,
            skills=skills,
        )

    def start_form(self, element: etree._Element, findings: Findings) -> StartForm:
        """Return the `handover:form` of a start event."""
        parts = extensions_of(element, "form", findings)
        return StartForm(form_in_file(parts, findings).get("form"), form_reference(parts, findings))

    def mapped(self, element: etree._Element, findings: Findings) -> Mapped:  # noqa: ARG002 - of the interface
        """Return nothing: an activity of our dialect sees all variables."""
        return Mapped()

    def call(self, element: etree._Element, findings: Findings) -> Call | None:
        """Return the called process, which gets all variables and returns all."""
        reference = (element.get("calledElement") or "").strip()
        called = reference if "${" in reference or "#{" in reference else referenced(reference)
        if not called:
            findings.fault(element, _no_called_element())
            return None
        process = attempt(element, lambda: self.value(called), Value(), findings)
        return Call(process, all_inputs=True, all_outputs=True)

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
        """Return the assignments of a script in our language, or the text of another one."""
        source = child_text(element, "script")
        format_ = (element.get("scriptFormat") or "").strip()
        if format_.lower() == "handover" or (not format_ and not self.lenient):
            return Script(native_script(element, source, findings))
        return Script(format=format_, text=source) if format_ else script_or_work(source)

    def occurrence(
        self, element: etree._Element, definition: etree._Element | None, findings: Findings
    ) -> Occurrence:
        """Return the entities of `handover:on`."""
        extension = extension_of(element, "on", findings)
        if extension is None and definition is not None:
            extension = extension_of(definition, "on", findings)
        if extension is None:
            return Occurrence()
        type_ = extension.get("type") or ""
        if not _TYPE.fullmatch(type_):
            findings.fault(extension, f'type="{type_}" names no entity type such as Alert or Task')
        variable = extension.get("variable", "entity")
        if not is_variable_name(variable):
            findings.fault(extension, f'"{variable}" cannot be the name of a variable')
        pattern = extension.get("idPattern")
        if pattern is not None:
            attempt(extension, lambda: _pattern(pattern), None, findings)
        text = extension.get("correlation")
        correlation = None if text is None else attempt(extension, lambda: native.read(text), None, findings)
        if correlation is not None and correlation.names() - {variable}:
            findings.fault(extension, f'the correlation reads only "{variable}"; it has no other variables')
        return Occurrence(EntityFilter(type_, pattern, extension.get("q"), variable, correlation))

    def correlation(self, declared: etree._Element, findings: Findings) -> Value | None:  # noqa: ARG002
        """Return None: our dialect has no correlation of a message."""
        return None

    def process(self, element: etree._Element, findings: Findings) -> ProcessExtension:
        """Return what `handover:process` says, and the translations."""
        translations = _translations(element, findings)
        extension = extension_of(element, "process", findings)
        if extension is None:
            return ProcessExtension(translations=translations)
        parameters: dict[str, ProcessParameter] = {}
        for part in parts_of(extension, {"parameter"}, findings)["parameter"]:
            name = part.get("name") or ""
            if not is_variable_name(name):
                findings.fault(part, f'"{name}" cannot be the name of a variable')
            if part.get("expression") is not None:
                findings.fault(part, "a parameter of the process has a value, not an expression")
            default = part.get("value")
            parameters[name] = ProcessParameter(
                name, default is None, None if default is None else json_or_text(default)
            )
        title = extension.get("title")
        naming = None if title is None else attempt(extension, lambda: _naming(title.strip()), None, findings)
        return ProcessExtension(extension.get("version"), parameters, naming, translations)

    def listeners(
        self,
        element: etree._Element,  # noqa: ARG002 - of the interface
    ) -> tuple[tuple[Assignment, ...], tuple[Assignment, ...]]:
        """Return nothing."""
        return (), ()

    def check(self, element: etree._Element, findings: Findings) -> None:
        """Report our extension elements that stand where they have no meaning."""
        for attribute in element.attrib:
            if attribute == f"{{{NAMESPACE}}}reserve" and local(element) in RESERVING:
                continue
            if attribute.startswith(f"{{{NAMESPACE}}}"):
                warn_without_effect(element, findings, f"handover:{etree.QName(attribute).localname}")
        name = local(element)
        allowed = (
            {"process", "translations"} if name == "process" else {"on"} if _can_be_event(element) else set()
        )
        if name.endswith(("ask", "Event")):
            allowed = allowed | {"escalation", "retry", "specification", "task"}
        if is_none_start(element):
            allowed = allowed | {"form"}
        if name in RESERVING:
            allowed = allowed | {"reserve"}
        for extension in extensions(element):
            if namespace(extension) == NAMESPACE and local(extension) not in allowed:
                supported = (
                    " or ".join(f"handover:{part}" for part in sorted(allowed)) or "nothing of handover"
                )
                findings.fault(
                    extension,
                    f"handover:{local(extension)} is unknown here; {supported} is what may stand here",
                )


def _translations(process: etree._Element, findings: Findings) -> dict[str, dict[str, str]]:
    groups = {
        extension: parts_of(extension, {"translation"}, findings)["translation"]
        for extension in extensions_of(process, "translations", findings)
    }
    return read_translations(groups, process, findings)


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


def _deadline(extension: etree._Element, findings: Findings) -> Duration | None:
    text = extension.get("deadline")
    return None if text is None else attempt(extension, lambda: parse_duration(text.strip()), None, findings)


def _performer_lost(extension: etree._Element, findings: Findings) -> PerformerLost:
    text = extension.get("onPerformerLost", PerformerLost.ASK)
    if text in set(PerformerLost):
        return PerformerLost(text)
    findings.fault(extension, f'onPerformerLost="{text[:64]}" is none of {", ".join(PerformerLost)}')
    return PerformerLost.ASK
