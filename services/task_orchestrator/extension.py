"""Our extension elements: the attributes of the Task that an activity creates.

<handover:task definition="pick" deadline="PT2M">
  <handover:involves resource="Device:ur10-1"/>
  <handover:parameter name="pose" expression="scan.pose"/>
</handover:task>

With handlesOutcomes="true" a Task with another outcome than `ok` is completed, and the process continues with
the variable `outcome`; otherwise such a Task fails.
"""

import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

import orjson
from lxml import etree

from handover.durations import Duration, parse_duration
from services.task_orchestrator.definition import (
    Activity,
    Fault,
    Given,
    Place,
    ProcessParameter,
    variable_of,
)
from services.task_orchestrator.languages.native import ExpressionError, is_variable_name, read
from services.task_orchestrator.xml_names import HANDOVER, local, qualified

_SHORT = re.compile(r"[A-Z][A-Za-z0-9]*:[A-Za-z0-9_.-]+", re.ASCII)
_URN = re.compile(r"urn:[a-z0-9][a-z0-9-]{0,31}:[^\s<>\"]+", re.ASCII)
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}", re.ASCII)

_ATTRIBUTES: Mapping[str, frozenset[str]] = {
    "task": frozenset({"definition", "deadline", "handlesOutcomes"}),
    "involves": frozenset({"resource", "expression"}),
    "happensAt": frozenset({"location", "expression", "function"}),
    "parameter": frozenset({"name", "value", "expression"}),
    "output": frozenset({"name", "from"}),
    "process": frozenset({"version"}),
}


class Findings:
    """The faults that were found."""

    def __init__(self) -> None:
        self.faults: list[Fault] = []

    def fault(self, element: etree._Element, message: str) -> None:
        """Add a fault of `element`, which is named by its id or that of its parent."""
        owner: etree._Element | None = element
        while owner is not None and owner.get("id") is None:
            owner = owner.getparent()
        self.faults.append(Fault(None if owner is None else owner.get("id"), element.sourceline, message))


def is_reference(text: object) -> bool:
    """Return whether `text` refers to an entity: `Device:glove-1` or a URN."""
    return isinstance(text, str) and bool(_SHORT.fullmatch(text) or _URN.fullmatch(text))


def read_activity(element: etree._Element, lane: str | None, found: Findings) -> Activity | None:
    """Return the activity of `element`; None, with a fault, if it has no extension element."""
    extension = _extension(element, "task", found)
    if extension is None:
        found.fault(element, 'an activity needs <handover:task definition="…"> in its extensionElements')
        return None
    definition = extension.get("definition") or ""
    if not _NAME.fullmatch(definition):
        found.fault(extension, f'definition="{definition}" is not a name; use A-Z, a-z, 0-9, - _ .')
    parts = _parts(extension, {"involves", "happensAt", "parameter", "output"}, found)
    involves = tuple(_reference(part, "resource", found) for part in parts["involves"])
    if not involves:
        found.fault(element, 'no performer: add <handover:involves resource="Device:…"/>')
    element_id = element.get("id") or ""
    outputs = _outputs(parts["output"], found)
    if not outputs and not is_variable_name(variable_of(element_id)):
        found.fault(
            element, f'"{variable_of(element_id)}" cannot be a variable; name its outputs or change the id'
        )
    return Activity(
        id=element_id,
        name=element.get("name") or element_id,
        description=(element.findtext(qualified("documentation")) or "").strip() or None,
        lane=lane,
        definition=definition,
        deadline=_deadline(extension, found),
        involves=involves,
        happens_at=tuple(
            Place(_reference(part, "location", found), part.get("function")) for part in parts["happensAt"]
        ),
        parameters={part.get("name") or "": _given(part, found) for part in parts["parameter"]},
        outputs=outputs,
        handles_outcomes=_handles_outcomes(extension, found),
    )


def read_process_extension(
    process: etree._Element, found: Findings
) -> tuple[str | None, dict[str, ProcessParameter]]:
    """Return the version label and the parameters of a process."""
    extension = _extension(process, "process", found)
    if extension is None:
        return None, {}
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
    return extension.get("version"), parameters


def _extension(element: etree._Element, name: str, found: Findings) -> etree._Element | None:
    ours: list[etree._Element] = []
    for extensions in element.iterchildren(qualified("extensionElements")):
        ours += extensions.iterchildren(f"{{{HANDOVER}}}*")
    for other in ours:
        if local(other) != name:
            found.fault(
                other, f"handover:{local(other)} is unknown here; handover:{name} is what may stand here"
            )
    named = [extension for extension in ours if local(extension) == name]
    if len(named) > 1:
        found.fault(named[1], f"one handover:{name} is enough")
    if named:
        _check_attributes(named[0], found)
    return named[0] if named else None


def _parts(extension: etree._Element, names: set[str], found: Findings) -> dict[str, list[etree._Element]]:
    parts: dict[str, list[etree._Element]] = {name: [] for name in names}
    for part in extension.iterchildren("{*}*"):
        if part.tag.startswith(f"{{{HANDOVER}}}") and local(part) in names:
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


def _deadline(extension: etree._Element, found: Findings) -> Duration | None:
    text = extension.get("deadline")
    if text is None:
        return None
    try:
        return parse_duration(text.strip())
    except ValueError as error:
        found.fault(extension, str(error))
        return None


def _handles_outcomes(extension: etree._Element, found: Findings) -> bool:
    text = extension.get("handlesOutcomes", "false")
    if text not in {"true", "false"}:
        found.fault(extension, f'handlesOutcomes="{text}" is neither true nor false')
    return bool(text == "true")


def _reference(part: etree._Element, attribute: str, found: Findings) -> Given:
    literal, expression = part.get(attribute), part.get("expression")
    if (literal is None) == (expression is None):
        found.fault(part, f"handover:{local(part)} has either {attribute} or expression")
        return Given()
    if expression is not None:
        return _expression(part, expression, found)
    if not is_reference(literal):
        found.fault(
            part, f'{attribute}="{literal}" names no entity; write Type:id such as Device:glove-1, or a URN'
        )
    return Given(literal)


def _given(part: etree._Element, found: Findings) -> Given:
    value, expression = part.get("value"), part.get("expression")
    if not part.get("name"):
        found.fault(part, "a parameter needs a name")
    if (value is None) == (expression is None):
        found.fault(part, "a parameter has either value or expression")
        return Given()
    return _expression(part, expression, found) if expression is not None else Given(_json(value or ""))


def _expression(part: etree._Element, text: str, found: Findings) -> Given:
    try:
        return Given(expression=read(text))
    except ExpressionError as error:
        found.fault(part, str(error))
        return Given()


def _outputs(parts: list[etree._Element], found: Findings) -> dict[str, str]:
    outputs: dict[str, str] = {}
    for part in parts:
        name = part.get("name") or ""
        if not is_variable_name(name):
            found.fault(part, f'"{name}" cannot be the name of a variable')
        outputs[name] = part.get("from") or name
    return outputs


def _json(text: str) -> Any:
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:
        return text
