"""REST: recordings of the humanoid: start, stop, list, download, replay, delete."""

import base64
from datetime import UTC, datetime
from typing import Annotated, Any, Final

from fastapi import FastAPI, Path, Query, Response
from pydantic import Field
from starlette.responses import FileResponse

from handover.errors import Problem
from handover.http.api_description import TaggedRoutes, sends
from handover.security.caller import Caller
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_humanoid.recording.recordings import Recordings
from handover_humanoid.recording.store import RecordingRow
from handover_humanoid.routes.access import of_humanoid
from handover_humanoid.routes.bodies import Body

RecordingId = Annotated[str, Path(pattern=r"^R-[0-9a-f]{16}$")]
DEFAULT_SPAN_S: Final = 20.0
MAX_SECONDS: Final = 1e6


class RecordingStart(Body):
    """What the recording is called."""

    label: str = Field("", max_length=200)


class RecordingView(Body):
    """A recording; digest, size in bytes and messages are those of the MCAP file of an ended one."""

    id: str
    humanoid: str
    label: str
    state: str
    started_by: str
    started: datetime
    ended: datetime | None
    end_reason: str | None
    duration_s: float | None
    sha256: str | None
    size: int
    messages: int
    deleted_after: datetime | None


class FrameView(Body):
    """A live document, `t` in s after the start of the recording."""

    t: float
    document: dict[str, Any]


class FramesView(Body):
    """At most 600 live documents; `nextFrom` is where the rest of the span begins."""

    duration_s: float
    frames: list[FrameView]
    next_from: float | None


def add_recording_routes(app: FastAPI, recordings: Recordings) -> None:
    """Add the routes."""
    routes = TaggedRoutes(app, "recordings")
    see = [require(Permission.READ, of_humanoid)]
    conduct = require(Permission.CONDUCT_STUDIES, of_humanoid)

    def view(row: RecordingRow) -> RecordingView:
        return _view(row, recordings)

    @routes.get("/recordings", dependencies=see)
    async def list_recordings() -> list[RecordingView]:
        """Return the recordings, newest first."""
        return [view(row) for row in await recordings.all()]

    @routes.post("/recordings", status_code=201)
    async def start(caller: Annotated[Caller, conduct], body: RecordingStart | None = None) -> RecordingView:
        """Record the state of the control cycle; 409 while a recording runs, 507 with a full disk."""
        return view(await recordings.start((body or RecordingStart()).label, caller.name))

    @routes.post("/recordings/{recording}/stop", dependencies=[conduct])
    async def stop(recording: RecordingId) -> RecordingView:
        """End a recording and close its file; the response has its SHA-256."""
        return view(await recordings.stop(recording))

    @routes.delete("/recordings/{recording}", status_code=204, dependencies=[conduct])
    async def delete(recording: RecordingId) -> Response:
        """Delete a recording with its file; one that runs is ended."""
        await recordings.delete(recording)
        return Response(status_code=204)

    @routes.get(
        "/recordings/{recording}",
        dependencies=see,
        response_class=FileResponse,
        responses=sends("application/octet-stream"),
    )
    async def download(recording: RecordingId) -> FileResponse:
        """Return the MCAP file, with its SHA-256 in `Repr-Digest` (RFC 9530); 409 while it is recorded."""
        row, path = await recordings.file(recording)
        digest = base64.b64encode(bytes.fromhex(row.sha256 or "")).decode()
        return FileResponse(
            path,
            media_type="application/octet-stream",
            filename=f"{row.id}.mcap",
            headers={"Repr-Digest": f"sha-256=:{digest}:", "Cache-Control": "no-store"},
        )

    @routes.get("/recordings/{recording}/frames", dependencies=see)
    async def frames(
        recording: RecordingId,
        from_s: Annotated[float, Query(alias="from", ge=0, le=MAX_SECONDS)] = 0.0,
        to_s: Annotated[float | None, Query(alias="to", ge=0, le=MAX_SECONDS)] = None,
    ) -> FramesView:
        """Return live documents between two times in s after the start, by default of 20 s, for a replay."""
        end_s = from_s + DEFAULT_SPAN_S if to_s is None else to_s
        if end_s < from_s:
            raise Problem.translated(
                422,
                "Bad span",
                "humanoid.bad_span",
                "the span is empty: from must not be after to; swap them",
            )
        part = await recordings.frames(recording, from_s, end_s)
        return FramesView(
            duration_s=part.duration_s,
            frames=[FrameView(t=t, document=document) for t, document in part.frames],
            next_from=part.next_s,
        )


def _view(row: RecordingRow, recordings: Recordings) -> RecordingView:
    state = "ended" if row.ended_s is not None else "interrupted"
    return RecordingView(
        id=row.id,
        humanoid=row.humanoid,
        label=row.label,
        state="running" if recordings.is_running(row) else state,
        started_by=row.started_by,
        started=_moment(row.started_s),
        ended=None if row.ended_s is None else _moment(row.ended_s),
        end_reason=row.end_reason,
        duration_s=None if row.ended_s is None else round(row.ended_s - row.started_s, 3),
        sha256=row.sha256,
        size=row.size,
        messages=row.messages,
        deleted_after=None if (at_s := recordings.expires_s(row)) is None else _moment(at_s),
    )


def _moment(at_s: float) -> datetime:
    return datetime.fromtimestamp(at_s, UTC)
