"""The threshold recognizer: a finger is bent below its lower threshold and straight above its upper one.

A finger between its thresholds is half bent, and the hand then shows no gesture. But the finger keeps its
previous state near the threshold that it passed last, and anywhere for `STEADY_S`, so that a tremble does not
break a hold. For a calibrated hand, a thumb in between follows the index finger, and a hand that may hold an
object is doubted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from handover_gloves.recognition.finger_states import BENT, BETWEEN, STRAIGHT, finger_states
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import Gestures
from handover_gloves.recognition.levels import FingerLevels
from handover_gloves.recognition.recognizer import HandContext, Recognition
from handover_gloves.recognition.thresholds import FINGERS, Threshold, Thresholds

STEADY_S = 0.3

LEEWAY = 1 / 3
"""Up to this share of the distance to the other threshold, a finger is near the one it passed last."""

APART, GRIP_APART = 0.4, 0.6
"""The least average distance of straight fingers from bent ones, as a share of their spans; the second is for
`GRIPS`.

An object keeps some fingers from closing and others from stretching. So the fingers of a working hand are
nearer together, though each of them may pass its threshold.
"""

GRIPS = frozenset({"02222", "20222", "00222", "00022", "22000", "20000"})
"""Gestures that resemble a hand around an object: a key or handle, a tool with the index finger along it, a
pinch, three fingertips, a pinch with the other fingers away, a plate. (T. Feix et al.: The GRASP Taxonomy of
Human Grasp Types, IEEE Trans. Human-Machine Systems 46, 2016.)
"""

SHORT = 0.2
"""A finger that is this far from the open hand, or from the fist, makes the states of a hand unclear."""


@dataclass(frozen=True, slots=True)
class _Steadied:
    """`code` is what counts, `since_s` when each finger came between its thresholds, `bend` the raw values.

    `close_since_s` is when straight and bent fingers came too near together for the gesture.
    """

    code: str
    since_s: tuple[float | None, ...]
    bend: list[float]
    close_since_s: float | None = None


@dataclass(frozen=True, slots=True)
class ThresholdRecognizer:
    """Classifies each finger by two thresholds."""

    thresholds: Thresholds
    gestures: Gestures
    levels: tuple[FingerLevels, ...] | None = None
    """The levels of fist and open hand; None until the hand is calibrated."""

    @classmethod
    def from_context(cls, context: HandContext) -> "ThresholdRecognizer":
        """Return the recognizer for the hand of `context`."""
        levels = None if context.calibration is None else context.calibration.levels
        return cls(context.thresholds, context.gestures, levels)

    def see(self, before: Recognition | None, frame: Frame) -> Recognition:
        """Return the result for `frame`."""
        states = finger_states(frame.bend, self.thresholds)
        code, since_s = states, _NONE_BETWEEN
        if BETWEEN in states:
            code = states if self.levels is None else _with_thumb_inferred(states)
            if BETWEEN in code and before is not None:
                code, since_s = self._steadied(code, before.memory, frame)
        gesture = self.gestures.names.get(code)
        if gesture is None or not self._is_close(code, frame.bend):
            return Recognition(states, gesture, 1.0, frame.t_s, _Steadied(code, since_s, frame.bend))
        close_since_s = _close_since_s(before, frame.t_s)
        memory = _Steadied(code, since_s, frame.bend, close_since_s)
        if before is not None and before.gesture == gesture and frame.t_s - close_since_s < STEADY_S:
            return Recognition(states, gesture, 1.0, frame.t_s, memory)
        unclear_fingers = self._short_fingers(code, frame.bend)
        return Recognition(states, None, 1.0, frame.t_s, memory, unclear_fingers)

    def odds(self, seen: Recognition) -> Mapping[str, float]:
        """Return for each gesture the position of its worst finger between the thresholds, from 0 to 1."""
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
        """Return the value and the thresholds of each finger, and the resulting gesture."""
        memory = seen.memory
        fingers = zip(FINGERS, memory.bend, self.thresholds.fingers, memory.code, strict=True)
        described = "; ".join(_described(*finger) for finger in fingers)
        meant = self.gestures.names.get(memory.code)
        if seen.gesture is None and meant is not None:
            apart, least = self._apart(memory.code, memory.bend), _min_apart(memory.code)
            return (
                f"{described}: {meant}, but as in a hand that holds something: straight fingers stand "
                f"{apart:.0%} above bent ones, and must stand {least:.0%} above them"
            )
        return f"{described}: {seen.gesture or 'no gesture has these states'}"

    def _is_close(self, code: str, bend: Sequence[float]) -> bool:
        if self.levels is None or len(set(code)) == 1:
            return False
        return self._apart(code, bend) < _min_apart(code)

    def _apart(self, code: str, bend: Sequence[float]) -> float:
        """Return the average distance of straight fingers from bent ones."""
        shares = self._shares(bend)
        straight = [share for share, state in zip(shares, code, strict=True) if state == STRAIGHT]
        return sum(straight) / len(straight) - (sum(shares) - sum(straight)) / (len(code) - len(straight))

    def _short_fingers(self, code: str, bend: Sequence[float]) -> tuple[str, ...]:
        """Return the one or two fingers that are furthest from the open hand, or from the fist."""
        short = {
            finger: 1 - share if state == STRAIGHT else share
            for finger, share, state in zip(FINGERS, self._shares(bend), code, strict=True)
        }
        worst = sorted(short, key=lambda finger: short[finger])[-2:]
        return tuple(finger for finger in FINGERS if finger in worst and short[finger] > SHORT)

    def _shares(self, bend: Sequence[float]) -> list[float]:
        levels = self.levels or ()
        return [(value - level.fist) / level.span for value, level in zip(bend, levels, strict=True)]

    def _steadied(self, states: str, before: _Steadied, frame: Frame) -> tuple[str, tuple[float | None, ...]]:
        code, since_s = list(states), list(_NONE_BETWEEN)
        for place, (now, previous) in enumerate(zip(states, before.code, strict=True)):
            if now != BETWEEN:
                continue
            if previous != BETWEEN and self._is_near(place, previous, frame.bend[place]):
                code[place] = previous
                continue
            began_s = before.since_s[place]
            since_s[place] = from_s = frame.t_s if began_s is None else began_s
            if previous != BETWEEN and 0 <= frame.t_s - from_s < STEADY_S:
                code[place] = previous
        return "".join(code), tuple(since_s)

    def _is_near(self, place: int, state: str, value: float) -> bool:
        threshold = self.thresholds.fingers[place]
        leeway = LEEWAY * (threshold.upper - threshold.lower)
        if state == STRAIGHT:
            return threshold.straight_margin(value) >= -leeway
        return threshold.bent_margin(value) >= -leeway


_NONE_BETWEEN: tuple[float | None, ...] = (None,) * len(FINGERS)


def _with_thumb_inferred(states: str) -> str:
    """Return `states` with a thumb in between replaced by its more likely state.

    A straight index finger lifts a bent thumb. Beside a bent index finger, a thumb that is stretched with
    other fingers does not reach the open hand; a thumb that is stretched alone does.
    """
    thumb, index = states[0], states[1]
    if thumb != BETWEEN or index == BETWEEN:
        return states
    return (STRAIGHT if index == BENT and STRAIGHT in states else BENT) + states[1:]


def _min_apart(code: str) -> float:
    return GRIP_APART if code in GRIPS else APART


def _close_since_s(before: Recognition | None, at_s: float) -> float:
    """Return when straight and bent fingers came too near together, given that they are so at `at_s`."""
    since_s = None if before is None else before.memory.close_since_s
    return at_s if since_s is None or since_s > at_s else float(since_s)


def _share(value: float, threshold: Threshold) -> float:
    width = threshold.upper - threshold.lower
    if width <= 0:
        return 1.0 if threshold.straight_margin(value) > 0 else 0.0
    return round(min(max(-threshold.bent_margin(value) / width, 0.0), 1.0), 3)


def _described(finger: str, value: float, threshold: Threshold, state: str) -> str:
    if threshold.lower <= value <= threshold.upper:
        taken = {STRAIGHT: ", taken for straight", BENT: ", taken for bent"}.get(state, "")
        return f"{finger} {value:g} is between {threshold.lower:g} and {threshold.upper:g}{taken}"
    is_above = value > threshold.upper
    side, bound = ("above", threshold.upper) if is_above else ("below", threshold.lower)
    shown = "bent" if is_above == threshold.inverted else "straight"
    return f"{finger} {value:g} is {side} {bound:g}, {shown}"
