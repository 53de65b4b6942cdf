"""The files of recordings: a journal while one runs, and an encrypted MCAP file when it has ended.

The journal takes each message at once, so that a crash loses at most what was not yet sealed. `finish` copies
it to a complete file, with index and compression, and deletes it afterwards. It does the same with a journal
that a crash has cut off, and may itself be interrupted and done again. Every function blocks.
"""

import io
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from handover.formats.mcap_files import rewrite
from handover_body.exchange.mcap import McapWriter
from handover_body.formats.json_messages import Recorded
from handover_body.recording.sealed import SealedReader, SealedWriter, SealError, chunks_of

JOURNAL: Final = ".journal"
SUFFIX: Final = ".mcap.sealed"
_UNFINISHED: Final = ".unfinished"


@dataclass(frozen=True, slots=True)
class Finished:
    """A complete file: SHA-256 and size in bytes are those of the decrypted MCAP."""

    sha256: str
    size: int
    messages: int
    last_s: float | None
    """The time of the newest message in s since 1970; None without one."""
    is_cut: bool


class Journal:
    """The file of a recording that runs."""

    def __init__(self, path: Path, key: bytes, name: str, subject: str, label: str) -> None:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._file = path.open("xb")
        try:
            path.chmod(0o600)
            self._sealed = SealedWriter(self._file, key, name)
            metadata = {"recording": name, "label": label}
            self._mcap = McapWriter(self._sealed, subject, metadata, is_journal=True)  # type: ignore[arg-type]
            self._sealed.seal()
        except BaseException:
            self._file.close()
            path.unlink()
            raise

    def write(self, items: Iterable[Recorded]) -> None:
        """Write messages to the disk. Raises `OSError` and `ExchangeError`."""
        for item in items:
            self._mcap.write(item)
        self._sealed.seal()

    def close(self) -> None:
        """End the journal."""
        try:
            self._mcap.close()
            self._sealed.close()
        finally:
            self._file.close()


class Archive:
    """The directory of recordings. `key` is None where none is set: then files can only be deleted."""

    def __init__(self, folder: Path, key: bytes | None) -> None:
        self._folder = folder
        self._key = key

    @property
    def has_key(self) -> bool:
        """Return whether files can be written and read."""
        return self._key is not None

    def free_bytes(self) -> int:
        """Return how many bytes are free on the disk of recordings."""
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        return shutil.disk_usage(self._folder).free

    def begin(self, name: str, subject: str, label: str) -> Journal:
        """Begin a recording."""
        return Journal(self._path(name, JOURNAL), self._given_key(), name, subject, label)

    def has_journal(self, name: str) -> bool:
        """Return whether a recording has a journal that was not finished."""
        return self._path(name, JOURNAL).exists()

    def finish(self, name: str) -> Finished:
        """Make the complete file of a journal, also of one that was cut off. The journal stays.

        Raises `OSError`, `SealError` for another key, and `McapFileError`.
        """
        unfinished, complete = self._path(name, _UNFINISHED), self._path(name, SUFFIX)
        with self._path(name, JOURNAL).open("rb") as source, unfinished.open("wb") as target:
            unfinished.chmod(0o600)
            sealed = SealedWriter(target, self._given_key(), name)
            chunks = chunks_of(source, self._given_key(), name, is_cut=True)
            done = rewrite(io.BufferedReader(SealedReader(chunks)), sealed)  # type: ignore[arg-type]
            sealed.close()
        unfinished.replace(complete)
        return Finished(sealed.sha256, sealed.tell(), done.messages, done.last_s, done.is_cut)

    def drop_journal(self, name: str) -> None:
        """Delete the journal of a recording whose complete file is known."""
        self._path(name, JOURNAL).unlink(missing_ok=True)

    def read(self, name: str) -> Iterator[bytes]:
        """Yield the decrypted MCAP file in pieces. Raises `SealError`, also in the middle, and `OSError`."""
        with self._path(name, SUFFIX).open("rb") as file:
            yield from chunks_of(file, self._given_key(), name)

    def delete(self, name: str) -> None:
        """Delete everything of a recording."""
        for suffix in (SUFFIX, JOURNAL, _UNFINISHED):
            self._path(name, suffix).unlink(missing_ok=True)

    def delete_others(self, identifiers: Iterable[str]) -> None:
        """Delete files of recordings that are not `known`: their deletion was interrupted."""
        names = set(identifiers)
        if not self._folder.is_dir():
            return
        for path in self._folder.iterdir():
            name = path.name.partition(".")[0]
            if path.name.endswith((SUFFIX, JOURNAL, _UNFINISHED)) and name not in names:
                path.unlink(missing_ok=True)

    def _path(self, name: str, suffix: str) -> Path:
        return self._folder / f"{name}{suffix}"

    def _given_key(self) -> bytes:
        if self._key is None:
            raise SealError("recordings need a key; set HANDOVER_HEALTH_RECORDING_KEY")
        return self._key
