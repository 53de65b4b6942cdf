"""JUEL, the expressions of Camunda 7: `${…}` and `#{…}`. docs/reference/expressions.md lists the subset.

An expression is parsed once into nested functions (closures) of the variables. There are no loops and no user
functions, so the time of an evaluation is bounded by the length of the expression.
"""

import re
from dataclasses import dataclass
from functools import lru_cache

from handover_bpmn.languages.base import ExpressionError, Json, Variables, evaluation_error, within_limits
from handover_bpmn.languages.juel.nodes import Node
from handover_bpmn.languages.juel.parser import JuelParser
from handover_bpmn.languages.juel.values import check_string, coerce_to_string
from handover_bpmn.languages.tokens import excerpt

START = re.compile(r"\\?[$#]\{")


@dataclass(frozen=True, slots=True)
class JuelExpression:
    """A JUEL expression, or a text with JUEL expressions in it, which yields a text."""

    text: str
    _node: Node
    _names: frozenset[str]

    def value(self, variables: Variables) -> Json:
        """Return the value; raise `ExpressionError` if a variable is missing or has the wrong type."""
        try:
            value = self._node(variables)
            return value if value is None or value is True or value is False else within_limits(value)
        except Exception as error:  # noqa: BLE001 - every failure is one of the expression
            raise evaluation_error(excerpt(self.text), error) from None

    def names(self) -> frozenset[str]:
        """Return the names of the variables that the expression reads."""
        return self._names


@lru_cache(maxsize=4096)
def read_juel(text: str) -> JuelExpression:
    """Return the expression `text`, which has at least one `${…}` or `#{…}`, without outer white space.

    A text that is one expression yields its value; one with characters around expressions yields a text.
    Raises `ExpressionError` if it is invalid.
    """
    stripped = text.strip()
    expression = parse(stripped)
    if expression is None:
        raise ExpressionError(
            f"{excerpt(stripped)} is no JUEL expression; write it between ${{ and }}, as in ${{approved}}"
        )
    return expression


@lru_cache(maxsize=4096)
def read_template(text: str) -> JuelExpression:
    """Return `text` as `read_juel`; a text without `${…}` and `#{…}` yields itself."""
    expression = parse(text.strip())
    if expression is None:
        literal = text.replace("\\${", "${").replace("\\#{", "#{")
        return JuelExpression(text, lambda _: literal, frozenset())
    return expression


def read_set_variable(
    text: str, parsing: type["JuelParser"] | None = None
) -> tuple[str, JuelExpression] | None:
    """Return name and value of `${execution.setVariable('name', value)}`; None if `text` is something else.

    This is the one call with a side effect that files often have; it equals a script `name = value`.
    """
    text = text.strip()
    if _SET_VARIABLE.match(text) is None:
        return None
    try:
        parser = (parsing or JuelParser)(text, 2)
        for part in ("execution", ".", "setVariable", "("):
            parser.tokens.expect(part)
        name = parser.string()
        parser.tokens.expect(",")
        node = parser.expression()
        parser.tokens.expect(")")
        if parser.close() != len(text):
            raise parser.tokens.error("nothing can follow execution.setVariable(…)")
    except ExpressionError as error:
        raise ExpressionError(f"{excerpt(text)}: {error}") from None
    return name, JuelExpression(text, node, frozenset(parser.names))


_SET_VARIABLE = re.compile(r"[$#]\{\s*execution\s*\.\s*setVariable\s*\(")


def parse(text: str, parsing: type["JuelParser"] | None = None) -> JuelExpression | None:
    """Return the expression or mixed text; None if `text` has no `${` or `#{`."""
    parts: list[str | Node] = []
    names: set[str] = set()
    position = 0
    try:
        while (match := START.search(text, position)) is not None:
            if match.start() > position:
                parts.append(text[position : match.start()])
            if match.group().startswith("\\"):
                parts.append(match.group()[1:])
                position = match.end()
                continue
            parser = (parsing or JuelParser)(text, match.end())
            parts.append(parser.expression())
            names |= parser.names
            position = parser.close()
    except ExpressionError as error:
        raise ExpressionError(f"{excerpt(text)}: {error}") from None
    except RecursionError:
        raise ExpressionError(f"{excerpt(text)}: an expression is nested too deeply") from None
    if all(isinstance(part, str) for part in parts):
        return None
    if position < len(text):
        parts.append(text[position:])
    first = parts[0]
    if len(parts) == 1 and not isinstance(first, str):
        return JuelExpression(text, first, frozenset(names))
    return JuelExpression(text, _mix(parts), frozenset(names))


def _mix(parts: list[str | Node]) -> Node:
    pieces = tuple(parts)

    def mixed(variables: Variables) -> Json:
        text = ""
        for piece in pieces:
            text = check_string(
                text + (piece if isinstance(piece, str) else coerce_to_string(piece(variables)))
            )
        return text

    return mixed
