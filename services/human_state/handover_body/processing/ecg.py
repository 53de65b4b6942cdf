"""ECG to heart rate, variability and breathing: beats of the first channel, then the rhythm of the beats.

A heart rate is valid only while a second estimate, which does not use the beats, agrees (`envelope`).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SensorFault, SensorReport, SignalInfo
from handover_body.processing.beats import Beat, BeatDetector
from handover_body.processing.breathing import BeatBreathing
from handover_body.processing.envelope import EnvelopeRate
from handover_body.processing.rhythm import Rhythm

METHOD: Final = "ecg-2"
"""The version of the algorithm; it changes when values change."""
BLOCK_S: Final = 0.5
SHORT_FAULTS: Final = frozenset(
    {SensorFault.GAP, SensorFault.RATE, SensorFault.CLOCK_JUMP, SensorFault.SATURATED}
)
"""Faults after which the electrodes still sit where they sat: the learned shape of a beat stays."""
RELEARN_BELOW: Final = 0.3
RELEARN_AFTER_S: Final = 15.0
RELEARN_UNCONFIRMED_S: Final = 6.0
"""So long a rate without confirmation comes from a wrong shape."""


class EcgProcessor:
    """An ECG of 50 to 2,000 Hz, any unit and polarity, one lead: the first channel."""

    def __init__(self, info: SignalInfo) -> None:
        if info.rate_hz is None:
            raise ValueError("an ECG needs a rate; the driver must give rate_hz")
        self._rate_hz: Final = info.rate_hz
        self._detector: Final = BeatDetector(info.rate_hz)
        self._rhythm: Final = Rhythm(METHOD)
        self._envelope: Final = EnvelopeRate(info.rate_hz)
        self._breathing: Final = BeatBreathing(METHOD)
        self._pending: list[Samples] = []
        self._waiting = 0
        self._fed = 0
        self._poor_s = 0.0
        self._unconfirmed_s = 0.0

    @property
    def rhythm(self) -> Rhythm:
        """The intervals of the last 300 s."""
        return self._rhythm

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take samples; blocks of 0.5 s at least are analysed, so that small packets cost no more."""
        self._pending.append(samples)
        self._waiting += len(samples.values)
        if self._waiting < BLOCK_S * self._rate_hz - 1:  # a rate may be a measured one
            return []
        block = np.concatenate([part.values[:, 0] for part in self._pending])
        quality = min(part.quality for part in self._pending)
        end_s = samples.end_s
        self._pending.clear()
        self._fed += self._waiting
        self._waiting = 0
        self._envelope.feed(block, end_s)
        beats = self._detector.feed(block)
        for beat in beats:
            at_s = end_s - (self._fed - 1 - beat.position) / self._rate_hz
            self._rhythm.add_beat(at_s, beat.quality * quality, is_usual_shape=beat.is_usual_shape)
            self._breathing.add_beat(at_s, beat.height, beat.quality * quality)
        block_s = len(block) / self._rate_hz
        features = self._rhythm.features(samples.source, end_s, max(1.0, block_s), self._envelope.rates_bpm)
        features += self._breathing.features(samples.source, end_s)
        self._relearn_if_poor(beats, features, block_s)
        return features

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Forget the signal before a fault."""
        if report.fault is not None or report.has_contact is False:
            self._detector.reset(keep_shape=report.fault in SHORT_FAULTS)
            self._rhythm.reset()
            self._envelope.reset()
            self._breathing.reset()
            self._pending.clear()
            self._waiting = self._fed = 0
            self._poor_s = self._unconfirmed_s = 0.0
        return []

    def _relearn_if_poor(self, beats: list[Beat], features: list[Feature], block_s: float) -> None:
        """Learn the shape again when nothing matches it, or when what matches it is not the heart."""
        is_good = any(beat.quality >= RELEARN_BELOW for beat in beats)
        self._poor_s = 0.0 if is_good else self._poor_s + block_s
        for feature in features:
            if feature.name is FeatureName.HEART_RATE:
                is_confirmed = feature.status is Status.VALID
                self._unconfirmed_s = 0.0 if is_confirmed else self._unconfirmed_s + block_s
        if self._poor_s > RELEARN_AFTER_S or self._unconfirmed_s > RELEARN_UNCONFIRMED_S:
            self._detector.reset()
            self._rhythm.reset()
            self._breathing.reset()
            self._fed = 0
            self._poor_s = self._unconfirmed_s = 0.0
