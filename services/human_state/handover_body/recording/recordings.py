"""Recordings of persons who consent: at most one runs for a person.

A recording takes every sample, value and report of the sensors of its person, and markers. They go to the
disk every `SEAL_EVERY_S`. It ends when somebody stops it, when the consent ends, after `MAX_HOURS`, when the
disk is full, and with the service. After a crash the next start closes it.
"""

import asyncio
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Final

from handover.errors import HandoverError, Problem
from handover.runtime.background_tasks import BackgroundTasks
from handover.telemetry import get_logger
from handover_body.formats.errors import ExchangeError
from handover_body.formats.json_messages import Marker, Recorded
from handover_body.monitoring.monitoring import Monitoring
from handover_body.monitoring.person_monitor import PersonMonitor
from handover_body.people.consent import Purpose
from handover_body.people.people import People, now_us
from handover_body.recording.archive import Archive, Journal
from handover_body.storage.store import RecordingRow, Store

log = get_logger(__name__)

SEAL_EVERY_S: Final = 1.0
EXPIRE_EVERY_S: Final = 600.0
MAX_HOURS: Final = 24.0
MAX_WAITING: Final = 50_000
"""Messages that wait for the disk; with more of them the disk is too slow to record."""
MIN_FREE_BYTES: Final = 256 * 2**20
DAY_US: Final = 86_400_000_000


class EndReason(StrEnum):
    """Why a recording has ended."""

    STOPPED = "stopped"
    CONSENT = "consent"
    """The consent to recordings ended or was withdrawn."""
    TOO_LONG = "tooLong"
    DISK = "disk"
    """The disk was full, too slow, or failed."""
    SERVICE = "service"
    """The service was stopped."""
    INTERRUPTED = "interrupted"
    """The service ended in the middle; what it had written is there."""


@dataclass(slots=True)
class _RunningRecording:
    row: RecordingRow
    person: str
    monitor: PersonMonitor
    journal: Journal
    tap: Callable[[Recorded], None]
    waiting: list[Recorded] = field(default_factory=list)
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    ending: asyncio.Task[None] | None = None


