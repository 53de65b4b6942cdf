"""Thresholds: a finger is straight above the upper value of its sensor and bent below the lower one.

The sensor of an inverted finger falls when the finger is stretched: it is straight below the lower value and
bent above the upper one.

Hands differ in span and gloves in gain, so thresholds belong to a glove on a person.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from handover.messages import message

FINGERS = ("thumb", "index", "middle", "ring", "little")


class WrongThreshold(ValueError):
    """A threshold is invalid; the message names the finger, the rule and the remedy."""


@dataclass(frozen=True, slots=True)
class Threshold:
    """A finger is straight above `upper` and bent below `lower`, in raw sensor units.

    With `inverted` it is bent above `upper` and straight below `lower`.
    """

    upper: float
    lower: float
    inverted: bool = False

    @property
    def straight(self) -> float:
        """The bound beyond which the finger is straight."""
        return self.lower if self.inverted else self.upper

    @property
    def bent(self) -> float:
        """The bound beyond which the finger is bent."""
        return self.upper if self.inverted else self.lower

    def straight_margin(self, value: float) -> float:
        """Return how far `value` is beyond the bound of straight; negative if it is not straight."""
        return self.lower - value if self.inverted else value - self.upper

    def bent_margin(self, value: float) -> float:
        """Return how far `value` is beyond the bound of bent; negative if it is not bent."""
        return value - self.upper if self.inverted else self.lower - value


@dataclass(frozen=True, slots=True)
class Thresholds:
    """The thresholds of the five fingers, thumb first."""

    fingers: tuple[Threshold, ...]

    def with_changes(self, changes: Mapping[str, Mapping[str, float]]) -> Self:
        """Return these thresholds with `changes`: `{finger: {"upper": …, "lower": …, "inverted": …}}`, each
        may be missing.

        Raises `WrongThreshold` for an unknown finger or bound, a value that is not finite, or lower above
        upper.
        """
        changed = dict(zip(FINGERS, self.fingers, strict=True))
        for finger, bounds in changes.items():
            if finger not in changed:
                raise WrongThreshold(
                    message(
                        "glove.unknown_finger",
                        'unknown finger "{finger}"; the fingers are {known}',
                        finger=finger,
                        known=", ".join(FINGERS),
                    )
                )
            unknown = set(bounds) - {"upper", "lower", "inverted"}
            if unknown:
                raise WrongThreshold(
                    message(
                        "glove.unknown_bound",
                        '{finger}: unknown bound "{unknown}"; give "upper" and "lower"',
                        finger=finger,
                        unknown=min(unknown),
                    )
                )
            before = changed[finger]
            changed[finger] = checked(
                finger,
                bounds.get("upper", before.upper),
                bounds.get("lower", before.lower),
                inverted=bool(bounds.get("inverted", before.inverted)),
            )
        return type(self)(tuple(changed.values()))

    def as_dict(self) -> dict[str, dict[str, float]]:
        """Return `{finger: {"upper": …, "lower": …}}`, with `"inverted": True` for an inverted finger."""
        return {
            finger: {"upper": threshold.upper, "lower": threshold.lower}
            | ({"inverted": True} if threshold.inverted else {})
            for finger, threshold in zip(FINGERS, self.fingers, strict=True)
        }


def checked(finger: str, upper: float, lower: float, *, inverted: bool = False) -> Threshold:
    """Return the threshold of `finger`; raise `WrongThreshold` if it is invalid."""
    if not (math.isfinite(upper) and math.isfinite(lower)):
        raise WrongThreshold(
            message(
                "glove.thresholds_not_finite",
                "{finger}: thresholds are finite numbers, not {upper} and {lower}",
                finger=finger,
                upper=upper,
                lower=lower,
            )
        )
    if lower > upper:
        raise WrongThreshold(
            message(
                "glove.thresholds_crossed",
                "{finger}: the lower threshold {lower} is above the upper one {upper}; a finger "
                "is bent below lower and straight above upper, so exchange or correct them",
                finger=finger,
                lower=f"{lower:g}",
                upper=f"{upper:g}",
            )
        )
    return Threshold(upper, lower, inverted)


M2O2P_THRESHOLDS = Thresholds(
    (
        Threshold(1000, 800),
        Threshold(1600, 850),
        Threshold(1600, 500),
        Threshold(1800, 800),
        Threshold(1900, 900),
    )
)
"""The thresholds that M2O2P has for a CaptoGlove: the default of a glove without calibration."""
