"""The state of one person: the features of all sensors, fused by quality. Pure; the time is an argument.

Each sensor has a value of each feature with a status: valid, stale (older than 3 s and three periods) or
implausible. The fused value is the mean of the valid ones, weighted by quality; of texts (activity, posture)
the one with the best quality counts. Two heart rates that are more than 15 bpm apart are not averaged: the
higher one holds, since it restricts more.

A fault, a lost contact or a lost link of a sensor ends the series of all its values.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

from handover_body.fusion.plausibility import Series, stale_after_s
from handover_body.model.features import MIN_QUALITY, Feature, FeatureName, Status
from handover_body.model.signals import LinkState, SensorReport

MAX_APART_BPM: Final = 15.0
MAX_SOURCES: Final = 32
"""Sensors of one person."""
_ENDING: Final = frozenset({LinkState.LOST, LinkState.FAULT, LinkState.SEARCHING, LinkState.PAIRING})


@dataclass(frozen=True, slots=True)
class FusedValue:
    """One feature of a person. `sensors` are the values of the sensors, the best quality first."""

    name: FeatureName
    value: float | str
    at_s: float
    quality: float
    status: Status
    method: str
    sensors: tuple[Feature, ...]
    disagree: bool = False
    """Whether two valid heart rates are more than 15 bpm apart."""
    is_calibrated: bool = True
    period_s: float = 1.0


@dataclass(slots=True)
class _Kept:
    series: Series
    shown: Feature | None = None
    """The last value that counted, or the implausible one after it."""
    counted: Feature | None = None
    """The last value that counted."""
    is_faulty: bool = False


class PersonState:
    """The present values of one person. Memory is bounded by sensors and kinds of features."""

    def __init__(self) -> None:
        self._kept: dict[tuple[FeatureName, str], _Kept] = {}

    @property
    def sources(self) -> set[str]:
        """Return the sensors that have sent a value."""
        return {source for _, source in self._kept}

    def take(self, feature: Feature, now_s: float) -> Feature | None:
        """Take a value; return it with its status if it changes what is shown.

        A time ahead of `now_s` counts as now, so that a clock ahead cannot keep a value fresh.
        """
        if feature.at_s > now_s:
            feature = replace(feature, at_s=now_s)
        key = feature.name, feature.source
        if key not in self._kept and len(self.sources | {feature.source}) > MAX_SOURCES:
            return None
        kept = self._kept.setdefault(key, _Kept(Series()))
        if _is_worse_method(feature, kept, now_s):
            return None
        kept.series, accepted = kept.series.take(feature)
        if accepted is None:
            return None
        kept.shown = _shown(accepted, kept.shown)
        kept.is_faulty = accepted.status is not Status.VALID
        if accepted.status is Status.VALID:
            kept.counted = accepted
        return accepted

    def report(self, report: SensorReport) -> None:
        """Take a fault, a lost contact or a lost link of a sensor: no value continues after it.

        What a fault of one signal ends comes as features, from whatever analyses the signal.
        """
        if report.kind is not None:
            return
        if report.fault is None and report.has_contact is not False and report.link not in _ENDING:
            return
        for (_, source), kept in self._kept.items():
            if source == report.source:
                kept.series = kept.series.broken()
                kept.is_faulty = True

    def forget(self, source: str) -> None:
        """Delete the values of a sensor that was taken away from the person."""
        for key in [key for key in self._kept if key[1] == source]:
            del self._kept[key]

    def sensors(self, name: FeatureName, now_s: float) -> list[Feature]:
        """Return the value of each sensor with its present status."""
        fused_values = []
        for (kind, _), kept in self._kept.items():
            if kind is name and kept.shown is not None:
                fused_values.append(_aged(kept, now_s))
        return fused_values

    def has_fault(self, name: FeatureName, now_s: float) -> bool:
        """Return whether a sensor that once counted has no valid value now, or has a fault."""
        return bool(self.faulty_sensors(name, now_s))

    def faulty_sensors(self, name: FeatureName, now_s: float) -> list[str]:
        """Return the sensors that once counted and have no valid value now, or a fault."""
        return sorted(
            source
            for (kind, source), kept in self._kept.items()
            if kind is name
            and kept.counted is not None
            and (kept.is_faulty or _is_stale(kept.counted, now_s))
        )

    def for_limits(self, name: FeatureName, now_s: float) -> FusedValue | None:
        """Return the value that may feed a limit: valid, and of calibrated sensors only."""
        usable = [
            sensor
            for sensor in self.sensors(name, now_s)
            if sensor.status is Status.VALID and sensor.is_calibrated and not isinstance(sensor.value, str)
        ]
        return fused(name, usable) if usable else None

    def values(self, now_s: float) -> list[FusedValue]:
        """Return all features of the person as they are now."""
        names = dict.fromkeys(name for name, _ in self._kept)
        return [value for name in names if (value := self.value(name, now_s)) is not None]

    def value(self, name: FeatureName, now_s: float) -> FusedValue | None:
        """Return one feature as it is now; None if no sensor has a value."""
        sensors = self.sensors(name, now_s)
        return None if not sensors else fused(name, sensors)


def fused(name: FeatureName, sensors: Iterable[Feature]) -> FusedValue:
    """Return the fused value of one feature of at least one sensor."""
    ordered = tuple(sorted(sensors, key=lambda feature: (feature.quality, feature.at_s), reverse=True))
    valid = [feature for feature in ordered if feature.status is Status.VALID]
    if not valid:
        last = max(ordered, key=lambda feature: feature.at_s)
        return FusedValue(
            name,
            last.value,
            last.at_s,
            last.quality,
            last.status,
            last.method,
            ordered,
            is_calibrated=last.is_calibrated,
            period_s=last.period_s,
        )
    numbers = [feature for feature in valid if not isinstance(feature.value, str)]
    if not numbers:
        best = valid[0]
        return _of(name, best.value, [best], ordered)
    values = [float(feature.value) for feature in numbers]
    if name is FeatureName.HEART_RATE and max(values) - min(values) > MAX_APART_BPM:
        highest = max(numbers, key=lambda feature: float(feature.value))
        return replace(_of(name, highest.value, [highest], ordered), disagree=True)
    # the mean lies between the values; bounds take away what rounding adds
    weights = sum(feature.quality for feature in numbers)
    mean = (
        sum(float(feature.value) * feature.quality for feature in numbers) / weights
        if weights > 0
        else values[0]
    )
    return _of(name, min(max(mean, min(values)), max(values)), numbers, ordered)


def _of(
    name: FeatureName, value: float | str, used: list[Feature], sensors: tuple[Feature, ...]
) -> FusedValue:
    return FusedValue(
        name,
        value,
        max(feature.at_s for feature in used),
        max(feature.quality for feature in used),
        Status.VALID,
        ", ".join(dict.fromkeys(feature.method for feature in used if feature.method)),
        sensors,
        is_calibrated=all(feature.is_calibrated for feature in used),
        period_s=min(feature.period_s for feature in used),
    )


def _shown(feature: Feature, before: Feature | None) -> Feature | None:
    """Return what is shown: a value that is no number keeps the one before, which is implausible now."""
    if isinstance(feature.value, str) or math.isfinite(feature.value):
        return feature
    return None if before is None else replace(before, status=feature.status, quality=0.0)


def _is_worse_method(feature: Feature, kept: _Kept, now_s: float) -> bool:
    """Return whether the sensor measures this better in another way: a belt beside the breathing of its ECG.

    A heart rate is never left out: it may restrict more.
    """
    best = kept.series.last
    return (
        feature.name is not FeatureName.HEART_RATE
        and best is not None
        and best.method != feature.method
        and feature.quality < MIN_QUALITY
        and not _is_stale(best, now_s)
    )


def _is_stale(feature: Feature, now_s: float) -> bool:
    return now_s - feature.at_s > stale_after_s(feature.period_s)


def _aged(kept: _Kept, now_s: float) -> Feature:
    assert kept.shown is not None  # noqa: S101 - only asked for values that are shown
    if _is_stale(kept.shown, now_s):
        return replace(kept.shown, status=Status.STALE)
    if kept.is_faulty and kept.shown.status is Status.VALID:
        return replace(kept.shown, status=Status.STALE)  # its sensor has a fault since then
    return kept.shown
