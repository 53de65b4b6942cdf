"""Drift: sensors warm up and a glove shifts; slow changes of level are followed while a gesture is held.

Only then is known where fingers should stand: one outside the room it should stand in moves its level there,
slowly, and never further. So following can only make clearer what the hand shows. A jump, or more drift than
is plausible, asks for a new calibration instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from services.gesture_controller.calibration.levels import Calibration
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

    def after(self, bend: Sequence[float], at_s: float, held: str | None, rooms: "Rooms") -> "Drift":
        """Return the drift once `bend` was measured at `at_s`.

        `held` is the code of the gesture that is being held, None while none is. Frames more than a second
        apart, and a clock that runs backwards, teach nothing.
        """
        passed_s = at_s - self.at_s
        if not self.bend or not 0 < passed_s <= 1.0:
            return replace(self, bend=bend, at_s=at_s, far_since_s=None, jump=None)
        far = rooms.far_from(bend, self.offsets)
        far_since_s = None if far is None else at_s if self.far_since_s is None else self.far_since_s
        jump = self._jump(bend, passed_s, at_s, rooms)
        wants = self.wants_calibration
        if wants is None and jump is not None and at_s - jump.at_s >= JUMPED_FOR_S:
            wants = f"the level of the {FINGERS[jump.place]} jumped by {jump.share:.0%} of its span"
        if wants is None and far is not None and far_since_s is not None and at_s - far_since_s >= LOST_FOR_S:
            wants = f"the {FINGERS[far]} stands far outside what it showed from fist to open hand"
        offsets = self.offsets
        if held is not None and BETWEEN not in held and wants is None:
            offsets = rooms.followed(held, bend, offsets, passed_s)
            if offsets is not self.offsets and (place := rooms.drifted(offsets)) is not None:
                wants = f"the level of the {FINGERS[place]} has drifted by {MOST:.0%} of its span"
        return Drift(offsets, wants, bend, at_s, far_since_s, jump)

    def _jump(self, bend: Sequence[float], passed_s: float, at_s: float, rooms: "Rooms") -> Jump | None:
        if self.jump is not None:
            place = self.jump.place
            on_level = rooms.is_on_level(place, bend[place] - self.offsets[place])
            return None if on_level else self.jump  # else it was a finger after all, or a spark
        least = max(JUMP, JUMP_PER_S * passed_s)
        for place, (before, now, span) in enumerate(zip(self.bend, bend, rooms.spans, strict=True)):
            change = abs(now - before)
            if change >= least * span and not rooms.is_on_level(place, now - self.offsets[place]):
                return Jump(place, change / span, at_s)
        return None


class Rooms:
    """Where the fingers of a hand are to be expected, in raw units, by what it shows."""

    def __init__(self, calibration: Calibration, thresholds: Thresholds) -> None:
        self._calibration = calibration
        self._thresholds = thresholds
        self._levels = calibration.levels
        self.spans = tuple(level.span for level in calibration.levels)
        self._near = [
            (level.fist + FAR_BELOW * level.span, level.fist + FAR_ABOVE * level.span)
            for level in calibration.levels
        ]
        self._rooms: dict[str, list[tuple[float, float]]] = {}

    def far_from(self, bend: Sequence[float], offsets: Sequence[float]) -> int | None:
        """Return the place of a finger that is where it cannot be; None if all may be where they are."""
        for place, (value, offset, (low, high)) in enumerate(zip(bend, offsets, self._near, strict=True)):
            if not low <= value - offset <= high:
                return place
        return None

    def is_on_level(self, place: int, value: float) -> bool:
        """Say whether a finger is near its level in the fist or in the open hand."""
        level, span = self._levels[place], self.spans[place]
        return abs(value - level.fist) <= ON_LEVEL * span or abs(value - level.open) <= ON_LEVEL * span

    def drifted(self, offsets: Sequence[float]) -> int | None:
        """Return the place of a finger whose level has drifted as far as it may; None if there is none."""
        for place, (offset, span) in enumerate(zip(offsets, self.spans, strict=True)):
            if abs(offset) >= MOST * span:
                return place
        return None

    def followed(
        self, code: str, bend: Sequence[float], offsets: tuple[float, ...], passed_s: float
    ) -> tuple[float, ...]:
        """Return `offsets` moved so that a hand that shows `code` comes nearer to its rooms."""
        rooms = self._rooms.get(code)
        if rooms is None:
            rooms = self._rooms[code] = [self._room(code, place) for place in FINGERS_AT]
        moved = None
        for place, (value, offset, (low, high)) in enumerate(zip(bend, offsets, rooms, strict=True)):
            stand = value - offset
            if low <= stand <= high:
                continue
            outside = stand - high if stand > high else stand - low
            span = self.spans[place]
            most = FASTEST_PER_S * passed_s * span
            step = min(max(outside * min(passed_s / TIME_S, 1.0), -most), most)
            moved = list(offsets) if moved is None else moved
            moved[place] = min(max(offset + step, -MOST * span), MOST * span)
        return offsets if moved is None else tuple(moved)

    def _room(self, code: str, place: int) -> tuple[float, float]:
        level, threshold = self._levels[place], self._thresholds.fingers[place]
        low, high = _room(code, place, self._calibration, threshold)
        return level.fist + low * level.span, level.fist + high * level.span


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
