"""Features of a person over minutes: apnoea events while asleep, and indices of stress and fatigue.

`PersonAnalysis` takes the features of a person, of all sensors, and returns derived ones. It keeps one
value a second for 10 minutes at most, so its memory is bounded.

Apnoea events (`apnoeaEvent`, a text). `breathingPause`: no breathing for 10 s at least, the rule of the
AASM manual for scoring sleep (Berry et al. 2012, J Clin Sleep Med 8:597). `cyclicHeartRate`: the heart
rate falls by 6 bpm or more below its mean and rises 10 bpm or more above that low within 60 s, as it does
around an apnoea (Guilleminault et al. 1984, Lancet 323:126). Neither is a diagnosis: an event says when
to look.

Stress (0 to 1) combines the heart rate above rest, RMSSD below the person's own rest, and tonic skin
conductance above it, each 0 at rest and 1 at a strong reaction, by the mean of those there are (the
direction of each: Kim et al. 2018, "Stress and heart rate variability", Psychiatry Investig 15:235;
Boucsein 2012). Fatigue (0 to 1) is the accumulated exertion: each minute adds what the Banister impulse
gives (Banister 1991; TRIMP) and recovery halves it every 30 minutes. Both are indices without a
calibration on people: they never feed a limit.
"""

from collections import deque
from collections.abc import Iterable
from typing import Final

import numpy as np

from handover_body.model.features import Feature, FeatureName, Status

HISTORY_S: Final = 600.0
PAUSE_S: Final = 10.0
MAX_PAUSE_S: Final = 120.0
PAUSE_BREATHS_PER_MINUTE: Final = 4.0
DIP_BPM: Final = 6.0
RISE_BPM: Final = 10.0
CYCLE_S: Final = 60.0
RECOVERY_HALF_S: Final = 1800.0
FULL_FATIGUE_TRIMP: Final = 60.0
"""The impulse of about half an hour of heavy work: index 0.63."""
INDEX_EACH_S: Final = 10.0


def is_cyclic(at_s: list[float], bpm: list[float]) -> bool:
    """Return whether the newest heart rate completes a dip and a rise; times in s, oldest first."""
    times, rates = np.array(at_s), np.array(bpm)
    recent = times >= times[-1] - CYCLE_S
    before = ~recent & (times >= times[-1] - 4 * CYCLE_S)
    if before.sum() < 30 or recent.sum() < 10:
        return False
    low = int(np.argmin(rates[recent]))
    window = rates[recent]
    return bool(
        low < len(window) - 1
        and window[low] <= rates[before].mean() - DIP_BPM
        and window[-1] >= window[low] + RISE_BPM
    )


