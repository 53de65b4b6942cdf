"""REST: recordings of the control of a robot."""

from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.responses import FileResponse

from handover.errors import Problem
from handover.http.api_description import TaggedRoutes, sends
from handover.security.guard import in_path, require
from handover.security.permissions import Permission
from handover_datamodels.times import iso
from handover_robots.control.recording import COLUMNS, file_of, stored

_OF_ROBOT = in_path("Device", "robot")


def add_recording_routes(app: FastAPI, data_dir: Path) -> None:
    """Add the routes."""
    routes = TaggedRoutes(app, "control")
    readers = [require(Permission.READ_STUDIES, _OF_ROBOT)]

    @routes.get("/robots/{robot}/control/recordings", dependencies=readers)
    async def recordings(robot: str) -> dict[str, Any]:
        """Return the recordings of a robot, the newest first, and the columns that all of them have."""
        _require_plain(robot)
        files = stored(data_dir, robot)
        return {
            "columns": COLUMNS,
            "recordings": [
                {"name": file.name, "bytes": file.size, "begunAt": iso(file.begun_at)} for file in files
            ],
        }

    @routes.get(
        "/robots/{robot}/control/recordings/{name}",
        dependencies=readers,
        response_class=FileResponse,
        responses=sends("text/csv"),
    )
    async def recording(robot: str, name: str) -> FileResponse:
        """Return a recording as CSV: both inputs, m, what was commanded, and times, one row a cycle."""
        return FileResponse(_file(data_dir, robot, name), media_type="text/csv; charset=utf-8", filename=name)

    @routes.delete(
        "/robots/{robot}/control/recordings/{name}",
        status_code=204,
        dependencies=[require(Permission.CONDUCT_STUDIES, _OF_ROBOT)],
    )
    async def delete_recording(robot: str, name: str) -> None:
        """Delete a recording."""
        _file(data_dir, robot, name).unlink()


def _file(data_dir: Path, robot: str, name: str) -> Path:
    _require_plain(robot)
    file = file_of(data_dir, robot, name)
    if file is None:
        raise Problem.translated(
            404,
            "No such recording",
            "robot.no_such_recording",
            'there is no recording "{name}" of {robot}',
            name=name,
            robot=robot,
        )
    return file


def _require_plain(robot: str) -> None:
    if "/" in robot or robot in {".", ".."}:
        raise Problem(404, "No such robot", f'"{robot[:64]}" is no name of a robot')
