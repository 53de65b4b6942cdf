"""A recognizer that returns the gesture whose finger positions are nearest to the hand."""

from collections.abc import Mapping

from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.recognizer import CannotRecognize, HandContext, Recognition

MAX_DISTANCE = 0.35
STRAIGHT_ABOVE, BENT_BELOW = 0.7, 0.4


class Nearest:
    """Compares each finger, from 0 (fist) to 1 (open hand), with its position in each gesture."""

    def __init__(self, context: HandContext) -> None:
        if context.calibration is None:
            raise CannotRecognize("it compares with your fist and your open hand; calibrate the glove first")
        self.levels = context.calibration.levels
        self.codes = context.gestures.codes

    def see(self, before: Recognition | None, frame: Frame) -> Recognition:
        """Return the gesture whose worst finger is nearest; `before` is not used."""
        positions = [
            (bend - level.fist) / level.span for bend, level in zip(frame.bend, self.levels, strict=True)
        ]
        states = "".join(
            "0" if position > STRAIGHT_ABOVE else "2" if position < BENT_BELOW else "1"
            for position in positions
        )
        distances = {
            name: max(abs(position - (state == "0")) for position, state in zip(positions, code, strict=True))
            for name, code in self.codes.items()
        }
        name, distance = nearest(distances)
        gesture = name if distance < MAX_DISTANCE else None
        return Recognition(states, gesture, max(0.0, 1 - distance), frame.t_s, distances)

    def odds(self, seen: Recognition) -> Mapping[str, float]:
        """Return 1 for a gesture that all fingers match, 0 for one with a finger at the other end."""
        return {name: max(0.0, 1 - distance) for name, distance in seen.memory.items()}

    def why(self, seen: Recognition) -> str:
        """Return the distance of the worst finger."""
        name, distance = nearest(seen.memory)
        return f"no finger differs by more than {distance:.0%} of its range from {name}"


def nearest(distances: Mapping[str, float]) -> tuple[str, float]:
    """Return the gesture with the smallest distance, and the distance."""
    return min(distances.items(), key=lambda item: item[1])
