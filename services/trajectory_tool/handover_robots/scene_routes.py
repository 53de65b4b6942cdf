"""REST: the cell, its robots and its scene, which an engineer changes while the robots work."""

from typing import Annotated, Any

from fastapi import Body, FastAPI, Header, Response

from handover.errors import Problem, UsageError
from handover.messages import message, text_of
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_robots.poses import Pose
from handover_robots.scene_shapes import drawn_shapes
from handover_robots.workcell import Workcell


def add_scene_routes(app: FastAPI, workcell: Workcell) -> None:
    """Add the routes of the cell and its scene."""

    @app.get("/cell", tags=["cell"], dependencies=[require(Permission.READ)])
    async def cell() -> dict[str, Any]:
        """Return the robots of the cell with their places, and the version of the scene."""
        return {
            "name": workcell.scene.name,
            "robots": [
                {
                    "id": name,
                    "model": one.model.name,
                    "revision": one.model.revision,
                    "driver": one.entry.driver,
                    "base": Pose.of(one.model.base).written(),
                }
                for name, one in workcell.cells.items()
            ],
            "scene": _version(workcell),
        }

    @app.get("/cell/scene", tags=["cell"], dependencies=[require(Permission.READ)])
    async def scene(response: Response) -> dict[str, Any]:
        """Return the scene as it is written in a scene file, with its digest and revision.

        Lengths are in m in the frame of the cell. `parts` are the poses of all known parts, `trueParts` those
        of a simulation, known or not, and `shapes` is what a page draws.
        """
        response.headers["ETag"] = f'"{workcell.scene.digest}"'
        return scene_view(workcell)

    @app.put("/cell/scene", tags=["cell"], dependencies=[require(Permission.CONFIGURE)])
    async def put_scene(
        written: Annotated[dict[str, Any], Body()],
        response: Response,
        if_match: Annotated[str | None, Header()] = None,
    ) -> dict[str, Any]:
        """Replace the scene; motions that run stop, and are planned again among the new obstacles.

        The change is durable before this answers. `If-Match` with the ETag of GET refuses to overwrite a
        change that somebody else made. `contacts` lists the robots that touch something now: each has to be
        moved away by hand, or the scene corrected.
        """
        if if_match is not None and if_match.strip('" ') not in {"*", workcell.scene.digest}:
            raise Problem(
                412,
                "Scene changed",
                message("robot.scene_changed", "another client has changed the scene; read it again"),
            )
        try:
            await workcell.change_scene(written)
        except UsageError as error:
            raise Problem(400, "Invalid scene", text_of(error)) from error
        except OSError as error:
            raise Problem(
                507,
                "Scene not stored",
                message(
                    "robot.scene_not_stored",
                    "the scene cannot be stored: {error}; free disk space or set HANDOVER_DATA_DIR",
                    error=error.strerror,
                ),
            ) from error
        response.headers["ETag"] = f'"{workcell.scene.digest}"'
        return {**_version(workcell), "contacts": await workcell.contacts()}


def scene_view(workcell: Workcell) -> dict[str, Any]:
    """Return the scene as JSON, with the parts in it and the shapes to draw."""
    parts = [
        {"part": lying.part, "place": lying.place, **lying.pose.written()}
        for lying in workcell.contents.lying
    ]
    return {
        **workcell.scene.model_dump(mode="json"),
        **_version(workcell),
        "parts": parts,
        "trueParts": _true_parts(workcell),
        "shapes": list(drawn_shapes(workcell.scene)),
    }


def _true_parts(workcell: Workcell) -> list[dict[str, Any]]:
    """Return the parts of simulations, whether or not the tool knows of them."""
    return [
        {"size": list(part.size), **part.pose.written()}
        for cell in workcell.cells.values()
        for part in cell.robot.true_parts() or ()
    ]


def _version(workcell: Workcell) -> dict[str, Any]:
    return {"digest": workcell.scene.digest, "revision": workcell.revision}
