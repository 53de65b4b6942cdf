"""Function of FEEL: its arguments and their types."""

from collections.abc import Callable
from typing import Any, NamedTuple

from handover_bpmn.languages.feel.values import Budget, FeelValue


class Function(NamedTuple):
    """A function of the budget and its arguments, with the numbers of arguments that it can take."""

    call: Callable[..., FeelValue]
    least: int
    most: int


class AnyValue:
    """Matches every value."""


NUMBER = (int, float)


def typed(*kinds: Any, optional: int = 0) -> Callable[[Callable[..., FeelValue]], Function]:
    """Return a decorator for a function whose arguments have these types, else its result is null."""

    def decorate(call: Callable[..., FeelValue]) -> Function:
        def checked(budget: Budget, *arguments: FeelValue) -> FeelValue:
            for argument, kind in zip(arguments, kinds, strict=False):
                if kind is AnyValue:
                    continue
                if not isinstance(argument, kind) or (isinstance(argument, bool) and kind is not bool):
                    return None
                if isinstance(argument, str):
                    budget.spend(len(argument) >> 6)
                elif isinstance(argument, list | dict):
                    budget.spend(len(argument))
            return call(budget, *arguments)

        return Function(checked, len(kinds) - optional, len(kinds))

    return decorate


def over_list(call: Callable[[Budget, list[FeelValue]], FeelValue]) -> Function:
    """Return a function of one list, or of its items as arguments."""

    def listed(budget: Budget, *arguments: FeelValue) -> FeelValue:
        first = arguments[0]
        if len(arguments) == 1 and first is None:
            return None
        items = first if len(arguments) == 1 and isinstance(first, list) else list(arguments)
        budget.spend(len(items))
        return call(budget, items)

    return Function(listed, 1, 100)
