"""Recordings in XDF 1.0 (github.com/sccn/xdf/wiki/Specifications), as LabRecorder writes them. Only writing.

A file is `XDF:` and chunks: length (1 byte with the number of bytes of the length, then the length), tag
(u16), content; all numbers little endian. Tags: 1 file header, 2 stream header, 3 samples, 4 clock offset,
5 boundary, 6 stream footer. Headers and footers are XML. Each signal of a sensor is a stream, and so are
features and markers. Time stamps are s since 1970, so the offset of every clock is 0.
"""

import struct
from collections.abc import Sequence
from types import TracebackType
from typing import IO, Final, Self
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from handover_body.formats.errors import ExchangeError
from handover_body.formats.json_messages import Marker, Recorded
from handover_body.model.features import UNITS, Feature
from handover_body.model.signals import Samples, SensorReport

MAX_STREAMS: Final = 1024
BOUNDARY_EVERY_BYTES: Final = 1 << 20
"""A reader finds the next chunk after a damaged place by a boundary."""

_FILE_HEADER, _STREAM_HEADER, _SAMPLES, _CLOCK_OFFSET, _BOUNDARY, _FOOTER = range(1, 7)
_BOUNDARY_ID: Final = bytes.fromhex("43A546DCCBF5410FB30ED5467383CBE4")


class _Stream:
    def __init__(self, number: int, channels: int) -> None:
        self.number = number
        self.channels = channels
        self.count = 0
        self.first_s = 0.0
        self.last_s = 0.0


