"""Two-hand gestures: one part is shown by the left glove of a person, the other by the right glove.

The hold counts from the moment at which the later hand begins, while both hands hold their parts. The hands
need not begin at the same moment, but a hand that has rested in its part for long must release it first. Each
glove has its own clock, so hold durations are compared, and both hands must have sent a frame recently.
"""

from dataclasses import dataclass

from handover_gloves.recognition.gestures import TwoHandGesture
from handover_gloves.recognition.hold import Hold, HoldEvent, HoldTiming


@dataclass(frozen=True, slots=True)
class ShownHand:
    """The hold of one hand, and when its last frame arrived (`at_s`, the controller's clock)."""

    hold: Hold
    at_s: float


@dataclass(frozen=True, slots=True)
class TwoHandProgress:
    """The progress of both hands."""

    held_ms: float = 0.0
    """How long both hands have held their parts."""
    reached: HoldEvent = HoldEvent.NONE
    last: HoldEvent = HoldEvent.NONE
    """The event of the last frame of either hand."""
    apart: bool = False
    """True while both hands show their parts, but one began too long before the other."""

    def after(
        self,
        gesture: TwoHandGesture,
        left: ShownHand | None,
        right: ShownHand | None,
        *,
        now_s: float,
        timing: HoldTiming,
    ) -> "TwoHandProgress":
        """Return the progress after a frame of either hand at `now_s`."""
        left_ms = _held_ms(left, gesture.left, now_s, timing)
        right_ms = _held_ms(right, gesture.right, now_s, timing)
        if left_ms is None or right_ms is None:
            return TwoHandProgress()
        if abs(left_ms - right_ms) > timing.apart_ms:
            return TwoHandProgress(apart=True)
        held_ms = min(left_ms, right_ms)
        reached = self.reached if held_ms >= self.held_ms else HoldEvent.NONE
        event = HoldEvent.NONE
        if reached is HoldEvent.NONE and held_ms >= timing.announce_ms:
            event = HoldEvent.ANNOUNCED
        elif reached is HoldEvent.ANNOUNCED and held_ms >= timing.confirm_ms:
            event = HoldEvent.CONFIRMED
        return TwoHandProgress(held_ms, reached if event is HoldEvent.NONE else event, event)


def _held_ms(shown: ShownHand | None, part: str, now_s: float, timing: HoldTiming) -> float | None:
    """Return how long a hand has held its part; None if it does not hold it, or sent nothing recently."""
    if shown is None or shown.hold.gesture != part or shown.hold.is_spent:
        return None
    if (now_s - shown.at_s) * 1000 > timing.gap_ms:
        return None
    return shown.hold.held_ms