class PersonAnalysis:
    """Derived features of one person. `rest_bpm` and `maximum_bpm` are the baseline of the heart rate."""

    def __init__(self, source: str, rest_bpm: float = 70.0, maximum_bpm: float = 180.0) -> None:
        if not 25 < rest_bpm < maximum_bpm < 250:
            raise ValueError(
                f"rest {rest_bpm:g} and maximum {maximum_bpm:g} bpm: rest must be lower, both 25 to 250"
            )
        self._source: Final = source
        self._rest_bpm: Final = rest_bpm
        self._maximum_bpm: Final = maximum_bpm
        self._rates: deque[tuple[float, float]] = deque(maxlen=int(HISTORY_S))
        self._newest: dict[FeatureName, tuple[float, float]] = {}
        self._rest: dict[FeatureName, float] = {}
        self._pause_from_s: float | None = None
        self._has_reported_pause = False
        self._quiet_until_s = -np.inf
        self._impulse = 0.0
        self._index_s: float | None = None

    def take(self, features: Iterable[Feature]) -> list[Feature]:
        """Take features of the person's sensors; return those that follow."""
        results: list[Feature] = []
        for feature in features:
            if isinstance(feature.value, str) or feature.status is not Status.VALID:
                continue
            self._newest[feature.name] = feature.at_s, float(feature.value)
            if feature.name is FeatureName.HEART_RATE:
                results += self._take_rate(feature.at_s, float(feature.value))
            elif feature.name is FeatureName.BREATHING_RATE:
                results += self._take_breathing(feature.at_s, float(feature.value))
            elif feature.name in {FeatureName.HRV_RMSSD, FeatureName.EDA_TONIC}:
                self._learn_rest(feature.name, float(feature.value))
        return results

    def breathing_stopped(self, since_s: float, now_s: float) -> list[Feature]:
        """Report that a sensor sees a person who has not breathed since `since_s` (radar, belt)."""
        if PAUSE_S <= now_s - since_s <= MAX_PAUSE_S and not self._has_reported_pause:
            self._has_reported_pause = True
            return [self._event("breathingPause", now_s, now_s - since_s)]
        return []

    def _take_rate(self, at_s: float, bpm: float) -> list[Feature]:
        if self._rates and at_s - self._rates[-1][0] < 0.9:
            return []
        if self._rates and not 0 <= at_s - self._rates[-1][0] < 30:
            self._rates.clear()  # no event is found across a gap
        self._rates.append((at_s, bpm))
        features = self._indices(at_s, bpm)
        if at_s >= self._quiet_until_s and is_cyclic(
            [t for t, _ in self._rates], [b for _, b in self._rates]
        ):
            self._quiet_until_s = at_s + CYCLE_S / 2
            features.append(self._event("cyclicHeartRate", at_s, CYCLE_S))
        return features

    def _take_breathing(self, at_s: float, per_minute: float) -> list[Feature]:
        if per_minute >= PAUSE_BREATHS_PER_MINUTE:
            self._pause_from_s, self._has_reported_pause = None, False
            return []
        if self._pause_from_s is None:
            self._pause_from_s = at_s
        return self.breathing_stopped(self._pause_from_s, at_s)

    def _learn_rest(self, name: FeatureName, value: float) -> None:
        """Follow the person's own rest slowly, while the heart rate is near rest."""
        rate = self._newest.get(FeatureName.HEART_RATE)
        if rate is not None and rate[1] < self._rest_bpm + 10:
            self._rest[name] = self._rest.get(name, value) + 0.02 * (value - self._rest.get(name, value))

    def _indices(self, at_s: float, bpm: float) -> list[Feature]:
        passed_s = 0.0 if self._index_s is None else at_s - self._index_s
        if self._index_s is not None and passed_s < INDEX_EACH_S:
            return []
        self._index_s = at_s
        reserve = float(np.clip((bpm - self._rest_bpm) / (self._maximum_bpm - self._rest_bpm), 0, 1))
        passed_s = min(max(passed_s, 0.0), 60.0)
        # Banister: minutes times reserve r times a weight that grows with it: 0.64 e^(1.92 r), for men.
        self._impulse *= 0.5 ** (passed_s / RECOVERY_HALF_S)
        self._impulse += (
            passed_s / 60 * reserve * 0.64 * float(np.exp(1.92 * reserve)) if reserve > 0.1 else 0.0
        )
        fatigue = 1 - float(np.exp(-self._impulse / FULL_FATIGUE_TRIMP))
        parts = [float(np.clip((bpm - self._rest_bpm) / 40, 0, 1))]
        for name, sign in ((FeatureName.HRV_RMSSD, -1.0), (FeatureName.EDA_TONIC, 1.0)):
            newest, rest = self._newest.get(name), self._rest.get(name)
            if newest is not None and rest and at_s - newest[0] < 60:
                parts.append(float(np.clip(sign * (newest[1] / rest - 1) / 0.6, 0, 1)))
        quality = (1 + len(parts)) / 4  # 0.5 from the heart rate alone, 1 from all three
        return [
            self._feature(
                FeatureName.FATIGUE, fatigue, at_s, 0.5, method="banister-1", window_s=RECOVERY_HALF_S
            ),
            self._feature(
                FeatureName.STRESS, float(np.mean(parts)), at_s, quality, method="stress-1", window_s=60.0
            ),
        ]

    def _event(self, text: str, at_s: float, window_s: float) -> Feature:
        return self._feature(FeatureName.APNOEA_EVENT, text, at_s, 0.6, method="apnoea-1", window_s=window_s)

    def _feature(
        self,
        name: FeatureName,
        value: float | str,
        at_s: float,
        quality: float,
        *,
        method: str,
        window_s: float,
    ) -> Feature:
        return Feature(
            name,
            self._source,
            value,
            at_s,
            quality,
            Status.VALID,
            method,
            window_s,
            INDEX_EACH_S,
            is_calibrated=False,
        )
