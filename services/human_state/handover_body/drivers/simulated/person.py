"""A person whose heart follows effort, in simulated time.

    person = SimulatedPerson(seed=1)
    person.effort = 0.6
    person.advance(30.0)
    person.heart_rate_bpm

Effort goes from 0 (rest) to 1 (maximum). The mean heart rate follows it with the dynamics of
`handover_body.model.cardiovascular`: some 57 s up and 54 s down, and a slow drift. Beats follow by
integrating the rate, modulated by breathing (respiratory sinus arrhythmia) and by slow waves of blood
pressure at 0.1 Hz; both shrink as the rate rises, since the vagus withdraws.

Who walks is described by `walk`, which sets effort and gait:

    person = SimulatedPerson(seed=1, body=Physiology.of_age(55))
    person.walk(1.2)

The same seed, efforts and steps give the same beats. Memory is bounded: beats older than `KEEP_S` are
forgotten.
"""

import math
from collections import deque
from typing import Final, Literal

import numpy as np

from handover_body.drivers.simulated.eyes import SimulatedEyes
from handover_body.model.cardiovascular import (
    Heart,
    Physiology,
    cadence_hz,
    speed_mps_of_cadence,
    stroke_volume_ml,
)

KEEP_S: Final = 10.0
AHEAD_S: Final = 1.0
"""Beats are decided this long before they happen, so that waves may begin before the R peak."""
STEP_S: Final = 0.05
MIN_WALK_MPS: Final = 0.1
"""Slower is standing: no steps."""
MIN_GAIT_EFFORT: Final = 0.1

BREATHING_REST: Final = 14.0
BREATHING_MAX: Final = 45.0


