"""An ECG that becomes quiet, as that of a strap that was taken off and reports nothing. Pure.

What moves is the difference over 60 ms: a QRS complex has the usual peak, T and P waves have 8 to 15 % of it.
Two rules, each with the longest quiet of the last beats:

- nothing above 5 % of the peak, neither T nor P wave, for `SILENT_S`, or 1.4 times the longest such quiet;
- no beat, nothing above 12 %, for `NO_BEAT_S`, or 1.3 times the longest such quiet: electrodes may be noisy.

The first finds it in one packet of 0.56 s at a usual heart rate. A slow heart is quiet for longer between its
beats, and so is one that pauses after an extrasystole: after a beat that came early the quiet may last until
the second regular beat is due (a compensatory pause), and 20 % longer.
"""

from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LAG_S: Final = 0.06
SILENT_S: Final = 0.42
NO_BEAT_S: Final = 1.05
UNKNOWN_S: Final = 1.5
"""The longest quiet while too few are known."""
MIN_KNOWN: Final = 8
_BLOCK_S: Final = 1.5
_PREMATURE: Final = 0.85


class QuietEcg:
    """Finds that the first channel of an ECG is quiet. Memory: figures of the last beats."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._lag = max(1, round(LAG_S * rate_hz))
        self._tail: Floats = np.empty(0)
        self._peaks: deque[float] = deque(maxlen=12)
        self._block_peak = 0.0
        self._block = 0
        self._silent = _Runs(0.05, SILENT_S, 1.4, rate_hz)
        self._no_beat = _Runs(0.12, NO_BEAT_S, 1.3, rate_hz)
        self._at = 0
        """Samples taken; beats are counted in them."""
        self._beats: deque[int] = deque(maxlen=12)

    def take(self, values: Floats) -> float | None:
        """Take the next samples; return for how many s the signal has been too quiet, else None."""
        joined = np.concatenate((self._tail, values))
        self._tail = joined[-self._lag :].copy()
        if len(joined) <= self._lag:
            return None
        moves = np.abs(joined[self._lag :] - joined[: -self._lag])
        self._block += len(moves)
        self._block_peak = max(self._block_peak, float(moves.max()))
        usual = float(np.median(self._peaks)) if len(self._peaks) >= 2 else 0.0
        if self._block >= _BLOCK_S * self._rate_hz:
            if self._block_peak > 0.2 * usual:
                self._peaks.append(self._block_peak)
            self._block, self._block_peak = 0, 0.0
        if usual <= 0:
            return None
        self._note_beats(moves > 0.5 * usual)
        self._at += len(moves)
        pause_s = self._pause_s()
        quiet = [runs.take(moves, usual, pause_s) for runs in (self._silent, self._no_beat)]
        return max((silence_s for silence_s in quiet if silence_s is not None), default=None)

    def _note_beats(self, steep: NDArray[np.bool_]) -> None:
        for place in np.flatnonzero(steep):
            at = self._at + int(place)
            if not self._beats or at - self._beats[-1] > 0.25 * self._rate_hz:
                self._beats.append(at)

    def _pause_s(self) -> float:
        """Return how long a pause may last after a beat that came early; 0 after a regular one."""
        if len(self._beats) < 5:
            return 0.0
        intervals = np.diff(self._beats) / self._rate_hz
        usual_s, last_s = float(np.median(intervals[:-1])), float(intervals[-1])
        return 1.2 * (2 * usual_s - last_s) if last_s < _PREMATURE * usual_s else 0.0


class _Runs:
    """How long nothing was above a share of the usual peak, now and in the last beats."""

    def __init__(self, share: float, least_s: float, factor: float, rate_hz: float) -> None:
        self._share, self._least_s, self._factor, self._rate_hz = share, least_s, factor, rate_hz
        self._quiet_s = 0.0
        self._longest_s: deque[float] = deque(maxlen=30)

    def take(self, moves: Floats, usual: float, pause_s: float) -> float | None:
        moving = np.flatnonzero(moves >= self._share * usual)
        has_enough = len(self._longest_s) >= MIN_KNOWN
        allowed_s = max(
            self._least_s, self._factor * (max(self._longest_s) if has_enough else UNKNOWN_S), pause_s
        )
        if len(moving):
            ended_s = self._quiet_s + float(moving[0]) / self._rate_hz
            between_s = (np.diff(moving) - 1) / self._rate_hz
            for run_s in (ended_s, *between_s[between_s > 0.1]):
                if 0.1 < run_s <= max(allowed_s, UNKNOWN_S):
                    self._longest_s.append(float(run_s))
            self._quiet_s = (len(moves) - 1 - int(moving[-1])) / self._rate_hz
        else:
            self._quiet_s += len(moves) / self._rate_hz
        return self._quiet_s if self._quiet_s > allowed_s else None
