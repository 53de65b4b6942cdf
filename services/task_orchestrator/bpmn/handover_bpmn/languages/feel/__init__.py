"""FEEL, the expressions of Camunda 8, in the subset that docs/reference/expressions.md lists.

An expression is parsed once into nested functions (closures) of a scope. A missing name and a value of the
wrong type give null, as in the standard (DMN 1.4, chapter 10). Loops and functions over lists take steps from
the budget of the evaluation, so that no expression runs for ever.
"""

from dataclasses import dataclass
from functools import lru_cache

from handover_bpmn.languages.base import ExpressionError, Json, Variables, evaluation_error, within_limits
from handover_bpmn.languages.feel.nodes import NameScope, Node
from handover_bpmn.languages.feel.parser import FeelParser
from handover_bpmn.languages.feel.values import Budget, to_json
from handover_bpmn.languages.tokens import excerpt


@dataclass(frozen=True, slots=True)
class FeelExpression:
    """A FEEL expression that was parsed and validated."""

    text: str
    _node: Node
    _names: frozenset[str]

    def value(self, variables: Variables) -> Json:
        """Return the value; raise `ExpressionError` only if a limit is exceeded."""
        try:
            budget = Budget()
            value = self._node(NameScope(variables, None, budget))
            if value is None or value is True or value is False:
                return value
            return within_limits(to_json(value, budget))
        except Exception as error:  # noqa: BLE001 - every failure is one of the expression
            raise evaluation_error(excerpt(self.text), error) from None

    def names(self) -> frozenset[str]:
        """Return the names that the expression reads; within a filter, they may be entries of its items."""
        return self._names


@lru_cache(maxsize=4096)
def read_feel(text: str) -> FeelExpression:
    """Return the expression `text`, with or without the `=` before it; raise `ExpressionError` for others."""
    stripped = text.strip()
    try:
        parser = FeelParser(stripped, 1 if stripped.startswith("=") else 0)
        node = parser.whole()
    except RecursionError:
        raise ExpressionError(f"{excerpt(stripped)}: an expression is nested too deeply") from None
    except Exception as error:  # noqa: BLE001 - every failure is one of the expression
        raise evaluation_error(excerpt(stripped), error) from None
    return FeelExpression(stripped, node, frozenset(parser.names))
