"""Inter-beat intervals that a strap computes: their variability, by the rules of `rhythm`."""

from collections.abc import Sequence
from typing import Final

from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import Samples, SensorReport, SignalInfo
from handover_body.processing.rhythm import Rhythm

SECONDS: Final = {"C26": 0.001, "SEC": 1.0}


class IntervalProcessor:
    """Intervals in ms (C26) or s (SEC), each at the time of the beat that ends it."""

    def __init__(self, info: SignalInfo) -> None:
        if info.unit not in SECONDS:
            raise ValueError(f"inter-beat intervals come in C26 (ms) or SEC, not in {info.unit}")
        self._factor: Final = SECONDS[info.unit]
        self._rhythm: Final = Rhythm("rr-1")

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take intervals; return the features that are due. The device's own heart rate is another signal."""
        for at_s, value in zip(samples.sample_times_s(), samples.values[:, 0], strict=True):
            self._rhythm.add_interval(float(at_s), float(value) * self._factor, samples.quality)
        features = self._rhythm.features(samples.source, samples.end_s, 1.0)
        return [feature for feature in features if feature.name is not FeatureName.HEART_RATE]

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Forget the intervals before a fault."""
        if report.fault is not None or report.has_contact is False:
            self._rhythm.reset()
        return []
