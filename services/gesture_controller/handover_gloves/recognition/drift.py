"""Drift correction: follows slow changes of sensor levels while a gesture is held.

Sensors warm up, and a glove shifts on the hand. The expected position of a finger is known only while a
gesture is held. A finger outside its expected range then moves its level slowly to the edge of the range,
never further. So the correction can only make the shown gesture clearer. A jump, or implausible drift,
requests a new calibration instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from handover_gloves.recognition.finger_states import BETWEEN, STRAIGHT
from handover_gloves.recognition.levels import Calibration, FingerLevels
from handover_gloves.recognition.thresholds import FINGERS, Threshold, Thresholds

TIME_S = 20.0
"""The time constant of the correction."""

MAX_RATE_PER_S = 0.01
"""The largest correction in a second, as a share of the span."""

MAX_DRIFT = 0.25
"""The largest correction in total, as a share of the span; more requests a calibration."""

JUMP, JUMP_PER_S = 0.3, 12.0
"""A change by this share of the span at this speed may be no movement: a tap takes 0.1 s for the span."""

MIN_JUMP_DURATION_S, ON_LEVEL = 1.0, 0.25
"""It is a jump if the level stays for this time, further than `ON_LEVEL` from fist and open hand."""

MIN_OUT_OF_RANGE_S = 2.0
FAR_BELOW, FAR_ABOVE = -1.2, 1.6
"""A finger outside these shares for `MIN_OUT_OF_RANGE_S` means a shifted glove or a broken sensor."""

FINGERS_AT = range(len(FINGERS))
_RANGE_STRAIGHT, _RANGE_STRAIGHT_ALONE = (0.92, 1.06), (0.7, 1.1)
_RANGE_BENT, _RANGE_BENT_THUMB = (-0.2, 0.4), (-0.7, 0.5)
_AROUND_SAMPLE = 0.1
_CLEAR = 0.05
"""The least distance of the expected ranges from the thresholds, as a share of the span."""

_STILL = (0.0,) * len(FINGERS)


@dataclass(frozen=True, slots=True)
class Jump:
    """The finger at `place` changed by `share` of its span within one frame."""

    place: int
    share: float
    at_s: float


@dataclass(frozen=True, slots=True)
class Drift:
    """The drift of each level since the calibration, in raw units, thumb first."""

    offsets: tuple[float, ...] = _STILL
    wants_calibration: str | None = None
    """The reason for a new calibration as half a sentence, if one is needed."""
    bend: Sequence[float] = ()
    at_s: float = 0.0
    far_since_s: float | None = None
    jump: "Jump | None" = None
    """A change that was too fast for a movement, until it has ended or is confirmed."""

    def corrected(self, bend: Sequence[float]) -> list[float]:
        """Return `bend` without the drift."""
        return [value - offset for value, offset in zip(bend, self.offsets, strict=True)]

    def after(
        self, bend: Sequence[float], at_s: float, held_code: str | None, bounds: "DriftBounds"
    ) -> "Drift":
        """Return the drift after `bend` was measured at `at_s`.

        `held_code` is the code of the gesture that is held, None if there is none. Frames more than a second
        apart, and a clock that runs backwards, change nothing.
        """
        passed_s = at_s - self.at_s
        if not self.bend or not 0 < passed_s <= 1.0:
            return replace(self, bend=bend, at_s=at_s, far_since_s=None, jump=None)
        far = bounds.far_from(bend, self.offsets)
        far_since_s = None if far is None else at_s if self.far_since_s is None else self.far_since_s
        jump = self._jump(bend, passed_s, at_s, bounds)
        wants = self.wants_calibration
        if wants is None and jump is not None and at_s - jump.at_s >= MIN_JUMP_DURATION_S:
            wants = f"the level of the {FINGERS[jump.place]} jumped by {jump.share:.0%} of its span"
        if (
            wants is None
            and far is not None
            and far_since_s is not None
            and at_s - far_since_s >= MIN_OUT_OF_RANGE_S
        ):
            wants = f"the {FINGERS[far]} stands far outside what it showed from fist to open hand"
        offsets = self.offsets
        if held_code is not None and BETWEEN not in held_code and wants is None:
            offsets = bounds.followed(held_code, bend, offsets, passed_s)
            if offsets is not self.offsets and (place := bounds.drifted(offsets)) is not None:
                wants = f"the level of the {FINGERS[place]} has drifted by {MAX_DRIFT:.0%} of its span"
        return Drift(offsets, wants, bend, at_s, far_since_s, jump)

    def _jump(
        self, bend: Sequence[float], passed_s: float, at_s: float, bounds: "DriftBounds"
    ) -> Jump | None:
        if self.jump is not None:
            place = self.jump.place
            on_level = bounds.is_on_level(place, bend[place] - self.offsets[place])
            return None if on_level else self.jump  # back on a level: it was a movement or a spike
        least = max(JUMP, JUMP_PER_S * passed_s)
        for place, (before, now, span) in enumerate(zip(self.bend, bend, bounds.spans, strict=True)):
            change = abs(now - before)
            if change >= least * span and not bounds.is_on_level(place, now - self.offsets[place]):
                return Jump(place, change / span, at_s)
        return None


class DriftBounds:
    """The expected range of each finger for each code, in raw units."""

    def __init__(self, calibration: Calibration, thresholds: Thresholds) -> None:
        self._calibration = calibration
        self._thresholds = thresholds
        self._levels = calibration.levels
        self.spans = tuple(abs(level.span) for level in calibration.levels)
        self._near = [_between(level, FAR_BELOW, FAR_ABOVE) for level in calibration.levels]
        self._ranges: dict[str, list[tuple[float, float]]] = {}

    def far_from(self, bend: Sequence[float], offsets: Sequence[float]) -> int | None:
        """Return the index of a finger outside its possible range; None if there is none."""
        for place, (value, offset, (low, high)) in enumerate(zip(bend, offsets, self._near, strict=True)):
            if not low <= value - offset <= high:
                return place
        return None

    def is_on_level(self, place: int, value: float) -> bool:
        """Return True if a finger is near its level in the fist or in the open hand."""
        level, span = self._levels[place], self.spans[place]
        return abs(value - level.fist) <= ON_LEVEL * span or abs(value - level.open) <= ON_LEVEL * span

    def drifted(self, offsets: Sequence[float]) -> int | None:
        """Return the index of a finger whose drift has reached the limit; None if there is none."""
        for place, (offset, span) in enumerate(zip(offsets, self.spans, strict=True)):
            if abs(offset) >= MAX_DRIFT * span:
                return place
        return None

    def followed(
        self, code: str, bend: Sequence[float], offsets: tuple[float, ...], passed_s: float
    ) -> tuple[float, ...]:
        """Return `offsets` moved so that a hand that shows `code` comes nearer to its expected ranges."""
        ranges = self._ranges.get(code)
        if ranges is None:
            ranges = self._ranges[code] = [self._range(code, place) for place in FINGERS_AT]
        moved = None
        for place, (value, offset, (low, high)) in enumerate(zip(bend, offsets, ranges, strict=True)):
            stand = value - offset
            if low <= stand <= high:
                continue
            outside = stand - high if stand > high else stand - low
            span = self.spans[place]
            most = MAX_RATE_PER_S * passed_s * span
            step = min(max(outside * min(passed_s / TIME_S, 1.0), -most), most)
            moved = list(offsets) if moved is None else moved
            moved[place] = min(max(offset + step, -MAX_DRIFT * span), MAX_DRIFT * span)
        return offsets if moved is None else tuple(moved)

    def _range(self, code: str, place: int) -> tuple[float, float]:
        level, threshold = self._levels[place], self._thresholds.fingers[place]
        low, high = _range_of(code, place, self._calibration, threshold)
        return _between(level, low, high)


def _between(level: FingerLevels, low: float, high: float) -> tuple[float, float]:
    """Return the range between two shares of the span, in raw units."""
    ends = level.fist + low * level.span, level.fist + high * level.span
    return min(ends), max(ends)


def _range_of(code: str, place: int, calibration: Calibration, threshold: Threshold) -> tuple[float, float]:
    """Return the expected range, in shares, of the finger at `place` of a hand that shows `code`."""
    level = calibration.levels[place]
    if code[place] == STRAIGHT:
        beside = code[max(place - 1, 0) : place + 2]
        alone = place == 0 or beside.count(STRAIGHT) == 1
        low, high = _RANGE_STRAIGHT_ALONE if alone else _RANGE_STRAIGHT
        high = max(high, (threshold.straight - level.fist) / level.span + _CLEAR)
        low = max(low, min((threshold.straight - level.fist) / level.span + _CLEAR, high))
    else:
        low, high = _RANGE_BENT_THUMB if place == 0 else _RANGE_BENT
        low = min(low, (threshold.bent - level.fist) / level.span - _CLEAR)
        high = min(high, max((threshold.bent - level.fist) / level.span - _CLEAR, low))
    for sample in calibration.samples:
        if sample.code == code:
            low = min(low, sample.shares[place] - _AROUND_SAMPLE)
            high = max(high, sample.shares[place] + _AROUND_SAMPLE)
    return low, high
