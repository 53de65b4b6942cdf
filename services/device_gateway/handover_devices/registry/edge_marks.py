"""What the centre has received of the stream of each edge, so that nothing is stored twice."""

from collections.abc import Mapping

from handover_devices.storage.history_writer import EdgeMark


class EdgeMarks:
    """The last number in the stream of each edge: of what was received, and of what is durable."""

    def __init__(self, stored: Mapping[str, tuple[str, int]]) -> None:
        self._stored = dict(stored)
        self._received = dict(stored)

    def merge(self, stored: Mapping[str, tuple[str, int]]) -> None:
        """Note what the database has, which another process may have stored."""
        for edge, (stream, seq) in stored.items():
            for marks in (self._stored, self._received):
                if self._of(marks, edge, stream) <= seq:
                    marks[edge] = stream, seq

    def stored(self, edge: str, stream: str) -> int:
        """Return the last number that is durable, 0 for a new stream."""
        return self._of(self._stored, edge, stream)

    def received(self, edge: str, stream: str) -> int:
        """Return the last number that was received, 0 for a new stream."""
        return self._of(self._received, edge, stream)

    def note_received(self, mark: EdgeMark) -> None:
        """Note what was received."""
        self._received[mark.edge] = mark.stream, mark.seq

    def note_stored(self, mark: EdgeMark) -> None:
        """Note what is durable."""
        self._stored[mark.edge] = mark.stream, mark.seq

    def forget(self, edge: str) -> None:
        """Forget an edge that was deleted."""
        self._stored.pop(edge, None)
        self._received.pop(edge, None)

    @staticmethod
    def _of(marks: Mapping[str, tuple[str, int]], edge: str, stream: str) -> int:
        marked_stream, seq = marks.get(edge, ("", 0))
        return seq if marked_stream == stream else 0
