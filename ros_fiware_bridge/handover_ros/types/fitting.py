"""Fits dicts to message definitions, with errors that name the field.

Missing fields take their defaults. Numbers are not rounded, truncated or wrapped: 300 does not fit uint8.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handover_ros.errors import BadMessage
from handover_ros.types.definition import FLOATS, INTEGER_RANGES, Definition, Field, FieldType, Many

Fit = Callable[[Any], Any]
_FLOAT32_MAX = float(np.finfo(np.float32).max)


class Unfit(Exception):
    """A value does not fit; the path to it grows while the error propagates to the whole message."""

    def __init__(self, rule: str, path: str = "") -> None:
        super().__init__(rule)
        self.rule = rule
        self.path = path

    def under(self, name: str) -> "Unfit":
        """Return the same error, seen from the enclosing field."""
        dot = "" if not self.path or self.path.startswith("[") else "."
        return Unfit(self.rule, f"{name}{dot}{self.path}")


class Fitting:
    """Fits dicts to the definitions of one store; the results have the attributes that the codec reads."""

    def __init__(
        self, definition_of: Callable[[str], Definition], attribute_of: Callable[[str], str]
    ) -> None:
        self._definition_of = definition_of
        self._attribute_of = attribute_of
        self._fits: dict[str, Fit] = {}
        self._defaults: dict[str, Any] = {}

    def message(self, type_name: str, message: Mapping[str, Any]) -> Any:
        """Return `message` for the codec.

        Raises:
            BadMessage: the error names the field path, the rule and the value.
        """
        try:
            return self._message_fit(type_name)(message)
        except Unfit as error:
            where = f"{type_name}, {error.path}" if error.path else type_name
            raise BadMessage(f"{where}: {error.rule}") from None

    def _message_fit(self, type_name: str) -> Fit:
        cached = self._fits.get(type_name)
        if cached is not None:
            return cached
        definition = self._definition_of(type_name)
        attributes = [self._attribute_of(field.name) for field in definition.fields]
        fits = {field.name: self._field_fit(field.type) for field in definition.fields}
        parts = list(zip(definition.fields, attributes, fits.values(), strict=True))
        defaults = {
            name: self._default(field) for field, name in zip(definition.fields, attributes, strict=True)
        }
        empty = SimpleNamespace(**defaults, structure_needs_at_least_one_member=0)
        self._defaults[type_name] = empty

        def fit(value: Any) -> Any:
            if not isinstance(value, Mapping):
                raise Unfit(f"{_shown(value)} is not a message of {type_name}; use an object with its fields")
            taken = 0
            made = SimpleNamespace(structure_needs_at_least_one_member=0)
            slots = made.__dict__
            for field, attribute, inner in parts:
                name = field.name
                if name in value:
                    taken += 1
                    try:
                        slots[attribute] = inner(value[name])
                    except Unfit as error:
                        raise error.under(name) from None
                else:
                    slots[attribute] = defaults[attribute]
            if taken != len(value):
                extra = next(name for name in value if name not in fits)
                raise Unfit(f'{type_name} has no field "{extra}"; {definition.suggest_field(str(extra))}')
            return made

        self._fits[type_name] = fit
        return fit

    def _default(self, field: Field) -> Any:
        kind = field.type
        if field.default is not None:
            try:
                return self._field_fit(kind)(field.default)
            except Unfit as error:
                raise BadMessage(f"the default of {field.name} does not fit: {error.rule}") from None
        if kind.many is not Many.ONE:
            if kind.is_octets:
                return np.zeros(kind.size if kind.many is Many.FIXED else 0, np.uint8)
            if kind.is_number_array:
                return np.zeros(kind.size if kind.many is Many.FIXED else 0, kind.base)
            element = self._empty(kind.item)
            return [element] * kind.size if kind.many is Many.FIXED else []
        return self._empty(kind)

    def _empty(self, kind: FieldType) -> Any:
        if kind.is_message:
            self._message_fit(kind.base)
            return self._defaults[kind.base]
        if kind.base == "string":
            return ""
        if kind.base == "wstring":
            return _units("", 0)
        if kind.base == "bool":
            return False
        return 0.0 if kind.base in FLOATS else 0

    def _field_fit(self, kind: FieldType) -> Fit:
        if kind.many is Many.ONE:
            return self._one_fit(kind)
        inner = self._one_fit(kind.item)
        if kind.is_octets:
            return lambda value: _counted(_octets(value, inner), kind)
        if kind.is_number_array:
            return _numbers_fit(kind, inner)

        def fit(value: Any) -> list[Any]:
            return [_at(index, inner, item) for index, item in enumerate(_counted(_items(value, kind), kind))]

        return fit

    def _one_fit(self, kind: FieldType) -> Fit:
        if kind.is_message:
            return self._message_fit(kind.base)
        if kind.base == "string":
            return lambda value: _text(value, kind.text_bound)
        if kind.base == "wstring":
            return lambda value: _units(value, kind.text_bound)
        if kind.base == "bool":
            return _bool
        if kind.base in FLOATS:
            return _float32 if kind.base == "float32" else _float64
        low, high = INTEGER_RANGES[kind.base]
        return lambda value: _integer(value, kind.base, low, high)


def _at(index: int, inner: Fit, item: Any) -> Any:
    try:
        return inner(item)
    except Unfit as error:
        raise error.under(f"[{index}]") from None


def _items(value: Any, kind: FieldType) -> list[Any]:
    if isinstance(value, (str, bytes, Mapping)) or not isinstance(value, Iterable):
        raise Unfit(f"{_shown(value)} is not a list; {kind} is expected")
    return list(value)


def _counted(items: Any, kind: FieldType) -> Any:
    count = len(items)
    if kind.many is Many.FIXED and count != kind.size:
        raise Unfit(f"{count} elements do not fit {kind}; exactly {kind.size} are expected")
    if kind.many is Many.SEQUENCE and kind.size and count > kind.size:
        raise Unfit(f"{count} elements do not fit {kind}; at most {kind.size} are allowed")
    return items


def _octets(value: Any, inner: Fit) -> NDArray[np.uint8]:
    if isinstance(value, (bytes, bytearray, memoryview)):
        return np.frombuffer(value, np.uint8)
    if isinstance(value, np.ndarray) and value.dtype == np.uint8 and value.ndim == 1:
        return np.ascontiguousarray(value)
    items = _items(value, FieldType("uint8", Many.SEQUENCE))
    return np.array([_at(index, inner, item) for index, item in enumerate(items)], np.uint8)


def _numbers_fit(kind: FieldType, inner: Fit) -> Fit:
    dtype = np.dtype(kind.base)

    def fit(value: Any) -> NDArray[Any]:
        if isinstance(value, np.ndarray) and value.dtype == dtype and value.ndim == 1:
            return np.ascontiguousarray(_counted(value, kind))
        items = _counted(_items(value, kind), kind)
        quick = _quick(items, dtype)
        if quick is not None:
            return quick
        return np.array([_at(index, inner, item) for index, item in enumerate(items)], dtype)

    return fit


def _quick(items: list[Any], dtype: np.dtype[Any]) -> NDArray[Any] | None:
    """Return the array if all `items` fit for certain; None means that each must be checked."""
    try:
        raw = np.asarray(items)
    except (ValueError, OverflowError):
        return None
    if raw.ndim != 1:
        return None
    if not raw.size:
        return raw.astype(dtype)
    if dtype.kind == "b":
        sure = raw.dtype.kind == "b"
    elif dtype.kind == "f":
        sure = raw.dtype.kind in "fiu" and not (
            dtype.itemsize == 4 and np.any(np.abs(raw[np.isfinite(raw)]) > _FLOAT32_MAX)
        )
    else:
        limits = np.iinfo(dtype)
        sure = raw.dtype.kind in "iu" and int(raw.min()) >= limits.min and int(raw.max()) <= limits.max
    return raw.astype(dtype) if sure else None


def _text(value: Any, bound: int) -> str:
    if not isinstance(value, str):
        raise Unfit(f"{_shown(value)} is not text")
    if "\0" in value:
        raise Unfit("text with a NUL character is not supported")
    try:
        size = len(value.encode())
    except UnicodeEncodeError:
        raise Unfit("text with half a surrogate pair is not supported") from None
    if bound and size > bound:
        raise Unfit(f"{size} bytes of text do not fit string<={bound}")
    return value


def _units(value: Any, bound: int) -> SimpleNamespace:
    """Return a text as the `units` of UTF-16 of a wstring."""
    units = np.frombuffer(_text(value, 0).encode("utf-16-le"), "<u2").astype(np.uint32)
    if bound and len(units) > bound:
        raise Unfit(f"{len(units)} units of UTF-16 do not fit wstring<={bound}")
    return SimpleNamespace(units=units)


def _bool(value: Any) -> bool:
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    raise Unfit(f"{_shown(value)} is not true or false")


def _float64(value: Any) -> float:
    if type(value) is float:
        return value
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise Unfit(f"{_shown(value)} is not a number")
    try:
        return float(value)
    except OverflowError:
        raise Unfit(f"{_shown(value)} is out of the range of float64") from None


def _float32(value: Any) -> float:
    number = _float64(value)
    if math.isfinite(number) and abs(number) > _FLOAT32_MAX:
        raise Unfit(f"{number} is out of the range of float32, which ends at {_FLOAT32_MAX:.7g}")
    return number


def _integer(value: Any, base: str, low: int, high: int) -> int:
    if isinstance(value, (float, np.floating)):
        if not float(value).is_integer():
            raise Unfit(f"{value} is not a whole number; {base} is expected")
        value = int(value)
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise Unfit(f"{_shown(value)} is not a whole number; {base} is expected")
    if not low <= value <= high:
        raise Unfit(f"{value} does not fit {base}, whose range is {low} to {high}")
    return int(value)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
