"""The eyes of a simulated person: fixations, saccades and blinks, with the rates of healthy adults.

A fixation is followed by a saccade, which begins the next one. Blinks come between, independent of both:

- fixations last 0.26 s (median; Rayner 1998, Psychol Bull 124:372: 0.2 to 0.35 s in reading and scenes);
- saccades have 4.5 degrees (mean), 2.2 ms a degree and 21 ms (Carpenter 1988, "Movements of the eyes"), and a
  peak velocity of 500 degrees/s, reached by large ones (the main sequence, Bahill et al. 1975);
- 17 blinks a minute at rest (Bentivoglio et al. 1997, Mov Disord 12:1028) of 0.17 s (median).

Gaze is in degrees from straight ahead, to the right and up. The same seed gives the same eyes, whatever the
steps of time. Memory is bounded: events older than `KEEP_S` are forgotten.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

KEEP_S: Final = 10.0
AHEAD_S: Final = 2.0
BLINKS_PER_MINUTE: Final = 17.0
FIXATION_MEDIAN_S: Final = 0.26
BLINK_MEDIAN_S: Final = 0.17
MEAN_AMPLITUDE_DEG: Final = 4.5
MAX_AMPLITUDE_DEG: Final = 20.0
FIELD_DEG: Final = 15.0
"""The gaze stays within this angle of straight ahead."""
PEAK_DEG_S: Final = 500.0
PEAK_AT_DEG: Final = 15.0
EYELID_MM: Final = 10.0
PUPIL_MM: Final = 3.6

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class EyeMovement:
    """A fixation, or a saccade (`amplitude_deg` above 0) from one gaze to another."""

    begin_s: float
    end_s: float
    start: tuple[float, float]
    end: tuple[float, float]
    amplitude_deg: float = 0.0

    @property
    def peak_deg_s(self) -> float:
        """Return the peak velocity of a saccade, by the main sequence."""
        return PEAK_DEG_S * (1 - math.exp(-self.amplitude_deg / PEAK_AT_DEG))


class SimulatedEyes:
    """Both eyes; `blinks_per_minute` may be set at any time."""

    def __init__(self, seed: int = 0) -> None:
        self.blinks_per_minute = BLINKS_PER_MINUTE
        self.movements: deque[EyeMovement] = deque()
        self.blinks: deque[tuple[float, float]] = deque()
        """Begin and end of each."""
        self._moves = np.random.default_rng([seed, 1])
        self._blinking = np.random.default_rng([seed, 2])
        self._gaze = (0.0, 0.0)
        self._moved_s = 0.0
        self._blinked_s = 0.0

    def advance(self, now_s: float) -> None:
        """Decide what happens until `AHEAD_S` after `now_s`."""
        while self._moved_s < now_s + AHEAD_S:
            self._look()
        while self._blinked_s < now_s + AHEAD_S:
            self._blink()
        while self.movements and self.movements[0].end_s < now_s - KEEP_S:
            self.movements.popleft()
        while self.blinks and self.blinks[0][1] < now_s - KEEP_S:
            self.blinks.popleft()

    def gaze_at(self, times_s: Floats) -> Floats:
        """Return the gaze in degrees, one row a time."""
        gaze = np.zeros((len(times_s), 2))
        for movement in self.movements:
            during = (times_s >= movement.begin_s) & (times_s < movement.end_s)
            if during.any():
                share = (times_s[during] - movement.begin_s) / (movement.end_s - movement.begin_s)
                way = (1 - np.cos(math.pi * share)) / 2  # begins and ends without velocity
                gaze[during] = np.array(movement.start) + np.outer(
                    way, np.subtract(movement.end, movement.start)
                )
        return gaze

    def lids_at(self, times_s: Floats) -> Floats:
        """Return how far the lids are open, 0 to 1."""
        open_share = np.ones(len(times_s))
        for begin_s, end_s in self.blinks:
            share = np.clip((times_s - begin_s) / (end_s - begin_s), 0.0, 1.0)
            open_share = np.minimum(open_share, 1 - np.sin(math.pi * share) ** 0.5)
        return open_share

    def _look(self) -> None:
        """Add a fixation and the saccade after it."""
        random = self._moves
        stays_s = float(np.clip(random.lognormal(math.log(FIXATION_MEDIAN_S), 0.35), 0.1, 1.2))
        fixation = EyeMovement(self._moved_s, self._moved_s + stays_s, self._gaze, self._gaze)
        size = float(np.clip(random.exponential(MEAN_AMPLITUDE_DEG), 0.7, MAX_AMPLITUDE_DEG))
        angle = float(random.uniform(0, math.tau))
        to = (self._gaze[0] + size * math.cos(angle), self._gaze[1] + size * math.sin(angle))
        if math.hypot(*to) > FIELD_DEG:  # back towards the middle
            away = math.hypot(*self._gaze) or 1.0
            to = (self._gaze[0] * (1 - size / away), self._gaze[1] * (1 - size / away))
        ends_s = fixation.end_s + 0.0022 * size + 0.021
        saccade = EyeMovement(fixation.end_s, ends_s, self._gaze, to, size)
        self.movements += (fixation, saccade)
        self._gaze, self._moved_s = to, ends_s

    def _blink(self) -> None:
        random = self._blinking
        lasts_s = float(np.clip(random.lognormal(math.log(BLINK_MEDIAN_S), 0.25), 0.08, 0.4))
        pause_s = 60 / max(self.blinks_per_minute, 0.1) - lasts_s
        begin_s = self._blinked_s + float(random.gamma(4.0, max(pause_s, 0.2) / 4.0))
        self.blinks.append((begin_s, begin_s + lasts_s))
        self._blinked_s = begin_s + lasts_s
