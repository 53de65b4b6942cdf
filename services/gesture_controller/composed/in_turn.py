"""In turn: two gestures of one hand, the second soon after the first.

The first is held as long as a gesture takes to be announced, the second for the rest of what a gesture takes
to count: so a sequence is held no shorter than a single gesture, and the hand must change on purpose between.
A wrong gesture that is held, too long a way, or a clock nobody can trust: it begins again from the first.
"""

from dataclasses import dataclass, replace

from services.gesture_controller.gestures import InTurn
from services.gesture_controller.hold import Hold, HoldEvent, HoldTiming


def second_ms(timing: HoldTiming) -> float:
    """Return how long the second is held: with the first, as long as one gesture that counts."""
    return timing.confirm_ms - timing.announce_ms


@dataclass(frozen=True, slots=True)
class Turn:
    """How far a hand has come in a sequence; all moments are on the glove's clock."""

    step: int = 0
    """How many of the two have been shown."""
    shown_s: float = 0.0
    """When the first was last seen, once it has been shown."""
    left_s: float | None = None
    """Since when the hand has not shown the first."""
    seen_s: float = float("-inf")
    first_ms: float = 0.0
    """How long the first has been held."""
    held_ms: float = 0.0
    """How long the part that is due has been held."""
    last: HoldEvent = HoldEvent.NONE
    """What the last frame did: ANNOUNCED when the first was shown, CONFIRMED at the end."""

    def after(self, asked: InTurn, hold: Hold, at_s: float, timing: HoldTiming) -> "Turn":
        """Return the turn once a frame at `at_s` has brought the hand to `hold`."""
        broken = not 0 <= (at_s - self.seen_s) * 1000 <= timing.gap_ms
        here = Turn() if broken else self
        kept_ms = 0.0 if hold.is_spent else hold.held_ms
        if here.step == 0:
            return here._first(asked, hold, kept_ms, at_s, timing)
        return here._second(asked, hold, kept_ms, at_s, timing)

    def _first(self, asked: InTurn, hold: Hold, kept_ms: float, at_s: float, timing: HoldTiming) -> "Turn":
        if hold.gesture != asked.first:
            return Turn(seen_s=at_s)
        if kept_ms < timing.announce_ms:
            return Turn(seen_s=at_s, held_ms=kept_ms)
        return Turn(1, at_s, None, at_s, kept_ms, 0.0, HoldEvent.ANNOUNCED)

    def _second(self, asked: InTurn, hold: Hold, kept_ms: float, at_s: float, timing: HoldTiming) -> "Turn":
        now = replace(self, seen_s=at_s, held_ms=0.0, last=HoldEvent.NONE)
        if self.left_s is None:
            if hold.gesture == asked.first:
                return replace(now, shown_s=at_s, first_ms=kept_ms)
            now = replace(now, left_s=at_s)
        left_s = now.left_s if now.left_s is not None else at_s
        let_go = asked.second != asked.first or (hold.since_s - left_s) * 1000 >= timing.release_ms
        if hold.gesture == asked.first and not let_go:
            return replace(now, shown_s=at_s, left_s=None)  # it only flickered
        in_time = (hold.since_s - self.shown_s) * 1000 <= timing.within_ms
        if hold.gesture == asked.second and in_time:
            if kept_ms >= second_ms(timing):
                return Turn(seen_s=at_s, held_ms=kept_ms, first_ms=self.first_ms, last=HoldEvent.CONFIRMED)
            return replace(now, held_ms=kept_ms)
        if hold.gesture == asked.first:
            again = Turn()._first(asked, hold, kept_ms, at_s, timing)
            return again if again.step else now if in_time else again
        strayed = hold.gesture is not None and kept_ms >= timing.announce_ms
        late = (at_s - self.shown_s) * 1000 > timing.within_ms
        return Turn(seen_s=at_s) if strayed or late else now
