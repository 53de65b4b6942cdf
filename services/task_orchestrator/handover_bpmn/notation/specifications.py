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
    extension = extension_of(element, "specification", context.found)
    if extension is None:
        return None
    return attempt(extension, partial(_read, extension), None, context.found)


def _read(extension: etree._Element) -> dict[str, Value]:
    given = {field: _value(text) for field in FIELDS if (text := (extension.get(field) or "").strip())}
    if all(each.expression is None for each in given.values()):
        Specification.of({field: each.literal for field, each in given.items()})
    return given


def _value(text: str) -> Value:
    return Value(expression=read_juel(text)) if "${" in text or "#{" in text else Value(text)
