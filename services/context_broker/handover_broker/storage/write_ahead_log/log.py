"""The log: records are appended to two files in turn, and read again after a crash."""

from contextlib import suppress
from pathlib import Path
from typing import Final

from handover_broker.storage.write_ahead_log.frames import (
    COMMIT,
    FILE_BYTES,
    ID_BYTES,
    PAGE_BYTES,
    VOID,
    FileContent,
    FileHeader,
    checksum_seed,
    encode_frame,
    encode_header,
    frame_bytes,
)
from handover_broker.storage.write_ahead_log.log_file import Damaged, LogFile

MEASUREMENTS: Final = 3


class WriteAheadLog:
    """Frames in two files beside `path`, numbered from 1 on. Written by one thread at a time."""

    def __init__(self, path: Path) -> None:
        self.files = (LogFile(path.with_suffix(".log-1")), LogFile(path.with_suffix(".log-2")))
        self._active = 0
        self._header = FileHeader(bytes(ID_BYTES), bytes(ID_BYTES), is_closed=True)
        self._checkpointed = 0
        self._attempt = 0
        self.number = 0
        """The number of the last frame."""

    @property
    def paths(self) -> tuple[Path, Path]:
        """Return the paths of the files."""
        return self.files[0].path, self.files[1].path

    @property
    def names(self) -> str:
        """Return the paths of the files, as in an error."""
        return " and ".join(str(path) for path in self.paths)

    def exists(self) -> bool:
        """Return whether one of the files exists and is not empty."""
        return any(path.exists() and path.stat().st_size for path in self.paths)

    # Reading what an earlier process wrote

    def read(self, database_id: bytes, log_id: bytes, checkpointed: int) -> list[bytes]:
        """Return the records of a log after number `checkpointed`.

        An interrupted last one is skipped, since it was never acknowledged. Raises `Damaged` if one is or may
        be missing, `UnknownVersion`, and OSError.
        """
        contents = [file.content_of(database_id, log_id) for file in self.files]
        records: dict[int, bytes] = {}
        for content in contents:
            records.update(content.records)
        following = checkpointed + 1
        while following in records:
            following += 1
        last = max(records, default=0)
        if last > following:
            raise Damaged(f"{self.names}: change {following} cannot be read, and {last} is there")
        self._require_following_sound(contents, following, last)
        if max((max(content.numbers.values(), default=0) for content in contents), default=0) < checkpointed:
            raise Damaged(f"{self.names}: an older copy; it ends before change {checkpointed} of the tables")
        return [records[number] for number in range(checkpointed + 1, following)]

    def _require_following_sound(self, contents: list[FileContent], following: int, last: int) -> None:
        """Raise `Damaged` for damage where change `following` may be: at the start, or after the last one."""
        for file, content in zip(self.files, contents, strict=True):
            for offset in content.damaged:
                may_follow = offset in {PAGE_BYTES, content.ends.get(last)}
                if may_follow and content.numbers.get(offset, following) >= following:
                    raise Damaged(f"{file.path}: change {following}, from byte {offset} on, is damaged")

    def describe_foreign(self, database_id: bytes, log_id: bytes) -> str | None:
        """Describe changes of another log that may be in no table; None if there are none. Raises
        `UnknownVersion`."""
        for file in self.files:
            header = file.header()
            if header is None or header.is_closed or header.log_id == log_id:
                continue
            if file.content().numbers:
                owner = "this database, later" if header.database_id == database_id else "another database"
                return f"{file.path} holds changes of {owner}"
        return None

    # Writing

    def begin(self, database_id: bytes, log_id: bytes) -> None:
        """Start a log with a unique id; the content of the files is overwritten."""
        self._header = FileHeader(database_id, log_id, is_closed=False)
        self._active = self._checkpointed = self.number = self._attempt = 0
        for file in self.files:
            file.prepare(self._header)

    def measure_write_s(self) -> float:
        """Return how long it takes to write a frame; call it before the first one."""
        return min(self.files[0].measure_write_s() for _ in range(MEASUREMENTS))

    @property
    def needs_checkpoint(self) -> bool:
        """Return whether the file that is not in use has changes that are not in the tables yet."""
        return self.files[1 - self._active].last_number > self._checkpointed

    def has_space(self, record: bytes) -> bool:
        """Return whether a record fits; if not, it does after a checkpoint (unless it is too large)."""
        return self._index_with_space(frame_bytes(len(record))) is not None

    @staticmethod
    def is_too_large(record: bytes) -> bool:
        """Return whether a record is too large for a file."""
        return frame_bytes(len(record)) > FILE_BYTES - PAGE_BYTES

    def append(self, record: bytes) -> None:
        """Write a record for which there is space and return when it is durable; raises OSError if it is
        not."""
        index = self._index_with_space(frame_bytes(len(record)))
        assert index is not None  # noqa: S101 - the caller has checked has_space
        file, number = self.files[index], self.number + 1
        start = self._next_offset(file)
        frame = self._frame(COMMIT, number, record)
        try:
            file.write(start, frame)
        except OSError:
            with suppress(OSError):  # else it might be there after a crash, although it was refused
                file.write(start, self._frame(VOID, self.number, b""))
            raise
        file.end = start + len(frame)
        file.last_number = self.number = number
        self._active = index

    def probe(self) -> None:
        """Write a void frame where the next one will be; raises OSError if the disk refuses it."""
        index = self._index_with_space(PAGE_BYTES)
        if index is not None:
            file = self.files[index]
            file.write(self._next_offset(file), self._frame(VOID, self.number, b""))

    def note_checkpoint(self, number: int) -> None:
        """Record that the tables have everything up to frame `number`."""
        self._checkpointed = number

    def close(self, *, is_copied: bool = False) -> None:
        """Close the files; the header notes if the tables have everything."""
        for file in self.files:
            if is_copied:
                with suppress(OSError):
                    file.write(0, encode_header(self._header._replace(is_closed=True)))
            file.close()

    def _frame(self, kind: bytes, number: int, record: bytes) -> bytes:
        self._attempt += 1
        return encode_frame(kind, number, record, self._attempt, checksum_seed(self._header.log_id))

    def _next_offset(self, file: LogFile) -> int:
        """Return where the next frame of a file begins: at its start once its changes are in the tables."""
        return PAGE_BYTES if file.last_number <= self._checkpointed else file.end

    def _index_with_space(self, length: int) -> int | None:
        """Return the index of a file with enough space, preferably the one in use."""
        if self._next_offset(self.files[self._active]) + length <= FILE_BYTES:
            return self._active
        return None if self.needs_checkpoint or length > FILE_BYTES - PAGE_BYTES else 1 - self._active
