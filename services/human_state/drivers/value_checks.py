"""Samples that cannot be of a body in this unit: at a bound, constant, of another magnitude. Pure."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover.messages import message
from services.human_state.model.signals import SignalInfo, SignalKind

WAVEFORMS: Final = frozenset(
    {SignalKind.ECG, SignalKind.PPG, SignalKind.EMG, SignalKind.EEG, SignalKind.EOG, SignalKind.ICG,
     SignalKind.BCG}
)  # fmt: skip
"""Signals that are never constant on a body."""
MAX_FLAT_S: Final = 0.4
SATURATED_RUN: Final = 3
"""Samples at a bound in a row; single ones are peaks."""
_BLOCK_S: Final = 2.0
_UNIT_FACTOR: Final = 100.0

ECG_SPREAD_UV: Final = (5.0, 50_000.0)
"""Peak to peak of an ECG at the skin in microvolt, with room for artefacts; volts lie outside."""
GRAVITY_MPS2: Final = (3.0, 30.0)
"""The median length of an acceleration with gravity, over 2 s; g and milli-g lie outside."""
_MICROVOLTS: Final = {"D82": 1.0, "2Z": 1e3, "VLT": 1e6}


class Runs:
    """Samples in a row that are at a bound, or equal, across packets; by channel."""

    def __init__(self, info: SignalInfo) -> None:
        channels = len(info.channels)
        self._info = info
        self._at_bound = np.zeros(channels, dtype=np.int64)
        self._equal = np.zeros(channels, dtype=np.int64)
        self._last = np.full(channels, np.nan)
        self._needed = SATURATED_RUN if (info.rate_hz or 0.0) >= 10 else 1
        is_wave = info.kind in WAVEFORMS and info.rate_hz is not None
        self._max_equal = max(3, round(MAX_FLAT_S * (info.rate_hz or 1.0))) if is_wave else None

    def take(self, values: NDArray[np.float64]) -> tuple[bool, bool]:
        """Return whether the samples are saturated, and whether they are flat."""
        bound = (values >= self._info.max_value) | (values <= self._info.min_value)
        if self._needed == 1:
            saturated = bool(((values > self._info.max_value) | (values < self._info.min_value)).any())
        else:
            longest, self._at_bound = _longest_runs(bound, self._at_bound)
            saturated = bool((longest >= self._needed).any())
        if self._max_equal is None:
            return saturated, False
        equal = values == np.vstack((self._last, values[:-1]))
        self._last = values[-1].copy()
        longest, self._equal = _longest_runs(equal, self._equal)
        return saturated, bool((longest >= self._max_equal).any())


def _longest_runs(
    flags: NDArray[np.bool_], before: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return per column the longest run of true rows, and the run at the end; `before` are runs so far."""
    rows = np.arange(1, len(flags) + 1)[:, None]
    last_false = np.maximum.accumulate(np.where(flags, 0, rows), axis=0)
    runs = np.where(last_false > 0, rows - last_false, rows + before)
    runs = np.where(flags, runs, 0)
    return runs.max(axis=0), runs[-1]


class Units:
    """Whether values have the order of magnitude of their unit, in blocks of 2 s."""

    def __init__(self, info: SignalInfo) -> None:
        self._info = info
        self._size = round(_BLOCK_S * info.rate_hz) if info.rate_hz and info.rate_hz >= 10 else 0
        self._is_watched = self._size > 0 and info.kind in (WAVEFORMS | {SignalKind.ACCELERATION})
        self._block: list[NDArray[np.float64]] = []
        self._count = 0
        self._typical: float | None = None
        self._odd = 0
        self._fault = ""

    def take(self, values: NDArray[np.float64], *, is_usable: bool) -> str:
        """Return what is wrong with the unit; an empty text if nothing is known to be wrong."""
        if not self._is_watched:
            return ""
        if not is_usable:
            self._block, self._count = [], 0
            return self._fault
        self._block.append(values)
        self._count += len(values)
        if self._count >= self._size:
            self._fault = self._fault_of(np.concatenate(self._block))
            self._block, self._count = [], 0
        return self._fault

    def _fault_of(self, block: NDArray[np.float64]) -> str:
        if not np.isfinite(block).any():
            return ""
        if self._info.kind is SignalKind.ACCELERATION:
            if self._info.unit != "MSK" or block.shape[1] != 3:
                return ""
            length = float(np.nanmedian(np.linalg.norm(block, axis=1)))
            lower, upper = GRAVITY_MPS2
            if lower <= length <= upper:
                return ""
            return message(
                "health.sensor.gravity",
                "{signal}: a median of {length} m/s² is no acceleration with gravity; is it another unit?",
                signal=self._info.kind,
                length=float(f"{length:.3g}"),
            )
        spread = float(np.nanmax(np.nanmax(block, axis=0) - np.nanmin(block, axis=0)))
        factor = _MICROVOLTS.get(self._info.unit)
        if self._info.kind is SignalKind.ECG and factor is not None:
            lower, upper = ECG_SPREAD_UV
            if not lower <= spread * factor <= upper:
                return message(
                    "health.sensor.no_ecg",
                    "{signal}: {spread} {unit} peak to peak is no ECG; is it another unit?",
                    signal=self._info.kind,
                    spread=float(f"{spread:.3g}"),
                    unit=self._info.unit,
                )
        return self._compared(spread)

    def _compared(self, spread: float) -> str:
        if spread <= 0:
            return self._fault
        if self._typical is None:
            self._typical = spread
            return ""
        ratio = spread / self._typical
        if 1 / _UNIT_FACTOR < ratio < _UNIT_FACTOR:
            self._typical *= max(0.8, min(1.25, ratio))
            self._odd = 0
            return ""
        self._odd += 1
        if self._odd < 2:
            return ""
        return message(
            "health.sensor.factor",
            "{signal}: the values changed by a factor of {factor}; did the unit change?",
            signal=self._info.kind,
            factor=float(f"{ratio:.3g}"),
        )
