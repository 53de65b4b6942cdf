"""The format of the log files: a header page, then frames that are divided into sectors.

Damage must not look like a crash. The header has the id of the database and the id of the log, which is new
at each start of a broker. A frame begins on a page of its own and is divided into sectors of 512 bytes, the
unit in which disks write. Each sector has a checksum and the number of the attempt that wrote it. A frame
with some new and some old or empty sectors is a write that a power failure interrupted, and that was never
acknowledged. A sector that is neither is damage.
"""

import struct
from dataclasses import dataclass, field
from typing import Final, NamedTuple
from zlib import crc32

PAGE_BYTES: Final = 4096
FILE_BYTES: Final = 512 * PAGE_BYTES
"""Size of a file: one to two thousand changes, which are also in memory until the next checkpoint."""
SECTOR_BYTES: Final = 512
ID_BYTES: Final = 8

COMMIT: Final = b"HFRM"
VOID: Final = b"HVOI"
"""A void frame replaces one that could not be written; it has the number of the last valid one."""

_FORMAT: Final = b"1"
_MAGIC: Final = b"HOVRLOG"
_FILE_HEADER: Final = struct.Struct("<7sc8s8sB")
"""Magic number, version of the format, database id, log id, and whether the log was closed cleanly."""
_HEADER_INDEX: Final = 0xFFFF
"""Stands for the index of a sector in the header page."""
_FRAME_HEADER: Final = struct.Struct("<4sQI")
"""At the beginning of a frame: its kind, its number, and the length of the record."""
_TRAILER: Final = struct.Struct("<IH")
"""At the end of a sector, before its checksum: the attempt that wrote it, and its index in the frame."""
_CHECKSUM: Final = struct.Struct("<I")
_PAYLOAD_BYTES: Final = SECTOR_BYTES - _TRAILER.size - _CHECKSUM.size
_EMPTY_SECTOR: Final = bytes(SECTOR_BYTES)


class UnknownVersion(Exception):
    """A version of the format or of a record that another version of Handover wrote; `what` names it."""

    def __init__(self, what: str) -> None:
        super().__init__(
            f"{what}, which this version of Handover does not know; start the version that wrote it and stop "
            "it: it copies the log to the tables; then start this one"
        )
        self.what = what


class FileHeader(NamedTuple):
    """The header of a log file. The ids have 8 bytes each."""

    database_id: bytes
    log_id: bytes
    is_closed: bool


class Frame(NamedTuple):
    """A frame as it is in a file: with its record if it is complete."""

    offset: int
    number: int
    record: bytes | None
    is_damaged: bool


@dataclass(slots=True)
class FileContent:
    """The frames of one log in a file."""

    records: dict[int, bytes] = field(default_factory=dict)
    """Complete records, by number."""
    ends: dict[int, int] = field(default_factory=dict)
    """By number, where the next frame may begin."""
    numbers: dict[int, int] = field(default_factory=dict)
    """The numbers of frames whose first sector is readable, by offset."""
    damaged: list[int] = field(default_factory=list)
    """Offsets of frames, or possible frames, with sectors that are neither old nor new."""

    def frames(self) -> list[Frame]:
        """Return the frames in the order of their offsets; damaged ones have the number 0."""
        frames = [Frame(offset, 0, None, is_damaged=True) for offset in set(self.damaged)]
        for offset, number in self.numbers.items():
            if offset not in self.damaged:
                record = self.records.get(number)
                is_whole = record is not None and self.ends[number] == offset + frame_bytes(len(record))
                frames.append(Frame(offset, number, record if is_whole else None, is_damaged=False))
        return sorted(frames, key=lambda frame: frame.offset)


def encode_header(header: FileHeader) -> bytes:
    """Return the header page."""
    fields = _FILE_HEADER.pack(_MAGIC, _FORMAT, header.database_id, header.log_id, header.is_closed)
    payload = fields.ljust(_PAYLOAD_BYTES, b"\0")
    trailer = _TRAILER.pack(0, _HEADER_INDEX)
    checksum = _CHECKSUM.pack(crc32(trailer, crc32(payload)))
    return (payload + trailer + checksum).ljust(PAGE_BYTES, b"\0")


