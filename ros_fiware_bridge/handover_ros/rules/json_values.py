"""Converts ROS values to JSON: no NumPy types, no NaN, no integer that a broker changes, no large arrays."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from handover.errors import HandoverError
from handover_datamodels.numbers import portable
from handover_ros.rules.message_schema import Definitions, InvalidRule, PathTarget
from handover_ros.types.definition import FLOATS, TEXTS, FieldType, Many

ToJson = Callable[[Any], Any]

MAX_TEXT_LENGTH = 65_536
_ABSENT = object()
_WIDE = (np.uint32, np.int64, np.uint64)
"""Types with integers that not every broker keeps."""


class NotANumber(HandoverError):
    """NaN or infinity, which JSON cannot represent."""


class TooLarge(HandoverError):
    """An array or a text over the limit of the rule."""


class JsonValues:
    """Converts the values of one rule to JSON, within the limits of the rule."""

    def __init__(self, definitions: Definitions, max_elements: int, *, large_arrays: bool) -> None:
        self._definitions = definitions
        self._max_elements = math.inf if large_arrays else max_elements
        self._large = large_arrays

    def maker(self, target: PathTarget, what: str, nan: Any = _ABSENT) -> ToJson:
        """Return the function that converts values of the type `target`; `what` names the value in errors.

        `nan` replaces a number that JSON cannot represent, if it is given. Raises `InvalidRule` if every such
        value would be over the limit.
        """
        if target.type is None:
            return lambda value: self._any(value, what, nan)
        self._refuse_large(target.type, what)
        kind = target.type
        if kind.many is Many.ONE and not kind.is_message:
            if kind.base in FLOATS:
                return lambda value: _finite(value, what, nan)
            if kind.base in TEXTS:
                return lambda value: _short(value, what)
            return _plain
        return lambda value: self._any(value, what, nan)

    def _refuse_large(self, kind: FieldType, what: str, inside: str = "") -> None:
        if self._large:
            return
        named = f"{what}{inside}"
        if kind.is_octets and not 0 < kind.size <= self._max_elements:
            raise InvalidRule(
                f"{named} is {kind}, bytes without a bound (an image, a point cloud): a context broker "
                "stores each version and sends it to every subscriber; map fields that describe it, or set "
                "large_arrays: true"
            )
        if kind.many is Many.FIXED and kind.size > self._max_elements:
            raise InvalidRule(
                f"{named} holds {kind.size} elements, more than {self._max_elements} (max_elements); "
                "choose some of them, or set large_arrays: true"
            )
        if kind.is_message:
            for field in self._definitions.definition(kind.base).fields:
                self._refuse_large(field.type, what, f"{inside}.{field.name}")

    def _any(self, value: Any, what: str, nan: Any) -> Any:
        if isinstance(value, float):
            return _finite(value, what, nan)
        if isinstance(value, str):
            return _short(value, what)
        if isinstance(value, np.ndarray | dict | list | tuple | bytes):
            return self._many(value, what, nan)
        return _plain(value)

    def _many(self, value: Any, what: str, nan: Any) -> Any:
        if isinstance(value, np.ndarray):
            return self._numbers(value, what, nan)
        if isinstance(value, dict):
            return {name: self._any(inner, f"{what}.{name}", nan) for name, inner in value.items()}
        self._bound(len(value), what)
        return [self._any(element, what, nan) for element in value]

    def _numbers(self, array: Any, what: str, nan: Any) -> Any:
        self._bound(array.size, what)
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            return [_finite(number, what, nan) for number in array.tolist()]
        return portable(array.tolist()) if array.dtype in _WIDE else array.tolist()

    def _bound(self, size: int, what: str) -> None:
        if size > self._max_elements:
            raise TooLarge(
                f"{what} holds {size} elements, more than {self._max_elements} (max_elements); choose some, "
                "or set large_arrays: true"
            )


def _plain(value: Any) -> Any:
    return portable(value.item() if isinstance(value, np.generic) else value)


def _finite(value: Any, what: str, nan: Any) -> Any:
    if math.isfinite(value):
        return float(value)
    if nan is _ABSENT:
        raise NotANumber(
            f"{what} is {value}, which JSON cannot represent; set `nan` to the value to write instead"
        )
    return nan


def _short(value: str, what: str) -> str:
    if len(value) > MAX_TEXT_LENGTH:
        raise TooLarge(f"{what} is text of {len(value)} characters, more than {MAX_TEXT_LENGTH}")
    return value


def absent() -> Any:
    """Return the marker for a missing `nan`."""
    return _ABSENT
