"""The recognizer by thresholds: bent below the lower, straight above the upper; it explains itself.

A finger that wavers between its thresholds keeps what it was for `KEEP_S`, so that a tremble does not break a
hold. A finger that stays between is half bent, and the hand then shows no gesture.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from services.gesture_controller.finger_states import BENT, BETWEEN, STRAIGHT, finger_states
from services.gesture_controller.frames import Frame
from services.gesture_controller.gestures import Gestures
from services.gesture_controller.recognition.recognizer import Given, Recognition
from services.gesture_controller.thresholds import FINGERS, Threshold, Thresholds

KEEP_S = 0.3


@dataclass(frozen=True, slots=True)
class _Steadied:
    """`code` is what counts, `since_s` when each finger came between its thresholds, `bend` as measured."""

    code: str
    since_s: tuple[float | None, ...]
    bend: list[float]


@dataclass(frozen=True, slots=True)
class ThresholdRecognizer:
    """Reads a hand with two thresholds a finger."""

    thresholds: Thresholds
    gestures: Gestures

    @classmethod
    def made_from(cls, given: Given) -> "ThresholdRecognizer":
        """Return the recognizer for the hand that `given` tells of."""
        return cls(given.thresholds, given.gestures)

    def see(self, before: Recognition | None, frame: Frame) -> Recognition:
        """Return what `frame` shows."""
        states = finger_states(frame.bend, self.thresholds)
        if BETWEEN not in states:
            memory = _Steadied(states, _NOBODY, frame.bend)
        else:
            memory = _steadied(states, None if before is None else before.memory, frame)
        gesture = self.gestures.names.get(memory.code)
        return Recognition(states, gesture, 1.0, frame.t_s, memory)

    def odds(self, seen: Recognition) -> Mapping[str, float]:
        """Return for each gesture how far its worst finger is between its thresholds, towards it."""
        bend = seen.memory.bend
        straight = [
            _share(value, threshold) for value, threshold in zip(bend, self.thresholds.fingers, strict=True)
        ]
        return {
            name: min(
                share if state == STRAIGHT else 1 - share for share, state in zip(straight, code, strict=True)
            )
            for name, code in self.gestures
        }

    def why(self, seen: Recognition) -> str:
        """Return each finger's value beside its thresholds, and what that makes."""
        fingers = zip(FINGERS, seen.memory.bend, self.thresholds.fingers, seen.states, strict=True)
        told = "; ".join(_told(*finger) for finger in fingers)
        return f"{told}: {seen.gesture or 'no gesture has these states'}"


_NOBODY: tuple[float | None, ...] = (None,) * len(FINGERS)


def _steadied(states: str, before: _Steadied | None, frame: Frame) -> _Steadied:
    if before is None:
        return _Steadied(states, _NOBODY, frame.bend)
    code, since_s = "", []
    for now, was, began_s in zip(states, before.code, before.since_s, strict=True):
        from_s = frame.t_s if began_s is None else began_s
        keeps = now == BETWEEN and was != BETWEEN and 0 <= frame.t_s - from_s < KEEP_S
        code += was if keeps else now
        since_s.append(from_s if now == BETWEEN else None)
    return _Steadied(code, tuple(since_s), frame.bend)


def _share(value: float, threshold: Threshold) -> float:
    width = threshold.upper - threshold.lower
    if width <= 0:
        return 1.0 if value > threshold.upper else 0.0
    return round(min(max((value - threshold.lower) / width, 0.0), 1.0), 3)


def _told(finger: str, value: float, threshold: Threshold, state: str) -> str:
    if state == STRAIGHT:
        return f"{finger} {value:g} is above {threshold.upper:g}, straight"
    if state == BENT:
        return f"{finger} {value:g} is below {threshold.lower:g}, bent"
    return f"{finger} {value:g} is between {threshold.lower:g} and {threshold.upper:g}"
