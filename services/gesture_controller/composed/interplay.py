"""Interplay: what a hand means together with what it showed before, or with the other hand of its person."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

from services.gesture_controller.composed.in_turn import Turn
from services.gesture_controller.composed.together import Shown, Together
from services.gesture_controller.errand import Errand
from services.gesture_controller.gestures import Commands, InTurn, Part, TwoHanded
from services.gesture_controller.hold import HoldEvent
from services.gesture_controller.pipeline import Senses, Sight


class HandInGlove(Protocol):
    """A hand, as far as it plays together with another."""

    @property
    def hand(self) -> str:
        """`left` or `right`."""

    @property
    def sight(self) -> Sight:
        """What it shows."""

    @property
    def last_s(self) -> float:
        """When it was last heard of, on the controller's clock."""

    @property
    def senses(self) -> Senses:
        """The gestures it knows, and how long is a hold."""

    @property
    def commands(self) -> Commands:
        """The commands that its gestures stand for."""

    @property
    def interplay(self) -> "Interplay":
        """How far it has come with what nobody asked for."""

    @property
    def testing(self) -> bool:
        """True while nothing that it shows counts."""

    @property
    def paused(self) -> bool:
        """True while its wearer has paused the work."""

    @property
    def filtering(self) -> bool:
        """True while only what is asked for counts."""

    @property
    def other_hand(self) -> Callable[[], Self | None]:
        """Finds the glove on the other hand of the same person."""


Hand = TypeVar("Hand", bound=HandInGlove)


@dataclass(frozen=True, slots=True)
class Commanded(Generic[Hand]):
    """A composed gesture that was shown as a command, and the hands that have shown it."""

    gesture: str
    hands: tuple[Hand, ...]


class Interplay:
    """How far a hand has come with composed gestures."""

    def __init__(self) -> None:
        self._turns: dict[str, Turn] = {}
        self._together: dict[str, Together] = {}

    def clear(self) -> None:
        """Begin anew."""
        self._turns.clear()
        self._together.clear()

    def commanded(self, hand: Hand, asked: str | None, now_s: float) -> "Commanded[Hand] | None":
        """Return the composed gesture that the last frame has completed and that has a command.

        The one that is `asked` for is left out: it answers, and is not a command of its own.
        """
        other = hand.other_hand()
        if other is not None and (other.testing or other.paused or other.filtering):
            other = None
        for name, composed in hand.senses.gestures.composed.items():
            if name not in hand.commands.ids or name == asked:
                continue
            if self._after(name, composed, hand, other, now_s) is HoldEvent.CONFIRMED:
                both = isinstance(composed, TwoHanded) and other is not None
                return Commanded(name, (hand, other) if both and other is not None else (hand,))
        return None

    def _after(
        self,
        name: str,
        composed: InTurn | TwoHanded,
        hand: HandInGlove,
        other: HandInGlove | None,
        now_s: float,
    ) -> HoldEvent:
        if isinstance(composed, InTurn):
            turn = turn_after(self._turns.get(name, Turn()), composed, hand)
            self._turns[name] = turn
            return turn.last
        both = together_after(self._together.get(name, Together()), composed, hand, other, now_s)
        self._together[name] = both
        if other is not None:
            other.interplay._together[name] = both
        return both.last


def fresh(errand: Errand) -> Turn | Together:
    """Return the progress of an errand with which nobody has begun."""
    return Turn() if isinstance(errand.asked.composed, InTurn) else Together()


def due_of(errand: Errand, hand: str) -> Part:
    """Return what `errand` asks of the `left` or `right` hand at this moment."""
    asked = errand.asked
    if isinstance(errand.progress, Turn):
        return asked.parts[errand.progress.step]
    own = next((part for part in asked.parts if part.hand == hand), None)
    return own or Part(asked.gesture, asked.code)


def answered(errand: Errand, hand: HandInGlove, partner: HandInGlove | None, now_s: float) -> float | None:
    """Take the last frame of `hand` to the progress of `errand`.

    Returns for how long the composed gesture was held (ms) once it counts, None before.
    """
    asked, before = errand.asked.composed, errand.progress
    if isinstance(asked, InTurn) and isinstance(before, Turn):
        errand.progress = turn = turn_after(before, asked, hand)
        return turn.first_ms + turn.held_ms if turn.last is HoldEvent.CONFIRMED else None
    if isinstance(asked, TwoHanded) and isinstance(before, Together):
        errand.progress = both = together_after(before, asked, hand, partner, now_s)
        return both.held_ms if both.last is HoldEvent.CONFIRMED else None
    return None


def turn_after(before: Turn, asked: InTurn, hand: HandInGlove) -> Turn:
    """Return how far `hand` has come with two gestures in turn."""
    hold = hand.sight.hold
    return before.after(asked, hold, hold.seen_s, hand.senses.timing)


def together_after(
    before: Together, asked: TwoHanded, hand: HandInGlove, other: HandInGlove | None, now_s: float
) -> Together:
    """Return how far both hands have come with a gesture of both."""
    shown = {one.hand: Shown(one.sight.hold, one.last_s) for one in (hand, other) if one is not None}
    return before.after(asked, shown.get("left"), shown.get("right"), now_s=now_s, timing=hand.senses.timing)


def is_part_of_more(gesture: str, hand: HandInGlove, errand: Errand | None) -> bool:
    """Say whether `gesture` is shown as a part of what is asked, or of a command of both hands."""
    if errand is not None and any(part.gesture == gesture for part in errand.asked.parts):
        return True
    other = hand.other_hand()
    if other is None:
        return False
    shown = {hand.hand: gesture, other.hand: other.sight.gesture}
    pair = TwoHanded(shown.get("left") or "", shown.get("right") or "")
    composed = hand.senses.gestures.composed
    return any(composed.get(name) == pair for name in hand.commands.ids)
