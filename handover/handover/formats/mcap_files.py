"""MCAP files (mcap.dev) with JSON messages: written by topic, and completed after a crash.

A file whose writer was not closed has no index and no footer. `rewrite` copies what is whole in it to a
complete file. The library comes with the extras that record.
"""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import IO, Any, Final

import orjson

from handover.distribution import install_command
from handover.errors import HandoverError, UsageError

LIBRARY: Final = "handover"
MAX_MESSAGE_BYTES: Final = 16 * 2**20


class McapFileError(HandoverError):
    """A file is damaged; the text says where."""


def library(module: str) -> ModuleType:
    """Return a module of the library. Raises `UsageError`, which names the extras, without it."""
    try:
        return importlib.import_module(f"mcap.{module}")
    except ImportError as error:
        raise UsageError(
            f"mcap is not installed ({error}); for body signals {install_command('body')}, for humanoids "
            f"{install_command('humanoid')}"
        ) from error


class JsonMcapWriter:
    """Writes JSON messages by topic to a binary stream, which stays open after `close`. Not thread-safe.

    With `is_journal` each message is written at once, without compression and index; otherwise in compressed
    chunks of `chunk_bytes`.
    """

    def __init__(self, stream: IO[bytes], *, is_journal: bool = False, chunk_bytes: int = 2**20) -> None:
        writer: Any = library("writer")
        self._writer = writer.Writer(stream, chunk_size=chunk_bytes, use_chunking=not is_journal)
        self._writer.start(profile="", library=LIBRARY)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequences: dict[str, int] = {}

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write metadata of the whole file."""
        self._writer.add_metadata(name, dict(values))

    @property
    def topics(self) -> frozenset[str]:
        """The topics so far."""
        return frozenset(self._channels)

    def add_topic(self, topic: str, schema: str, definition: Mapping[str, Any]) -> None:
        """Begin a topic whose messages have the JSON Schema `definition`, which is called `schema`."""
        if schema not in self._schemas:
            text = orjson.dumps(definition)
            self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", text)
        self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[schema])

    def write(self, topic: str, data: bytes, at_ns: int) -> None:
        """Write a message of a topic that was added; the time is in ns since 1970."""
        sequence = self._sequences[topic] = self._sequences.get(topic, -1) + 1
        self._writer.add_message(
            self._channels[topic], log_time=at_ns, data=data, publish_time=at_ns, sequence=sequence
        )

    def close(self) -> None:
        """Write the index and the footer."""
        self._writer.finish()


@dataclass(frozen=True, slots=True)
class Rewritten:
    """What `rewrite` has copied. Times are in s since 1970; None without messages."""

    messages: int
    last_s: float | None
    is_cut: bool
    """The source ended in the middle, as after a crash."""


def rewrite(source: IO[bytes], target: IO[bytes]) -> Rewritten:
    """Copy a recording, also one that was cut off, to a complete one with compression and index.

    `source` is read once, from the beginning to the end. Raises `McapFileError` if it is damaged elsewhere.
    """
    streams: Any = library("stream_reader")
    records: Any = library("records")
    exceptions: Any = library("exceptions")
    writer = library("writer").Writer(target)
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
        raise McapFileError(f"the recording cannot be read: {error!r}; was the file changed?") from None
    writer.finish()
    return Rewritten(messages, last_ns / 1e9 if messages else None, is_cut)
