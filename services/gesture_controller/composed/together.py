"""Together: a gesture of both hands, shown by the left and the right glove of one person.

It counts from when the later hand began, as long as both hold their parts. Hands need not begin at the same
moment, but one that has long been resting in its part must let go first. Each glove has a clock of its own;
what is compared is how long each has held, and that both have been heard of lately.
"""

from dataclasses import dataclass

from services.gesture_controller.gestures import TwoHanded
from services.gesture_controller.hold import Hold, HoldEvent, HoldTiming


@dataclass(frozen=True, slots=True)
class Shown:
    """What one hand shows: its hold, and when it was last heard of (`at_s`, the controller's clock)."""

    hold: Hold
    at_s: float


@dataclass(frozen=True, slots=True)
class Together:
    """How far both hands have come."""

    held_ms: float = 0.0
    """How long both have held their parts."""
    reached: HoldEvent = HoldEvent.NONE
    last: HoldEvent = HoldEvent.NONE
    """What the last frame of either did."""
    apart: bool = False
    """True while both show their parts, but one began too long before the other."""

    def after(
        self,
        asked: TwoHanded,
        left: Shown | None,
        right: Shown | None,
        *,
        now_s: float,
        timing: HoldTiming,
    ) -> "Together":
        """Return how far the hands have come once a frame of either has come at `now_s`."""
        left_ms = _held_ms(left, asked.left, now_s, timing)
        right_ms = _held_ms(right, asked.right, now_s, timing)
        if left_ms is None or right_ms is None:
            return Together()
        if abs(left_ms - right_ms) > timing.apart_ms:
            return Together(apart=True)
        held_ms = min(left_ms, right_ms)
        reached = self.reached if held_ms >= self.held_ms else HoldEvent.NONE
        event = HoldEvent.NONE
        if reached is HoldEvent.NONE and held_ms >= timing.announce_ms:
            event = HoldEvent.ANNOUNCED
        elif reached is HoldEvent.ANNOUNCED and held_ms >= timing.confirm_ms:
            event = HoldEvent.CONFIRMED
        return Together(held_ms, reached if event is HoldEvent.NONE else event, event)


def _held_ms(shown: Shown | None, part: str, now_s: float, timing: HoldTiming) -> float | None:
    """Return how long a hand has held its part; None if it does not, or if nobody has heard of it lately."""
    if shown is None or shown.hold.gesture != part or shown.hold.is_spent:
        return None
    if (now_s - shown.at_s) * 1000 > timing.gap_ms:
        return None
    return shown.hold.held_ms
