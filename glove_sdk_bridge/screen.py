"""The screen: what the simulated operator sees of the controller, looked at a few times a second."""

import threading
import time
from enum import Enum

from glove_sdk_bridge.controller import Controller, Declined, Unreachable
from glove_sdk_bridge.errors import Say
from glove_sdk_bridge.frames import Five
from glove_sdk_bridge.simulated_operator import View

LOOK_EVERY_S = 0.2
FORGET_AFTER_S = 2.0
"""A screen that has shown nothing for so long is blank: the operator stops waiting for it."""

_NOT_FOUND = 404


class Calibrated(Enum):
    """How far the calibration has come that was handed in last."""

    NOT_YET = "not yet"
    DONE = "done"
    REFUSED = "refused"


class Screen:
    """Looks at `glove` in a thread of its own, for as long as the program runs; `say` gets bad news."""

    def __init__(self, controller: Controller, glove: str, *, say: Say) -> None:
        self.calibrated = Calibrated.NOT_YET
        self._controller = controller
        self._glove = glove
        self._say = say
        self._view = View()
        self._seen_s = 0.0
        self._levels: tuple[list[Five], list[Five]] | None = None
        self._bad_news = ""

    def start(self) -> None:
        """Begin to look."""
        threading.Thread(target=self._watch, name="glove screen", daemon=True).start()

    @property
    def view(self) -> View:
        """Return what is to be seen; nothing, once the screen has been blank for a while."""
        return self._view if time.monotonic() - self._seen_s < FORGET_AFTER_S else View()

    def hand_in(self, fist: list[Five], open_hand: list[Five]) -> None:
        """Have thresholds made from frames of a fist and of an open hand; `calibrated` tells the outcome."""
        self.calibrated = Calibrated.NOT_YET
        self._levels = (fist, open_hand)

    def _watch(self) -> None:
        while True:
            try:
                self._calibrate()
                self._view = View.of(self._controller.glove(self._glove))
                self._seen_s = time.monotonic()
                self._bad_news = ""
            except Unreachable as error:
                self._tell(str(error))
            except Declined as error:
                if error.status != _NOT_FOUND:  # a glove that has not said hello yet is not known: it will be
                    self._tell(str(error))
            time.sleep(LOOK_EVERY_S)

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

    def _tell(self, news: str) -> None:
        """Say bad news once, not five times a second."""
        if news != self._bad_news:
            self._say(news)
        self._bad_news = news
