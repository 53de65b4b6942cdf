"""The write-ahead log of SQLite, as far as its format is needed: https://www.sqlite.org/fileformat2.html#walformat."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_MAGIC: Final = frozenset({0x377F0682, 0x377F0683})
_HEADER: Final = struct.Struct(">IIII8s8x")
_FRAME: Final = struct.Struct(">II8s8x")


@dataclass(frozen=True, slots=True)
class WalFrame:
    """A copy of a page. `database_pages` is the size of the database after a commit, 0 inside of one."""

    page: int
    database_pages: int
    content: bytes


@dataclass(frozen=True, slots=True)
class WalFile:
    """A write-ahead log; `salts` are new each time when it starts again at its first frame."""

    path: Path
    page_size: int
    salts: bytes

    def frames(self) -> Iterator[WalFrame]:
        """Yield the frames since the log was started the last time, including interrupted ones at its end."""
        with self.path.open("rb") as file:
            file.seek(_HEADER.size)
            while len(head := file.read(_FRAME.size)) == _FRAME.size:
                page, pages, salts = _FRAME.unpack(head)
                content = file.read(self.page_size)
                if salts != self.salts or len(content) < self.page_size:
                    return
                yield WalFrame(page, pages, content)


def wal_of(database: Path) -> Path:
    """Return the path of the write-ahead log of a database."""
    return database.with_name(f"{database.name}-wal")


def read_wal(database: Path) -> WalFile | None:
    """Return the write-ahead log of a database; None if there is none, or one without a header."""
    path = wal_of(database)
    try:
        with path.open("rb") as file:
            head = file.read(_HEADER.size)
    except FileNotFoundError:
        return None
    if len(head) < _HEADER.size:
        return None
    magic, _, page_size, _, salts = _HEADER.unpack(head)
    return WalFile(path, page_size, salts) if magic in _MAGIC else None
