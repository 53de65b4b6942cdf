"""Lines: the frames of the protocol in a stream of bytes, of bounded length."""

from handover_devices.protocol.messages import MAX_LINE_BYTES


class LineBuffer:
    """Splits a stream into lines; it keeps at most one incomplete line.

    `has_overflowed` is True once a line was too long; what follows cannot be read.
    """

    def __init__(self, max_line_bytes: int = MAX_LINE_BYTES) -> None:
        self.has_overflowed = False
        self.max_line_bytes = max_line_bytes
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that `data` completes, without their ends, up to the first that is too long.

        The lines do not depend on how the stream is divided into `data`.
        """
        if self.has_overflowed:
            return []
        end = data.rfind(b"\n")
        if end < 0:
            self._rest += data
            lines = []
        else:
            lines = (bytes(self._rest) + data[:end]).split(b"\n")
            self._rest = bytearray(data[end + 1 :])
        for number, line in enumerate(lines):
            if len(line) > self.max_line_bytes:
                return self._overflow(lines[:number])
        return lines if len(self._rest) <= self.max_line_bytes else self._overflow(lines)

    def _overflow(self, lines: list[bytes]) -> list[bytes]:
        self.has_overflowed = True
        self._rest.clear()
        return lines
