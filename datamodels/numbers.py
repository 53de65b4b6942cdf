"""Numbers that every broker keeps as they are.

Some brokers keep an integer in 32 bits, and answer with another number for a larger one. They keep floats.
"""

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
