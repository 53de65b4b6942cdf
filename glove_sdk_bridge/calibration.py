"""Calibration of a glove with a fist and an open hand, one second each.

The frames come from the hand, as the controller receives them, or from a table of poses.
"""

import itertools
import threading
import time
from collections.abc import Callable
from pathlib import Path

from glove_sdk_bridge.controller_client import ControllerClient
from glove_sdk_bridge.errors import BridgeError, Dropped, Say
from glove_sdk_bridge.frames import FINGERS
from glove_sdk_bridge.replay import RATE_HZ, read_table

PREPARATION_S = 2.0
CAPTURE_S = 1.5
POLL_INTERVAL_S = 0.02
MIN_FRAMES = 10
MAX_SILENCE_S = 5.0

Frames = list[list[float]]


class Calibrator:
    """Sends frames to the controller, which calculates the thresholds of `glove`, and reports them."""

    def __init__(
        self,
        glove: str,
        controller: ControllerClient,
        *,
        say: Say,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self._glove = glove
        self._controller = controller
        self._say = say
        self._clock = clock
        self._wait = wait

    def from_hand(self, stop: threading.Event) -> None:
        """Ask for a fist and an open hand; raises `BridgeError`."""
        frames = {}
        for name, words in (("fist", "make a fist"), ("open", "open your hand, fingers straight")):
            self._say(f"{self._glove}: {words} and keep it …")
            self._wait(PREPARATION_S)
            frames[name] = self._watch(stop)
            if stop.is_set():
                return
        self._send(frames["fist"], frames["open"])

    def from_table(self, path: Path, fist: str, open_hand: str, seconds: float) -> None:
        """Use the first `seconds` of the poses `fist` and `open_hand` of the table at `path`."""
        self._send(self._pose(path, fist, seconds), self._pose(path, open_hand, seconds))

    def _watch(self, stop: threading.Event) -> Frames:
        """Return the frames that the controller receives within `CAPTURE_S` from the first new one."""
        seen: Frames = []
        last = int(self._controller.glove(self._glove)["frames"])
        until_s, silent_s = None, self._clock() + MAX_SILENCE_S
        while not stop.is_set() and (until_s is None or self._clock() < until_s):
            view = self._controller.glove(self._glove)
            if view["frames"] != last and view["bend"] is not None:
                last = int(view["frames"])
                seen.append(list(view["bend"]))
                until_s = until_s if until_s is not None else self._clock() + CAPTURE_S
            elif until_s is None and self._clock() > silent_s:
                raise BridgeError(
                    f"{self._glove} sends nothing to {self._controller.url}; "
                    "switch it on and check that its bridge runs"
                )
            self._wait(POLL_INTERVAL_S)
        if len(seen) < MIN_FRAMES and not stop.is_set():
            raise BridgeError(
                f"{self._glove} sent {len(seen)} frames in {CAPTURE_S:g} s; at least {MIN_FRAMES} are needed"
            )
        return seen

    def _pose(self, path: Path, pose: str, seconds: float) -> Frames:
        try:
            rows = read_table(path, Dropped(str(path), self._say), {pose})
            frames = [list(frame.bend) for _, frame in itertools.islice(rows, round(seconds * RATE_HZ))]
        except OSError as error:
            raise BridgeError(f"{path} cannot be read ({error.strerror}); check its name") from None
        if not frames:
            raise BridgeError(f"{path} has no frames of pose {pose}; name others with --fist and --open")
        return frames

    def _send(self, fist: Frames, open_hand: Frames) -> None:
        made = self._controller.calibrate(self._glove, fist, open_hand)["thresholds"]
        words = (f"{finger} {made[finger]['lower']:g}/{made[finger]['upper']:g}" for finger in FINGERS)
        self._say(f"{self._glove} is calibrated (bent below/straight above): {', '.join(words)}")
