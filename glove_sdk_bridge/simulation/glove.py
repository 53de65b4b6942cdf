"""The source `simulate`: the hand of the simulated operator, at the frame rate of a real glove.

The operator calibrates the glove first: a fist for a moment, then the open hand.
"""

import time
from collections.abc import Callable, Iterator

from glove_sdk_bridge.errors import BridgeError, Say
from glove_sdk_bridge.frames import Five, Frame
from glove_sdk_bridge.simulation.glove_operator import SimulatedOperator
from glove_sdk_bridge.simulation.hand import AT_REST, FIST, OPEN_HAND, Posture, SimulatedHand
from glove_sdk_bridge.simulation.screen import Calibrated, Screen

MOVE_S = 0.4
SETTLE_S = 0.2
KEEP_S = 0.8
"""How long the fist and the open hand are held for the calibration."""

CALIBRATIONS = 3
_MAX_LAG_S = 0.5


class SimulatedGlove:
    """The frames of `hand` in real time; `operator` moves it according to `screen`."""

    patience_s = 0.0
    dropped = None

    def __init__(
        self,
        hand: SimulatedHand,
        operator: SimulatedOperator,
        screen: Screen,
        *,
        say: Say,
        calibrate: bool = True,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self._hand = hand
        self._operator = operator
        self._screen = screen
        self._say = say
        self._calibrate = calibrate
        self._clock = clock
        self._wait = wait
        self._due_s = 0.0

    def frames(self) -> Iterator[Frame]:
        """Yield frames at the rate of the hand; raise `BridgeError` if the calibration fails."""
        self._screen.start()
        self._due_s = self._clock()
        if self._calibrate:
            yield from self._put_on()
        while True:
            frame = self._next()
            movement = self._operator.look(self._screen.view, frame.t_s)
            if movement is not None:
                self._hand.move(movement.to, movement.duration_s)
            yield frame

    def _put_on(self) -> Iterator[Frame]:
        for _ in range(CALIBRATIONS):
            fist: list[Five] = []
            open_hand: list[Five] = []
            yield from self._keep(FIST, fist)
            yield from self._keep(OPEN_HAND, open_hand)
            self._hand.move(AT_REST, MOVE_S)
            self._screen.hand_in(fist, open_hand)
            while self._screen.calibrated is Calibrated.NOT_YET:
                yield self._next()
            if self._screen.calibrated is Calibrated.DONE:
                self._say("calibrated with a fist and an open hand")
                return
        raise BridgeError(
            f"the controller refused {CALIBRATIONS} calibrations; start with --no-calibrate to use the "
            "thresholds that it has"
        )

    def _keep(self, posture: Posture, kept: list[Five]) -> Iterator[Frame]:
        """Move to `posture`, and append the values to `kept` once the hand has settled."""
        self._hand.move(posture, MOVE_S)
        unsettled = round((MOVE_S + SETTLE_S) * self._hand.rate_hz)
        for place in range(unsettled + max(10, round(KEEP_S * self._hand.rate_hz))):
            frame = self._next()
            if place >= unsettled:
                kept.append(frame.bend)
            yield frame

    def _next(self) -> Frame:
        """Wait until the next frame is due, and return it."""
        self._due_s += 1 / self._hand.rate_hz
        early_s = self._due_s - self._clock()
        if early_s > 0:
            self._wait(early_s)
        elif early_s < -_MAX_LAG_S:
            self._due_s = self._clock()
        return Frame(self._clock(), self._hand.read())
