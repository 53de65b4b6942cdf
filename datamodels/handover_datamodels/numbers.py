"""Numbers that every broker keeps as they are.

Some brokers keep an integer in 32 bits, and answer with another number for a larger one. They keep floats.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

MIN_INTEGER: Final = -(2**31)
MAX_INTEGER: Final = 2**31 - 1


def portable(value: Any) -> Any:
    """Return a JSON value with its integers of more than 32 bits as floats, where a float is exact.

    An integer that no float is equal to, which has more than 53 bits, stays: an identifier must not change.
    """
    if isinstance(value, dict):
        return {name: portable(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [portable(inner) for inner in value]
    if not isinstance(value, int) or MIN_INTEGER <= value <= MAX_INTEGER:
        return value
    try:
        number = float(value)
    except OverflowError:
        return value
    return number if number == value else value


def not_finite_place(value: Any) -> str | None:
    """Return the place of a NaN or infinite number in a value, as `joints.1`; None if there is none.

    JSON has no such number. Its writers put `null` there, or text that other readers refuse.
    """
    if isinstance(value, float):
        return None if math.isfinite(value) else ""
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, Mapping):
        items = value.items()
    elif isinstance(value, list | tuple):
        items = enumerate(value)
    for name, inner in items:
        if (place := not_finite_place(inner)) is not None:
            return f"{name}.{place}" if place else str(name)
    return None