Posture = Literal["sitting", "standing", "lying", "lyingLeft", "lyingRight", "prone"]
LYING: Final[frozenset[Posture]] = frozenset({"lying", "lyingLeft", "lyingRight", "prone"})


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
        body: Physiology | None = None,
    ) -> None:
        self.body: Final = body or Physiology(rest_bpm, max_bpm)
        self.rest_bpm: Final = self.body.rest_bpm
        self.max_bpm: Final = self.body.max_bpm
        self.effort = effort
        self.walking_mps: float | None = None
        """The speed of a walk, which sets the gait; None: the gait follows the effort."""
        self.is_breathing = True
        """False: an apnoea, with the fall of the heart rate and the rise after it."""
        self.posture: Posture = "sitting"
        self.lean = (0.0, 0.0)
        """How far the upper body leans to the right and forwards, -1 to 1."""
        self.movement: float | None = None
        """The movement that a radar sees, 0 to 100; None: it follows effort."""
        self.eyes: Final = SimulatedEyes(seed)
        self.now_s = 0.0
        self.beats_s: deque[float] = deque()
        self.beat_count = 0
        self._variability = variability
        self._random = np.random.default_rng([seed, 0])
        self._heart = Heart.steady(effort)
        self._apnoea = 0.0
        self._breath_phase = 0.0
        self._wave_phase = float(self._random.uniform(0, math.tau))
        self._beat_phase = 0.0
        self._next_noise = 1.0
        self._decided_s = 0.0
        self._breaths: deque[tuple[float, float, float]] = deque()  # time, phase, depth
        self._gait_phase = 0.0
        self._gait: deque[tuple[float, float]] = deque()  # time, phase

    @property
    def heart_rate_bpm(self) -> float:
        """Return the mean heart rate of now, without its variability."""
        rate = self._heart.rate_bpm(self.body)
        return max(30.0, rate * (1 - 0.15 * max(self._apnoea, 0.0) + 0.2 * max(-self._apnoea, 0.0)))

    @property
    def strain(self) -> float:
        """Return the share of the heart rate reserve that the heart uses now, 0 to 1."""
        return self._heart.total(self.body)

    @property
    def stroke_volume_ml(self) -> float:
        """Return what the heart pumps with each beat."""
        return stroke_volume_ml(self.strain, is_lying=self.posture in LYING)

    @property
    def breathing_rate(self) -> float:
        """Return the breaths per minute; 0 in an apnoea."""
        return (BREATHING_REST + self.strain * (BREATHING_MAX - BREATHING_REST)) if self.is_breathing else 0.0

    def walk(self, speed_mps: float, grade: float = 0.0) -> None:
        """Walk at a speed from now on, on a grade; 0 stands still."""
        self.walking_mps = max(speed_mps, 0.0)
        self.effort = self.body.walking_effort(speed_mps, grade)

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self.now_s += seconds
        while self._decided_s < self.now_s + AHEAD_S:
            self._step()
        self.eyes.advance(self.now_s)
        while self.beats_s and self.beats_s[0] < self.now_s - KEEP_S:
            self.beats_s.popleft()
        while self._breaths and self._breaths[0][0] < self.now_s - KEEP_S:
            self._breaths.popleft()
            self._gait.popleft()

    def breath_at(self, times_s: "np.ndarray") -> "np.ndarray":
        """Return the chest's expansion, -1 to 1, at `times_s` of the last `KEEP_S` or the next second."""
        breaths = np.array(self._breaths)
        phase = np.interp(times_s, breaths[:, 0], breaths[:, 1])
        depth = np.interp(times_s, breaths[:, 0], breaths[:, 2])
        wave: np.ndarray = depth * np.sin(phase)
        return wave

    @property
    def steps_hz(self) -> float:
        """Return the steps a second: those of the walk, or of an effort above 0.1; 0 without a gait."""
        if self.walking_mps is None:
            return 1.5 + 1.0 * self.effort if self.effort > MIN_GAIT_EFFORT else 0.0
        return cadence_hz(self.walking_mps) if self.walking_mps > MIN_WALK_MPS else 0.0

    @property
    def is_walking(self) -> bool:
        """Return whether there is a gait: the steps of somebody who stands up, or walks at a speed."""
        is_upright = self.posture == "standing" or self.walking_mps is not None
        return is_upright and self.steps_hz > 0

    @property
    def gait_mps(self) -> float:
        """Return the speed of the gait; 0 without one."""
        if not self.is_walking:
            return 0.0
        return speed_mps_of_cadence(self.steps_hz) if self.walking_mps is None else self.walking_mps

    def gait_at(self, times_s: "np.ndarray") -> "np.ndarray":
        """Return the phase of the gait in rad, a step each turn: continuous, whatever the speed does."""
        strides = np.array(self._gait)
        phase: np.ndarray = np.interp(times_s, strides[:, 0], strides[:, 1])
        return phase

    def gait_times_s(self, phases: "np.ndarray") -> "np.ndarray":
        """Return when the gait had these phases, in the last `KEEP_S`."""
        strides = np.array(self._gait)
        times_s: np.ndarray = np.interp(phases, strides[:, 1], strides[:, 0])
        return times_s

    def _step(self) -> None:
        self._heart = self._heart.step(self.effort, STEP_S, self.body)
        # An apnoea slows the heart; when breath returns the rate overshoots for some seconds.
        if not self.is_breathing:
            self._apnoea += (1.0 - self._apnoea) * STEP_S / 8.0
        elif self._apnoea > 0.3:
            self._apnoea = -1.0
        else:
            self._apnoea += (0.0 - self._apnoea) * STEP_S / 6.0
        calm = 1 - self.strain
        self._breath_phase += math.tau * self.breathing_rate / 60 * STEP_S
        self._wave_phase += math.tau * 0.1 * STEP_S
        depth = (1.0 if self.is_breathing else 0.0) * (1 + 0.5 * (1 - calm))
        before = self._breaths[-1][2] if self._breaths else depth
        depth = before + (depth - before) * STEP_S / 0.5
        self._breaths.append((self._decided_s, self._breath_phase, depth))
        self._gait_phase += math.tau * self.steps_hz * STEP_S
        self._gait.append((self._decided_s, self._gait_phase))
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
