"""The interface of recognizers, which find the gesture in the frames of a glove, a camera or another device.

A recognizer is immutable. It returns the state that it needs for the next frame, and receives it again with
that frame. So recognizers can be tested, replayed and compared without a glove.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from handover_gloves.recognition.gestures import Gestures
from handover_gloves.recognition.levels import Calibration
from handover_gloves.recognition.thresholds import Thresholds


class Timed(Protocol):
    """A frame of any device, with a time on the device's own clock in seconds."""

    @property
    def t_s(self) -> float:
        """When it was measured."""


FrameT_contra = TypeVar("FrameT_contra", bound=Timed, contravariant=True)


@dataclass(frozen=True, slots=True)
class Recognition:
    """The result of a recognizer for a frame.

    `states` are the five fingers, thumb first (0 straight, 1 between, 2 bent). `gesture` is None for no
    gesture or in doubt. `certainty` (0 to 1) is that of this result. `memory` is private to the recognizer.
    `unclear_fingers` are the fingers that prevent the gesture of these states; the person should show them
    more clearly.
    """

    states: str
    gesture: str | None
    certainty: float
    at_s: float
    memory: Any = field(default=None, repr=False, compare=False)
    unclear_fingers: tuple[str, ...] = ()


class Recognizer(Protocol[FrameT_contra]):
    """Finds the gesture of a hand. All methods are pure; `see` must return within 100 µs."""

    def see(self, before: Recognition | None, frame: FrameT_contra) -> Recognition:
        """Return the result for `frame`; `before` is the previous result, None at the beginning.

        Time may jump (a gap, a clock that restarted), and frames arrive at 20 to 200 Hz.
        """

    def odds(self, seen: Recognition) -> Mapping[str, float]:
        """Return the score of each gesture from 0 to 1: a probability or a margin."""

    def why(self, seen: Recognition) -> str:
        """Return a sentence that explains `seen`."""


class CannotRecognize(ValueError):
    """A recognizer cannot work with this hand; the message says what is missing."""


@dataclass(frozen=True, slots=True)
class HandContext:
    """Everything known of a hand in a glove; the argument of a recognizer factory.

    `calibration` is None until the person has calibrated. `in_use` has the codes that the person may be asked
    for or gives commands with; empty means unknown.
    """

    thresholds: Thresholds
    gestures: Gestures
    calibration: Calibration | None = None
    in_use: frozenset[str] = frozenset()


class RecognizerFactory(Protocol):
    """A class or function that is registered under a name."""

    def __call__(self, context: HandContext) -> Recognizer[Any]:
        """Return a recognizer for the hand; raise `CannotRecognize` if `context` is not sufficient."""
