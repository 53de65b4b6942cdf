"""The recorder: writes the frames of a glove to a file, as the controller receives them."""

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path

from glove_sdk_bridge.controller_client import ControllerClient, Declined, Unreachable
from glove_sdk_bridge.errors import BadLine, BridgeError, Dropped, Say
from glove_sdk_bridge.frames import FINGERS, Hello, parse_frame, parse_hello, parse_object
from glove_sdk_bridge.recording import RecordingWriter

RECONNECT_INTERVAL_S = 1.0
MAX_WAITING = 10_000
"""The largest number of frames that wait for the disk."""

_CHECK_INTERVAL_S = 0.2


class Recorder:
    """Writes the frames of `glove` to the recording at `path`; reconnects to the controller."""

    def __init__(
        self,
        path: Path,
        glove: str,
        controller: ControllerClient,
        *,
        say: Say,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.dropped = Dropped(controller.url, say)
        self._path = path
        self._glove = glove
        self._controller = controller
        self._say = say
        self._clock = clock
        self._lines: queue.Queue[bytes | Exception] = queue.Queue(MAX_WAITING)
        self._sensors = FINGERS

    def record(self, stop: threading.Event, seconds: float | None = None) -> None:
        """Record until `stop` is set, or for `seconds`.

        Raises `BridgeError` if the controller does not respond at the start, does not know the glove or ends
        the recording, and if the file cannot be written.
        """
        threading.Thread(target=self._follow, name="glove recorder", daemon=True).start()
        hello = self._hello(stop)
        if hello is None:
            return
        until_s = None if seconds is None else self._clock() + seconds
        with RecordingWriter(self._path, hello) as recording:
            self._say(f"recording {self._glove} to {self._path}; Ctrl-C ends it")
            try:
                while not stop.is_set() and (until_s is None or self._clock() < until_s):
                    line = self._next()
                    if line is not None:
                        self._take(line, recording)
            finally:
                self._say(f"{recording.frames} frames recorded, {len(self.dropped)} dropped")

    def _follow(self) -> None:
        """Put the lines of the controller into the queue until the program ends."""
        begun = False
        lost = False
        while True:
            try:
                for line in self._controller.lines(self._glove):
                    if lost:
                        self._say(f"{self._controller.url} is available again")
                    begun, lost = True, False
                    self._lines.put(line)
            except (Unreachable, Declined) as error:
                if not begun:
                    self._lines.put(error)
                    return
            if not lost:
                self._say(f"{self._controller.url} is not available; waiting for it")
                lost = True
            time.sleep(RECONNECT_INTERVAL_S)

    def _hello(self, stop: threading.Event) -> Hello | None:
        """Return the hello of the glove, or None if `stop` is set first."""
        while not stop.is_set():
            line = self._next()
            if line is not None:
                try:
                    hello = parse_hello(line)
                except BadLine as bad:
                    raise BridgeError(
                        f"{self._controller.url} does not respond as a gesture controller does ({bad.rule})"
                    ) from None
                self._sensors = hello.sensors
                return hello
        return None

    def _next(self) -> bytes | None:
        """Return a line, or None if there is none now; raise an exception of the reader thread."""
        try:
            line = self._lines.get(timeout=_CHECK_INTERVAL_S)
        except queue.Empty:
            return None
        if isinstance(line, Exception):
            raise line
        return line

    def _take(self, line: bytes, recording: RecordingWriter) -> None:
        try:
            kind = parse_object(line).get("type")
            if kind == "hello":
                self._sensors = parse_hello(line).sensors
            elif kind == "error":
                raise BridgeError(str(parse_object(line).get("reason", "the controller ends the recording")))
            else:
                recording.write(parse_frame(line, self._sensors))
        except BadLine as bad:
            self.dropped.add(bad.rule, line)
