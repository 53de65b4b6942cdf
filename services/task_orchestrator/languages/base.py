"""What every expression language offers: an expression that was read once and is evaluated often."""

from collections.abc import Mapping
from typing import Any, Protocol, TypeAlias

from services.task_orchestrator.grammar import ExpressionError

__all__ = ["Expression", "ExpressionError", "Json", "Variables"]

Json: TypeAlias = Any
Variables: TypeAlias = Mapping[str, Json]


class Expression(Protocol):
    """An expression that was read and checked; it has no side effects and its values are JSON."""

    @property
    def text(self) -> str:
        """Return the expression as the file has it."""
        ...

    def value(self, variables: Variables) -> Json:
        """Return the value; raise `ExpressionError` if a variable is missing or has the wrong type."""
        ...

    def names(self) -> frozenset[str]:
        """Return the names of the variables that the expression reads."""
        ...
