"""Scripts: what of other languages can be read, since it only sets variables."""

import re

from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.languages.java import read_java_assignment
from handover_bpmn.languages.juel import read_set_variable
from handover_bpmn.model import Assignment, Value

JAVA_LIKE = frozenset(
    {
        *("javascript", "js", "ecmascript", "graal.js", "groovy", "java", "mvel"),
        *("http://www.java.com/java", "http://www.mvel.org/2.0", "http://www.javascript.com/javascript"),
    }
)
"""Languages whose simple expressions are those of JUEL, by the names that Camunda and jBPM give them."""

_PRINT = re.compile(r"(?:(?:java\.lang\.)?System\.(?:out|err)\.print(?:ln|f)?)\s*\(.*\)", re.DOTALL)
_STATEMENTS = re.compile(r"""((?:"(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*'|[^;\n"'])*)[;\n]?""")
"""Statements up to a semicolon or the end of the line, which are none within a text."""


def set_variables(source: str) -> tuple[Assignment, ...] | None:
    """Return the variables that a script sets; None if it does anything else.

    Its statements are `execution.setVariable('name', value)`. Statements that only print are left out.
    """
    assignments: list[Assignment] = []
    for statement in (part.strip() for part in _STATEMENTS.findall(source)):
        if not statement or statement.startswith("//") or _PRINT.fullmatch(statement):
            continue
        try:
            assigned = read_java_assignment(statement)
        except ExpressionError:
            return None
        if assigned is None:
            return None
        assignments.append(Assignment(assigned[0], Value(expression=assigned[1])))
    return tuple(assignments)


def assigned_by(expression: str) -> tuple[Assignment, ...]:
    """Return the variable that an expression `${execution.setVariable('name', value)}` sets, if it is one."""
    try:
        assignment = read_set_variable(expression)
    except ExpressionError:
        return ()
    return () if assignment is None else (Assignment(assignment[0], Value(expression=assignment[1])),)