class Recordings:
    """All recordings. Everything but the disk happens on the event loop."""

    def __init__(  # noqa: PLR0917 - the parts of the service
        self,
        archive: Archive,
        store: Store,
        people: People,
        monitoring: Monitoring,
        tasks: BackgroundTasks,
        keep_days: float,
    ) -> None:
        self.archive = archive
        self.on_changed: Callable[[RecordingRow], None] = lambda _: None
        """Called when a recording has started or ended."""
        self.on_deleted: Callable[[str], None] = lambda _: None
        """Called with the id of a recording that was deleted."""
        self._store = store
        self._people = people
        self._monitoring = monitoring
        self._tasks = tasks
        self._keep_us = int(keep_days * DAY_US)
        self._rows: dict[str, RecordingRow] = {}
        self._running: dict[str, _RunningRecording] = {}
        """By the name of the person."""
        self._turn = asyncio.Lock()

    async def load(self) -> None:
        """Read what was stored."""
        for row in await asyncio.to_thread(self._store.recordings):
            self._rows[row.id] = row
        await asyncio.to_thread(self.archive.delete_others, list(self._rows))

    async def recover(self) -> None:
        """Close what a crash has interrupted: seconds for a long recording."""
        for row in list(self._rows.values()):
            async with self._turn:
                if row.id not in self._rows or self._find(row.id) is not None:
                    continue
                if row.ended_us is None:
                    await self._recover(row)
                else:
                    await asyncio.to_thread(self.archive.drop_journal, row.id)

    async def run(self) -> None:
        """Write, end what may not continue, and delete what is too old, until cancelled."""
        expired_s = -EXPIRE_EVERY_S
        while True:
            for running in list(self._running.values()):
                await self._check(running)
            if time.monotonic() - expired_s >= EXPIRE_EVERY_S:
                expired_s = time.monotonic()
                await self._delete_old()
            await asyncio.sleep(SEAL_EVERY_S)

    async def close(self) -> None:
        """End all recordings, since the service stops."""
        for running in list(self._running.values()):
            await self._end(running, EndReason.SERVICE)

    def apply(self, name: str) -> None:
        """End the recording of a person who no longer consents to it. Nothing more is taken at once."""
        running = self._running.get(name)
        if running is not None and not self._is_allowed(running):
            self._begin_end(running, EndReason.CONSENT)

    def all(self) -> list[RecordingRow]:
        """Return all recordings."""
        return list(self._rows.values())

    def of(self, subject: str) -> list[RecordingRow]:
        """Return the recordings of a pseudonym, newest first."""
        rows = [row for row in self._rows.values() if row.subject == subject]
        return sorted(rows, key=lambda row: -row.started_us)

    def recording(self, identifier: str, subject: str) -> RecordingRow:
        """Return a recording of a pseudonym; raise `Problem` 404."""
        row = self._rows.get(identifier)
        if row is None or row.subject != subject:
            raise Problem.translated(
                404,
                "Unknown recording",
                "health.unknown_recording",
                'there is no recording "{recording}" of this person; it may have been deleted',
                recording=identifier,
            )
        return row

    def is_running(self, row: RecordingRow) -> bool:
        """Return whether a recording takes signals now."""
        return any(running.row.id == row.id and running.ending is None for running in self._running.values())

    def expires_us(self, row: RecordingRow) -> int:
        """Return when a recording is deleted, in us since 1970."""
        return (row.ended_us or row.started_us) + self._keep_us

    async def start(self, name: str, label: str, started_by: str) -> RecordingRow:
        """Start the recording of a person. Raises `Problem`."""
        async with self._turn:
            person = self._people.person(name)
            monitor = self._monitoring.monitors.get(name)
            if Purpose.RECORDING not in person.purposes() or monitor is None:
                raise Problem.translated(
                    409,
                    "No consent",
                    "health.no_recording_consent",
                    "{person} does not consent to recordings; ask the person, then record",
                    person=name,
                )
            if not self.archive.has_key:
                raise no_key()
            if name in self._running:
                raise Problem.translated(
                    409,
                    "Already recording",
                    "health.already_recording",
                    "{person} is being recorded; stop that recording first",
                    person=name,
                )
            if await asyncio.to_thread(self.archive.free_bytes) < MIN_FREE_BYTES:
                raise Problem(
                    507, "Disk full", "less than 256 MiB are free for recordings; delete some, then record"
                )
            row = RecordingRow(f"R-{secrets.token_hex(8)}", person.pseudonym, label, now_us(), started_by)
            await asyncio.to_thread(self._store.save_recording, row)
            try:
                journal = await asyncio.to_thread(self.archive.begin, row.id, row.subject, label)
            except (OSError, HandoverError, ExchangeError) as error:
                await asyncio.to_thread(self._store.delete_recording, row.id)
                raise Problem(503, "Cannot record", f"the recording cannot begin: {error}") from None
            self._begin(row, name, monitor, journal)
        return row

    async def stop(self, row: RecordingRow) -> RecordingRow:
        """End a recording; without effect on one that has ended. Raises `Problem` if it cannot be closed."""
        running = self._find(row.id)
        if running is not None:
            await self._end(running, EndReason.STOPPED)
        else:
            async with self._turn:
                if row.id in self._rows and self._rows[row.id].ended_us is None:
                    await self._recover(row)
        ended = self._rows.get(row.id, row)
        if ended.ended_us is None:
            raise Problem(
                503,
                "Not closed",
                "the recording is kept, but its file cannot be closed now; see the log, then stop it again",
            )
        return ended

    def mark(self, row: RecordingRow, marker: Marker) -> None:
        """Add a marker to a recording that runs. Raises `Problem` 409."""
        running = self._find(row.id)
        if running is None or running.ending is not None:
            raise Problem.translated(
                409, "Not recording", "health.not_recording", "the recording has ended; start another one"
            )
        self._take(running, marker)

    def mark_person(self, name: str, marker: Marker) -> None:
        """Add a marker to the recording of a person, if one runs."""
        running = self._running.get(name)
        if running is not None:
            self._take(running, marker)

    def recorded(self) -> list[str]:
        """Return the names of the persons who are being recorded."""
        return [name for name, running in self._running.items() if running.ending is None]

    async def delete(self, row: RecordingRow) -> None:
        """Delete a recording with its file; one that runs is ended."""
        running = self._find(row.id)
        if running is not None:
            await self._end(running, EndReason.STOPPED)
        async with self._turn:
            await asyncio.to_thread(self.archive.delete, row.id)
            await asyncio.to_thread(self._store.delete_recording, row.id)
            self._rows.pop(row.id, None)
        self.on_deleted(row.id)

    async def delete_of(self, subject: str) -> None:
        """Delete all recordings of a pseudonym."""
        async with self._turn:  # one that starts now is there afterwards
            rows = self.of(subject)
        for row in rows:
            await self.delete(row)

    def _begin(self, row: RecordingRow, name: str, monitor: PersonMonitor, journal: Journal) -> None:
        def tap(item: Recorded) -> None:
            self._take(running, item)

        running = _RunningRecording(row, name, monitor, journal, tap)
        self._rows[row.id] = row
        self._running[name] = running
        monitor.taps.add(tap)
        monitor.recording = row.id
        self.on_changed(row)
        self.apply(name)  # the consent may have ended while the file was made

    def _find(self, identifier: str) -> _RunningRecording | None:
        return next((running for running in self._running.values() if running.row.id == identifier), None)

    def _is_allowed(self, running: _RunningRecording) -> bool:
        person = self._people.find(running.person)
        return (
            person is not None
            and Purpose.RECORDING in person.purposes()
            and self._monitoring.monitors.get(running.person) is running.monitor
        )

    def _take(self, running: _RunningRecording, item: Recorded) -> None:
        if running.ending is not None:
            return
        if not self._is_allowed(running):
            self._begin_end(running, EndReason.CONSENT)
        elif len(running.waiting) >= MAX_WAITING:
            self._begin_end(running, EndReason.DISK)
        else:
            running.waiting.append(item)

    async def _check(self, running: _RunningRecording) -> None:
        if running.ending is not None:
            return
        if not self._is_allowed(running):
            self._begin_end(running, EndReason.CONSENT)
        elif now_us() - running.row.started_us > MAX_HOURS * 3600e6:
            self._begin_end(running, EndReason.TOO_LONG)
        elif not await self._write(running) or (
            await asyncio.to_thread(self.archive.free_bytes) < MIN_FREE_BYTES
        ):
            self._begin_end(running, EndReason.DISK)

    async def _write(self, running: _RunningRecording) -> bool:
        """Write what waits; return whether that succeeded."""
        async with running.turn:
            items, running.waiting = running.waiting, []
            try:
                await asyncio.to_thread(running.journal.write, items)
            except (OSError, ExchangeError, ValueError) as error:
                log.warning("recording cannot be written", recording=running.row.id, error=str(error))
                return False
        return True

    def _begin_end(self, running: _RunningRecording, reason: EndReason) -> asyncio.Task[None]:
        if running.ending is None:
            running.monitor.taps.discard(running.tap)
            running.monitor.recording = None
            running.ending = self._tasks.start(self._close, running, reason)
        return running.ending

    async def _end(self, running: _RunningRecording, reason: EndReason) -> None:
        await asyncio.wait([self._begin_end(running, reason)])

    async def _close(self, running: _RunningRecording, reason: EndReason) -> None:
        ended_us = now_us()
        await self._write(running)
        try:
            await asyncio.to_thread(running.journal.close)
        except (OSError, ExchangeError, ValueError) as error:
            log.warning("recording not closed", recording=running.row.id, error=str(error))
        try:
            await self._finish(running.row, reason, ended_us)
        finally:
            if self._running.get(running.person) is running:
                del self._running[running.person]

    async def _recover(self, row: RecordingRow) -> None:
        """Close a recording that was interrupted; without the key it stays as it is."""
        if not await asyncio.to_thread(self.archive.has_journal, row.id):
            await asyncio.to_thread(self._store.delete_recording, row.id)
            self._rows.pop(row.id, None)
        elif self.archive.has_key:
            await self._finish(row, EndReason.INTERRUPTED, None)
        else:
            log.warning("an interrupted recording waits for the key", recording=row.id)

    async def _finish(self, row: RecordingRow, reason: EndReason, ended_us: int | None) -> None:
        try:
            done = await asyncio.to_thread(self.archive.finish, row.id)
        except (OSError, HandoverError, ExchangeError) as error:
            log.warning("recording cannot be closed", recording=row.id, error=str(error))
            return
        last_us = row.started_us if done.last_s is None else int(done.last_s * 1e6)
        ended = replace(
            row,
            ended_us=max(last_us, row.started_us) if ended_us is None else ended_us,
            end_reason=reason,
            sha256=done.sha256,
            size=done.size,
            messages=done.messages,
        )
        await asyncio.to_thread(self._store.save_recording, ended)
        await asyncio.to_thread(self.archive.drop_journal, row.id)
        self._rows[row.id] = ended
        self.on_changed(ended)

    async def _delete_old(self) -> None:
        at_us = now_us()
        for row in list(self._rows.values()):
            if self._find(row.id) is None and self.expires_us(row) <= at_us:
                await self.delete(row)


def no_key() -> Problem:
    """Return the problem that recordings have no key."""
    return Problem.translated(
        409,
        "No key",
        "health.no_recording_key",
        "recordings are encrypted, and no key is set; set HANDOVER_HEALTH_RECORDING_KEY to the output of "
        "openssl rand -base64 32 and restart the service",
    )
