"""Values of Camunda 7: texts, lists, maps and scripts of inputOutput."""

from collections.abc import Iterator

from lxml import etree

from handover.messages import message
from handover_bpmn.languages.base import MAX_NUMBER, Json
from handover_bpmn.languages.juel import read_template
from handover_bpmn.languages.native_grammar import is_name
from handover_bpmn.model import Assignment, Value
from handover_bpmn.notation.dialects.base import attempt, composed
from handover_bpmn.notation.dialects.camunda7_elements import children_named, has_expression, own_extensions
from handover_bpmn.notation.document import local, text
from handover_bpmn.notation.faults import Findings


def input_output(element: etree._Element, name: str, findings: Findings) -> Iterator[Assignment]:
    """Yield the parameters `name` of the `inputOutput` of an element."""
    for group in (extension for extension in own_extensions(element) if local(extension) == "inputOutput"):
        yield from _assignments(group, name, findings)


def connector_input_output(connector: etree._Element, name: str, findings: Findings) -> Iterator[Assignment]:
    """Yield the parameters `name` of the `inputOutput` of a connector."""
    for group in children_named(connector, "inputOutput"):
        yield from _assignments(group, name, findings)


def _assignments(group: etree._Element, name: str, findings: Findings) -> Iterator[Assignment]:
    for part in children_named(group, name):
        target = part.get("name") or ""
        if not is_name(target):
            findings.fault(part, f'{name} "{target}" cannot be the name of a variable')
            continue
        value = _content(part, f"{name} {target}", findings)
        if value is not None:
            yield Assignment(target, value)


def _content(part: etree._Element, what: str, findings: Findings) -> Value | None:
    """Return the value of a parameter, entry or list item: text, list, map, or a script that nobody runs."""
    for inner in part.iterchildren("{*}*"):
        match local(inner):
            case "list":
                items = [_content(item, what, findings) for item in inner.iterchildren("{*}*")]
                members = {str(nth): item for nth, item in enumerate(items) if item is not None}
                return composed(what, members, is_list=True)
            case "map":
                entries = {
                    entry.get("key") or "": _content(entry, what, findings)
                    for entry in children_named(inner, "entry")
                }
                return composed(what, {key: value for key, value in entries.items() if value is not None})
            case "script":
                return _foreign_script(inner, what, findings)
    content = text(part)
    if local(part) == "script":
        return _foreign_script(part, what, findings)
    if not has_expression(content):
        return Value(content or None)
    return attempt(part, lambda: Value(expression=read_template(content)), Value(), findings)


def _foreign_script(script: etree._Element, what: str, findings: Findings) -> Value | None:
    format_ = script.get("scriptFormat") or ""
    source = text(script) or script.get("resource") or ""
    if format_.lower() == "juel":
        return attempt(script, lambda: Value(expression=read_template(source)), Value(), findings)
    findings.warn(
        script,
        message(
            "bpmn.foreign_value_script",
            "the {format} script of {what} is not run here: its value is null; use an expression",
            format=format_,
            what=what,
        ),
    )
    return Value(None)


def default_of_type(type_: str, default: str) -> Json:
    """Return a default as a value of a type of JSON Schema; the text if it is none."""
    if type_ == "boolean":
        return default.strip().lower() == "true"
    if type_ in {"integer", "number"}:
        try:
            number = float(default)
        except ValueError:
            return default
        if abs(number) <= MAX_NUMBER:
            return int(number) if number == int(number) else number
    return default


def text_value(text: str) -> Value:
    """Return a text, which may contain JUEL expressions."""
    return Value(expression=read_template(text)) if has_expression(text) else Value(text)
