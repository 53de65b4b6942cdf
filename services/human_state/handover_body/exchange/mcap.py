"""Recordings in MCAP (mcap.dev), with JSON Schemas: readable by Foxglove and by the driver of recordings."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self

from handover.formats.mcap_files import MAX_MESSAGE_BYTES, JsonMcapWriter
from handover_body.formats.errors import ExchangeError
from handover_body.formats.extra import required
from handover_body.formats.json_messages import (
    SCHEMAS,
    Recorded,
    from_json,
    schema_name,
    time_of,
    to_json,
    topic_of,
)

METADATA: Final = "handover.session"
MAX_CHANNELS: Final = 1024


class McapWriter:
    """Writes one recording to a binary stream; the stream stays open after `close`.

    Not thread-safe. A file without `close` has no index: `rewrite` or `mcap recover` makes it readable. With
    `is_journal` each message is written at once, without compression and index.
    """

    def __init__(
        self,
        stream: IO[bytes],
        subject: str = "",
        metadata: Mapping[str, str] | None = None,
        *,
        is_journal: bool = False,
    ) -> None:
        self._writer = JsonMcapWriter(stream, is_journal=is_journal)
        self._writer.add_metadata(METADATA, {"subject": subject, **(metadata or {})})
        self._subject = subject

    def write(self, item: Recorded) -> None:
        """Write samples, a feature, a report or a marker. Raises `ExchangeError` beyond `MAX_CHANNELS`."""
        topic = topic_of(item)
        if topic not in self._writer.topics:
            if len(self._writer.topics) >= MAX_CHANNELS:
                raise ExchangeError(
                    f"{topic} is one topic beyond the {MAX_CHANNELS} of a recording; record fewer sensors"
                )
            name = schema_name(item)
            self._writer.add_topic(topic, name, SCHEMAS[name])
        data = json.dumps(to_json(item, self._subject), allow_nan=False).encode()
        self._writer.write(topic, data, max(round(time_of(item) * 1e9), 0))

    def close(self) -> None:
        """Write the index and the footer."""
        self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def read(path: Path) -> Iterator[Recorded]:
    """Yield everything that a `McapWriter` wrote to `path`, by time. Topics of others are left out.

    Raises `ExchangeError` for a damaged file and for a faulty message.
    """
    try:
        with path.open("rb") as file:
            yield from read_stream(file, path.name)
    except OSError as error:
        raise ExchangeError(f"{path.name} cannot be read: {error}; is the file complete?") from None


def read_stream(file: IO[bytes], name: str) -> Iterator[Recorded]:
    """Yield what a `McapWriter` wrote to a file that can seek, as `read` does."""
    reader: Any = required("mcap.reader")
    exceptions: Any = required("mcap.exceptions")
    try:
        for schema, channel, message in reader.make_reader(file, validate_crcs=True).iter_messages():
            if schema is None or schema.name not in SCHEMAS or channel.message_encoding != "json":
                continue
            if len(message.data) > MAX_MESSAGE_BYTES:
                raise ExchangeError(f"{name}: a message has {len(message.data)} bytes; it is no packet")
            yield from_json(schema.name, json.loads(message.data))
    except (exceptions.McapError, OSError, json.JSONDecodeError, EOFError) as error:
        raise ExchangeError(f"{name} cannot be read: {error}; is the file complete?") from None


def metadata_of(path: Path) -> dict[str, str]:
    """Return subject and metadata of a recording; empty if it has none. Raises `ExchangeError`."""
    reader: Any = required("mcap.reader")
    exceptions: Any = required("mcap.exceptions")
    try:
        with path.open("rb") as file:
            for record in reader.make_reader(file).iter_metadata():
                if record.name == METADATA:
                    return dict(record.metadata)
    except (exceptions.McapError, OSError, EOFError) as error:
        raise ExchangeError(f"{path.name} cannot be read: {error}; is the file complete?") from None
    return {}
