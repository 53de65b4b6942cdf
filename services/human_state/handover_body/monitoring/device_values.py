"""Values that a device computes itself, such as a heart rate, as features."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import Samples, SensorReport, SignalInfo, SignalKind

VALUES: Final[Mapping[SignalKind, FeatureName]] = {
    SignalKind.HEART_RATE: FeatureName.HEART_RATE,
    SignalKind.BREATHING_RATE: FeatureName.BREATHING_RATE,
    SignalKind.SPO2: FeatureName.SPO2,
    SignalKind.SKIN_TEMPERATURE: FeatureName.SKIN_TEMPERATURE,
    SignalKind.MOVEMENT: FeatureName.BODY_MOVEMENT,
    SignalKind.STEPS: FeatureName.STEPS,
}
UNITS: Final[Mapping[SignalKind, frozenset[str]]] = {
    SignalKind.HEART_RATE: frozenset({"BPM"}),
    SignalKind.BREATHING_RATE: frozenset({"C94"}),
    SignalKind.SPO2: frozenset({"P1"}),
    SignalKind.SKIN_TEMPERATURE: frozenset({"CEL"}),
}
"""A signal in another unit is refused: guessing could let a wrong value through."""
INITIAL_PERIOD_S: Final = 1.0
MAX_PERIOD_S: Final = 60.0
PERIOD_WEIGHT: Final = 0.2


class DeviceValues:
    """A processor of one signal: its last value of each packet is a feature."""

    def __init__(self, info: SignalInfo) -> None:
        allowed = UNITS.get(info.kind)
        if allowed is not None and info.unit not in allowed:
            raise ValueError(
                f"a {info.kind} comes in {', '.join(sorted(allowed))}, not in {info.unit or 'no unit'}"
            )
        self._info = info
        self._name = VALUES[info.kind]
        self._period_s = INITIAL_PERIOD_S if info.rate_hz is None else 1 / info.rate_hz
        self._last_s: float | None = None

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Return the newest value; NaN and contact lost give one of quality 0."""
        if len(samples.values) == 0:
            return ()
        value, at_s = float(samples.values[-1, 0]), samples.end_s
        if self._last_s is not None and self._info.rate_hz is None and at_s > self._last_s:
            passed_s = min(at_s - self._last_s, 4 * self._period_s, MAX_PERIOD_S)
            self._period_s += PERIOD_WEIGHT * (passed_s - self._period_s)
        self._last_s = at_s
        is_usable = math.isfinite(value) and samples.has_contact is not False
        return (
            Feature(
                self._name,
                samples.source,
                value,
                at_s,
                samples.quality if is_usable else 0.0,
                method=self._info.method or "device",
                period_s=self._period_s,
                is_calibrated=self._name is not FeatureName.SPO2,
            ),
        )

    def report(self, report: SensorReport) -> Sequence[Feature]:  # noqa: ARG002 - the state ends the series
        """Forget when the last value came."""
        self._last_s = None
        return ()
