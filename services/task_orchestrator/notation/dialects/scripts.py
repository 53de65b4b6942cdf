"""Scripts: what of other languages can be read as JUEL, since its simple expressions have the same form."""

import re

from services.task_orchestrator.languages.base import Expression, ExpressionError
from services.task_orchestrator.languages.juel import read_juel, read_set_variable
from services.task_orchestrator.model import Assignment, Value

SIMILAR_TO_JUEL = frozenset({"javascript", "js", "ecmascript", "graal.js", "groovy"})
"""Languages whose simple expressions are those of JUEL."""

SIMILAR_URIS = frozenset(
    {
        *("http://www.java.com/java", "http://www.mvel.org/2.0", "http://www.javascript.com/javascript"),
        *("java", "mvel"),
    }
)
"""The names that jBPM gives to such languages."""

_RETURN = re.compile(r"return\b\s*(.*?);?\s*", re.DOTALL)
_PRINT = re.compile(r"(?:java\.lang\.)?System\.(?:out|err)\.print(?:ln|f)?\s*\(.*\)", re.DOTALL)


def similar_condition(given: str) -> Expression:
    """Return a condition of Java, MVEL, JavaScript or Groovy, read as JUEL; raise `ExpressionError`."""
    inner = given.strip().rstrip(";")
    returned = _RETURN.fullmatch(inner)
    if returned is not None:
        inner = returned[1]
    inner = re.sub(r"(?<![\w'\"$])\$(\w+)", r"\1", inner)  # an older form of variables
    inner = inner.replace("!==", "!=").replace("===", "==").replace("kcontext.", "execution.")
    return read_juel("${" + inner + "}")


def set_variables(source: str) -> tuple[Assignment, ...] | None:
    """Return the variables that a script sets; None if it does anything else.

    Its lines are `execution.setVariable('name', value)`. Lines that only print are left out.
    """
    found: list[Assignment] = []
    for line in re.split(r"[;\n]", source):
        statement = line.strip().replace("kcontext.", "execution.")
        if not statement or statement.startswith("//") or _PRINT.fullmatch(statement):
            continue
        assigned = assigned_by("${" + statement + "}")
        if not assigned:
            return None
        found += assigned
    return tuple(found)


def assigned_by(expression: str) -> tuple[Assignment, ...]:
    """Return the variable that an expression `${execution.setVariable('name', value)}` sets, if it is one."""
    try:
        found = read_set_variable(expression)
    except ExpressionError:
        return ()
    return () if found is None else (Assignment(found[0], Value(expression=found[1])),)
