"""A recognizer that returns the gesture whose finger positions are nearest to the hand."""

from services.gesture_controller.recognition.recognizer import CannotRecognize, HandContext, Recognition

NEAR = 0.35


class Nearest:
    """Compares where the fingers stand, from 0 (fist) to 1 (open hand), with where each gesture has them."""

    def __init__(self, context: HandContext) -> None:
        if context.calibration is None:
            raise CannotRecognize("it compares with your fist and your open hand; calibrate the glove first")
        self.levels, self.codes = context.calibration.levels, context.gestures.codes

    def see(self, before, frame):
        """Return the gesture whose worst finger is nearest; it needs no memory, so `before` is left alone."""
        stands = [
            (bend - level.fist) / level.span for bend, level in zip(frame.bend, self.levels, strict=True)
        ]
        states = "".join("0" if stand > 0.7 else "2" if stand < 0.4 else "1" for stand in stands)
        apart = {
            name: max(abs(stand - (state == "0")) for stand, state in zip(stands, code, strict=True))
            for name, code in self.codes.items()
        }
        name = min(apart, key=apart.get)
        return Recognition(
            states, name if apart[name] < NEAR else None, max(0.0, 1 - apart[name]), frame.t_s, apart
        )

    def odds(self, seen):
        """Return how near each gesture is: 1 for every finger in its place, 0 for one on the wrong side."""
        return {name: max(0.0, 1 - apart) for name, apart in seen.memory.items()}

    def why(self, seen):
        """Return how far the worst finger was away."""
        name = min(seen.memory, key=seen.memory.get)
        return f"no finger is further than {seen.memory[name]:.0%} of its way from {name}"
