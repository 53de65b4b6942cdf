"""The file of a recording: raw values of the ports, and the live documents that a page replays.

Topics: one for each port (`/state`, `/wish`) with its values by name, and `/live` with the documents of the
WebSocket `/live`. Times are those of the values in ns since 1970. No topic names a person: sessions and poses
of patients are left out.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import orjson

from handover.formats.mcap_files import JsonMcapWriter, McapFileError, library

METADATA: Final = "handover.humanoid"
LIVE_TOPIC: Final = "/live"
MAX_FRAMES: Final = 600
CHUNK_BYTES: Final = 2**18
"""What a crash may lose."""
_PLACES: Final = 6


class RecordingWriter:
    """Writes one recording; the stream stays open."""

    def __init__(self, stream: IO[bytes], metadata: Mapping[str, str]) -> None:
        self._writer = JsonMcapWriter(stream, chunk_bytes=CHUNK_BYTES)
        self._writer.add_metadata(METADATA, metadata)
        self._writer.add_topic(LIVE_TOPIC, "handover.Live", {"type": "object"})
        self.messages = 0

    def write_port(self, port: str, names: Sequence[str], values: Sequence[float], at_ns: int) -> None:
        """Write the values of a port; what is not finite is null."""
        topic = f"/{port}"
        if topic not in self._writer.topics:
            properties = {name: {"type": ["number", "null"]} for name in names}
            schema = {"type": "object", "properties": properties}
            self._writer.add_topic(topic, f"handover.humanoid.{port}", schema)
        written = {
            name: round(value, _PLACES) if math.isfinite(value) else None
            for name, value in zip(names, values, strict=True)
        }
        self._write(topic, written, at_ns)

    def write_document(self, document: Mapping[str, Any], at_ns: int) -> None:
        """Write a live document, without its session."""
        self._write(LIVE_TOPIC, {**document, "session": None}, at_ns)

    def close(self) -> None:
        """Write index and footer."""
        self._writer.close()

    def _write(self, topic: str, content: Mapping[str, Any], at_ns: int) -> None:
        self._writer.write(topic, orjson.dumps(content), at_ns)
        self.messages += 1


@dataclass(frozen=True, slots=True)
class Frames:
    """Live documents by time in s since the first; `next_s` is where the rest begins, None at the end."""

    frames: list[tuple[float, dict[str, Any]]]
    duration_s: float
    next_s: float | None


def read_frames(path: Path, from_s: float, to_s: float) -> Frames:
    """Return at most `MAX_FRAMES` documents from `from_s` until before `to_s`, which is not earlier.

    Raises `McapFileError` and `OSError`.
    """
    exceptions: Any = library("exceptions")
    frames: list[tuple[float, dict[str, Any]]] = []
    try:
        with path.open("rb") as file:
            reader = library("reader").make_reader(file)
            summary = reader.get_summary()
            if summary is None or summary.statistics is None:
                raise McapFileError(f"{path.name} has no index; was it changed?")
            start_ns: int = summary.statistics.message_start_time
            duration_s = (summary.statistics.message_end_time - start_ns) / 1e9
            first_ns, end_ns = (
                start_ns + round(min(time_s, duration_s + 1) * 1e9) for time_s in (from_s, to_s)
            )
            for _, _, item in reader.iter_messages(LIVE_TOPIC, first_ns, end_ns):
                at_s = (item.log_time - start_ns) / 1e9
                if len(frames) == MAX_FRAMES:
                    return Frames(frames, duration_s, at_s)
                frames.append((at_s, orjson.loads(item.data)))
    except (exceptions.McapError, orjson.JSONDecodeError, EOFError) as error:
        raise McapFileError(f"{path.name} cannot be read: {error!r}; was the file changed?") from None
    return Frames(frames, duration_s, None)
