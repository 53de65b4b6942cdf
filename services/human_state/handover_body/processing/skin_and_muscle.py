"""Skin conductance (EDA) to its tonic and phasic part, and the envelope of an EMG, as incremental filters.

The tonic level is the EDA below 0.05 Hz, the phasic part the EDA between 0.05 Hz and 1 Hz, a common split
with filters (Boucsein, "Electrodermal activity", 2012, 2.2.4). Electrodes without contact have no
conductance: below 0.05 microsiemens the quality is 0. The EMG envelope is the root mean square of 20 to
450 Hz in 0.25 s (SENIAM, Hermens et al. 2000, J Electromyogr Kinesiol 10:361).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal as dsp

from handover.messages import number_text
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SensorReport, SignalInfo

MIN_CONDUCTANCE_US: Final = 0.05
TONIC_HZ: Final = 0.05
SETTLE_S: Final = 10.0
ENVELOPE_S: Final = 0.25
EACH_S: Final = 1.0
MICROVOLTS: Final = {"D82": 1.0, "2Z": 1e3, "VLT": 1e6}


class EdaProcessor:
    """Skin conductance in microsiemens, 1 Hz or more, first channel."""

    def __init__(self, info: SignalInfo) -> None:
        if info.rate_hz is None or info.rate_hz < 1 or info.unit != "D80":
            raise ValueError(
                f"EDA needs microsiemens (D80) at 1 Hz at least, not {info.unit} at "
                f"{number_text(info.rate_hz)} Hz"
            )
        self._rate_hz: Final = info.rate_hz
        self._tonic_filter: Final = dsp.butter(1, TONIC_HZ, "low", fs=info.rate_hz, output="sos")
        smooth_hz = min(1.0, 0.4 * info.rate_hz)
        self._smooth_filter: Final = dsp.butter(1, smooth_hz, "low", fs=info.rate_hz, output="sos")
        self._reset()

    def _reset(self) -> None:
        self._tonic_state: NDArray[np.float64] | None = None
        self._smooth_state: NDArray[np.float64] | None = None
        self._seen = 0
        self._due_s = -np.inf

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take samples; return both parts once a second, after 10 s."""
        x = samples.values[:, 0]
        if self._tonic_state is None or self._smooth_state is None:
            self._tonic_state = dsp.sosfilt_zi(self._tonic_filter) * x[0]
            self._smooth_state = dsp.sosfilt_zi(self._smooth_filter) * x[0]
        tonic, self._tonic_state = dsp.sosfilt(self._tonic_filter, x, zi=self._tonic_state)
        smooth, self._smooth_state = dsp.sosfilt(self._smooth_filter, x, zi=self._smooth_state)
        self._seen += len(x)
        at_s = samples.end_s
        if self._seen < SETTLE_S * self._rate_hz or at_s < self._due_s:
            return []
        self._due_s = at_s + EACH_S - 0.5 / self._rate_hz
        quality = samples.quality if float(x.min()) >= MIN_CONDUCTANCE_US else 0.0
        return [
            Feature(
                name, samples.source, float(value), at_s, quality, Status.VALID, "eda-1", 1 / TONIC_HZ, EACH_S
            )
            for name, value in (
                (FeatureName.EDA_TONIC, tonic[-1]),
                (FeatureName.EDA_PHASIC, smooth[-1] - tonic[-1]),
            )
        ]

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Start the filters again after a fault."""
        if report.fault is not None or report.has_contact is False:
            self._reset()
        return []


class EmgProcessor:
    """An EMG of 100 Hz or more, first channel; the envelope in microvolts."""

    def __init__(self, info: SignalInfo) -> None:
        if info.rate_hz is None or info.rate_hz < 100 or info.unit not in MICROVOLTS:
            raise ValueError(
                f"EMG needs volts (D82, 2Z, VLT) at 100 Hz at least, not {info.unit} at "
                f"{number_text(info.rate_hz)} Hz"
            )
        self._rate_hz: Final = info.rate_hz
        self._factor: Final = MICROVOLTS[info.unit]
        upper_hz = min(450.0, 0.45 * info.rate_hz)
        self._filter: Final = dsp.butter(2, [20, upper_hz], "band", fs=info.rate_hz, output="sos")
        self._state: NDArray[np.float64] | None = None
        self._squares = np.empty(0)

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take samples; return the envelope of the last 0.25 s, with each packet."""
        x = samples.values[:, 0] * self._factor
        if self._state is None:
            self._state = dsp.sosfilt_zi(self._filter) * x[0]
        wave, self._state = dsp.sosfilt(self._filter, x, zi=self._state)
        need = round(ENVELOPE_S * self._rate_hz)
        self._squares = np.concatenate((self._squares, wave * wave))[-need:]
        if len(self._squares) < need:
            return []
        envelope = float(np.sqrt(self._squares.mean()))
        period_s = max(len(x) / self._rate_hz, 0.02)
        return [
            Feature(
                FeatureName.EMG_ENVELOPE, samples.source, envelope, samples.end_s, samples.quality,
                method="emg-1", window_s=ENVELOPE_S, period_s=period_s,
            )
        ]  # fmt: skip

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Start the filter again after a fault."""
        if report.fault is not None or report.has_contact is False:
            self._state = None
            self._squares = np.empty(0)
        return []
