"""The recorder: takes down what a glove sends, from the controller that it is connected to."""

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path

from glove_sdk_bridge.controller import Controller, Declined, Unreachable
from glove_sdk_bridge.errors import BadLine, BridgeError, Dropped, Say
from glove_sdk_bridge.frames import FINGERS, Hello, parse_frame, parse_hello, parse_object
from glove_sdk_bridge.recording import RecordingWriter

AGAIN_AFTER_S = 1.0
MOST_WAITING = 10_000
"""Frames that may wait for a slow disk."""

_LOOK_EVERY_S = 0.2


class Recorder:
    """Writes the frames of `glove` to the recording at `path`, however often the controller goes away."""

    def __init__(
        self,
        path: Path,
        glove: str,
        controller: Controller,
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
        self._lines: queue.Queue[bytes | Exception] = queue.Queue(MOST_WAITING)
        self._sensors = FINGERS

    def record(self, stop: threading.Event, seconds: float | None = None) -> None:
        """Record until `stop` is set, or for `seconds`.

        Raises `BridgeError` when the controller is not there to begin with or does not know the glove, when
        it says that recording cannot go on, and when the file cannot be written.
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
        """Put the lines of the controller into the queue for as long as the program runs."""
        begun = False
        lost = False
        while True:
            try:
                for line in self._controller.lines(self._glove):
                    if lost:
                        self._say(f"{self._controller.url} is back")
                    begun, lost = True, False
                    self._lines.put(line)
            except (Unreachable, Declined) as error:
                if not begun:
                    self._lines.put(error)
                    return
            if not lost:
                self._say(f"{self._controller.url} is gone; it is waited for")
                lost = True
            time.sleep(AGAIN_AFTER_S)

    def _hello(self, stop: threading.Event) -> Hello | None:
        """Return how the glove introduces itself, or None if `stop` comes before it does."""
        while not stop.is_set():
            line = self._next()
            if line is not None:
                try:
                    hello = parse_hello(line)
                except BadLine as bad:
                    raise BridgeError(
                        f"{self._controller.url} does not speak as a gesture controller does ({bad.rule})"
                    ) from None
                self._sensors = hello.sensors
                return hello
        return None

    def _next(self) -> bytes | None:
        """Return a line, or None if there is none for the moment; raise what the follower met."""
        try:
            line = self._lines.get(timeout=_LOOK_EVERY_S)
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
