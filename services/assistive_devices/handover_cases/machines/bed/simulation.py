"""A simulated bed, and a sleeper: positions, apnoea events and restlessness. Pure.

The bed follows its command with the lag of its drives. The sleeper lies on the back; an apnoea of 15 s lets
the heart slow down and then race (the simulated person has that), and may end with a turn to the side, as
those of positional apnoea do.
"""

import math
from dataclasses import dataclass
from typing import Final

LAG_S: Final = 0.5
CALM_MOVEMENT: Final = 3.0
TURN_MOVEMENT: Final = 45.0
RESTLESS_MOVEMENT: Final = 70.0
TURN_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class Frame:
    """The bed: the phase of its rocking (rad), its deflection (-1 to 1), and its backrest (degrees)."""

    phase_rad: float = 0.0
    amplitude: float = 0.0
    backrest_deg: float = 0.0

    @property
    def deflection(self) -> float:
        """Return where the bed is within its stroke, -1 to 1."""
        return self.amplitude * math.sin(self.phase_rad)

    def step(self, period_s: float, amplitude: float, backrest_deg: float, dt_s: float) -> "Frame":
        """Return the bed `dt_s` later."""
        share = 1 - math.exp(-dt_s / LAG_S)
        return Frame(
            math.remainder(self.phase_rad + math.tau * dt_s / period_s, math.tau),
            self.amplitude + share * (amplitude - self.amplitude),
            self.backrest_deg + share * (backrest_deg - self.backrest_deg),
        )


@dataclass(frozen=True, slots=True)
class Sleeper:
    """What the sleeper does; `turning_s` is what is left of a turn."""

    posture: str = "lying"
    is_breathing: bool = True
    is_restless: bool = False
    turning_s: float = 0.0
    effort: float = 0.0

    @property
    def movement(self) -> float:
        """Return the movement that a radar sees, 0 to 100."""
        if self.is_restless:
            return RESTLESS_MOVEMENT
        return TURN_MOVEMENT if self.turning_s > 0 else CALM_MOVEMENT

    def turn(self, posture: str) -> "Sleeper":
        """Return the sleeper who turns."""
        return Sleeper(posture, self.is_breathing, self.is_restless, TURN_S, self.effort)

    def step(self, dt_s: float) -> "Sleeper":
        """Return the sleeper `dt_s` later."""
        left_s = max(self.turning_s - dt_s, 0.0)
        return Sleeper(self.posture, self.is_breathing, self.is_restless, left_s, self.effort)
