"""A checksum of each page of a database file, in a file beside it.

    HOVRPAGE | page size (4) | commits (8) | number of pages (4) | CRC-32 of each page | CRC-32 of all before

Numbers are little-endian. The file is written before the checkpoint that changes the pages, under another
name, and gets its name afterwards; in between the checksums of either are right.
"""

import array
import os
import struct
import sys
import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from zlib import crc32

from handover.files.durable_files import sync_folder

_MAGIC: Final = b"HOVRPAGE"
_HEADER: Final = struct.Struct("<8sIQI")
_CHECKSUM: Final = struct.Struct("<I")


class InvalidChecksums(ValueError):
    """The content of the file was changed."""


@dataclass(frozen=True, slots=True)
class PageChecksums:
    """The checksums of all pages of a database file that has the commits up to number `commits`."""

    page_size: int
    commits: int
    values: "array.array[int]"

    def changed(self, commits: int, pages: Mapping[int, int], size: int) -> "PageChecksums":
        """Return the checksums of a database of `size` pages, of which those in `pages` (from 1) are new."""
        values = self.values[:size]
        values.extend([0] * (size - len(values)))
        for page, checksum in pages.items():
            if page <= size:
                values[page - 1] = checksum
        return PageChecksums(self.page_size, commits, values)


def pages_of(database: Path) -> Path:
    """Return the path of the checksums of a database."""
    return database.with_name(f"{database.name}.pages")


def pending_pages_of(database: Path) -> Path:
    """Return the path of the checksums of a checkpoint that is not complete."""
    return database.with_name(f"{database.name}.pages-new")


def checksums_of_file(database: Path, page_size: int, commits: int) -> PageChecksums:
    """Return the checksums of a database file as it is.

    No connection of this process may have the file open: closing a file releases all locks of the process.
    """
    return PageChecksums(page_size, commits, array.array("I", map(crc32, _pages(database, page_size))))


def differing_pages(
    database: Path, accepted: Collection[PageChecksums], ignored: Collection[int], end_s: float | None
) -> Iterator[int | None]:
    """Yield the number of each page, from 1, whose checksum is in none of `accepted`, except for `ignored`.

    Yields None and ends at the monotonic time `end_s`. No connection of this process may have the file open.
    """
    (first, *_) = accepted
    number = 0
    for number, page in enumerate(_pages(database, first.page_size), start=1):
        if number % 256 == 0 and end_s is not None and time.monotonic() > end_s:
            yield None
            return
        if number in ignored:
            continue
        checksum = crc32(page)
        if all(
            number > len(checksums.values) or checksums.values[number - 1] != checksum
            for checksums in accepted
        ):
            yield number
    shortest = min(len(checksums.values) for checksums in accepted)
    yield from (missing for missing in range(number + 1, shortest + 1) if missing not in ignored)


def read_checksums(path: Path) -> PageChecksums | None:
    """Return the checksums in a file, or None without it. Raises `InvalidChecksums`, `OSError`."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    body = content[_HEADER.size : -_CHECKSUM.size]
    try:
        magic, page_size, commits, count = _HEADER.unpack_from(content)
        is_whole = _CHECKSUM.unpack(content[-_CHECKSUM.size :]) == (crc32(content[: -_CHECKSUM.size]),)
    except struct.error:
        is_whole = False
    if not is_whole or magic != _MAGIC or len(body) != _CHECKSUM.size * count:
        raise InvalidChecksums(f"{path} is damaged")
    return PageChecksums(page_size, commits, _little_endian(array.array("I", body)))


def write_checksums(path: Path, checksums: PageChecksums) -> None:
    """Replace the checksums in a file durably, or leave it. Raises `OSError`."""
    header = _HEADER.pack(_MAGIC, checksums.page_size, checksums.commits, len(checksums.values))
    content = header + _little_endian(checksums.values).tobytes()
    part = path.with_name(f"{path.name}.part")
    part.unlink(missing_ok=True)
    try:
        with os.fdopen(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "wb") as file:
            file.write(content + _CHECKSUM.pack(crc32(content)))
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)  # a full disk has no space for an incomplete one
        raise
    sync_folder(path.parent)


def _little_endian(values: "array.array[int]") -> "array.array[int]":
    if sys.byteorder == "little":
        return values
    swapped = values[:]
    swapped.byteswap()
    return swapped


def _pages(database: Path, page_size: int) -> Iterator[bytes]:
    with database.open("rb") as file:
        while page := file.read(page_size):
            yield page
