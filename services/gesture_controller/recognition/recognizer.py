"""Recognizers: whatever tells from a glove, a camera or any other device which gesture a hand shows.

A recognizer is a frozen value. What it must remember from one frame to the next it puts into what it
returns, and is given back with the next frame; so it can be tried, replayed and compared without a glove.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from services.gesture_controller.calibration.levels import Calibration
from services.gesture_controller.gestures import Gestures
from services.gesture_controller.thresholds import Thresholds


class Timed(Protocol):
    """A frame of any device: it has a time, on the device's own clock in seconds."""

    @property
    def t_s(self) -> float:
        """Return when it was measured."""


FrameT_contra = TypeVar("FrameT_contra", bound=Timed, contravariant=True)


@dataclass(frozen=True, slots=True)
class Recognition:
    """What a recognizer made of a frame.

    `states` are the five fingers for the page, thumb first (0 straight, 1 between, 2 bent); `gesture` is the
    name of what the hand shows, None for no gesture or in doubt; `certainty` (0 to 1) is that of this
    answer. `memory` is the recognizer's own, and is read by nobody else.
    """

    states: str
    gesture: str | None
    certainty: float
    at_s: float
    memory: Any = field(default=None, repr=False, compare=False)


class Recognizer(Protocol[FrameT_contra]):
    """Tells which gesture a hand shows. All methods are pure; `see` has 100 µs."""

    def see(self, before: Recognition | None, frame: FrameT_contra) -> Recognition:
        """Return what `frame` shows; `before` is what this method returned last, None at the beginning.

        Time may jump (a gap, a clock that began anew), and frames come at 20 to 200 Hz.
        """

    def odds(self, seen: Recognition) -> Mapping[str, float]:
        """Return for each gesture how much speaks for it, 0 to 1: a probability, or a margin."""

    def why(self, seen: Recognition) -> str:
        """Return in a sentence why `seen` was answered so."""


class CannotRecognize(ValueError):
    """A recognizer cannot work with what is known of this hand; the message says what it lacks."""


@dataclass(frozen=True, slots=True)
class Given:
    """All that is known of a hand in a glove, from which a recognizer is made.

    `calibration` is None until the person has calibrated; `in_use` are the codes of the gestures that they
    are asked for or give commands with, empty if that is not known.
    """

    thresholds: Thresholds
    gestures: Gestures
    calibration: Calibration | None = None
    in_use: frozenset[str] = frozenset()


class Maker(Protocol):
    """What is registered under a name: a class or a function."""

    def __call__(self, given: Given) -> Recognizer[Any]:
        """Return a recognizer for the hand; raise `CannotRecognize` if `given` does not suffice."""
