"""Values of ROS as JSON has them: no NumPy, no NaN, no picture of five million bytes by accident."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from handover.errors import HandoverError
from ros_fiware_bridge.rules.definitions import Definitions, Leads, WrongRule
from ros_fiware_bridge.types.definition import FLOATS, FieldType, Many

ToJson = Callable[[Any], Any]

LONGEST_TEXT = 65_536
_ABSENT = object()


class NotANumber(HandoverError):
    """NaN or infinity, for which JSON has no word."""


class TooLarge(HandoverError):
    """More elements, or more text, than a context broker should be given unasked."""


class JsonValues:
    """Makes JSON of the values of one rule, within its limits."""

    def __init__(self, definitions: Definitions, most_elements: int, *, large_arrays: bool) -> None:
        self._definitions = definitions
        self._most = math.inf if large_arrays else most_elements
        self._large = large_arrays

    def maker(self, leads: Leads, what: str, nan: Any = _ABSENT) -> ToJson:
        """Return the function that makes JSON of what `leads` tells of; `what` is how errors call it.

        `nan` is what stands for a number that is none, if anything does. Raises `WrongRule` when it
        would be too large for sure.
        """
        if leads.type is None:
            return lambda value: self._any(value, what, nan)
        self._refuse_pictures(leads.type, what)
        found = leads.type
        if found.many is Many.ONE and not found.is_message:
            if found.base in FLOATS:
                return lambda value: _finite(value, what, nan)
            if found.base == "string":
                return lambda value: _short(value, what)
            return lambda value: value.item() if isinstance(value, np.generic) else value
        return lambda value: self._any(value, what, nan)

    def _refuse_pictures(self, found: FieldType, what: str, inside: str = "") -> None:
        if self._large:
            return
        named = f"{what}{inside}"
        if found.is_octets and not 0 < found.size <= self._most:
            raise WrongRule(
                f"{named} is {found}, bytes without a limit (a picture, a point cloud): a context broker "
                "keeps and sends each version of it to everyone; map fields that describe it, or say "
                "large_arrays: true"
            )
        if found.many is Many.FIXED and found.size > self._most:
            raise WrongRule(
                f"{named} holds {found.size} elements, more than {self._most} (most_elements); "
                "choose some of them, or say large_arrays: true"
            )
        if found.is_message:
            for field in self._definitions.definition(found.base).fields:
                self._refuse_pictures(field.type, what, f"{inside}.{field.name}")

    def _any(self, value: Any, what: str, nan: Any) -> Any:
        if isinstance(value, float):
            return _finite(value, what, nan)
        if isinstance(value, str):
            return _short(value, what)
        if isinstance(value, np.ndarray | dict | list | tuple | bytes):
            return self._many(value, what, nan)
        return value.item() if isinstance(value, np.generic) else value

    def _many(self, value: Any, what: str, nan: Any) -> Any:
        if isinstance(value, np.ndarray):
            return self._numbers(value, what, nan)
        if isinstance(value, dict):
            return {name: self._any(inner, f"{what}.{name}", nan) for name, inner in value.items()}
        self._bound(len(value), what)
        return [self._any(one, what, nan) for one in value]

    def _numbers(self, array: Any, what: str, nan: Any) -> Any:
        self._bound(array.size, what)
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            return [_finite(number, what, nan) for number in array.tolist()]
        return array.tolist()

    def _bound(self, size: int, what: str) -> None:
        if size > self._most:
            raise TooLarge(
                f"{what} holds {size} elements, more than {self._most} (most_elements); choose some of them, "
                "or say large_arrays: true"
            )


def _finite(value: Any, what: str, nan: Any) -> Any:
    if math.isfinite(value):
        return float(value)
    if nan is _ABSENT:
        raise NotANumber(f"{what} is {value}, which JSON cannot say; `nan` tells what to write instead")
    return nan


def _short(value: str, what: str) -> str:
    if len(value) > LONGEST_TEXT:
        raise TooLarge(f"{what} is text of {len(value)} characters, more than {LONGEST_TEXT}")
    return value


def absent() -> Any:
    """Return what says that nothing stands for NaN."""
    return _ABSENT
