"""Personal baselines: heart rate at rest and at most, by age or by a measured protocol.

By age: maximum 208 - 0.7 age (Tanaka, Monahan and Seals 2001, J Am Coll Cardiol 37:153), rest 70 bpm.
At rest, measured: the lowest mean of one minute in five minutes of sitting still. Maximum, measured: the
highest mean of ten seconds in a graded test that somebody qualified supervises; it never lies below the one
that was measured before.

Exertion is the share of the heart rate reserve (Karvonen): (rate - rest) / (maximum - rest).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from handover_body.model.cardiovascular import maximum_of_age
from handover_body.model.features import Feature, FeatureName, Status

DEFAULT_REST_BPM: Final = 70.0
DEFAULT_AGE: Final = 40
MIN_RESERVE_BPM: Final = 30.0
REST_PROTOCOL_S: Final = 300.0
REST_WINDOW_S: Final = 60.0
MAXIMUM_WINDOW_S: Final = 10.0
MIN_COVERAGE: Final = 0.8
"""The share of a window that valid values must cover."""


class NoBaseline(ValueError):
    """A measurement from which no baseline follows; the text says why and what to do."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """Heart rates of a person in bpm, and how they were found: `default`, `age`, `measured` or `given`."""

    rest_bpm: float = DEFAULT_REST_BPM
    maximum_bpm: float = maximum_of_age(DEFAULT_AGE)
    method: str = "default"

    def __post_init__(self) -> None:
        is_in_range = 30 <= self.rest_bpm <= 120 and 100 <= self.maximum_bpm <= 220
        if not is_in_range or self.maximum_bpm - self.rest_bpm < MIN_RESERVE_BPM:
            raise NoBaseline(
                f"a heart rate at rest of {self.rest_bpm:.0f} and a maximum of {self.maximum_bpm:.0f} bpm "
                f"cannot be: rest is 30 to 120, the maximum 100 to 220 and at least {MIN_RESERVE_BPM:.0f} "
                "above rest; measure again or give both"
            )

    def exertion(self, heart_rate_bpm: float) -> float:
        """Return the share of the heart rate reserve, 0 to 1."""
        share = (heart_rate_bpm - self.rest_bpm) / (self.maximum_bpm - self.rest_bpm)
        return min(max(share, 0.0), 1.0)

    def at_exertion(self, share: float) -> float:
        """Return the heart rate in bpm at a share of the reserve."""
        return self.rest_bpm + share * (self.maximum_bpm - self.rest_bpm)


def by_age(age_years: float) -> Baseline:
    """Return the baseline of an age in years."""
    if not (math.isfinite(age_years) and 14 <= age_years <= 100):
        raise NoBaseline(f"the age {age_years} is not in 14 to 100 years; give the heart rates instead")
    return Baseline(DEFAULT_REST_BPM, maximum_of_age(age_years), "age")


def measured_rest_bpm(values: Sequence[Feature]) -> float:
    """Return the heart rate at rest from the values of a person who sat still for five minutes.

    Raises `NoBaseline` if they are too few.
    """
    means = _window_means(values, REST_WINDOW_S)
    usable = sorted((feature for feature in values if _is_usable(feature)), key=lambda feature: feature.at_s)
    if not usable or usable[-1].at_s - usable[0].at_s < REST_PROTOCOL_S * MIN_COVERAGE or not means:
        raise NoBaseline(
            f"the heart rate at rest needs {REST_PROTOCOL_S:.0f} s of valid values in {MIN_COVERAGE:.0%} of "
            "the time; sit still, check the sensor, and measure again"
        )
    return min(means)


def measured_maximum_bpm(values: Sequence[Feature]) -> float:
    """Return the highest mean of ten seconds. Raises `NoBaseline` if there is none."""
    means = _window_means(values, MAXIMUM_WINDOW_S)
    if not means:
        raise NoBaseline(
            f"the maximum needs {MAXIMUM_WINDOW_S:.0f} s of valid values at least; check the sensor"
        )
    return max(means)


def _is_usable(feature: Feature) -> bool:
    return (
        feature.name is FeatureName.HEART_RATE
        and feature.status is Status.VALID
        and not isinstance(feature.value, str)
    )


def _window_means(values: Sequence[Feature], window_s: float) -> list[float]:
    """Return the means of all windows that end with a value and that values cover well enough."""
    usable = sorted((feature for feature in values if _is_usable(feature)), key=lambda feature: feature.at_s)
    means: list[float] = []
    first, total, covered_s = 0, 0.0, 0.0
    for index, value in enumerate(usable):
        total += float(value.value)
        covered_s += max(value.period_s, 0.0)
        while usable[first].at_s <= value.at_s - window_s:
            total -= float(usable[first].value)
            covered_s -= max(usable[first].period_s, 0.0)
            first += 1
        if covered_s >= MIN_COVERAGE * window_s:
            means.append(total / (index - first + 1))
    return means
