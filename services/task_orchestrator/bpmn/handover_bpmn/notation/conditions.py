"""Conditions: of sequence flows, conditional events and loops, in the language that each of them names."""

from collections.abc import Callable, Mapping

from lxml import etree

from handover.messages import message
from handover_bpmn.languages import native
from handover_bpmn.languages.base import Expression, ExpressionError
from handover_bpmn.languages.feel import read_feel
from handover_bpmn.languages.java import read_java
from handover_bpmn.languages.juel import read_juel
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.base import attempt
from handover_bpmn.notation.dialects.scripts import JAVA_LIKE
from handover_bpmn.notation.document import text
from handover_bpmn.notation.elements import refuse

_LANGUAGES: Mapping[str, Callable[[str], Expression]] = {
    "handover": native.read,
    "juel": read_juel,
    "feel": read_feel,
}
"""The languages that a condition may name; any other URI names that of the file."""

_RULES = frozenset({"http://www.jboss.org/drools/rule", "drools"})
"""Rules over the facts of a session, which no process has here; `eval(…)` in them is Java."""


def read_condition(
    element: etree._Element, condition: etree._Element | None, context: Context
) -> Expression | None:
    """Return a condition of `element`; None without one, or with a fault."""
    if condition is None:
        return None
    language, expression = (condition.get("language") or "").strip(), text(condition)
    if not expression and not language:
        return _missing(element, context)
    name = language.lower()
    if name in JAVA_LIKE or name in _RULES:
        return _java_condition(element, language, expression, context)
    reading = _LANGUAGES.get("feel" if "/feel" in name else name)
    if reading is None:
        if language and not name.startswith(("http:", "https:")):
            return _refuse(element, language, context)
        reading = context.dialects.main.expression
    chosen = reading
    return attempt(element, lambda: chosen(expression), None, context.findings)


def _missing(element: etree._Element, context: Context) -> Expression | None:
    if context.dialects.is_ours:
        context.findings.fault(element, "an expression is empty")
    return None


def _java_condition(
    element: etree._Element, language: str, text_: str, context: Context
) -> Expression | None:
    try:
        expression = read_java(text_)
    except ExpressionError:
        return _refuse(element, language, context)
    context.findings.warn(
        element,
        message(
            "bpmn.condition_read_as_juel",
            "the condition in {language} is read as JUEL; check that it means the same",
            language=language,
        ),
    )
    return expression


def _refuse(element: etree._Element, language: str, context: Context) -> Expression | None:
    refuse(
        element,
        f"a condition in {language}",
        "write an expression without a language attribute",
        context.findings,
    )
    return None
