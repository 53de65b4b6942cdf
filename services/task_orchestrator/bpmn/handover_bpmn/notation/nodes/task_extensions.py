"""Extensions of Tasks in all dialects: escalations, and rows of the specification database.

<handover:escalation after="PT15M" group="shift-leads"/>
<handover:escalation after="PT1H" code="late"/>

say what happens when a Task is not completed in time, in several levels.

<handover:specification name="Confirm" description="Look at ${part}" gesture="Thumbs up"/>

is the row that is written to the specification database before the Task is posted.
"""

from functools import partial

from lxml import etree

from handover.formats.durations import parse_duration
from handover.tasks.specification import FIELDS, Specification
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.model import Escalation, Value
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.base import attempt
from handover_bpmn.notation.dialects.handover_elements import extension_of, extensions_of
from handover_bpmn.notation.faults import Findings


def read_escalations(element: etree._Element, findings: Findings) -> tuple[Escalation, ...]:
    """Return the escalations of an activity, the earliest first."""
    extensions = extensions_of(element, "escalation", findings)
    read = [
        attempt(extension, partial(_read_escalation, extension), None, findings) for extension in extensions
    ]
    levels = [level for level in read if level is not None]
    return tuple(sorted(levels, key=lambda level: level.after.nominal_s))


def _read_escalation(extension: etree._Element) -> Escalation:
    code = (extension.get("code") or "").strip() or None
    group = (extension.get("group") or "").strip() or None
    if code is None and group is None:
        raise ValueError("a handover:escalation has the code of a BPMN escalation, or a group, or both")
    return Escalation(parse_duration((extension.get("after") or "PT0S").strip()), code, group)


def read_specification(element: etree._Element, context: Context) -> dict[str, Value] | None:
    """Return the values of `handover:specification` by field; None without it."""
    extension = extension_of(element, "specification", context.findings)
    if extension is None:
        return None
    return attempt(extension, partial(_read_specification, extension), None, context.findings)


def _read_specification(extension: etree._Element) -> dict[str, Value]:
    values = {
        field: _text_or_expression(text) for field in FIELDS if (text := (extension.get(field) or "").strip())
    }
    if all(value.expression is None for value in values.values()):
        Specification.of({field: value.literal for field, value in values.items()})
    return values


def _text_or_expression(text: str) -> Value:
    return Value(expression=read_juel(text)) if "${" in text or "#{" in text else Value(text)
