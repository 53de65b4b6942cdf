"""Compiles conversions of values: units, mapped values and rounding.

A conversion of units is a factor and an offset. That holds for all units of pint except logarithmic ones,
which are refused. `yaw -> quaternion` and `quaternion -> yaw` are between forms of a rotation.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

from handover.errors import HandoverError
from handover_ros.mapping.values import Conversion
from handover_ros.rules.message_schema import InvalidRule

Convert = Callable[[Any], Any]

QUATERNION = "geometry_msgs/msg/Quaternion"
YAW_TO_QUATERNION = ("yaw", "quaternion")
QUATERNION_TO_YAW = ("quaternion", "yaw")
_NORM_TOLERANCE = 0.01


class UnmappedValue(HandoverError):
    """`values` does not contain a value, and there is no `otherwise`."""


class NotNumeric(HandoverError):
    """A value to compute with is not a number."""


def compiled(conversion: Conversion) -> Convert | None:
    """Return the function for `conversion`; None if it changes nothing. Raises `InvalidRule`."""
    if conversion.values is not None:
        return _lookup(conversion)
    if conversion.units == YAW_TO_QUATERNION:
        return _quaternion
    steps: list[Convert] = []
    if conversion.units is not None and conversion.units != QUATERNION_TO_YAW:
        factor, offset = affine(*conversion.units)
        steps.append(lambda number: number * factor + offset)
    if (digits := conversion.round) is not None:
        steps.append(lambda number: round(number, digits) if math.isfinite(number) else number)
    if not steps:
        return _yaw if conversion.units == QUATERNION_TO_YAW else None

    def convert(value: Any) -> Any:
        if conversion.units == QUATERNION_TO_YAW:
            value = _yaw(value)
        elif isinstance(value, bool) or not isinstance(value, int | float):
            if isinstance(value, list):
                return [convert(element) for element in value]
            raise NotNumeric(f"{value!r:.80} is not a number; only numbers are converted and rounded")
        for step in steps:
            value = step(value)
        return value

    return convert


def _quaternion(yaw: Any) -> dict[str, float]:
    """Return the rotation by `yaw` rad about the vertical axis, counter-clockwise."""
    if isinstance(yaw, bool) or not isinstance(yaw, int | float) or not math.isfinite(yaw):
        raise NotNumeric(f"{yaw!r:.80} is no angle; a yaw is a finite number of rad, counter-clockwise")
    return {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}


def _yaw(quaternion: Any) -> float:
    """Return the angle about the vertical axis, in rad from -pi to pi."""
    try:
        x, y, z, w = (float(quaternion[name]) for name in "xyzw")
    except (KeyError, TypeError, ValueError):
        raise NotNumeric(f"{quaternion!r:.80} is no quaternion with x, y, z and w") from None
    if not abs(math.hypot(x, y, z, w) - 1.0) <= _NORM_TOLERANCE:
        raise NotNumeric(f"{quaternion!r:.80} is no rotation: x² + y² + z² + w² must be 1")
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


@cache
def affine(unit: str, wanted: str) -> tuple[float, float]:
    """Return factor and offset of the conversion between two units. Raises `InvalidRule`."""
    import pint  # noqa: PLC0415 - reading its units takes a while, and few mappings convert

    registry = _registry()
    try:
        at_0, at_1, at_2 = (
            float(registry.Quantity(number, unit).to(wanted).magnitude) for number in (0.0, 1.0, 2.0)
        )
    except pint.DimensionalityError as error:
        raise InvalidRule(f'"{unit}" cannot be converted to "{wanted}": {error}') from None
    except (pint.UndefinedUnitError, pint.PintError, AttributeError, ValueError, TypeError) as error:
        raise InvalidRule(f'"{unit} -> {wanted}" has a unit that pint does not know: {error}') from None
    except (ZeroDivisionError, OverflowError, ArithmeticError):
        at_0, at_1, at_2 = math.inf, 0.0, 0.0
    factor = at_1 - at_0
    if not math.isclose(at_2, at_0 + 2 * factor, rel_tol=1e-9, abs_tol=1e-12) or not math.isfinite(at_2):
        raise InvalidRule(f'"{unit} -> {wanted}" is not a factor with an offset; convert in the sender')
    return factor, at_0


@cache
def _registry() -> Any:
    import pint  # noqa: PLC0415

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


def _lookup(conversion: Conversion) -> Convert:
    values, otherwise = dict(conversion.values or {}), conversion.otherwise
    has_otherwise = "otherwise" in conversion.model_fields_set
    names = ", ".join(map(repr, values))

    def look_up(value: Any) -> Any:
        try:
            return values[value]
        except (KeyError, TypeError):
            if has_otherwise:
                return otherwise
            raise UnmappedValue(
                f"{value!r:.80} is not among the `values` {names:.200}; add it, or add `otherwise`"
            ) from None

    return look_up
