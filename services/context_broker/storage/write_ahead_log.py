"""The write-ahead log before an SQLite file: a commit is one frame, flushed before its writers are answered.

SQLite writes whole pages for a change of some hundred bytes, and calls back into the interpreter for each
statement. A frame is one write, into space that the file has already: flushing a growing file costs the disk
four times as much. Two files of a fixed size are used in turn; a file is overwritten once its content is in
the tables. So the log stays small, and is read quickly after a crash.

Damage must not look like a crash. Each file begins with a stamp: the database it belongs to, and the opening
of the broker that wrote it. A frame begins on a page of its own and is divided into sectors of 512 bytes, the
unit in which disks write. Each sector has a checksum and the number of the attempt that wrote it. A frame
with some new and some old or empty sectors is a write that a power failure interrupted, and that was never
acknowledged. A sector that is neither is damage, and so is a file that is missing, of another length or of
another opening, and a log that ends before the last checkpoint.
"""

import os
import struct
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple
from zlib import crc32

from services.context_broker.storage.database import flush_folder

PAGE: Final = 4096
SIZE: Final = 512 * PAGE
"""Size of a file: one to two thousand changes, which are also in memory until the next checkpoint."""

TRIES: Final = 3

_SECTOR: Final = 512
_TAIL: Final = struct.Struct("<IH")
"""At the end of a sector, before its checksum: the attempt that wrote it, and its index in the frame."""
_SUM: Final = struct.Struct("<I")
_PAYLOAD: Final = _SECTOR - _TAIL.size - _SUM.size
_HEAD: Final = struct.Struct("<4sQI")
"""At the beginning of a frame: whether it is valid, its number, and the length of the record."""
_COUNTS: Final = b"HFRM"
_VOID: Final = b"HVOI"
"""A void frame replaces one that could not be written; it has the number of the last valid one."""
_STAMP: Final = struct.Struct("<8s8s8sB")
"""Magic number with the version of the format, database, opening, and whether the log was closed cleanly."""
_MARK: Final = b"HOVRLOG1"
_STAMP_PLACE: Final = 0xFFFF
_EMPTY: Final = bytes(_SECTOR)
_SYNCED: Final = getattr(os, "O_DSYNC", 0)
"""With this flag a write returns when it is durable, without a second call."""


class Damaged(Exception):
    """Acknowledged changes cannot be read, or may be incomplete; the message names the file."""


class Stamp(NamedTuple):
    """The first page of a file: 8 bytes each for the database and its opening."""

    database: bytes
    opening: bytes
    is_closed: bool


class Frame(NamedTuple):
    """A frame as it is in a file: with its record if it is complete."""

    offset: int
    number: int
    record: bytes | None
    is_damaged: bool


