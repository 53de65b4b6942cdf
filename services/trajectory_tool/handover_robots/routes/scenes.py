"""REST: the cell, its robots and its scene, which an engineer changes while the robots work."""

from collections.abc import Iterator
from typing import Annotated, Any

from fastapi import Body, FastAPI, Header, Response

from handover.errors import Problem, UsageError
from handover.messages import text_of
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_robots.cell.cell import RobotCell
from handover_robots.model.obstacles import Box, Cylinder, Mesh, Shape, Sphere
from handover_robots.model.poses import Frame, Pose
from handover_robots.planning import is_available
from handover_robots.scene.scene import IDENTITY, Scene


def add_scene_routes(app: FastAPI, cell: RobotCell) -> None:
    """Add the routes of the cell and its scene."""

    @app.get("/cell", name="cell", tags=["cell"], dependencies=[require(Permission.READ)])
    async def robots_of_cell() -> dict[str, Any]:
        """Return the robots of the cell with their places, and the version of the scene."""
        return {
            "name": cell.scene.name,
            "robots": [
                {
                    "id": name,
                    "model": unit.model.name,
                    "revision": unit.model.revision,
                    "driver": unit.entry.driver,
                    "base": Pose.of(unit.model.base).written(),
                }
                for name, unit in cell.units.items()
            ],
            "scene": _version(cell),
        }

    @app.get("/cell/scene", tags=["cell"], dependencies=[require(Permission.READ)])
    async def scene(response: Response) -> dict[str, Any]:
        """Return the scene as it is written in a scene file, with its digest and revision.

        Lengths are in m in the frame of the cell. `parts` are the poses of all known parts, `trueParts` those
        of a simulation, known or not, and `shapes` is what a page draws.
        """
        response.headers["ETag"] = f'"{cell.scene.digest}"'
        return scene_view(cell)

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
        if if_match is not None and if_match.strip('" ') not in {"*", cell.scene.digest}:
            raise Problem.translated(
                412,
                "Scene changed",
                "robot.scene_changed",
                "another client has changed the scene; read it again",
            )
        try:
            await cell.change_scene(written)
        except UsageError as error:
            raise Problem(400, "Invalid scene", text_of(error)) from error
        except OSError as error:
            raise Problem.translated(
                507,
                "Scene not stored",
                "robot.scene_not_stored",
                "the scene cannot be stored: {error}; free disk space or set HANDOVER_DATA_DIR",
                error=error.strerror,
            ) from error
        response.headers["ETag"] = f'"{cell.scene.digest}"'
        return {**_version(cell), "contacts": await cell.contacts()}


def scene_view(cell: RobotCell) -> dict[str, Any]:
    """Return the scene as JSON, with the parts in it and the shapes to draw."""
    parts = [
        {"part": lying.part, "place": lying.place, **lying.pose.written()} for lying in cell.contents.lying
    ]
    return {
        **cell.scene.model_dump(mode="json"),
        **_version(cell),
        "parts": parts,
        "trueParts": _true_parts(cell),
        "shapes": list(drawn_shapes(cell.scene)),
    }


def _true_parts(cell: RobotCell) -> list[dict[str, Any]]:
    """Return the parts of simulations, whether or not the tool knows of them."""
    return [
        {"size": list(part.size), **part.pose.written()}
        for unit in cell.units.values()
        for part in unit.robot.true_parts() or ()
    ]


def _version(cell: RobotCell) -> dict[str, Any]:
    return {"digest": cell.scene.digest, "revision": cell.revision}


def drawn_shapes(scene: Scene) -> Iterator[dict[str, Any]]:
    """Yield the shapes of obstacles, fences, cameras and zones; a mesh is drawn as its bounding box."""
    for name, thing in scene.obstacles.items():
        yield _drawn_shape("obstacle", name, thing.shape(scene.folder), thing.pose)
    for name, fence in scene.fences.items():
        for panel in fence.obstacles(name):
            yield _drawn_shape("fence", name, panel.shape, panel.pose)
    for name, camera in scene.cameras.items():
        housing = camera.obstacle(name)
        yield _drawn_shape("camera", name, housing.shape, housing.pose)
    for zone in scene.all_zones():
        yield _drawn_shape(zone.kind, zone.name, zone.shape, zone.pose)


def _drawn_shape(kind: str, name: str, shape: Shape, pose: Pose) -> dict[str, Any]:
    match shape:
        case Box(size):
            form, lengths = "box", size
        case Cylinder(radius, length):
            form, lengths = "cylinder", (2 * radius, 2 * radius, length)
        case Sphere(radius):
            form, lengths = "sphere", (2 * radius, 2 * radius, 2 * radius)
        case Mesh():
            form = "box"
            lengths, pose = _bounding_box(shape, pose)
        case _:
            raise ValueError(f"{name} cannot be drawn")
    return {"kind": kind, "name": name, "form": form, "size": list(lengths), **pose.written()}


def _bounding_box(mesh: Mesh, pose: Pose) -> tuple[tuple[float, float, float], Pose]:
    if not is_available():
        return (0.1, 0.1, 0.1), pose
    from handover_robots.planning.collision import geometry_of  # noqa: PLC0415 - needs the extra

    hull = geometry_of(mesh)
    hull.computeLocalAABB()
    low, high = hull.aabb_local.min_.tolist(), hull.aabb_local.max_.tolist()
    middle = Frame(IDENTITY, tuple((lower + upper) / 2 for lower, upper in zip(low, high, strict=True)))
    size = tuple(upper - lower for lower, upper in zip(low, high, strict=True))
    return (size[0], size[1], size[2]), Pose.of(pose.frame() @ middle)
