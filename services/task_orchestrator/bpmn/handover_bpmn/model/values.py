"""Values: literals and expressions over the process variables."""

from dataclasses import dataclass

from handover_bpmn.languages.base import Expression, Json, Variables


@dataclass(frozen=True, slots=True)
class Value:
    """A literal, or an expression over the process variables."""

    literal: Json = None
    expression: Expression | None = None

    def value(self, variables: Variables) -> Json:
        """Return the value; raise `ExpressionError` if a variable is missing or has the wrong type."""
        return self.literal if self.expression is None else self.expression.value(variables)


@dataclass(frozen=True, slots=True)
class Assignment:
    """`target` (a variable, or a parameter of a Task) gets `value`."""

    target: str
    value: Value
