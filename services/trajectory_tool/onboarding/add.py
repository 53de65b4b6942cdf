"""Makes a robot folder from a URDF; nothing is written unless the robot can be loaded and planned for."""

import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml
from lxml import etree

from handover.errors import UsageError
from handover.robot_xml import number_of
from services.trajectory_tool.onboarding import urdf
from services.trajectory_tool.onboarding.semantics import Semantics, sample
from services.trajectory_tool.onboarding.shapes import replace_meshes
from services.trajectory_tool.onboarding.sources import find_urdf
from services.trajectory_tool.onboarding.urdf import Examined, Finding, examine
from services.trajectory_tool.planning.planner import Planner
from services.trajectory_tool.planning.torques import Torques
from services.trajectory_tool.robot_model import MAX_URDF_BYTES, RobotModel
from services.trajectory_tool.robots.folder import FILE, read_folder

DEFAULT_SAMPLES = 3000


@dataclass(frozen=True, slots=True)
class Added:
    """An added robot: its folder, its model, and what is missing or odd in its URDF."""

    folder: Path
    model: RobotModel
    findings: tuple[Finding, ...]


def add_robot(
    source: str,
    name: str,
    into: Path,
    *,
    tip: str | None = None,
    samples: int = DEFAULT_SAMPLES,
    replaces: bool = False,
) -> Added:
    """Write the folder `name` in `into`. Raises `UsageError` with every fault of the URDF."""
    folder = into / name
    if folder.exists() and not replaces:
        raise UsageError(f"the robot {folder} exists; choose another name, or replace it: --replace")
    path = find_urdf(source)
    try:
        examined = examine(_text(path), tip)
        replace_meshes(examined, path)
    except UsageError as fault:
        raise UsageError("\n".join(f"{path}: {line}" for line in str(fault).splitlines())) from None
    into.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=into, prefix=f".{name}-") as made:
        _write(Path(made), name, examined)
        model = read_folder(Path(made))
        semantics = sample(model, samples, seed=1, meshes=examined.meshes)
        if semantics.home is None:
            raise UsageError(
                f"{path}: no position of the joints is free of contact; check its collision shapes"
            )
        (Path(made) / f"{name}.srdf").write_bytes(semantics.written(name, model.joint_names))
        model = read_folder(Path(made))
        findings = [*examined.findings, *_of_the_model(model, semantics.checked)]
        if folder.exists():
            shutil.rmtree(folder)
        shutil.copytree(made, folder)
    return Added(folder, replace(model), tuple(findings))


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_URDF_BYTES:
            raise UsageError(f"it has more than {MAX_URDF_BYTES >> 20} MB")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"it cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError("not XML: it is not UTF-8") from None


def _write(folder: Path, name: str, examined: Examined) -> None:
    examined.root.set("name", name)
    etree.indent(examined.root)
    (folder / f"{name}.urdf").write_bytes(
        etree.tostring(examined.root, xml_declaration=True, encoding="UTF-8")
    )
    first = Semantics({}, 0, tuple(_start(joint) for joint in examined.movable))
    names = tuple(joint.get("name") for joint in examined.movable)
    (folder / f"{name}.srdf").write_bytes(first.written(name, names))
    speeds = {
        joint.get("name"): number_of(joint.find("limit"), "velocity") or 0.0 for joint in examined.movable
    }
    entry: dict[str, Any] = {
        "name": name,
        "urdf": f"{name}.urdf",
        "srdf": f"{name}.srdf",
        "tip": examined.tip,
        "max_acceleration": {
            joint: round(urdf.ACCELERATION_OF_SPEED * speed, 4) for joint, speed in speeds.items()
        },
        "max_jerk": {joint: round(urdf.JERK_OF_SPEED * speed, 4) for joint, speed in speeds.items()},
    }
    (folder / FILE).write_text(yaml.safe_dump(entry, sort_keys=False), encoding="utf-8")


def _start(joint: Any) -> float:
    """Return 0, or the middle of the limits of a joint that cannot be there."""
    limit = joint.find("limit")
    lower, upper = (number_of(limit, side) or 0.0 for side in ("lower", "upper"))
    is_free = joint.get("type") == "continuous" or lower <= 0.0 <= upper
    return 0.0 if is_free else (lower + upper) / 2


def _of_the_model(model: RobotModel, checked: int) -> list[Finding]:
    planner = Planner(model)
    found = [
        Finding(
            "warning",
            "limits",
            f"a URDF has no limits of acceleration and jerk; {urdf.ACCELERATION_OF_SPEED:g} and "
            f"{urdf.JERK_OF_SPEED:g} times the velocity are assumed; correct them in {FILE}",
        ),
        Finding("info", "SRDF", f"{checked} pairs of links are checked for collision"),
    ]
    torques = Torques(planner.arm)
    if torques.unchecked is not None:
        found.append(
            Finding("warning", "torques", f"torques of motions are not checked: {torques.unchecked}")
        )
    if len(model.joints) < 6:
        found.append(
            Finding(
                "warning", "joints", f"{len(model.joints)} joints reach only some poses; give joints instead"
            )
        )
    elif planner.inverse.solve(model.tool_pose(model.home), planner.arm.lower * 0 + model.home) is None:
        found.append(Finding("warning", "joints", "inverse kinematics does not converge at home"))
    return found
