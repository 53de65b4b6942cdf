"""Specifications: the row of an activity that is written to the specification database before its Task.

<handover:specification name="Confirm" description="Look at ${part}" gesture="Thumbs up"/>
"""

from functools import partial

from lxml import etree

from handover.tasks.specification import FIELDS, Specification
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.model import Value
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.base import attempt
from handover_bpmn.notation.dialects.handover_elements import extension_of


def read_specification(element: etree._Element, context: Context) -> dict[str, Value] | None:
    """Return the values of `handover:specification` by field; None without it."""
    extension = extension_of(element, "specification", context.findings)
    if extension is None:
        return None
    return attempt(extension, partial(_read, extension), None, context.findings)


def _read(extension: etree._Element) -> dict[str, Value]:
    values = {field: _value(text) for field in FIELDS if (text := (extension.get(field) or "").strip())}
    if all(value.expression is None for value in values.values()):
        Specification.of({field: value.literal for field, value in values.items()})
    return values


def _value(text: str) -> Value:
    return Value(expression=read_juel(text)) if "${" in text or "#{" in text else Value(text)