class WriteAheadLog:
    """Frames in two files beside `path`, numbered from 1 on. Written by one thread at a time."""

    def __init__(self, path: Path) -> None:
        self._files = (_File(path.with_suffix(".log-1")), _File(path.with_suffix(".log-2")))
        self._active = 0
        self._stamp = Stamp(bytes(8), bytes(8), is_closed=True)
        self._checkpointed = 0
        self._attempt = 0
        self.number = 0
        """The number of the last frame."""

    @property
    def paths(self) -> tuple[Path, Path]:
        """Return the paths of the files."""
        return self._files[0].path, self._files[1].path

    def exists(self) -> bool:
        """Return whether one of the files exists and is not empty."""
        return any(path.exists() and path.stat().st_size for path in self.paths)

    def read(self, database: bytes, opening: bytes, checkpointed: int) -> list[bytes]:
        """Return the records after number `checkpointed` that an opening of a database wrote.

        An interrupted last one is skipped, since it was never acknowledged. Raises `Damaged` if one is or may
        be missing, and OSError.
        """
        contents = [file.content_of(database, opening) for file in self._files]
        found: dict[int, bytes] = {}
        for content in contents:
            found.update(content.records)
        following = checkpointed + 1
        while following in found:
            following += 1
        last = max(found, default=0)
        if last > following:
            raise Damaged(f"{self._names()}: change {following} cannot be read, and {last} is there")
        for file, content in zip(self._files, contents, strict=True):
            for at in content.damaged:
                if content.numbers.get(at, following) >= following and at in {PAGE, content.ends.get(last)}:
                    # The next change may be there: at the beginning, or after the last one.
                    raise Damaged(f"{file.path}: change {following}, from byte {at} on, is damaged")
        if (
            max((number for content in contents for number in content.numbers.values()), default=0)
            < checkpointed
        ):
            raise Damaged(
                f"{self._names()}: an older copy; it ends before change {checkpointed} of the tables"
            )
        return [found[number] for number in range(checkpointed + 1, following)]

    def stamps(self) -> list[tuple[Path, Stamp | None]]:
        """Return the files that exist, each with its stamp, None where that is not readable."""
        return [(file.path, file.stamp()) for file in self._files if file.path.exists()]

    def frames(self, path: Path) -> list[Frame]:
        """Return the frames of one file in the order of their offsets; damaged ones have the number 0."""
        (file,) = (file for file in self._files if file.path == path)
        content = file.content()
        found = [Frame(at, 0, None, is_damaged=True) for at in set(content.damaged)]
        for at, number in content.numbers.items():
            if at not in content.damaged:
                record = content.records.get(number)
                is_whole = record is not None and content.ends[number] == at + _pages(len(record))
                found.append(Frame(at, number, record if is_whole else None, is_damaged=False))
        return sorted(found, key=lambda frame: frame.offset)

    def foreign(self, database: bytes, opening: bytes) -> str | None:
        """Return a description of changes of another opening that may be in no table; None if there are
        none."""
        for file in self._files:
            stamp = file.stamp()
            if stamp is None or stamp.is_closed or stamp.opening == opening:
                continue
            if file.content().numbers:
                whose = "this database, later" if stamp.database == database else "another database"
                return f"{file.path} holds changes of {whose}"
        return None

    def begin(self, database: bytes, opening: bytes) -> None:
        """Start a log for an opening (8 bytes that are unique); the content of the files is overwritten."""
        self._stamp = Stamp(database, opening, is_closed=False)
        self._active = self._checkpointed = self.number = self._attempt = 0
        for file in self._files:
            file.prepare(self._stamp)

    def tried_s(self) -> float:
        """Return how long it takes to write a frame; call it before the first one."""
        return min(self._files[0].tried_s() for _ in range(TRIES))

    @property
    def is_tight(self) -> bool:
        """Return whether the file that is not in use has changes that are not in the tables yet."""
        return self._files[1 - self._active].last > self._checkpointed

    def has_room(self, record: bytes) -> bool:
        """Return whether a record fits; if not, it does after a checkpoint (unless it `never_fits`)."""
        return self._roomy(_pages(len(record))) is not None

    @staticmethod
    def never_fits(record: bytes) -> bool:
        """Return whether a record is too large for a file."""
        return _pages(len(record)) > SIZE - PAGE

    def append(self, record: bytes) -> None:
        """Write a record that fits and return when it is durable; raises OSError if it is not."""
        room = self._roomy(_pages(len(record)))
        assert room is not None  # noqa: S101 - the caller has checked has_room
        file = self._files[room]
        number = self.number + 1
        start = PAGE if file.last <= self._checkpointed else file.end
        frame = self._frame(_COUNTS, number, record)
        try:
            file.write(start, frame)
        except OSError:
            with suppress(OSError):  # else it might be there after a crash, although it was refused
                file.write(start, self._frame(_VOID, self.number, b""))
            raise
        file.end = start + len(frame)
        file.last = self.number = number
        self._active = room

    def try_out(self) -> None:
        """Write a void frame where the next one will be; raises OSError if the disk refuses it."""
        room = self._roomy(PAGE)
        if room is not None:
            file = self._files[room]
            file.write(
                PAGE if file.last <= self._checkpointed else file.end, self._frame(_VOID, self.number, b"")
            )

    def checkpointed(self, number: int) -> None:
        """Record that the tables have everything up to frame `number`."""
        self._checkpointed = number

    def close(self, *, in_order: bool = False) -> None:
        """Close the files; after a clean end they say that the tables have everything."""
        for file in self._files:
            if in_order:
                with suppress(OSError):
                    file.write(0, _stamp_page(self._stamp._replace(is_closed=True)))
            file.close()

    def _frame(self, kind: bytes, number: int, record: bytes) -> bytes:
        """Return a record in sectors, each with its own checksum, padded to whole pages."""
        self._attempt += 1
        seed = _seed(self._stamp.opening)
        body = b"".join((_HEAD.pack(kind, number, len(record)), record))
        body += bytes(-len(body) % _PAYLOAD)
        pieces: list[bytes] = []
        for place, start in enumerate(range(0, len(body), _PAYLOAD)):
            payload = body[start : start + _PAYLOAD]
            tail = _TAIL.pack(self._attempt, place)
            pieces += (payload, tail, _SUM.pack(crc32(tail, crc32(payload, seed))))
        pieces.append(bytes(_pages(len(record)) - len(pieces) // 3 * _SECTOR))
        return b"".join(pieces)

    def _roomy(self, length: int) -> int | None:
        """Return the index of a file with enough space, preferably the one in use."""
        file = self._files[self._active]
        taken = PAGE if file.last <= self._checkpointed else file.end
        if taken + length <= SIZE:
            return self._active
        return None if self.is_tight or length > SIZE - PAGE else 1 - self._active

    def _names(self) -> str:
        return " and ".join(str(path) for path in self.paths)


@dataclass(slots=True)
class _Content:
    """The content of a file that one opening wrote."""

    records: dict[int, bytes] = field(default_factory=dict)
    """Complete records, by number."""
    ends: dict[int, int] = field(default_factory=dict)
    """By number, where the next frame may begin."""
    numbers: dict[int, int] = field(default_factory=dict)
    """The numbers of frames whose first sector is readable, by offset."""
    damaged: list[int] = field(default_factory=list)
    """Offsets of frames, or possible frames, with sectors that are neither old nor new."""


class _File:
    """One of the two files; it has its full size before the first frame is written."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.end = PAGE
        """Offset of the next frame."""
        self.last = 0
        """The number of the last frame."""
        self._handle: BinaryIO | None = None

    def stamp(self) -> Stamp | None:
        """Return the content of the first page; None if it is not readable."""
        try:
            with self.path.open("rb") as file:
                sector = file.read(_SECTOR)
        except FileNotFoundError:
            return None
        if len(sector) < _SECTOR or _written_by(sector, 0) != (0, _STAMP_PLACE):
            return None
        mark, database, opening, is_closed = _STAMP.unpack_from(sector)
        return Stamp(database, opening, bool(is_closed)) if mark == _MARK else None

    def content_of(self, database: bytes, opening: bytes) -> _Content:
        """Return the content of an opening that was not closed. Raises `Damaged`."""
        if not self.path.exists():
            raise Damaged(f"{self.path} is missing, which holds changes that are not in the tables yet")
        if (size := self.path.stat().st_size) != SIZE:
            raise Damaged(
                f"{self.path} has {size} bytes instead of {SIZE}: it was cut, or is of another version"
            )
        stamp = self.stamp()
        if stamp is None:
            raise Damaged(f"{self.path}: its first page is damaged")
        if stamp.database != database:
            raise Damaged(f"{self.path} belongs to another database")
        if stamp.opening != opening or stamp.is_closed:
            raise Damaged(f"{self.path} is not of the last opening of the database: one of the two is older")
        return self.content()

    def content(self) -> _Content:
        """Return the content of the opening in the stamp."""
        content, stamp, raw = _Content(), self.stamp(), self.path.read_bytes()
        seed = _seed(b"" if stamp is None else stamp.opening)
        at = PAGE
        while at + PAGE <= len(raw):
            sector = raw[at : at + _SECTOR]
            written = _written_by(sector, seed)
            length = 0
            if written is None and sector != _EMPTY:
                content.damaged.append(at)
            elif written is not None and written[1] == 0:
                length = self._read_frame(content, raw, at, written[0], seed)
            at += length or PAGE
        return content

    @staticmethod
    def _read_frame(content: _Content, raw: bytes, at: int, attempt: int, seed: int) -> int:
        """Add the frame at offset `at`; return its length, 0 if it is incomplete."""
        kind, number, length = _HEAD.unpack_from(raw, at)
        content.numbers[at] = number
        sectors = -(-(_HEAD.size + length) // _PAYLOAD)
        payloads: list[bytes] = []
        for place in range(sectors):
            sector = raw[at + place * _SECTOR : at + (place + 1) * _SECTOR]
            written = _written_by(sector, seed)
            if written == (attempt, place):
                payloads.append(sector[:_PAYLOAD])
            elif written is None and sector != _EMPTY:
                content.damaged.append(at)
                return 0
        if kind != _COUNTS or len(payloads) < sectors:
            return 0
        content.records[number] = b"".join(payloads)[_HEAD.size : _HEAD.size + length]
        content.ends[number] = at + _pages(length)
        return _pages(length)

    def prepare(self, stamp: Stamp) -> None:
        """Open the file, clear it, extend it to its full size, and stamp it."""
        self.end, self.last = PAGE, 0
        if self._handle is None:
            self._handle = open(  # noqa: SIM115 - it stays open
                self.path, "r+b" if self.path.exists() else "w+b", buffering=0, opener=_open_synced
            )
        try:
            content = self._handle.read() if self._handle.seek(0) == 0 else b""
            used = SIZE if len(content) < SIZE else len(content.rstrip(b"\0"))
            if used > PAGE:
                self._handle.seek(PAGE)
                _write(self._handle, bytes(used - PAGE))
            if len(content) > SIZE:
                self._handle.truncate(SIZE)
            self._handle.seek(0)
            _write(self._handle, _stamp_page(stamp))
            if not _SYNCED or len(content) != SIZE:
                os.fsync(self._handle.fileno())
                flush_folder(self.path.parent)
        except OSError:
            self.close()
            raise

    def tried_s(self) -> float:
        """Return how long it takes to write a page; the file must not have changes that are needed."""
        began_s = time.perf_counter()
        self.write(PAGE, bytes(PAGE))
        return time.perf_counter() - began_s

    def write(self, at: int, frame: bytes) -> None:
        """Write a frame and return when it is durable."""
        file = self._handle
        assert file is not None  # noqa: S101 - it has been prepared
        file.seek(at)
        _write(file, frame)
        if not _SYNCED:
            os.fsync(file.fileno())

    def close(self) -> None:
        """Close the file."""
        if self._handle is not None:
            self._handle.close()
            self._handle = None


def _written_by(sector: bytes, seed: int) -> tuple[int, int] | None:
    """Return the attempt that wrote a sector, and its index in the frame; None if it is not readable."""
    (checksum,) = _SUM.unpack_from(sector, _SECTOR - _SUM.size)
    if crc32(sector[_PAYLOAD : -_SUM.size], crc32(sector[:_PAYLOAD], seed)) != checksum:
        return None
    attempt, place = _TAIL.unpack_from(sector, _PAYLOAD)
    return attempt, place


def _stamp_page(stamp: Stamp) -> bytes:
    payload = _STAMP.pack(_MARK, stamp.database, stamp.opening, stamp.is_closed).ljust(_PAYLOAD, b"\0")
    tail = _TAIL.pack(0, _STAMP_PLACE)
    return (payload + tail + _SUM.pack(crc32(tail, crc32(payload)))).ljust(PAGE, b"\0")


def _seed(opening: bytes) -> int:
    """Return the seed of an opening's checksums, so that sectors of other openings are not valid."""
    return crc32(opening)


def _open_synced(path: str, flags: int) -> int:
    return os.open(path, flags | _SYNCED, 0o644)


def _write(file: BinaryIO, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[file.write(rest) :]


def _pages(length: int) -> int:
    """Return the size of a frame for a record of so many bytes: whole pages."""
    sectors = -(-(_HEAD.size + length) // _PAYLOAD)
    return -(-sectors * _SECTOR // PAGE) * PAGE
