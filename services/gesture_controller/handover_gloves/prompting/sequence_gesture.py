"""Sequence gestures: two gestures of one hand, the second soon after the first.

The first is held as long as a gesture takes to be announced, the second for the rest of the confirmation
time. So a sequence is held as long as a single gesture, and the hand must change on purpose in between. The
sequence starts again after another gesture that is held, a change that takes too long, or an unreliable
clock.
"""

from dataclasses import dataclass, replace

from handover_gloves.recognition.gestures import SequenceGesture
from handover_gloves.recognition.hold import Hold, HoldEvent, HoldTiming


def second_ms(timing: HoldTiming) -> float:
    """Return how long the second gesture is held."""
    return timing.confirm_ms - timing.announce_ms


@dataclass(frozen=True, slots=True)
class SequenceProgress:
    """The progress of one hand with a sequence; all moments are on the glove's clock."""

    step: int = 0
    """How many of the two gestures have been shown."""
    shown_s: float = 0.0
    """When the first gesture was last seen, once it has been shown."""
    left_s: float | None = None
    """Since when the hand has not shown the first gesture."""
    seen_s: float = float("-inf")
    first_ms: float = 0.0
    """How long the first gesture was held."""
    held_ms: float = 0.0
    """How long the gesture that is due has been held."""
    last: HoldEvent = HoldEvent.NONE
    """The event of the last frame: ANNOUNCED after the first gesture, CONFIRMED after the second."""

    def after(
        self, gesture: SequenceGesture, hold: Hold, at_s: float, timing: HoldTiming
    ) -> "SequenceProgress":
        """Return the progress after a frame at `at_s` with which the hand is at `hold`."""
        is_broken = not 0 <= (at_s - self.seen_s) * 1000 <= timing.gap_ms
        here = SequenceProgress() if is_broken else self
        kept_ms = 0.0 if hold.is_spent else hold.held_ms
        if here.step == 0:
            return here._after_first(gesture, hold, kept_ms, at_s, timing)
        return here._after_second(gesture, hold, kept_ms, at_s, timing)

    def _after_first(
        self, gesture: SequenceGesture, hold: Hold, kept_ms: float, at_s: float, timing: HoldTiming
    ) -> "SequenceProgress":
        if hold.gesture != gesture.first:
            return SequenceProgress(seen_s=at_s)
        if kept_ms < timing.announce_ms:
            return SequenceProgress(seen_s=at_s, held_ms=kept_ms)
        return SequenceProgress(1, at_s, None, at_s, kept_ms, 0.0, HoldEvent.ANNOUNCED)

    def _after_second(
        self, gesture: SequenceGesture, hold: Hold, kept_ms: float, at_s: float, timing: HoldTiming
    ) -> "SequenceProgress":
        now = replace(self, seen_s=at_s, held_ms=0.0, last=HoldEvent.NONE)
        if self.left_s is None:
            if hold.gesture == gesture.first:
                return replace(now, shown_s=at_s, first_ms=kept_ms)
            now = replace(now, left_s=at_s)
        left_s = now.left_s if now.left_s is not None else at_s
        was_released = gesture.second != gesture.first or (hold.since_s - left_s) * 1000 >= timing.release_ms
        if hold.gesture == gesture.first and not was_released:
            return replace(now, shown_s=at_s, left_s=None)  # the first gesture only flickered
        in_time = (hold.since_s - self.shown_s) * 1000 <= timing.within_ms
        if hold.gesture == gesture.second and in_time:
            if kept_ms >= second_ms(timing):
                return SequenceProgress(
                    seen_s=at_s, held_ms=kept_ms, first_ms=self.first_ms, last=HoldEvent.CONFIRMED
                )
            return replace(now, held_ms=kept_ms)
        if hold.gesture == gesture.first:
            again = SequenceProgress()._after_first(gesture, hold, kept_ms, at_s, timing)
            return again if again.step else now if in_time else again
        is_wrong = hold.gesture is not None and kept_ms >= timing.announce_ms
        is_late = (at_s - self.shown_s) * 1000 > timing.within_ms
        return SequenceProgress(seen_s=at_s) if is_wrong or is_late else now
