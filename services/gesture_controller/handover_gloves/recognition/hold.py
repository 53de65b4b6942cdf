"""Hold: how long a gesture has been kept, and what that means.

A gesture kept for `announce_ms` is announced to the operator; kept for `confirm_ms` it counts. Letting go,
or changing the gesture, starts again from zero. (Machines 2022, 10, 957, Algorithm 1.) A hold that has
counted is spent: the hand must leave the gesture before the same gesture can count again.
"""

from dataclasses import dataclass, replace
from enum import Enum

LONG_AGO = float("-inf")


class HoldEvent(Enum):
    """What a frame did to the hold."""

    NONE = "none"
    ANNOUNCED = "announced"
    CONFIRMED = "confirmed"


@dataclass(frozen=True, slots=True)
class HoldTiming:
    """How long is long enough. Frames more than `gap_ms` apart break a hold; `release_ms` away is let go.

    One of two hands may begin `apart_ms` after the other; the second of two gestures in turn must begin
    `within_ms` after the first was let go.
    """

    announce_ms: float = 500
    confirm_ms: float = 1500
    gap_ms: float = 250
    release_ms: float = 100
    apart_ms: float = 2000
    within_ms: float = 3000


@dataclass(frozen=True, slots=True)
class Hold:
    """A gesture, since when (`since_s`) and until when (`seen_s`, both on the glove's clock) it was kept."""

    gesture: str | None = None
    since_s: float = 0.0
    seen_s: float = LONG_AGO
    last: HoldEvent = HoldEvent.NONE
    """What the last frame did."""
    reached: HoldEvent = HoldEvent.NONE
    """The furthest this hold has come."""
    spent: str | None = None
    """The gesture that counted last and that the hand has not left since."""
    left_s: float | None = None
    """Since when the hand has been away from the spent gesture."""

    @property
    def held_ms(self) -> float:
        """Return for how long the gesture has been kept, to the microsecond."""
        if self.gesture is None:
            return 0.0
        return max(round((self.seen_s - self.since_s) * 1000, 3), 0.0)

    @property
    def is_spent(self) -> bool:
        """Say whether the hand still shows a gesture that has counted already."""
        return self.gesture is not None and self.gesture == self.spent

    def after(self, gesture: str | None, at_s: float, timing: HoldTiming) -> "Hold":
        """Return the hold once `gesture` has been seen at `at_s`; `last` is what just happened.

        A clock that runs backwards, or a gap, breaks the hold: nobody saw what the hand did meanwhile.
        """
        broken = not 0 <= (at_s - self.seen_s) * 1000 <= timing.gap_ms
        spent, left_s = (
            (None, None) if self.spent is None else self._spent_after(gesture, at_s, broken, timing)
        )
        if gesture is None or gesture != self.gesture or broken:
            return Hold(gesture, at_s, at_s, HoldEvent.NONE, HoldEvent.NONE, spent, left_s)
        event = HoldEvent.NONE if gesture == spent else self._event(at_s, timing)
        reached = self.reached if event is HoldEvent.NONE else event
        return Hold(gesture, self.since_s, at_s, event, reached, spent, left_s)

    def mark_spent(self) -> "Hold":
        """Return the hold once it has counted."""
        return replace(self, spent=self.gesture, left_s=None)

    def restarted(self) -> "Hold":
        """Return the hold as it begins again with the next frame; what is spent stays so."""
        return Hold(spent=self.spent)

    def _event(self, at_s: float, timing: HoldTiming) -> HoldEvent:
        held_ms = round((at_s - self.since_s) * 1000, 3)
        if self.reached is HoldEvent.NONE and held_ms >= timing.announce_ms:
            return HoldEvent.ANNOUNCED
        if self.reached is HoldEvent.ANNOUNCED and held_ms >= timing.confirm_ms:
            return HoldEvent.CONFIRMED
        return HoldEvent.NONE

    def _spent_after(
        self, gesture: str | None, at_s: float, broken: bool, timing: HoldTiming
    ) -> tuple[str | None, float | None]:
        if gesture == self.spent:
            return self.spent, None
        if self.left_s is None or broken:
            return self.spent, at_s
        if (at_s - self.left_s) * 1000 >= timing.release_ms:
            return None, None
        return self.spent, self.left_s
