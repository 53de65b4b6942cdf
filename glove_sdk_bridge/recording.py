"""Recordings: files with one JSON object a line, a hello before the frames of each session.

Lines are only appended, each with one write. After a crash only the last line can be incomplete; readers and
writers skip it.
"""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self

from glove_sdk_bridge.errors import BadLine, BridgeError, Dropped
from glove_sdk_bridge.frames import FINGERS, MAX_LINE_BYTES, Frame, Hello, parse_frame, parse_hello
from glove_sdk_bridge.lines import Lines

SYNC_INTERVAL_S = 1.0
"""How much of a recording may be lost in a power failure."""

SESSION_GAP_S = 0.02
"""The time set between the last frame of one session and the first frame of the next."""

_CHUNK_BYTES = 64 * 1024


class RecordingWriter:
    """Writes a recording; an existing one is continued with a new session.

    Frames are written thumb first and the hello without its token. Raises `BridgeError` if `path` cannot be
    written, is no recording, or belongs to another glove.
    """

    def __init__(self, path: Path, hello: Hello, clock: Callable[[], float] = time.monotonic) -> None:
        self.frames = 0
        self._path = path
        self._clock = clock
        self._saved_s = clock()
        try:
            self._file = path.open("r+b" if path.exists() else "xb", buffering=0)
            try:
                if path.stat().st_size:
                    self._continue(hello)
                self._add(Hello(hello.glove, hello.hand).encode())
            except BaseException:
                self._file.close()
                raise
        except OSError as error:
            raise self._unwritable(error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, frame: Frame) -> None:
        """Append `frame`; raise `BridgeError` if it cannot be written."""
        try:
            self._add(frame.encode())
            self.frames += 1
            if self._clock() - self._saved_s >= SYNC_INTERVAL_S:
                os.fsync(self._file.fileno())
                self._saved_s = self._clock()
        except OSError as error:
            raise self._unwritable(error) from None

    def close(self) -> None:
        """Sync the file to disk and close it."""
        if self._file.closed:
            return
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            raise self._unwritable(error) from None
        finally:
            self._file.close()

    def _continue(self, hello: Hello) -> None:
        """Seek to the end of the last complete line, if it is a recording of the same glove."""
        first = self._file.readline(MAX_LINE_BYTES)
        try:
            before = parse_hello(first)
        except BadLine:
            raise BridgeError(f"{self._path} is no recording of ours; choose another file") from None
        if before.glove != hello.glove:
            raise BridgeError(f"{self._path} is a recording of {before.glove}; choose another file")
        end = _end_of_last_line(self._path)
        self._file.truncate(end)
        self._file.seek(end)

    def _add(self, line: bytes) -> None:
        while line:
            line = line[self._file.write(line) or 0 :]

    def _unwritable(self, error: OSError) -> BridgeError:
        return BridgeError(
            f"{self._path} cannot be written ({error.strerror}); choose another file or make room"
        )


def is_recording(path: Path) -> bool:
    """Return True if the file at `path` is a recording (JSON lines), False for a table."""
    with path.open("rb") as file:
        return file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{")


def hello_of(path: Path) -> Hello | None:
    """Return the hello at the beginning of the recording at `path`, or None if it has none."""
    with path.open("rb") as file:
        try:
            return parse_hello(file.readline(MAX_LINE_BYTES).removeprefix(b"\xef\xbb\xbf"))
        except BadLine:
            return None


def read_recording(path: Path, dropped: Dropped) -> Iterator[Frame]:
    """Yield the frames of the recording at `path`, thumb first, with monotonic times over all sessions.

    Invalid lines are dropped and counted.
    """
    sensors = FINGERS
    shift_s = last_s = None
    with path.open("rb") as file:
        for line in _lines(file.fileno(), dropped):
            if b'"hello"' in line:
                sensors, shift_s = _sensors(line, dropped, sensors), None
                continue
            try:
                frame = parse_frame(line, sensors)
            except BadLine as bad:
                dropped.add(bad.rule, line)
                continue
            if shift_s is None or (last_s is not None and frame.t_s + shift_s < last_s):
                shift_s = 0.0 if last_s is None else last_s + SESSION_GAP_S - frame.t_s
            last_s = frame.t_s + shift_s
            yield Frame(last_s, frame.bend, frame.seq, frame.pressure, frame.battery)


def _sensors(line: bytes, dropped: Dropped, before: tuple[str, ...]) -> tuple[str, ...]:
    try:
        return parse_hello(line).sensors
    except BadLine as bad:
        dropped.add(bad.rule, line)
        return before


def _lines(descriptor: int, dropped: Dropped) -> Iterator[bytes]:
    lines = Lines()
    while data := os.read(descriptor, _CHUNK_BYTES):
        yield from (line for line in lines.feed(data) if line.strip())
    yield from (line for line in lines.end() if line.strip())
    for _ in range(lines.too_long):
        dropped.add(f"a line holds at most {MAX_LINE_BYTES} bytes", b"")


def _end_of_last_line(path: Path) -> int:
    """Return the offset of the end of the last complete line, in bytes."""
    with path.open("rb") as file:
        place = file.seek(0, os.SEEK_END)
        while place > 0:
            start = max(0, place - _CHUNK_BYTES)
            file.seek(start)
            newline = file.read(place - start).rfind(b"\n")
            if newline >= 0:
                return start + newline + 1
            place = start
    return 0
