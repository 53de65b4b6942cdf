"""REST: recordings of a person: start, stop, mark, list, download, export, delete."""

import asyncio
import base64
import hashlib
import time
from itertools import chain
from typing import Annotated

from fastapi import FastAPI, Path, Request, Response
from starlette.responses import StreamingResponse

from handover.errors import Problem
from handover.http.api_description import TaggedRoutes, sends
from handover.security.permissions import Permission
from handover_body.formats.json_messages import Marker
from handover_body.people.people import People
from handover_body.recording.recordings import Recordings, no_key
from handover_body.recording.sealed import SealError
from handover_body.recording.service import RecordingService
from handover_body.routes.access import SignedIn, require_own_or
from handover_body.routes.bodies import MarkerGiven, Name, RecordingStart, RecordingView
from handover_body.routes.views import moment
from handover_body.storage.store import RecordingRow

RecordingId = Annotated[str, Path(pattern=r"^R-[0-9a-f]{16}$")]


def add_recording_routes(app: FastAPI, people: People, recording_service: RecordingService) -> None:
    """Add the routes."""
    routes = TaggedRoutes(app, "recordings")
    recordings = recording_service.recordings
    recording_service.mount(app)
    _add_files(app, people, recording_service)

    def recording_of(person: str, recording: str) -> RecordingRow:
        return recordings.recording(recording, people.person(person).pseudonym)

    def view(row: RecordingRow) -> RecordingView:
        return _view(row, recordings)

    @routes.get("/people/{person}/recordings")
    async def list_recordings(person: Name, caller: SignedIn, request: Request) -> list[RecordingView]:
        """Return the recordings of a person, newest first."""
        await require_own_or(request, caller, Permission.READ_HEALTH_DATA, person)
        return [view(row) for row in recordings.of(people.person(person).pseudonym)]

    @routes.post("/people/{person}/recordings", status_code=201)
    async def start(person: Name, body: RecordingStart, caller: SignedIn, request: Request) -> RecordingView:
        """Start to record all signals and values of a person; 409 without consent or key."""
        await require_own_or(request, caller, Permission.CONDUCT_STUDIES, person)
        started_by = caller.acting_name(body.started_by)
        return view(await recordings.start(person, body.label, started_by[:200]))

    @routes.post("/people/{person}/recordings/{recording}/stop")
    async def stop(person: Name, recording: RecordingId, caller: SignedIn, request: Request) -> RecordingView:
        """End a recording and close its file; the response has its SHA-256."""
        await require_own_or(request, caller, Permission.CONDUCT_STUDIES, person)
        return view(await recordings.stop(recording_of(person, recording)))

    @routes.post("/people/{person}/recordings/{recording}/markers", status_code=204)
    async def mark(
        person: Name, recording: RecordingId, body: MarkerGiven, caller: SignedIn, request: Request
    ) -> Response:
        """Mark a time in a recording that runs: now, or `at`."""
        await require_own_or(request, caller, Permission.CONDUCT_STUDIES, person)
        at_s = time.time() if body.at is None else body.at.timestamp()
        recordings.mark(recording_of(person, recording), Marker(at_s, body.name, body.text))
        return Response(status_code=204)

    @routes.delete("/people/{person}/recordings/{recording}", status_code=204)
    async def delete(person: Name, recording: RecordingId, caller: SignedIn, request: Request) -> Response:
        """Delete a recording with its file; one that runs is ended."""
        await require_own_or(request, caller, Permission.CONDUCT_STUDIES, person)
        await recordings.delete(recording_of(person, recording))
        return Response(status_code=204)


