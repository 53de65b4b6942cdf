"""The source `forward`: reads frames on standard input.

So the output of any vendor program can be piped in. Each line is `{"bend":[…]}`, a complete frame, or five
numbers separated by commas.
"""

import os
import time
from collections.abc import Callable, Iterator

from glove_sdk_bridge.errors import BadLine, Dropped, Say
from glove_sdk_bridge.frames import MAX_LINE_BYTES, Frame, frame_of, is_number, parse_object
from glove_sdk_bridge.lines import Lines, five_numbers

STDIN = 0
_CHUNK_BYTES = 64 * 1024


class Forward:
    """Frames from the file descriptor `stdin`; a line without a time gets its arrival time."""

    patience_s = 3.0

    def __init__(self, *, say: Say, stdin: int = STDIN, clock: Callable[[], float] = time.monotonic) -> None:
        self.dropped = Dropped("standard input", say)
        self._stdin = stdin
        self._clock = clock

    def frames(self) -> Iterator[Frame]:
        """Yield a frame for each line until the input ends."""
        lines = Lines()
        while data := os.read(self._stdin, _CHUNK_BYTES):
            t_s = self._clock()
            too_long = lines.too_long
            for line in lines.feed(data):
                yield from self._frame(line, t_s)
            for _ in range(lines.too_long - too_long):
                self.dropped.add(f"a line holds at most {MAX_LINE_BYTES} bytes", b"")
        for line in lines.end():
            yield from self._frame(line, self._clock())

    def _frame(self, line: bytes, t_s: float) -> Iterator[Frame]:
        if not line.strip():
            return
        try:
            frame = parse_forwarded(line, t_s)
        except BadLine as bad:
            self.dropped.add(bad.rule, line)
            return
        if frame is not None:
            yield frame


def parse_forwarded(line: bytes, t_s: float) -> Frame | None:
    """Return the frame in `line`, at `t_s` unless the line has a time `t`; None for a hello.

    Raises `BadLine` if it is none of JSON with `bend`, a whole frame, or five numbers.
    """
    text = line.decode("utf-8", "replace").strip().removeprefix("\ufeff")
    if not text.startswith("{"):
        return Frame(t_s, five_numbers(text))
    message = parse_object(text)
    kind = message.get("type", "frame")
    if kind == "hello":
        return None
    if kind != "frame":
        raise BadLine('a line has the type "frame", or none')
    own_s = message.get("t", t_s)
    if not is_number(own_s):
        raise BadLine('"t" is a time in seconds')
    return frame_of({**message, "seq": 0}, own_s)
