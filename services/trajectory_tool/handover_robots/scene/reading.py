"""Reads a scene, and says what is wrong with it: a line for each fault, with its place."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from handover.errors import UsageError
from handover.telemetry import get_logger
from handover_robots.model.faults import Unreachable
from handover_robots.model.poses import Pose
from handover_robots.model.robot_model import RobotModel
from handover_robots.scene.scene import Scene

log = get_logger(__name__)


def load(file: Path | None, *models: RobotModel) -> Scene:
    """Return the scene of `file`, by default that of the first robot, or an empty one without any.

    Raises `UsageError` with one line for each fault; some robot must reach everything in a scene.
    """
    path = file or models[0].scene
    if path is None:
        return Scene(name="empty cell")
    try:
        written = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"the scene file {path} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"the scene file {path} is not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(written, Mapping):
        raise UsageError(f"the scene file {path} must name the cell, its bins and fixtures")
    return read_scene(written, path.parent, f"scene file {path}", *models)


def read_scene(written: Mapping[str, Any], folder: Path, source: str, *models: RobotModel) -> Scene:
    """Return the scene with a content; `source` is named in faults. Raises `UsageError`."""
    try:
        scene = Scene.model_validate({**written, "folder": folder})
    except ValidationError as error:
        shown = (f"{source}: {_place(fault['loc'])}: {fault['msg']}" for fault in error.errors())
        raise UsageError("\n".join(shown)) from None
    faults = [f"{source}: {fault}" for fault in _faults(scene, models)]
    if faults:
        raise UsageError("\n".join(faults))
    for model in models:
        if scene.gripper.part_mass_kg is not None and model.max_payload_kg is None:
            log.warning(
                "payload unknown, no part is carried: give the robot max_payload_kg in its robot.yaml",
                robot=model.name,
                part_mass_kg=scene.gripper.part_mass_kg,
                tool_kg=round(model.tool_kg, 3),
            )
    return scene


def _faults(scene: Scene, models: Sequence[RobotModel]) -> Iterator[str]:
    yield from _repeated_names(scene)
    for model in models:
        if model.max_payload_kg is None:
            continue  # the cell starts, and no motion with the part is planned
        if (too_heavy := model.payload_fault(scene.gripper.part_mass_kg or 0.0)) is not None:
            yield f"gripper: {too_heavy}"
    if scene.home is not None:
        if len(models) > 1:
            yield "home: several robots are in the cell; give each its home in the cell file"
            return
        try:
            models[0].allow(scene.home)
        except Unreachable as why:
            yield f"home: {why}"
            return
    for where, pose in _poses(scene):
        reasons = []
        for model in models:
            try:
                model.reach(pose, model.home if scene.home is None else scene.home)
                break
            except Unreachable as why:
                reasons.append(str(why))
        else:
            yield f"{where}: {'; '.join(reasons)}"


def _repeated_names(scene: Scene) -> Iterator[str]:
    kinds: dict[str, str] = {}
    for kind, names in (
        ("bin", scene.bins),
        ("fixture", scene.fixtures),
        ("obstacle", scene.obstacles),
        ("fence", scene.fences),
        ("camera", scene.cameras),
        ("zone", scene.zones),
        ("sensor of people", scene.people_sensors),
    ):
        for name in names:
            if name in kinds:
                yield f'"{name}" is a {kinds[name]} and a {kind}; give one of them another name'
            kinds[name] = kind


def _poses(scene: Scene) -> Iterator[tuple[str, Pose]]:
    approach_m = scene.gripper.approach_m
    for name, bin_ in scene.bins.items():
        yield f"bins.{name}.view", bin_.view.pose
        for number, spot in enumerate(bin_.more_views):
            yield f"bins.{name}.more_views.{number}", spot.pose
        for number, spot in enumerate(bin_.parts):
            yield f"bins.{name}.parts.{number}", spot.pose
            yield f"bins.{name}.parts.{number}, approached from above", spot.pose.raised(approach_m)
    for name, fixture in scene.fixtures.items():
        for number, spot in enumerate(fixture.nests):
            yield f"fixtures.{name}.nests.{number}", spot.pose
            yield f"fixtures.{name}.nests.{number}, approached from above", spot.pose.raised(approach_m)


def _place(location: tuple[Any, ...]) -> str:
    return ".".join(str(part) for part in location) or "file"
