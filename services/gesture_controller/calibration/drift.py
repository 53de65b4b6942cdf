"""Drift: sensors warm up and a glove shifts; slow changes of level are followed while a gesture is held.

Only then is known where fingers should stand: one outside the room it should stand in moves its level there,
slowly, and never further. So following can only make clearer what the hand shows. A jump, or more drift than
is plausible, asks for a new calibration instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from services.gesture_controller.calibration.levels import Calibration, FingerLevels
from services.gesture_controller.finger_states import BETWEEN, STRAIGHT
from services.gesture_controller.thresholds import FINGERS, Threshold, Thresholds

TIME_S = 20.0
"""The time constant with which a level moves to where it should stand."""

FASTEST_PER_S = 0.01
"""The share of its span by which a level moves in a second at most."""

MOST = 0.25
"""The share of its span by which a level may drift; more asks for a new calibration."""

JUMP, JUMP_PER_S = 0.3, 12.0
"""A change by so much of the span, so fast, may be no finger: a tap takes 0.1 s for the whole span."""

JUMPED_FOR_S, ON_LEVEL = 1.0, 0.25
"""It was none if it stays for so long, further than this from fist and open hand."""

LOST_FOR_S = 2.0
FAR_BELOW, FAR_ABOVE = -1.2, 1.6
"""A finger out here for `LOST_FOR_S` is not worn as it was calibrated, or its sensor is broken."""

FINGERS_AT = range(len(FINGERS))
_ROOM_STRAIGHT, _ROOM_STRAIGHT_ALONE = (0.92, 1.06), (0.7, 1.1)
_ROOM_BENT, _ROOM_BENT_THUMB = (-0.2, 0.4), (-0.7, 0.5)
_AROUND_SAMPLE = 0.1
_CLEAR = 0.05
"""How far, as a share, following keeps a finger away from its thresholds at least."""

_STILL = (0.0,) * len(FINGERS)


@dataclass(frozen=True, slots=True)
class Jump:
    """The finger at `place` changed by `share` of its span within one frame."""

    place: int
    share: float
    at_s: float


@dataclass(frozen=True, slots=True)
class Drift:
    """How far the levels of the fingers have moved since the calibration, in raw units, thumb first."""

    offsets: tuple[float, ...] = _STILL
    wants_calibration: str | None = None
    """Why the hand should be calibrated again, as half a sentence; None while it need not."""
    bend: Sequence[float] = ()
    at_s: float = 0.0
    far_since_s: float | None = None
    jump: "Jump | None" = None
    """A change that was too fast for a finger, until it is known whether it stays."""

    def corrected(self, bend: Sequence[float]) -> list[float]:
        """Return `bend` as it would be without the drift."""
        return [value - offset for value, offset in zip(bend, self.offsets, strict=True)]

    def after(
        self,
        bend: Sequence[float],
        at_s: float,
        held: str | None,
        calibration: Calibration,
        thresholds: Thresholds,
    ) -> "Drift":
        """Return the drift once `bend` was measured at `at_s`.

        `held` is the code of the gesture that is being held, None while none is. Frames more than a second
        apart, and a clock that runs backwards, teach nothing.
        """
        passed_s = at_s - self.at_s
        if not self.bend or not 0 < passed_s <= 1.0:
            return replace(self, bend=bend, at_s=at_s, far_since_s=None, jump=None)
        far_since_s = self._far_since_s(bend, at_s, calibration.levels)
        jump = self._jump(bend, passed_s, at_s, calibration.levels)
        wants = self.wants_calibration or self._wish(bend, at_s, far_since_s, jump, calibration.levels)
        offsets = self.offsets
        if held is not None and BETWEEN not in held and wants is None:
            rooms = [_room(held, place, calibration, thresholds.fingers[place]) for place in FINGERS_AT]
            offsets = tuple(
                _moved(offset, value, level, room, passed_s)
                for offset, value, level, room in zip(offsets, bend, calibration.levels, rooms, strict=True)
            )
        return Drift(offsets, wants, bend, at_s, far_since_s, jump)

    def _jump(
        self, bend: Sequence[float], passed_s: float, at_s: float, levels: Sequence[FingerLevels]
    ) -> Jump | None:
        if self.jump is not None and _is_on_level(
            bend[self.jump.place] - self.offsets[self.jump.place], levels[self.jump.place]
        ):
            return None  # so it was a finger after all, or a spark
        if self.jump is not None:
            return self.jump
        for place, (before, now, level) in enumerate(zip(self.bend, bend, levels, strict=True)):
            change = abs(now - before) / level.span
            if change >= max(JUMP, JUMP_PER_S * passed_s) and not _is_on_level(
                now - self.offsets[place], level
            ):
                return Jump(place, change, at_s)
        return None

    def _wish(
        self,
        bend: Sequence[float],
        at_s: float,
        far_since_s: float | None,
        jump: Jump | None,
        levels: Sequence[FingerLevels],
    ) -> str | None:
        if jump is not None and at_s - jump.at_s >= JUMPED_FOR_S:
            return f"the level of the {FINGERS[jump.place]} jumped by {jump.share:.0%} of its span"
        for finger, offset, level in zip(FINGERS, self.offsets, levels, strict=True):
            if abs(offset) >= MOST * level.span:
                return f"the level of the {finger} has drifted by {MOST:.0%} of its span"
        if far_since_s is not None and at_s - far_since_s >= LOST_FOR_S:
            finger = next(
                name
                for name, value, level in zip(FINGERS, self.corrected(bend), levels, strict=True)
                if _is_far(value, level)
            )
            return f"the {finger} stands far outside what it showed from fist to open hand"
        return None

    def _far_since_s(
        self, bend: Sequence[float], at_s: float, levels: Sequence[FingerLevels]
    ) -> float | None:
        if not any(map(_is_far, self.corrected(bend), levels)):
            return None
        return at_s if self.far_since_s is None else self.far_since_s


def _is_on_level(value: float, level: FingerLevels) -> bool:
    share = (value - level.fist) / level.span
    return abs(share) <= ON_LEVEL or abs(share - 1) <= ON_LEVEL


def _is_far(value: float, level: FingerLevels) -> bool:
    return not FAR_BELOW <= (value - level.fist) / level.span <= FAR_ABOVE


def _room(code: str, place: int, calibration: Calibration, threshold: Threshold) -> tuple[float, float]:
    """Return between which shares the finger at `place` of a hand that shows `code` is to be expected."""
    level = calibration.levels[place]
    if code[place] == STRAIGHT:
        beside = code[max(place - 1, 0) : place + 2]
        alone = place == 0 or beside.count(STRAIGHT) == 1
        low, high = _ROOM_STRAIGHT_ALONE if alone else _ROOM_STRAIGHT
        high = max(high, (threshold.upper - level.fist) / level.span + _CLEAR)
        low = max(low, min((threshold.upper - level.fist) / level.span + _CLEAR, high))
    else:
        low, high = _ROOM_BENT_THUMB if place == 0 else _ROOM_BENT
        low = min(low, (threshold.lower - level.fist) / level.span - _CLEAR)
        high = min(high, max((threshold.lower - level.fist) / level.span - _CLEAR, low))
    for sample in calibration.samples:
        if sample.code == code:
            low = min(low, sample.shares[place] - _AROUND_SAMPLE)
            high = max(high, sample.shares[place] + _AROUND_SAMPLE)
    return low, high


def _moved(
    offset: float, value: float, level: FingerLevels, room: tuple[float, float], passed_s: float
) -> float:
    """Return `offset` moved so that `value` comes nearer to its `room`, by what `passed_s` allows."""
    share = (value - offset - level.fist) / level.span
    outside = max(share - room[1], 0.0) + min(share - room[0], 0.0)
    if outside == 0.0:
        return offset
    most = FASTEST_PER_S * passed_s
    step = min(max(outside * min(passed_s / TIME_S, 1.0), -most), most) * level.span
    return min(max(offset + step, -MOST * level.span), MOST * level.span)
