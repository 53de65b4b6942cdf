"""A person whose heart follows effort, in simulated time.

    person = SimulatedPerson(seed=1)
    person.effort = 0.6
    person.advance(30.0)
    person.heart_rate_bpm

Heart rate has two parts, both driven by effort from 0 (rest) to 1 (maximum): a fast one, which rises with a
time constant of 25 s and recovers with 50 s, and a slow drift with 200 s, for long work. The steady state is
`rest + effort * (maximum - rest)`, a linear relation as of oxygen uptake (ACSM's Guidelines for Exercise
Testing and Prescription). Beats follow by integrating the rate, modulated by breathing (respiratory sinus
arrhythmia) and by slow waves of blood pressure at 0.1 Hz; both shrink as the rate rises.

The same seed, efforts and steps give the same beats. Memory is bounded: beats older than `KEEP_S` are
forgotten.
"""

import math
from collections import deque
from typing import Final

import numpy as np

RISE_S: Final = 25.0
RECOVERY_S: Final = 50.0
DRIFT_S: Final = 200.0
DRIFT_SHARE: Final = 0.15
"""Share of the rise that comes with the slow part."""
KEEP_S: Final = 10.0
AHEAD_S: Final = 1.0
"""Beats are decided this long before they happen, so that waves may begin before the R peak."""
STEP_S: Final = 0.05

BREATHING_REST: Final = 14.0
BREATHING_MAX: Final = 45.0


class SimulatedPerson:
    """The state of one person; `effort` may be set at any time."""

    def __init__(
        self,
        seed: int = 0,
        *,
        rest_bpm: float = 65.0,
        max_bpm: float = 185.0,
        effort: float = 0.0,
        variability: float = 1.0,
    ) -> None:
        if not 30 <= rest_bpm < max_bpm <= 230:
            raise ValueError(
                f"a heart that beats {rest_bpm:g} at rest and {max_bpm:g} at most cannot be simulated; "
                "give 30 to 230 bpm, rest below maximum"
            )
        self.rest_bpm: Final = rest_bpm
        self.max_bpm: Final = max_bpm
        self.effort = effort
        self.is_breathing = True
        """False: an apnoea, with the fall of the heart rate and the rise after it."""
        self.posture = "sitting"
        self.now_s = 0.0
        self.beats_s: deque[float] = deque()
        self.beat_count = 0
        self._variability = variability
        self._random = np.random.default_rng([seed, 0])
        self._fast = effort * (1 - DRIFT_SHARE)
        self._slow = effort * DRIFT_SHARE
        self._apnoea = 0.0
        self._breath_phase = 0.0
        self._wave_phase = float(self._random.uniform(0, math.tau))
        self._beat_phase = 0.0
        self._next_noise = 1.0
        self._decided_s = 0.0
        self._breaths: deque[tuple[float, float, float]] = deque()  # time, phase, depth

    @property
    def heart_rate_bpm(self) -> float:
        """Return the mean heart rate of now, without its variability."""
        share = min(1.0, self._fast + self._slow)
        rate = self.rest_bpm + share * (self.max_bpm - self.rest_bpm)
        return max(30.0, rate * (1 - 0.15 * max(self._apnoea, 0.0) + 0.2 * max(-self._apnoea, 0.0)))

    @property
    def breathing_rate(self) -> float:
        """Return the breaths per minute; 0 in an apnoea."""
        share = min(1.0, self._fast + self._slow)
        return (BREATHING_REST + share * (BREATHING_MAX - BREATHING_REST)) if self.is_breathing else 0.0

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self.now_s += seconds
        while self._decided_s < self.now_s + AHEAD_S:
            self._step()
        while self.beats_s and self.beats_s[0] < self.now_s - KEEP_S:
            self.beats_s.popleft()
        while self._breaths and self._breaths[0][0] < self.now_s - KEEP_S:
            self._breaths.popleft()

    def breath_at(self, times_s: "np.ndarray") -> "np.ndarray":
        """Return the chest's expansion, -1 to 1, at `times_s` of the last `KEEP_S` or the next second."""
        known = np.array(self._breaths)
        phase = np.interp(times_s, known[:, 0], known[:, 1])
        depth = np.interp(times_s, known[:, 0], known[:, 2])
        wave: np.ndarray = depth * np.sin(phase)
        return wave

    def _step(self) -> None:
        effort = min(max(self.effort, 0.0), 1.0)
        fast, slow = effort * (1 - DRIFT_SHARE), effort * DRIFT_SHARE
        self._fast += (fast - self._fast) * STEP_S / (RISE_S if fast > self._fast else RECOVERY_S)
        self._slow += (slow - self._slow) * STEP_S / DRIFT_S
        # An apnoea slows the heart; when breath returns the rate overshoots for some seconds.
        if not self.is_breathing:
            self._apnoea += (1.0 - self._apnoea) * STEP_S / 8.0
        elif self._apnoea > 0.3:
            self._apnoea = -1.0
        else:
            self._apnoea += (0.0 - self._apnoea) * STEP_S / 6.0
        calm = 1 - min(1.0, self._fast + self._slow)
        self._breath_phase += math.tau * self.breathing_rate / 60 * STEP_S
        self._wave_phase += math.tau * 0.1 * STEP_S
        depth = (1.0 if self.is_breathing else 0.0) * (1 + 0.5 * (1 - calm))
        before = self._breaths[-1][2] if self._breaths else depth
        depth = before + (depth - before) * STEP_S / 0.5
        self._breaths.append((self._decided_s, self._breath_phase, depth))
        modulation = (
            self._variability
            * calm
            * (0.05 * depth * math.sin(self._breath_phase) + 0.03 * math.sin(self._wave_phase))
        )
        rate_hz = self.heart_rate_bpm / 60 * (1 + modulation)
        advanced = self._beat_phase + rate_hz * STEP_S
        if advanced >= self._next_noise:
            at_s = self._decided_s + STEP_S * (self._next_noise - self._beat_phase) / (rate_hz * STEP_S)
            self.beats_s.append(at_s)
            self.beat_count += 1
            advanced -= self._next_noise
            self._next_noise = 1 + float(self._random.normal(0, 0.008)) * self._variability * calm
        self._beat_phase = advanced
        self._decided_s += STEP_S