def _add_files(app: FastAPI, people: People, recording_service: RecordingService) -> None:
    routes = TaggedRoutes(app, "recordings")
    recordings, entities = recording_service.recordings, recording_service.entities

    def recording_of(person: str, recording: str) -> RecordingRow:
        return recordings.recording(recording, people.person(person).pseudonym)

    @routes.get(
        "/people/{person}/recordings/{recording}/file",
        response_class=StreamingResponse,
        responses=sends("application/octet-stream"),
    )
    async def download(
        person: Name, recording: RecordingId, caller: SignedIn, request: Request
    ) -> StreamingResponse:
        """Return the decrypted MCAP file, with its SHA-256 in `Repr-Digest` (RFC 9530)."""
        await require_own_or(request, caller, Permission.READ_HEALTH_DATA, person)
        row = _ended(recording_of(person, recording))
        if not recordings.archive.has_key:
            raise no_key()
        pieces = recordings.archive.read(row.id)
        try:
            first = await asyncio.to_thread(next, pieces, b"")
        except (SealError, OSError) as error:
            raise Problem(409, "Cannot be read", f"the recording cannot be read: {error}") from None
        headers = {
            "Content-Disposition": f'attachment; filename="{row.id}.mcap"',
            "Content-Length": str(row.size),
            "Repr-Digest": _digest(bytes.fromhex(row.sha256 or "")),
            "Cache-Control": "no-store",
        }
        return StreamingResponse(
            chain((first,), pieces), media_type="application/octet-stream", headers=headers
        )

    @routes.get(
        "/people/{person}/recordings/{recording}/bundle",
        response_class=Response,
        responses=sends("application/fhir+json"),
    )
    async def bundle(person: Name, recording: RecordingId, caller: SignedIn, request: Request) -> Response:
        """Return values and waveforms as an HL7 FHIR R5 Bundle, with SHA-256; 413 for a long recording."""
        await require_own_or(request, caller, Permission.READ_HEALTH_DATA, person)
        row = _ended(recording_of(person, recording))
        if not recordings.archive.has_key:
            raise no_key()
        content = await recording_service.export.bundle(row, entities.id_of(row.id), time.time())
        headers = {
            "Content-Disposition": f'attachment; filename="{row.id}.fhir.json"',
            "Repr-Digest": _digest(await asyncio.to_thread(_sha256, content)),
            "Cache-Control": "no-store",
        }
        return Response(content, media_type="application/fhir+json", headers=headers)

    @routes.get(
        "/people/{person}/recordings/{recording}/xdf",
        response_class=Response,
        responses=sends("application/octet-stream"),
    )
    async def xdf(person: Name, recording: RecordingId, caller: SignedIn, request: Request) -> Response:
        """Return signals, values and markers as XDF 1.0, with its SHA-256; 413 for a long recording."""
        await require_own_or(request, caller, Permission.READ_HEALTH_DATA, person)
        row = _ended(recording_of(person, recording))
        if not recordings.archive.has_key:
            raise no_key()
        content = await recording_service.export.xdf(row)
        headers = {
            "Content-Disposition": f'attachment; filename="{row.id}.xdf"',
            "Repr-Digest": _digest(await asyncio.to_thread(_sha256, content)),
            "Cache-Control": "no-store",
        }
        return Response(content, media_type="application/octet-stream", headers=headers)


def _sha256(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()


def _digest(sha256: bytes) -> str:
    """Return the value of `Repr-Digest` (RFC 9530)."""
    return f"sha-256=:{base64.b64encode(sha256).decode()}:"


def _ended(row: RecordingRow) -> RecordingRow:
    if row.ended_us is None:
        raise Problem.translated(
            409, "Still recording", "health.still_recording", "the recording has not ended; stop it first"
        )
    return row


def _view(row: RecordingRow, recordings: Recordings) -> RecordingView:
    state = "ended" if row.ended_us is not None else "interrupted"
    return RecordingView(
        id=row.id,
        label=row.label,
        state="running" if recordings.is_running(row) else state,
        started=moment(row.started_us),
        started_by=row.started_by,
        ended=None if row.ended_us is None else moment(row.ended_us),
        end_reason=row.end_reason,
        sha256=row.sha256,
        size=row.size,
        messages=row.messages,
        deleted_after=moment(recordings.expires_us(row)),
    )
