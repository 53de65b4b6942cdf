"""Elements of handover: which attributes they have, and where expressions may stand."""

from collections import Counter
from collections.abc import Iterator, Mapping, Set

from lxml import etree

from handover.messages import message
from handover.tasks.specification import FIELDS
from handover_bpmn.notation.dialects.translations import PLACEHOLDER
from handover_bpmn.notation.document import extensions, local, namespace
from handover_bpmn.notation.faults import Findings

NAMESPACE = "urn:handover:bpmn"

HINTS = ("assignee", "candidateUsers", "candidateGroups", "dueDate", "followUpDate", "priority")
ATTRIBUTES: Mapping[str, frozenset[str]] = {
    "task": frozenset(
        {
            "definition",
            "deadline",
            "handlesOutcomes",
            "requirePin",
            "onPerformerLost",
            "role",
            "skills",
            *HINTS,
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
EVALUATED: Mapping[str, frozenset[str]] = {
    "task": frozenset(HINTS),
    "specification": frozenset(FIELDS),
    "on": frozenset({"idPattern", "correlation"}),
    "process": frozenset({"title"}),
    "translation": frozenset({"source"}),
}
"""Attributes that may have `${…}`, beside `expression`; in a regular expression it has another meaning."""
RESERVING = frozenset({"process", "subProcess"})
"""Elements that may have `handover:reserve`, beside lanes and groups."""


def has_task(element: etree._Element) -> bool:
    """Return whether an activity has a `handover:task`."""
    return any(extension.tag == f"{{{NAMESPACE}}}task" for extension in extensions(element))


def reserve_elements(element: etree._Element) -> Iterator[etree._Element]:
    """Yield the extension elements `handover:reserve` of an element."""
    for extension in extensions(element):
        if extension.tag == f"{{{NAMESPACE}}}reserve":
            yield extension


def check_reserve(extension: etree._Element, findings: Findings) -> None:
    """Report a `handover:reserve` that does not say in one way what it reserves."""
    check_attributes(extension, findings)
    forms = [extension.get("resource"), extension.get("expression")]
    forms.append(extension.get("role") or extension.get("skills"))
    if sum(form is not None for form in forms) != 1:
        findings.fault(
            extension,
            message(
                "bpmn.reserve_one_form",
                "handover:reserve has one of resource, expression, and role with skills",
            ),
        )


def extension_of(element: etree._Element, name: str, findings: Findings) -> etree._Element | None:
    """Return our extension element `name` of an element, if it has one, and report unknown attributes."""
    named = [extension for extension in extensions(element) if extension.tag == f"{{{NAMESPACE}}}{name}"]
    if len(named) > 1:
        findings.fault(named[1], f"one handover:{name} is enough")
    if named:
        check_attributes(named[0], findings)
    return named[0] if named else None


def extensions_of(element: etree._Element, name: str, findings: Findings) -> list[etree._Element]:
    """Return our extension elements `name` of an element, and report unknown attributes."""
    named = [extension for extension in extensions(element) if extension.tag == f"{{{NAMESPACE}}}{name}"]
    for extension in named:
        check_attributes(extension, findings)
    return named


def parts_of(
    extension: etree._Element, names: Set[str], findings: Findings
) -> dict[str, list[etree._Element]]:
    """Return the parts of an extension element by name; others are faults."""
    parts: dict[str, list[etree._Element]] = {name: [] for name in names}
    for part in extension.iterchildren("{*}*"):
        if namespace(part) == NAMESPACE and local(part) in names:
            check_attributes(part, findings)
            parts[local(part)].append(part)
        else:
            findings.fault(part, f"{local(part)} is unknown here; known are {', '.join(sorted(names))}")
    for name in ("parameter", "output"):
        times = Counter(part.get("name") for part in parts.get(name, []))
        for twice in (attribute for attribute, number in times.items() if number > 1):
            findings.fault(extension, f'the {name} "{twice}" is given twice')
    return parts


def check_attributes(element: etree._Element, findings: Findings) -> None:
    """Report attributes that an element does not have, and expressions where none may stand."""
    allowed = ATTRIBUTES[local(element)]
    for name in element.attrib:
        if name not in allowed:
            findings.fault(
                element,
                f'handover:{local(element)} has no attribute "{name}"; it has {", ".join(sorted(allowed))}',
            )
        elif name != "expression" and name not in EVALUATED.get(local(element), ()):
            _check_literal(element, name, allowed, findings)


def _check_literal(element: etree._Element, name: str, attributes: Set[str], findings: Findings) -> None:
    """Report an expression where a literal stands, which would be handed over as that text."""
    written = str(element.get(name)).strip()
    if written.startswith('"') or not ("${" in written or "#{" in written or written.startswith("=")):
        return
    if "expression" not in attributes or _is_of_process(element):
        text = message(
            "bpmn.expression_not_evaluated",
            '{name}="{given}" is an expression, and {name} is not evaluated; write the value itself',
            name=name,
            given=written[:100],
        )
    else:
        text = message(
            "bpmn.expression_as_literal",
            '{name}="{given}" is an expression where a literal stands; write expression="{inner}" instead',
            name=name,
            given=written[:100],
            inner=_as_expression(written)[:100],
        )
    findings.fault_of_deployment(element, text)


def _as_expression(text: str) -> str:
    """Return the native expression for a literal: `x` for `${x}` and `= x`, `'Turn ' + x` for `Turn ${x}`."""
    inner = text.removeprefix("=").strip()
    if inner != text or inner.startswith(("{", "[")):
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
