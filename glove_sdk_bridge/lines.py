"""Splits a byte stream into lines, and parses lines of five numbers."""

import re
from collections.abc import Iterator

from glove_sdk_bridge.errors import BadLine
from glove_sdk_bridge.frames import MAX_LINE_BYTES, Five, five

_NUMBER = re.compile(r"[+-]?\d{1,12}(\.\d{0,12})?", re.ASCII)


class Lines:
    """Splits a byte stream into lines; a line longer than `limit` bytes is dropped and counted."""

    def __init__(self, limit: int = MAX_LINE_BYTES) -> None:
        self.too_long = 0
        self._limit = limit
        self._rest = bytearray()
        self._skipping = False

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the complete lines, without line ends."""
        *complete, rest = data.split(b"\n")
        for piece in complete:
            line = bytes(self._rest) + piece
            self._rest.clear()
            if self._skipping:
                self._skipping = False
            elif len(line) > self._limit:
                self.too_long += 1
            else:
                yield line.rstrip(b"\r")
        if not self._skipping:
            self._rest += rest
            if len(self._rest) > self._limit:
                self._rest.clear()
                self._skipping = True
                self.too_long += 1

    def end(self) -> Iterator[bytes]:
        """Yield the last line if it has no line end."""
        if self._rest and not self._skipping:
            yield bytes(self._rest).rstrip(b"\r")
        self._rest.clear()
        self._skipping = False


def five_numbers(text: str) -> Five:
    """Return the five numbers of a comma-separated line, thumb first; raises `BadLine`."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 5:
        raise BadLine("five numbers with commas between them are needed, thumb first")
    return five([number(part) for part in parts], "bend")


def number(text: str) -> int | float:
    """Return the decimal number in `text`; raises `BadLine`."""
    if not _NUMBER.fullmatch(text):
        raise BadLine("not a number")
    return float(text) if "." in text else int(text)