def decode_header(sector: bytes) -> FileHeader | None:
    """Return the header in the first sector of a file; None if it is damaged. Raises `UnknownVersion`."""
    if len(sector) < SECTOR_BYTES or _verified(sector, 0) != (0, _HEADER_INDEX):
        return None
    magic, version, database_id, log_id, is_closed = _FILE_HEADER.unpack_from(sector)
    if magic != _MAGIC:
        return None
    if version != _FORMAT:
        raise UnknownVersion(f"format {version.decode('latin-1')} of the log")
    return FileHeader(database_id, log_id, bool(is_closed))


def checksum_seed(log_id: bytes) -> int:
    """Return the seed of the checksums of a log, so that sectors of other logs are not valid."""
    return crc32(log_id)


def frame_bytes(record_bytes: int) -> int:
    """Return the size of a frame for a record of so many bytes: whole pages."""
    return -(-_sector_count(record_bytes) * SECTOR_BYTES // PAGE_BYTES) * PAGE_BYTES


def encode_frame(kind: bytes, number: int, record: bytes, attempt: int, seed: int) -> bytes:
    """Return a record in sectors, each with its own checksum, padded to whole pages."""
    content = b"".join((_FRAME_HEADER.pack(kind, number, len(record)), record))
    content += bytes(-len(content) % _PAYLOAD_BYTES)
    parts: list[bytes] = []
    for index, start in enumerate(range(0, len(content), _PAYLOAD_BYTES)):
        sector = content[start : start + _PAYLOAD_BYTES] + _TRAILER.pack(attempt, index)
        parts += (sector, _CHECKSUM.pack(crc32(sector, seed)))
    parts.append(bytes(frame_bytes(len(record)) - len(parts) // 2 * SECTOR_BYTES))
    return b"".join(parts)


def decode_file(raw: bytes, log_id: bytes) -> FileContent:
    """Return the frames of a log in a file's content."""
    content, seed = FileContent(), checksum_seed(log_id)
    offset = PAGE_BYTES
    while offset + PAGE_BYTES <= len(raw):
        sector = raw[offset : offset + SECTOR_BYTES]
        verified = _verified(sector, seed)
        length = 0
        if verified is None and sector != _EMPTY_SECTOR:
            content.damaged.append(offset)
        elif verified is not None and verified[1] == 0:
            length = _decode_frame(content, raw, offset, verified[0], seed)
        offset += length or PAGE_BYTES
    return content


def _decode_frame(content: FileContent, raw: bytes, offset: int, attempt: int, seed: int) -> int:
    """Add the frame at an offset to `content`; return its length, 0 if it is incomplete."""
    kind, number, length = _FRAME_HEADER.unpack_from(raw, offset)
    content.numbers[offset] = number
    count = _sector_count(length)
    payloads: list[bytes] = []
    for index in range(count):
        start = offset + index * SECTOR_BYTES
        sector = raw[start : start + SECTOR_BYTES]
        verified = _verified(sector, seed)
        if verified == (attempt, index):
            payloads.append(sector[:_PAYLOAD_BYTES])
        elif verified is None and sector != _EMPTY_SECTOR:
            content.damaged.append(offset)
            return 0
    if kind != COMMIT or len(payloads) < count:
        return 0
    content.records[number] = b"".join(payloads)[_FRAME_HEADER.size : _FRAME_HEADER.size + length]
    content.ends[number] = offset + frame_bytes(length)
    return frame_bytes(length)


def _sector_count(record_bytes: int) -> int:
    return -(-(_FRAME_HEADER.size + record_bytes) // _PAYLOAD_BYTES)


def _verified(sector: bytes, seed: int) -> tuple[int, int] | None:
    """Return the attempt that wrote a sector, and its index in the frame; None if its checksum is wrong."""
    (checksum,) = _CHECKSUM.unpack_from(sector, SECTOR_BYTES - _CHECKSUM.size)
    if crc32(sector[_PAYLOAD_BYTES : -_CHECKSUM.size], crc32(sector[:_PAYLOAD_BYTES], seed)) != checksum:
        return None
    attempt, index = _TRAILER.unpack_from(sector, _PAYLOAD_BYTES)
    return attempt, index
