"""The calibration wizard: leads a person through a calibration, using only the frames of the glove.

Each step counts down, then waits until the hand has been still for a second. A person who is late is waited
for. The fist may also be shown in the step of the open hand, and the open hand in the step of the fist.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from statistics import median

from handover_gloves.recognition.levels import MIN_FRAMES
from handover_gloves.recognition.thresholds import FINGERS

COUNTDOWN_S = 3.0
CAPTURE_S = 1.0
"""How long the hand must be still."""

MAX_GAP_S = 1.0
"""A longer gap between frames restarts the capture."""

MAX_UNCHANGED_S = 15.0
"""A hand that has not moved since the fist is captured after this time: perhaps no sensor works."""

MAX_CAPTURE_S = 60.0

MAX_UNREST = 0.06
"""How far a finger may move during the capture, as a share of the range of all values so far."""

MIN_MOVEMENT = 0.08
"""A finger that moved by this share of that range has moved since the fist."""

_NOISES = 6.0
_DIFFERENCE_TO_SIGMA = 1.4826 / 2**0.5

Frames = tuple[tuple[float, ...], ...]


class Step(Enum):
    """What the person is asked to show."""

    FIST = "fist"
    OPEN = "open"
    GESTURE = "gesture"


class WizardPhase(Enum):
    """The progress within a step."""

    COUNTDOWN = "countdown"
    CAPTURE = "capture"
    DONE = "done"
    GIVEN_UP = "givenUp"
    INTERRUPTED = "interrupted"
    """The controller stopped during the calibration."""


HAND_STEPS = (Step.FIST, Step.OPEN)
SAMPLE_STEPS = (Step.GESTURE,)


@dataclass(frozen=True, slots=True)
class CalibrationWizard:
    """The progress of a calibration; times are on the glove's clock, in seconds."""

    steps: tuple[Step, ...] = HAND_STEPS
    countdown_s: float = COUNTDOWN_S
    phase: WizardPhase = WizardPhase.COUNTDOWN
    captured: tuple[Frames, ...] = ()
    """The frames of each finished step."""
    since_s: float | None = None
    """When this phase began; None until the first frame."""
    at_s: float = 0.0
    window: tuple[tuple[float, tuple[float, ...]], ...] = ()
    lowest: float = 0.0
    highest: float = 0.0
    restless: tuple[str, ...] = ()
    """The fingers that moved during the last second."""
    waits_for_change: bool = False
    """True if the hand is still, but has not changed since the previous step."""

    @property
    def is_over(self) -> bool:
        """True if no more frames are needed."""
        return self.phase in {WizardPhase.DONE, WizardPhase.GIVEN_UP, WizardPhase.INTERRUPTED}

    @property
    def step(self) -> Step:
        """The current or last step."""
        return self.steps[min(len(self.captured), len(self.steps) - 1)]

    @property
    def remaining_s(self) -> float:
        """The rest of the countdown, or of the second that the hand must be still."""
        if self.phase is WizardPhase.COUNTDOWN:
            return self.countdown_s if self.since_s is None else self.since_s + self.countdown_s - self.at_s
        if self.phase is WizardPhase.CAPTURE:
            return max(CAPTURE_S - (self.window[-1][0] - self.window[0][0] if self.window else 0.0), 0.0)
        return 0.0

    def hand(self) -> tuple[Frames, Frames]:
        """Return the frames of the fist and of the open hand, in either order of showing."""
        first, second = self.captured
        falls = sum(before > after for before, after in zip(_levels(first), _levels(second), strict=True))
        return (second, first) if falls >= len(FINGERS) - 1 else (first, second)

    def after(self, bend: Sequence[float], at_s: float) -> "CalibrationWizard":
        """Return the progress after a frame."""
        if self.is_over:
            return self
        if self.since_s is None or not 0 <= at_s - self.at_s <= MAX_GAP_S:
            seen = self if self.since_s is not None else replace(self, lowest=min(bend), highest=max(bend))
            return replace(seen, since_s=at_s, at_s=at_s, window=())
        now = replace(self, at_s=at_s, lowest=min(self.lowest, *bend), highest=max(self.highest, *bend))
        if self.phase is WizardPhase.COUNTDOWN:
            if at_s - self.since_s < self.countdown_s:
                return now
            return replace(now, phase=WizardPhase.CAPTURE, since_s=at_s, window=((at_s, tuple(bend)),))
        return now._after_capture(tuple(bend), at_s, at_s - self.since_s)

    def _after_capture(self, bend: tuple[float, ...], at_s: float, waited_s: float) -> "CalibrationWizard":
        window = (*(entry for entry in self.window if at_s - entry[0] <= CAPTURE_S), (at_s, bend))
        now = replace(self, window=window)
        if len(window) < MIN_FRAMES or at_s - window[0][0] < CAPTURE_S - (at_s - window[-2][0]):
            return replace(now, phase=WizardPhase.GIVEN_UP) if waited_s >= MAX_CAPTURE_S else now
        frames = tuple(frame for _, frame in window)
        restless = tuple(self._restless(frames))
        is_unchanged = not restless and bool(self.captured) and not self._has_moved(frames)
        now = replace(now, restless=restless, waits_for_change=is_unchanged and waited_s < MAX_UNCHANGED_S)
        if restless or now.waits_for_change:
            return replace(now, phase=WizardPhase.GIVEN_UP) if waited_s >= MAX_CAPTURE_S else now
        captured = (*self.captured, frames)
        return replace(
            now,
            captured=captured,
            phase=WizardPhase.DONE if len(captured) == len(self.steps) else WizardPhase.COUNTDOWN,
            since_s=at_s,
            window=(),
            waits_for_change=False,
        )

    def _restless(self, frames: Frames) -> list[str]:
        """Return the fingers whose level changes between the quarters by more than noise explains."""
        quarter = len(frames) / 4
        restless = []
        for finger, values in zip(FINGERS, zip(*frames, strict=True), strict=True):
            levels = [median(values[round(n * quarter) : round((n + 1) * quarter)]) for n in range(4)]
            moved = max(levels) - min(levels)
            steps = [abs(now - before) for before, now in pairwise(values)]
            noise = _DIFFERENCE_TO_SIGMA * median(steps)
            if moved > max(MAX_UNREST * (self.highest - self.lowest), _NOISES * noise / quarter**0.5):
                restless.append(finger)
        return restless

    def _has_moved(self, frames: Frames) -> bool:
        least = MIN_MOVEMENT * (self.highest - self.lowest)
        pairs = zip(_levels(self.captured[-1]), _levels(frames), strict=True)
        return sum(abs(before - now) > least for before, now in pairs) >= 2


def _levels(frames: Frames) -> list[float]:
    return [median(values) for values in zip(*frames, strict=True)]
