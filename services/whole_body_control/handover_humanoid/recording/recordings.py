"""All recordings of a humanoid: at most one runs; bounded in time and on the disk.

The oldest ended recordings are deleted when they are older than `keep_days`, or when all together are larger
than `keep_bytes`. After a crash the next start completes the file of the recording that ran.
"""

import asyncio
import hashlib
import secrets
import shutil
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

from handover.errors import HandoverError, Problem
from handover.formats.mcap_files import McapFileError, rewrite
from handover.telemetry import get_logger
from handover_humanoid.recording.files import Frames, read_frames
from handover_humanoid.recording.recorder import Document, Recorder, RecordingEnd, RecordingLimits
from handover_humanoid.recording.store import RecordingRow, RecordingStore

log = get_logger(__name__)

SUFFIX: Final = ".mcap"
WATCH_EVERY_S: Final = 0.5
EXPIRE_EVERY_S: Final = 600.0
MIN_FREE_BYTES: Final = 256 * 2**20
DAY_S: Final = 86_400.0
_UNFINISHED: Final = ".unfinished"


@dataclass(frozen=True, slots=True)
class Keep:
    """Where files are, and how long and how many of them are kept."""

    folder: Path
    keep_days: float
    keep_bytes: int
    max_s: float
    hz: float


class Recordings:
    """Starts, ends, lists and deletes recordings; the methods of an event loop."""

    def __init__(
        self, humanoid: str, ports: Path, keep: Keep, store: RecordingStore, document: Document
    ) -> None:
        self._humanoid, self._ports, self._keep = humanoid, ports, keep
        self._store, self._document = store, document
        self._recorder: Recorder | None = None
        self._row: RecordingRow | None = None
        self._turn = asyncio.Lock()

    def prepare(self) -> None:
        """Prepare the database, and complete what a killed service has left. Blocks for the disk."""
        self._store.prepare()
        self._keep.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        rows = self._store.all()
        for row in rows:
            if row.ended_s is None:
                self._complete(row)
        stored = {row.id for row in rows}
        for path in self._keep.folder.iterdir():
            if path.name.partition(".")[0] not in stored:
                path.unlink()  # its deletion was interrupted

    async def run(self) -> None:
        """End the recording whose bound is reached, and delete the old ones, until cancelled."""
        expire_s = float("-inf")
        while True:
            if self._recorder is not None and not self._recorder.is_running:
                async with self._turn:
                    await self._end(RecordingEnd.STOPPED)
            if time.monotonic() - expire_s > EXPIRE_EVERY_S:
                expire_s = time.monotonic()
                await asyncio.to_thread(self._expire)
            await asyncio.sleep(WATCH_EVERY_S)

    def is_running(self, row: RecordingRow) -> bool:
        """Whether this recording runs."""
        return self._row is not None and self._row.id == row.id

    def expires_s(self, row: RecordingRow) -> float | None:
        """Return when an ended recording will be deleted, in s since 1970."""
        return None if row.ended_s is None else row.ended_s + self._keep.keep_days * DAY_S

    async def all(self) -> list[RecordingRow]:
        """Return the recordings, newest first."""
        return await asyncio.to_thread(self._store.all)

    async def find(self, recording: str) -> RecordingRow:
        """Return a recording. Raises `Problem` 404."""
        row = await asyncio.to_thread(self._store.find, recording)
        if row is None:
            raise Problem.translated(
                404,
                "No such recording",
                "humanoid.no_such_recording",
                'there is no recording "{recording}"; GET /recordings lists them',
                recording=recording,
            )
        return row

    async def start(self, label: str, started_by: str) -> RecordingRow:
        """Start a recording. Raises `Problem` 409 while one runs, 507 with a full disk."""
        async with self._turn:
            if self._row is not None:
                raise Problem.translated(
                    409,
                    "Already recording",
                    "humanoid.already_recording",
                    "a recording runs already; stop it first",
                )
            row = RecordingRow(
                f"R-{secrets.token_hex(8)}", self._humanoid, label, started_by[:200], time.time()
            )
            self._recorder = await asyncio.to_thread(self._begin, row)
            self._row = row
            log.info("recording started", recording=row.id)
            return row

    async def stop(self, recording: str) -> RecordingRow:
        """End a recording and close its file. Raises `Problem` 404 and 409."""
        row = await self.find(recording)
        async with self._turn:
            if not self.is_running(row):
                raise Problem.translated(
                    409, "Not recording", "humanoid.not_recording", "the recording has ended already"
                )
            return await self._end(RecordingEnd.STOPPED)

    async def close(self) -> None:
        """End the recording that runs, since the service ends."""
        async with self._turn:
            if self._row is not None:
                await self._end(RecordingEnd.SERVICE)

    async def delete(self, recording: str) -> None:
        """Delete a recording with its file; one that runs is ended. Raises `Problem` 404."""
        row = await self.find(recording)
        async with self._turn:
            if self.is_running(row):
                await self._end(RecordingEnd.STOPPED)
            await asyncio.to_thread(self._delete, row)

    async def file(self, recording: str) -> tuple[RecordingRow, Path]:
        """Return an ended recording and its file. Raises `Problem` 404 and 409."""
        row = await self.find(recording)
        if row.ended_s is None:
            raise Problem.translated(
                409,
                "Still recording",
                "humanoid.still_recording",
                "the recording has not ended; stop it first",
            )
        path = self._path(row)
        if not path.is_file():
            raise Problem.translated(
                410, "No file", "humanoid.no_recording_file", "the file of the recording is missing"
            )
        return row, path

    async def frames(self, recording: str, from_s: float, to_s: float) -> Frames:
        """Return live documents of an ended recording. Raises `Problem` 404, 409 and 410."""
        _, path = await self.file(recording)
        try:
            return await asyncio.to_thread(read_frames, path, from_s, to_s)
        except (McapFileError, OSError) as error:
            raise Problem.translated(
                409,
                "Cannot be read",
                "humanoid.recording_damaged",
                "the recording cannot be read: {reason}",
                reason=str(error),
            ) from None

    def _path(self, row: RecordingRow) -> Path:
        return self._keep.folder / f"{row.id}{SUFFIX}"

    def _begin(self, row: RecordingRow) -> Recorder:
        self._expire()
        keep = self._keep
        free = shutil.disk_usage(keep.folder).free - MIN_FREE_BYTES
        if free <= 0:
            raise Problem.translated(
                507,
                "Disk full",
                "humanoid.disk_full",
                "a recording needs {megabytes} MB of free disk space",
                megabytes=MIN_FREE_BYTES // 2**20,
            )
        bounds = RecordingLimits(keep.max_s, min(keep.keep_bytes, free), keep.hz)
        self._store.add(asdict(row))
        try:
            return Recorder(self._path(row), self._ports, self._document, bounds, row.id)
        except (HandoverError, OSError):
            self._store.delete(row.id)
            raise

    async def _end(self, reason: RecordingEnd) -> RecordingRow:
        recorder, row = self._recorder, self._row
        assert recorder is not None and row is not None  # noqa: PT018, S101 - the caller has looked
        await asyncio.to_thread(recorder.stop)
        self._recorder, self._row = None, None
        return await asyncio.to_thread(self._close, row, recorder.reason or reason, recorder.messages)

    def _close(self, row: RecordingRow, reason: RecordingEnd, messages: int) -> RecordingRow:
        path = self._path(row)
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        ended = replace(
            row,
            ended_s=time.time(),
            end_reason=reason.value,
            sha256=digest,
            size=path.stat().st_size,
            messages=messages,
        )
        self._store.change(row.id, asdict(ended))
        log.info("recording ended", recording=row.id, reason=reason.value, messages=messages)
        return ended

    def _complete(self, row: RecordingRow) -> None:
        """Make a whole file of one that was cut off; delete a recording of which nothing is left."""
        path = self._path(row)
        unfinished = path.with_suffix(_UNFINISHED)
        try:
            with path.open("rb") as source, unfinished.open("wb") as target:
                unfinished.chmod(0o600)
                done = rewrite(source, target)
            unfinished.replace(path)
            self._close(row, RecordingEnd.INTERRUPTED, done.messages)
        except (McapFileError, OSError):
            log.exception("interrupted recording lost", recording=row.id)
            unfinished.unlink(missing_ok=True)
            self._delete(row)

    def _expire(self) -> None:
        """Delete what is older, or more, than is kept; the newest go last."""
        now_s, total = time.time(), 0
        for row in self._store.all():
            expires_s = self.expires_s(row)
            if expires_s is None:
                continue
            total += row.size
            if now_s > expires_s or total > self._keep.keep_bytes:
                log.info("recording deleted", recording=row.id, size=row.size)
                self._delete(row)

    def _delete(self, row: RecordingRow) -> None:
        self._path(row).unlink(missing_ok=True)
        self._store.delete(row.id)
