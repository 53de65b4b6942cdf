"""Clocks: times that a jump of the wall clock or a suspended machine does not falsify.

The wall clock (Unix time) jumps when it is set, and the monotonic clock of Linux stands still while the
machine is suspended. So a span of time is measured by `steady_s`, which runs on in suspend. What other
processes judge by the wall clock, such as a token, has a `Lifetime`: it is over as soon as one clock says
so.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

Clock = Callable[[], float]

SET_BACK_S: Final = 1.0
"""A wall clock that has moved back by more makes a lifetime end: nobody can say how old a thing is."""


def steady_s() -> float:
    """Return the time since some moment; it never jumps, and runs on while the machine is suspended."""
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()


@dataclass(frozen=True, slots=True)
class Lifetime:
    """The life of something that was made now and is valid for `life_s`."""

    life_s: float
    begun_s: float
    begun_wall_s: float

    @classmethod
    def begin(cls, life_s: float, *, steady: Clock = steady_s, wall: Clock = time.time) -> "Lifetime":
        """Return a life that begins now."""
        return cls(life_s, steady(), wall())

    def age_s(self, *, steady: Clock = steady_s, wall: Clock = time.time) -> float:
        """Return the age by the clock that says more; infinite if the wall clock was set back."""
        by_wall = wall() - self.begun_wall_s
        return math.inf if by_wall < -SET_BACK_S else max(by_wall, steady() - self.begun_s)

    def is_over(self, part: float = 1.0, *, steady: Clock = steady_s, wall: Clock = time.time) -> bool:
        """Return whether `part` of the life is over."""
        return math.isfinite(self.life_s) and self.age_s(steady=steady, wall=wall) >= self.life_s * part


class SteadyTime:
    """The Unix time of when it was made, plus what has passed since: it does not jump."""

    def __init__(self, *, steady: Clock = steady_s, wall: Clock = time.time) -> None:
        self._steady = steady
        self._offset_s = wall() - steady()

    def __call__(self) -> float:
        """Return the time in s since 1970."""
        return self._steady() + self._offset_s
