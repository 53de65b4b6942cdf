"""Recordings in MCAP (mcap.dev), with JSON Schemas: readable by Foxglove and by the driver of recordings."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self

from services.human_state.formats.errors import ExchangeError
from services.human_state.formats.extra import required
from services.human_state.formats.json_messages import (
    SCHEMAS,
    Recorded,
    from_json,
    schema_name,
    time_of,
    to_json,
    topic_of,
)

LIBRARY: Final = "handover"
METADATA: Final = "handover.session"
MAX_CHANNELS: Final = 1024
MAX_MESSAGE_BYTES: Final = 16 * 2**20


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
        writer: Any = required("mcap.writer")
        self._writer = writer.Writer(stream, use_chunking=not is_journal)
        self._writer.start(profile="", library=LIBRARY)
        self._writer.add_metadata(METADATA, {"subject": subject, **(metadata or {})})
        self._subject = subject
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequences: dict[str, int] = {}

    def write(self, item: Recorded) -> None:
        """Write samples, a feature, a report or a marker. Raises `ExchangeError` beyond `MAX_CHANNELS`."""
        topic = topic_of(item)
        if topic not in self._channels:
            self._add_channel(topic, schema_name(item))
        at_ns = max(round(time_of(item) * 1e9), 0)
        sequence = self._sequences[topic] = self._sequences.get(topic, -1) + 1
        self._writer.add_message(
            self._channels[topic],
            log_time=at_ns,
            data=json.dumps(to_json(item, self._subject), allow_nan=False).encode(),
            publish_time=at_ns,
            sequence=sequence,
        )

    def close(self) -> None:
        """Write the index and the footer."""
        self._writer.finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _add_channel(self, topic: str, schema: str) -> None:
        if len(self._channels) >= MAX_CHANNELS:
            raise ExchangeError(
                f"{topic} is one topic beyond the {MAX_CHANNELS} of a recording; record fewer sensors"
            )
        if schema not in self._schemas:
            text = json.dumps(SCHEMAS[schema]).encode()
            self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", text)
        self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[schema])


@dataclass(frozen=True, slots=True)
class Rewritten:
    """What `rewrite` has copied. Times are in s since 1970; None without messages."""

    messages: int
    last_s: float | None
    is_cut: bool
    """The source ended in the middle, as after a crash."""


def rewrite(source: IO[bytes], target: IO[bytes]) -> Rewritten:
    """Copy a recording, also one that was cut off, to a complete one with compression and index.

    `source` is read once, from the beginning to the end. Raises `ExchangeError` if it is damaged elsewhere.
    """
    streams: Any = required("mcap.stream_reader")
    records: Any = required("mcap.records")
    exceptions: Any = required("mcap.exceptions")
    writer = required("mcap.writer").Writer(target)
    writer.start(profile="", library=LIBRARY)
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    messages, last_ns, is_cut = 0, 0, False
    try:
        for record in streams.StreamReader(source, record_size_limit=MAX_MESSAGE_BYTES).records:
            if isinstance(record, records.DataEnd):
                break  # the summary repeats schemas and channels
            if isinstance(record, records.Schema):
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, records.Channel):
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
                )
            elif isinstance(record, records.Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, records.Message):
                writer.add_message(
                    channels[record.channel_id],
                    log_time=record.log_time,
                    data=record.data,
                    publish_time=record.publish_time,
                    sequence=record.sequence,
                )
                messages, last_ns = messages + 1, max(last_ns, record.log_time)
    except exceptions.EndOfFile:
        is_cut = True
    except (exceptions.McapError, KeyError, ValueError) as error:
        raise ExchangeError(f"the recording cannot be read: {error!r}; was the file changed?") from None
    writer.finish()
    return Rewritten(messages, last_ns / 1e9 if messages else None, is_cut)


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