class XdfWriter:
    """Writes one recording to a binary stream, which stays open after `close`. Not thread-safe."""

    def __init__(self, stream: IO[bytes], subject: str = "") -> None:
        self._file = stream
        self._subject = subject
        self._streams: dict[tuple[str, ...], _Stream] = {}
        self._since_boundary = 0
        self._file.write(b"XDF:")
        header = Element("info")
        SubElement(header, "version").text = "1.0"
        self._chunk(_FILE_HEADER, tostring(header, xml_declaration=True, encoding="UTF-8"))

    @property
    def count(self) -> int:
        """Return the number of streams."""
        return len(self._streams)

    def write(self, item: Recorded) -> None:
        """Write samples, a feature, a report or a marker. Raises `ExchangeError` beyond `MAX_STREAMS`."""
        if isinstance(item, Samples):
            self._write_samples(item)
        elif isinstance(item, Feature):
            self._write_feature(item)
        elif isinstance(item, Marker):
            self._write_text(("markers",), "markers", "Markers", item.at_s, _line(item.name, item.text))
        else:
            self._write_report(item)

    def close(self) -> None:
        """Write the footers."""
        for stream in self._streams.values():
            footer = Element("info")
            SubElement(footer, "first_timestamp").text = repr(stream.first_s)
            SubElement(footer, "last_timestamp").text = repr(stream.last_s)
            SubElement(footer, "sample_count").text = str(stream.count)
            offsets = SubElement(footer, "clock_offsets")
            for at_s in dict.fromkeys((stream.first_s, stream.last_s)):
                offset = SubElement(offsets, "offset")
                SubElement(offset, "time").text = repr(at_s)
                SubElement(offset, "value").text = "0"
            content = tostring(footer, xml_declaration=True, encoding="UTF-8")
            self._chunk(_FOOTER, struct.pack("<I", stream.number) + content)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write_samples(self, item: Samples) -> None:
        info = item.info
        stream = self._stream(
            ("signal", item.source, info.kind.value, str(len(info.channels))),
            f"{item.source} {info.kind.value}",
            info.kind.value,
            [(label or info.kind.value, info.unit) for label in info.channels],
            rate_hz=info.rate_hz or 0.0,
            source=item.source,
            method=info.method,
        )
        times_s = np.asarray(item.sample_times_s(), np.float64)
        if len(times_s):
            rows = np.empty(len(times_s), [("tag", "u1"), ("at", "<f8"), ("row", "<f8", (stream.channels,))])
            rows["tag"], rows["at"], rows["row"] = 8, times_s, item.values
            self._samples(stream, times_s.tolist(), rows.tobytes())

    def _write_feature(self, item: Feature) -> None:
        name = f"{item.source} {item.name.value}"
        if isinstance(item.value, str):
            key = ("feature", item.source, item.name.value, "text")
            self._write_text(key, name, "Feature", item.at_s, item.value)
            return
        stream = self._stream(
            ("feature", item.source, item.name.value),
            name,
            "Feature",
            [(item.name.value, UNITS.get(item.name, "")), ("quality", ""), ("valid", "")],
            source=item.source,
            method=item.method,
        )
        is_valid = float(item.status == "valid")
        row = struct.pack("<Bdddd", 8, item.at_s, item.value, item.quality, is_valid)
        self._samples(stream, [item.at_s], row)

    def _write_report(self, item: SensorReport) -> None:
        what = [part.value for part in (item.link, item.fault) if part is not None]
        text = _line(" ".join(what), item.text)
        if text:
            self._write_text(("report", item.source), f"{item.source} reports", "Markers", item.at_s, text)

    def _write_text(self, key: tuple[str, ...], name: str, kind: str, at_s: float, text: str) -> None:
        stream = self._stream(key, name, kind, [("text", "")], is_text=True)
        encoded = text.encode()
        self._samples(stream, [at_s], struct.pack("<Bd", 8, at_s) + _length(len(encoded)) + encoded)

    def _stream(
        self,
        key: tuple[str, ...],
        name: str,
        kind: str,
        channels: Sequence[tuple[str, str]],
        *,
        rate_hz: float = 0.0,
        source: str = "",
        method: str = "",
        is_text: bool = False,
    ) -> _Stream:
        if key in self._streams:
            return self._streams[key]
        if len(self._streams) >= MAX_STREAMS:
            raise ExchangeError(f"a recording has at most {MAX_STREAMS} streams; record fewer sensors")
        stream = self._streams[key] = _Stream(len(self._streams) + 1, len(channels))
        info = Element("info")
        for tag, value in {
            "name": name,
            "type": kind,
            "channel_count": str(len(channels)),
            "nominal_srate": repr(rate_hz),
            "channel_format": "string" if is_text else "double64",
            "source_id": source or name,
        }.items():
            SubElement(info, tag).text = _printable(value)
        described = SubElement(info, "desc")
        SubElement(SubElement(described, "subject"), "id").text = _printable(self._subject)
        SubElement(SubElement(described, "acquisition"), "method").text = _printable(method)
        listed = SubElement(described, "channels")
        for label, unit in channels:
            channel = SubElement(listed, "channel")
            SubElement(channel, "label").text = _printable(label)
            SubElement(channel, "unit").text = _printable(unit)
            SubElement(channel, "type").text = kind
        content = tostring(info, xml_declaration=True, encoding="UTF-8")
        self._chunk(_STREAM_HEADER, struct.pack("<I", stream.number) + content)
        return stream

    def _samples(self, stream: _Stream, times_s: Sequence[float], content: bytes) -> None:
        if stream.count == 0:
            stream.first_s = times_s[0]
            self._chunk(_CLOCK_OFFSET, struct.pack("<Idd", stream.number, times_s[0], 0.0))
        stream.count += len(times_s)
        stream.last_s = times_s[-1]
        self._chunk(_SAMPLES, struct.pack("<I", stream.number) + _length(len(times_s)) + content)
        if self._since_boundary >= BOUNDARY_EVERY_BYTES:
            self._chunk(_BOUNDARY, _BOUNDARY_ID)
            self._since_boundary = 0

    def _chunk(self, tag: int, content: bytes) -> None:
        chunk = _length(len(content) + 2) + struct.pack("<H", tag) + content
        self._file.write(chunk)
        self._since_boundary += len(chunk)


def _length(number: int) -> bytes:
    if number < 1 << 8:
        return struct.pack("<BB", 1, number)
    return struct.pack("<BI", 4, number) if number < 1 << 32 else struct.pack("<BQ", 8, number)


def _line(first: str, second: str) -> str:
    return f"{first}: {second}" if first and second else first or second


def _printable(text: str) -> str:
    """Return the text without characters that XML 1.0 cannot contain."""
    return "".join(character for character in text if character in "\t\n" or _is_printable(ord(character)))


def _is_printable(code: int) -> bool:
    return 0x20 <= code < 0xD800 or 0xE000 <= code < 0xFFFE or code > 0xFFFF
