"""Rocking and backrest of a nocturnal bed, from heart rate, movement and posture. Pure.

The period of the rocking is inverse to the heart rate: `k / HR`. The paper gives no figures; here 60 bpm rock
in 4 s, as gently as published rocking beds (0.25 Hz), and the period stays within 2.5 and 6 s. Since rocking
may excite the sleeper whose heart sets it, this is a positive feedback. Three things bound it: the bounds of
the period, a slew limit of the period (0.05 s in a second), and a smoothed heart rate. A cycle of feedback
cannot run away faster than 30 s from 4 s to 2.5 s, and ends there.

A heart rate that is stale or implausible, or a limit of the body of 0, stops the rocking. Restlessness, the
moving mean of 10 s of the movement (0 to 100) above a threshold, stops it as well; the backrest then rises to
45 degrees at 3 degrees a second, only with somebody who lies there, and only once the rocking has stopped.
While nobody is known to lie there, the backrest stays where it is. A person starts the bed again.

Invariants, for any signals: the period is within its bounds and its slew; the amplitude falls to 0 whenever
the heart rate is not valid; the backrest rises only while the bed does not rock and somebody lies, and never
above 45 degrees.

Worked example: after 30 s at 60 bpm the period is 4.0 s. The heart rate jumps to 80 bpm: it would be 3.0 s,
and is 3.5 s after 10 s at the earliest.
"""

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Final

from handover_cases.model.smoothing import within_rate

WINDOW_S: Final = 10.0
MIN_COVERAGE: Final = 0.6
"""The share of the window for which a movement must be known before restlessness is decided."""
MAX_DT_S: Final = 0.2


@dataclass(frozen=True, slots=True)
class BedParameters:
    """Bounds of the bed. The 45 degrees are those of the paper, the others ours."""

    period_at_60_bpm_s: float = 4.0
    min_period_s: float = 2.5
    max_period_s: float = 6.0
    period_slew_s_per_s: float = 0.05
    heart_rate_time_constant_s: float = 5.0
    amplitude_slew_per_s: float = 0.2
    restless_movement: float = 35.0
    raised_deg: float = 45.0
    backrest_deg_per_s: float = 3.0


@dataclass(frozen=True, slots=True)
class Signals:
    """What is known of the sleeper; None for what is not valid now."""

    heart_rate_bpm: float | None
    movement: float | None
    is_lying: bool
    fraction: float = 1.0
    """The limit of the body, 0 to 1; it scales the amplitude."""


@dataclass(frozen=True, slots=True)
class Bed:
    """The controller at the time of the last step. `amplitude` is 0 to 1, `backrest_deg` a command."""

    parameters: BedParameters = field(default_factory=BedParameters)
    is_enabled: bool = False
    is_restless: bool = False
    """Latched: the backrest rises, until a person starts the bed again."""
    period_s: float = 4.0
    amplitude: float = 0.0
    backrest_deg: float = 0.0
    heart_rate_bpm: float | None = None
    movements: tuple[tuple[float, float], ...] = ()
    """The time and value of the movements of the window."""
    now_s: float = 0.0

    def start(self) -> "Bed":
        """Return the bed that lowers its backrest, and then rocks."""
        return replace(self, is_enabled=True, is_restless=False, movements=())

    def stop(self) -> "Bed":
        """Return the bed that stops rocking; the backrest stays."""
        return replace(self, is_enabled=False)

    @property
    def mean_movement(self) -> float | None:
        """Return the moving mean; None while too little of the window is known."""
        if not self.movements or self.now_s - self.movements[0][0] < MIN_COVERAGE * WINDOW_S:
            return None
        return sum(value for _, value in self.movements) / len(self.movements)

    def wanted_period_s(self, heart_rate_bpm: float) -> float:
        """Return the period that belongs to a heart rate, within its bounds."""
        bounds = self.parameters
        period_s = bounds.period_at_60_bpm_s * 60 / max(heart_rate_bpm, 1.0)
        return min(max(period_s, bounds.min_period_s), bounds.max_period_s)

    def step(self, signals: Signals, dt_s: float) -> "Bed":
        """Return the bed `dt_s` later."""
        dt_s = min(max(dt_s, 0.0), MAX_DT_S)
        made = replace(self, now_s=self.now_s + dt_s)._moved(signals)
        made = made._following(signals, dt_s)
        may_rock = (
            made.is_enabled
            and not made.is_restless
            and signals.heart_rate_bpm is not None
            and signals.is_lying
            and made.backrest_deg <= 0.0
        )
        return made._rocking(signals, dt_s, may_rock=may_rock)._lifting(signals, dt_s)

    def _moved(self, signals: Signals) -> "Bed":
        movements = deque(movement for movement in self.movements if movement[0] > self.now_s - WINDOW_S)
        if signals.movement is not None:
            movements.append((self.now_s, signals.movement))
        made = replace(self, movements=tuple(movements))
        mean = made.mean_movement
        is_restless = mean is not None and mean > self.parameters.restless_movement and self.is_enabled
        return replace(made, is_restless=self.is_restless or is_restless)

    def _following(self, signals: Signals, dt_s: float) -> "Bed":
        rate, bounds = signals.heart_rate_bpm, self.parameters
        if rate is None:
            return replace(self, heart_rate_bpm=None)
        before = rate if self.heart_rate_bpm is None else self.heart_rate_bpm
        share = min(dt_s / bounds.heart_rate_time_constant_s, 1.0)
        smoothed = before + share * (rate - before)
        slew_s = bounds.period_slew_s_per_s * dt_s
        change_s = self.wanted_period_s(smoothed) - self.period_s
        period_s = self.period_s + min(max(change_s, -slew_s), slew_s)
        return replace(self, heart_rate_bpm=smoothed, period_s=period_s)

    def _rocking(self, signals: Signals, dt_s: float, *, may_rock: bool) -> "Bed":
        slew = self.parameters.amplitude_slew_per_s
        target = min(max(signals.fraction, 0.0), 1.0) if may_rock else 0.0
        return replace(self, amplitude=within_rate(self.amplitude, target, slew, slew, dt_s))

    def _lifting(self, signals: Signals, dt_s: float) -> "Bed":
        bounds = self.parameters
        if self.amplitude > 0.0 or not signals.is_lying:
            return self
        if self.is_restless:
            target = bounds.raised_deg
        elif self.is_enabled:
            target = 0.0
        else:
            return self
        reach = bounds.backrest_deg_per_s * dt_s
        change = min(max(target - self.backrest_deg, -reach), reach)
        return replace(self, backrest_deg=min(max(self.backrest_deg + change, 0.0), bounds.raised_deg))
