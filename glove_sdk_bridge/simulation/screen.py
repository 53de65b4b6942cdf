"""The screen of the simulated operator: the view of the controller, polled a few times a second."""

import threading
import time
from enum import Enum

from glove_sdk_bridge.controller_client import ControllerClient, Declined, Unreachable
from glove_sdk_bridge.errors import Say
from glove_sdk_bridge.frames import Five
from glove_sdk_bridge.simulation.glove_operator import View

POLL_INTERVAL_S = 0.2
MAX_VIEW_AGE_S = 2.0
"""An older view counts as empty."""

_NOT_FOUND = 404


class Calibrated(Enum):
    """The state of the last calibration."""

    NOT_YET = "not yet"
    DONE = "done"
    REFUSED = "refused"


class Screen:
    """Polls the view of `glove` in a thread until the program ends; `say` gets errors."""

    def __init__(self, controller: ControllerClient, glove: str, *, say: Say) -> None:
        self.calibrated = Calibrated.NOT_YET
        self._controller = controller
        self._glove = glove
        self._say = say
        self._view = View()
        self._seen_s = 0.0
        self._levels: tuple[list[Five], list[Five]] | None = None
        self._last_error = ""

    def start(self) -> None:
        """Start polling."""
        threading.Thread(target=self._watch, name="glove screen", daemon=True).start()

    @property
    def view(self) -> View:
        """The latest view; an empty one if it is too old."""
        return self._view if time.monotonic() - self._seen_s < MAX_VIEW_AGE_S else View()

    def hand_in(self, fist: list[Five], open_hand: list[Five]) -> None:
        """Calibrate from frames of a fist and of an open hand; `calibrated` has the result."""
        self.calibrated = Calibrated.NOT_YET
        self._levels = (fist, open_hand)

    def _watch(self) -> None:
        while True:
            try:
                self._calibrate()
                self._view = View.of(self._controller.glove(self._glove))
                self._seen_s = time.monotonic()
                self._last_error = ""
            except Unreachable as error:
                self._report(str(error))
            except Declined as error:
                if error.status != _NOT_FOUND:  # the glove is unknown until its first hello
                    self._report(str(error))
            time.sleep(POLL_INTERVAL_S)

    def _calibrate(self) -> None:
        levels = self._levels
        if levels is None:
            return
        fist, open_hand = ([list(frame) for frame in frames] for frames in levels)
        try:
            self._controller.calibrate(self._glove, fist, open_hand)
        except Declined as error:
            if error.status == _NOT_FOUND:
                raise
            self._say(f"calibration: {error}")
            self._levels, self.calibrated = None, Calibrated.REFUSED
            return
        self._levels, self.calibrated = None, Calibrated.DONE

    def _report(self, error: str) -> None:
        """Report an error once, not with every poll."""
        if error != self._last_error:
            self._say(error)
        self._last_error = error
