"""The guide: leads a person through a calibration, by the frames of their glove alone.

It says what to do, counts down, and then waits until the hand has been still for a second: who is late is
waited for, and who makes the fist only when the open hand is asked for is understood too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from statistics import median

from services.gesture_controller.calibration.levels import LEAST_FRAMES
from services.gesture_controller.thresholds import FINGERS

COUNTDOWN_S = 3.0
KEEP_S = 1.0
"""How long the hand has to be still."""

GAP_S = 1.0
"""After longer without a frame the second begins anew."""

UNCHANGED_FOR_S = 15.0
"""A hand that has not moved since the fist is taken as it is after so long: perhaps no sensor works."""

GIVE_UP_S = 60.0

STILL = 0.06
"""How far a finger may wander in that second, as a share of all that the glove has shown meanwhile."""

MOVED = 0.08
"""A finger that moved by so much of that has moved from the fist."""

_NOISES = 6.0
_DIFFERENCE_TO_SIGMA = 1.4826 / 2**0.5

Frames = tuple[tuple[float, ...], ...]


class Step(Enum):
    """What the person is asked to show."""

    FIST = "fist"
    OPEN = "open"
    GESTURE = "gesture"


class Phase(Enum):
    """How far the step is."""

    COUNTDOWN = "countdown"
    CAPTURE = "capture"
    DONE = "done"
    GIVEN_UP = "givenUp"


HAND = (Step.FIST, Step.OPEN)
SAMPLE = (Step.GESTURE,)


@dataclass(frozen=True, slots=True)
class Guide:
    """How far a calibration is. Times are on the glove's clock, in seconds."""

    steps: tuple[Step, ...] = HAND
    countdown_s: float = COUNTDOWN_S
    phase: Phase = Phase.COUNTDOWN
    captured: tuple[Frames, ...] = ()
    """The second of each step that is done."""
    since_s: float | None = None
    """Since when this phase has lasted; None until the first frame."""
    at_s: float = 0.0
    window: tuple[tuple[float, tuple[float, ...]], ...] = ()
    lowest: float = 0.0
    highest: float = 0.0
    restless: tuple[str, ...] = ()
    """The fingers that were not still in the last second."""
    waits_for_change: bool = False
    """Whether the hand is still, but has not opened yet."""

    @property
    def is_over(self) -> bool:
        """Say whether no more frames are needed."""
        return self.phase in {Phase.DONE, Phase.GIVEN_UP}

    @property
    def step(self) -> Step:
        """Return what the person is asked to show, or was at last."""
        return self.steps[min(len(self.captured), len(self.steps) - 1)]

    @property
    def remaining_s(self) -> float:
        """Return what is left of the countdown, or of the second that the hand must be still."""
        if self.phase is Phase.COUNTDOWN:
            return self.countdown_s if self.since_s is None else self.since_s + self.countdown_s - self.at_s
        if self.phase is Phase.CAPTURE:
            return max(KEEP_S - (self.window[-1][0] - self.window[0][0] if self.window else 0.0), 0.0)
        return 0.0

    def hand(self) -> tuple[Frames, Frames]:
        """Return the frames of the fist and of the open hand, whichever was shown first."""
        first, second = self.captured
        falls = sum(before > after for before, after in zip(_levels(first), _levels(second), strict=True))
        return (second, first) if falls >= len(FINGERS) - 1 else (first, second)

    def after(self, bend: Sequence[float], at_s: float) -> "Guide":
        """Return the guide once `bend` was measured at `at_s`."""
        if self.is_over:
            return self
        if self.since_s is None or not 0 <= at_s - self.at_s <= GAP_S:
            seen = self if self.since_s is not None else replace(self, lowest=min(bend), highest=max(bend))
            return replace(seen, since_s=at_s, at_s=at_s, window=())
        now = replace(self, at_s=at_s, lowest=min(self.lowest, *bend), highest=max(self.highest, *bend))
        if self.phase is Phase.COUNTDOWN:
            if at_s - self.since_s < self.countdown_s:
                return now
            return replace(now, phase=Phase.CAPTURE, since_s=at_s, window=((at_s, tuple(bend)),))
        return now._captured(tuple(bend), at_s, at_s - self.since_s)

    def _captured(self, bend: tuple[float, ...], at_s: float, waited_s: float) -> "Guide":
        window = (*(one for one in self.window if at_s - one[0] <= KEEP_S), (at_s, bend))
        now = replace(self, window=window)
        if len(window) < LEAST_FRAMES or at_s - window[0][0] < KEEP_S - (at_s - window[-2][0]):
            return replace(now, phase=Phase.GIVEN_UP) if waited_s >= GIVE_UP_S else now
        frames = tuple(frame for _, frame in window)
        restless = tuple(self._restless(frames))
        unchanged = not restless and bool(self.captured) and not self._has_moved(frames)
        now = replace(now, restless=restless, waits_for_change=unchanged and waited_s < UNCHANGED_FOR_S)
        if restless or now.waits_for_change:
            return replace(now, phase=Phase.GIVEN_UP) if waited_s >= GIVE_UP_S else now
        captured = (*self.captured, frames)
        over = len(captured) == len(self.steps)
        return replace(
            now,
            captured=captured,
            phase=Phase.DONE if over else Phase.COUNTDOWN,
            since_s=at_s,
            window=(),
            waits_for_change=False,
        )

    def _restless(self, frames: Frames) -> list[str]:
        """Return the fingers whose level differs between the quarters by more than noise and unrest make."""
        quarter = len(frames) / 4
        restless = []
        for finger, values in zip(FINGERS, zip(*frames, strict=True), strict=True):
            levels = [median(values[round(n * quarter) : round((n + 1) * quarter)]) for n in range(4)]
            moved = max(levels) - min(levels)
            steps = [abs(now - before) for before, now in pairwise(values)]
            noise = _DIFFERENCE_TO_SIGMA * median(steps)
            if moved > max(STILL * (self.highest - self.lowest), _NOISES * noise / quarter**0.5):
                restless.append(finger)
        return restless

    def _has_moved(self, frames: Frames) -> bool:
        most = MOVED * (self.highest - self.lowest)
        pairs = zip(_levels(self.captured[-1]), _levels(frames), strict=True)
        return sum(abs(before - now) > most for before, now in pairs) >= 2


def _levels(frames: Frames) -> list[float]:
    return [median(values) for values in zip(*frames, strict=True)]
