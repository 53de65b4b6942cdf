"""Composite gestures: the progress of one hand, or of both hands of a person, with each of them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

from handover_gloves.prompting.modes import GloveModes
from handover_gloves.prompting.prompt import GesturePrompt
from handover_gloves.prompting.sequence_gesture import SequenceProgress
from handover_gloves.prompting.two_hand_gesture import ShownHand, TwoHandProgress
from handover_gloves.recognition.gestures import Commands, Part, SequenceGesture, TwoHandGesture
from handover_gloves.recognition.hand_reader import HandReader
from handover_gloves.recognition.hold import HoldEvent


class CompositeHand(Protocol):
    """What composite gestures need to know of a hand."""

    @property
    def hand(self) -> str:
        """`left` or `right`."""

    @property
    def last_s(self) -> float:
        """When its last frame arrived, on the controller's clock."""

    @property
    def reader(self) -> HandReader:
        """The recognition of the hand."""

    @property
    def commands(self) -> Commands:
        """The commands of its gestures."""

    @property
    def tracker(self) -> "CompositeTracker":
        """Its progress with composite gestures that are commands."""

    @property
    def modes(self) -> GloveModes:
        """Which of its gestures count."""

    @property
    def other_hand(self) -> Callable[[], Self | None]:
        """Returns the other hand of the same person, if it has a glove."""


Hand = TypeVar("Hand", bound=CompositeHand)


@dataclass(frozen=True, slots=True)
class CompositeCommand(Generic[Hand]):
    """A completed composite gesture that is a command, and the hands that showed it."""

    gesture: str
    hands: tuple[Hand, ...]


class CompositeTracker:
    """The progress of a hand with the composite gestures that are commands."""

    def __init__(self) -> None:
        self._sequences: dict[str, SequenceProgress] = {}
        self._two_hands: dict[str, TwoHandProgress] = {}

    def clear(self) -> None:
        """Start again with every gesture."""
        self._sequences.clear()
        self._two_hands.clear()

    def completed_command(
        self, hand: Hand, prompted: str | None, now_s: float
    ) -> "CompositeCommand[Hand] | None":
        """Return the composite gesture with a command that the last frame completed, if any.

        The `prompted` gesture is skipped: it answers the prompt and is no command of its own.
        """
        other = hand.other_hand()
        if other is not None and (other.modes.testing or other.modes.paused or other.modes.filtering):
            other = None
        for name, composite in hand.reader.config.gestures.composites.items():
            if name not in hand.commands.ids or name == prompted:
                continue
            if self._advance(name, composite, hand, other, now_s) is HoldEvent.CONFIRMED:
                both = isinstance(composite, TwoHandGesture) and other is not None
                return CompositeCommand(name, (hand, other) if both and other is not None else (hand,))
        return None

    def _advance(
        self,
        name: str,
        composite: SequenceGesture | TwoHandGesture,
        hand: CompositeHand,
        other: CompositeHand | None,
        now_s: float,
    ) -> HoldEvent:
        if isinstance(composite, SequenceGesture):
            sequence = advance_sequence(self._sequences.get(name, SequenceProgress()), composite, hand)
            self._sequences[name] = sequence
            return sequence.last
        before = self._two_hands.get(name, TwoHandProgress())
        both = advance_two_hands(before, composite, hand, other, now_s)
        self._two_hands[name] = both
        if other is not None:
            other.tracker._two_hands[name] = both
        return both.last


def initial_progress(prompt: GesturePrompt) -> SequenceProgress | TwoHandProgress:
    """Return the progress of a prompt before the first frame."""
    return SequenceProgress() if isinstance(prompt.spec.composite, SequenceGesture) else TwoHandProgress()


def due_part(prompt: GesturePrompt, hand: str) -> Part:
    """Return what `prompt` asks of the `left` or `right` hand at this moment."""
    spec = prompt.spec
    if isinstance(prompt.progress, SequenceProgress):
        return spec.parts[prompt.progress.step]
    own = next((part for part in spec.parts if part.hand == hand), None)
    return own or Part(spec.gesture, spec.code)


def advance_prompt(
    prompt: GesturePrompt, hand: CompositeHand, partner: CompositeHand | None, now_s: float
) -> float | None:
    """Update the progress of `prompt` with the last frame of `hand`.

    Returns how long the composite gesture was held (ms) once it counts, else None.
    """
    composite, before = prompt.spec.composite, prompt.progress
    if isinstance(composite, SequenceGesture) and isinstance(before, SequenceProgress):
        prompt.progress = sequence = advance_sequence(before, composite, hand)
        return sequence.first_ms + sequence.held_ms if sequence.last is HoldEvent.CONFIRMED else None
    if isinstance(composite, TwoHandGesture) and isinstance(before, TwoHandProgress):
        prompt.progress = both = advance_two_hands(before, composite, hand, partner, now_s)
        return both.held_ms if both.last is HoldEvent.CONFIRMED else None
    return None


def advance_sequence(
    before: SequenceProgress, gesture: SequenceGesture, hand: CompositeHand
) -> SequenceProgress:
    """Return the progress with a sequence after the last frame of `hand`."""
    hold = hand.reader.state.hold
    return before.after(gesture, hold, hold.seen_s, hand.reader.config.timing)


def advance_two_hands(
    before: TwoHandProgress,
    gesture: TwoHandGesture,
    hand: CompositeHand,
    other: CompositeHand | None,
    now_s: float,
) -> TwoHandProgress:
    """Return the progress with a two-hand gesture after the last frame of `hand`."""
    shown = {
        shape.hand: ShownHand(shape.reader.state.hold, shape.last_s)
        for shape in (hand, other)
        if shape is not None
    }
    timing = hand.reader.config.timing
    return before.after(gesture, shown.get("left"), shown.get("right"), now_s=now_s, timing=timing)


def is_part_of_composite(gesture: str, hand: CompositeHand, prompt: GesturePrompt | None) -> bool:
    """Return True if `gesture` is a part of the prompted gesture, or of a two-hand command being shown."""
    if prompt is not None and any(part.gesture == gesture for part in prompt.spec.parts):
        return True
    other = hand.other_hand()
    if other is None:
        return False
    shown = {hand.hand: gesture, other.hand: other.reader.state.gesture}
    pair = TwoHandGesture(shown.get("left") or "", shown.get("right") or "")
    composites = hand.reader.config.gestures.composites
    return any(composites.get(name) == pair for name in hand.commands.ids)
