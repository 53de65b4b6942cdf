"""Conditions: whether a message, or an element of it, is one that a rule is about."""

from collections.abc import Callable
from typing import Any

from ros_fiware_bridge.mapping.values import Condition
from ros_fiware_bridge.rules.definitions import Anatomy, WrongRule

Holds = Callable[[Any], bool]


def compiled(condition: Condition | None, anatomy: Anatomy) -> Holds | None:
    """Return the function that says whether `condition` holds; None if there is none. Raises `WrongRule`."""
    if condition is None:
        return None
    find, leads = anatomy.find(condition.field), anatomy.leads(condition.field)
    tests = list(_tests(condition))
    if (condition.above is not None or condition.below is not None) and not leads.is_number:
        raise WrongRule(f"{condition.field} is {leads}; only a number is `above` or `below` another")

    def holds(scope: Any) -> bool:
        value = find(scope)
        return all(test(value) for test in tests)

    return holds


def _tests(condition: Condition) -> list[Holds]:
    tests: list[Holds] = []
    if "equals" in condition.model_fields_set:
        wanted = condition.equals
        tests.append(lambda value: bool(value == wanted))
    if (any_of := condition.any_of) is not None:
        tests.append(lambda value: value in any_of)
    if (none_of := condition.none_of) is not None:
        tests.append(lambda value: value not in none_of)
    if (above := condition.above) is not None:
        tests.append(lambda value: value > above)
    if (below := condition.below) is not None:
        tests.append(lambda value: value < below)
    return tests
