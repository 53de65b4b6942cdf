"""The file of a backup: a gzipped tar, encrypted if there is a passphrase.

    head.json        the release that made it, and when
    data/…           the files of the data directory
    settings/NAME/…  files outside of it that a setting names
    postgres/…       dumps of PostgreSQL databases
    manifest.json    each file with its size, checksum and mode; what was left out; the settings

The head is first, so that a newer release is refused before anything is read; the manifest is last, since
only then all checksums are known. A backup without its manifest is incomplete.
"""

import gzip
import hashlib
import io
import os
import re
import stat
import tarfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import IO, Any, BinaryIO, Final, cast

import orjson

from handover.backup.sealed_stream import CUT, SealedReader, SealedWriter, is_sealed
from handover.distribution import version
from handover.errors import UsageError

HEAD: Final = "head.json"
MANIFEST: Final = "manifest.json"
DATA: Final = "data"
SETTINGS: Final = "settings"
POSTGRES: Final = "postgres"
FORMAT: Final = 1
COMPRESSION: Final = 6
MAX_LIST_BYTES: Final = 256 * 1024 * 1024
_COPY_BYTES: Final = 1024 * 1024


@dataclass(frozen=True, slots=True)
class Head:
    """Which release made a backup, when, and in which format."""

    release: str
    created_at: str
    format: int = FORMAT


@dataclass(slots=True)
class Manifest:
    """What a backup has, and what it has not."""

    files: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Size, SHA-256 and mode of each file, by its name in the archive."""
    marked: list[str] = field(default_factory=list)
    """The SQLite databases that have marks beside them (`handover.database.sqlite_integrity`)."""
    left_out: list[str] = field(default_factory=list)
    """What belongs to the cell and is not in the backup, one line each."""
    settings: dict[str, str] = field(default_factory=dict)
    """The settings of the cell as environment variables."""
    places: dict[str, str] = field(default_factory=dict)
    """The name in the archive of the file or folder of a setting."""
    dumps: dict[str, str] = field(default_factory=dict)
    """The name in the archive of the dump of the database of a setting."""


class ArchiveWriter:
    """Adds files to a backup; `finish` writes the manifest, `close` the end."""

    def __init__(self, target: BinaryIO) -> None:
        self.manifest = Manifest()
        self._zip = gzip.GzipFile(fileobj=target, mode="wb", filename="", compresslevel=COMPRESSION)
        self._tar = tarfile.open(fileobj=self._zip, mode="w|", format=tarfile.PAX_FORMAT)  # noqa: SIM115
        head = Head(release(), datetime.now(UTC).isoformat(timespec="seconds"))
        self._add_text(HEAD, orjson.dumps(head))

    def add(self, name: str, path: Path) -> None:
        """Add a file; one that grows meanwhile is added as far as it was. Raises `OSError`."""
        digest = hashlib.sha256()
        with path.open("rb") as source:
            status = os.fstat(source.fileno())
            mode = stat.S_IMODE(status.st_mode)
            reader = _Measured(source, status.st_size, digest)
            self._tar.addfile(_member(name, status.st_size, mode), cast("IO[bytes]", reader))
        listed = {"size": status.st_size, "sha256": digest.hexdigest(), "mode": mode}
        self.manifest.files[name] = listed

    def finish(self) -> None:
        """Write the manifest."""
        self._add_text(MANIFEST, orjson.dumps(self.manifest))

    def close(self) -> None:
        """Write the end of the archive, which is incomplete without `finish`."""
        try:
            self._tar.close()
        finally:
            self._zip.close()

    def _add_text(self, name: str, content: bytes) -> None:
        self._tar.addfile(_member(name, len(content), 0o600), io.BytesIO(content))


class _Measured:
    """Reads `size` bytes of a file and their checksum; a file that became shorter ends in zeros."""

    def __init__(self, source: BinaryIO, size: int, digest: "hashlib._Hash") -> None:
        self._source, self._left, self._digest = source, size, digest

    def read(self, size: int = _COPY_BYTES) -> bytes:
        wanted = min(size, self._left)
        content = self._source.read(wanted).ljust(wanted, b"\0")
        self._left -= len(content)
        self._digest.update(content)
        return content


def _member(name: str, size: int, mode: int) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.size, member.mode = size, mode
    member.mtime = int(datetime.now(UTC).timestamp())
    return member


@contextmanager
def written(path: Path, passphrase: str | None) -> Iterator[ArchiveWriter]:
    """Write a backup into a new file that only its owner can read. Raises `OSError`, `FileExistsError`."""
    descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
    with os.fdopen(descriptor, "wb") as file, ExitStack() as stack:
        target: BinaryIO = file
        if passphrase is not None:
            target = cast("BinaryIO", stack.enter_context(closing(SealedWriter(file, passphrase))))
        writer = ArchiveWriter(target)
        try:
            yield writer
            writer.finish()
        finally:
            writer.close()
        stack.close()
        file.flush()
        os.fsync(file.fileno())


def read_archive(path: Path, passphrase: str | None, folder: Path | None) -> tuple[Head, Manifest]:
    """Check a whole backup, and extract its files into `folder` if there is one.

    Raises `UsageError` if it is of a newer release, damaged, incomplete, or if the passphrase is wrong.
    """
    try:
        with path.open("rb") as file:
            return _read(_opened(file, path, passphrase), folder)
    except (tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise UsageError(f"{path} is no complete backup of `handover backup`: {error}") from None
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}") from None


def needs_passphrase(path: Path) -> bool:
    """Return whether a backup is encrypted. Raises `UsageError` if it cannot be read."""
    try:
        with path.open("rb") as file:
            return is_sealed(file)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from None


def _opened(file: BinaryIO, path: Path, passphrase: str | None) -> BinaryIO:
    if not is_sealed(file):
        return file
    if passphrase is None:
        raise UsageError(f"{path} is encrypted; give its passphrase with --passphrase-file, or type it")
    return io.BufferedReader(SealedReader(file, passphrase), _COPY_BYTES)


def _read(source: BinaryIO, folder: Path | None) -> tuple[Head, Manifest]:
    head: Head | None = None
    manifest: Manifest | None = None
    seen: dict[str, dict[str, Any]] = {}
    content_of_tar = gzip.GzipFile(fileobj=source, mode="rb")
    with tarfile.open(fileobj=content_of_tar, mode="r|") as tar:
        for member in tar:
            content = tar.extractfile(member) if member.isreg() else None
            if content is None or manifest is not None:
                raise UsageError(f'the backup has "{member.name}", which `handover backup` never writes')
            if head is None:
                head = _head_in(member, content)
            elif member.name == MANIFEST:
                manifest = Manifest(**orjson.loads(content.read(MAX_LIST_BYTES)))
            else:
                seen[member.name] = _extract(member, content, folder)
    if head is None or manifest is None:
        raise UsageError(CUT)
    for name in manifest.files.keys() | seen.keys():
        if manifest.files.get(name) != seen.get(name):
            raise UsageError(f'the backup is damaged: "{name}" is not as it was written; use another copy')
    for rest in (content_of_tar, source):  # to the end, where the last checksums are
        while rest.read(_COPY_BYTES):
            pass
    return head, manifest


def _head_in(member: tarfile.TarInfo, content: IO[bytes]) -> Head:
    if member.name != HEAD:
        raise UsageError(f'this is no backup of `handover backup`: it begins with "{member.name}"')
    head = Head(**orjson.loads(content.read(MAX_LIST_BYTES)))
    if head.format > FORMAT or _numbers(head.release) > _numbers(release()):
        raise UsageError(
            f"the backup was made by Handover {head.release}, and this is {release()}, which may not read "
            "its data; install that release or a newer one"
        )
    return head


def _extract(member: tarfile.TarInfo, content: IO[bytes], folder: Path | None) -> dict[str, Any]:
    place = PurePosixPath(member.name)
    if place.is_absolute() or ".." in place.parts or place.parts[0] not in {DATA, SETTINGS, POSTGRES}:
        raise UsageError(f'the backup has "{member.name}", which `handover backup` never writes')
    digest = hashlib.sha256()
    mode = member.mode & 0o777
    with ExitStack() as stack:
        target = None
        if folder is not None:
            path = folder.joinpath(*place.parts)
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            target = stack.enter_context(
                os.fdopen(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "wb")
            )
        while block := content.read(_COPY_BYTES):
            digest.update(block)
            if target is not None:
                target.write(block)
        if target is not None and os.name == "posix":
            os.fchmod(target.fileno(), mode)
    return {"size": member.size, "sha256": digest.hexdigest(), "mode": mode}


def release() -> str:
    """Return the release of the installed Handover."""
    return version()


def _numbers(of: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", of))
