"""Makes a robot folder from a URDF; nothing is written unless the robot can be loaded and planned for."""

import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from lxml import etree

from handover.errors import UsageError
from handover.formats.robot_xml import number_of
from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import World
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.srdf import Srdf
from handover_robots.onboarding import urdf
from handover_robots.onboarding.comparison import (
    DEFAULT_CONFIGURATIONS,
    MAX_FALSELY_REFUSED,
    Comparison,
    compare,
    decide,
    link_pairs,
)
from handover_robots.onboarding.home import HomePosition, find_home
from handover_robots.onboarding.hulls import Piece
from handover_robots.onboarding.refinement import SEED, Shaping, unchecked_on_purpose
from handover_robots.onboarding.semantics import FROM_SRDF, Semantics
from handover_robots.onboarding.shapes import replace_meshes
from handover_robots.onboarding.sources import find_urdf
from handover_robots.onboarding.urdf import Examined, Finding, examine, read_urdf
from handover_robots.planning.arm import Arm
from handover_robots.planning.collision import Collisions
from handover_robots.planning.planner import Planner
from handover_robots.planning.torques import Torques
from handover_robots.robots.folder import FILE, read_folder
from handover_robots.robots.urdf import load_srdf

DEFAULT_SAMPLES = 3000
NOT_CHECKED = {
    FROM_SRDF: "the SRDF disables the pair; remove its line there if they can collide",
    "Always": "they touch in nearly all positions",
}


@dataclass(frozen=True, slots=True)
class Added:
    """An added robot: its folder, its model, and what is missing or odd in its URDF."""

    folder: Path
    model: RobotModel
    findings: tuple[Finding, ...]
    comparison: Comparison
    """How its shapes decide about self-collision, beside its meshes."""


def add_robot(
    source: str,
    name: str,
    into: Path,
    *,
    tip: str | None = None,
    srdf: Path | None = None,
    samples: int = DEFAULT_SAMPLES,
    replaces: bool = False,
) -> Added:
    """Write the folder `name` in `into`. Raises `UsageError` with every fault of the URDF.

    Without `srdf`, one that lies beside the URDF is read.
    """
    folder = into / name
    if folder.exists() and not replaces:
        raise UsageError(f"the robot {folder} exists; choose another name, or replace it: --replace")
    path = find_urdf(source)
    try:
        examined = examine(read_urdf(path), tip)
        pieces = replace_meshes(examined, path)
    except UsageError as fault:
        raise UsageError("\n".join(f"{path}: {line}" for line in str(fault).splitlines())) from None
    semantics = given_srdf(path, srdf, examined)
    into.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=into, prefix=f".{name}-") as made:
        _write(Path(made), name, examined)
        model, comparison = _settle(Path(made), name, examined, pieces, srdf=semantics, samples=samples)
        _require_movable(path, comparison)
        findings = [*examined.findings, *_of_the_model(model)]
        if folder.exists():
            shutil.rmtree(folder)
        shutil.copytree(made, folder)
    return Added(folder, replace(model), tuple(findings), comparison)


def _settle(
    folder: Path, name: str, examined: Examined, pieces: dict[str, list[Piece]], *, srdf: Srdf, samples: int
) -> tuple[RobotModel, Comparison]:
    """Decide what is checked, by which shapes, and the named positions. Raises `UsageError`."""
    shaping = Shaping(read_folder(folder), examined.root, pieces, examined.surfaces)
    excluded = shaping.settle(srdf, samples)
    arm = shaping.arm(excluded)
    try:
        home = find_home(arm, SEED)
    except UsageError as fault:
        raise UsageError(f"{name}: {fault}") from None
    semantics = Semantics(excluded, {"home": home.joints, **_given_poses(arm, srdf, examined.findings)})
    if semantics.poses["home"] == home.joints:
        examined.findings.append(_about(home, arm))
    _write_urdf(folder, name, examined)
    (folder / f"{name}.srdf").write_bytes(semantics.written(name, arm.model.joint_names))
    model = read_folder(folder)
    arm = Arm(model)
    decided = decide(arm, examined.surfaces, DEFAULT_CONFIGURATIONS, SEED + 1)
    comparison = compare(arm, decided, unchecked_on_purpose(excluded))
    examined.findings += [
        Finding(
            "warning",
            f"{pair.first}, {pair.second}",
            f"their meshes touch in {100 * pair.touching:.1f} % of the positions, and they are not checked: "
            f"{NOT_CHECKED[excluded[frozenset((pair.first, pair.second))]]}",
        )
        for pair in comparison.unchecked
    ]
    return model, comparison


def _about(home: HomePosition, arm: Arm) -> Finding:
    values = ", ".join(f"{round(value, 2) + 0.0:g}" for value in home.joints)
    place = ", ".join(f"{value:.2f}" for value in arm.tool(home.joints).translation)
    why = (
        "the tool points down there, as near to the middle of the joints as it moves well"
        if home.is_tool_down
        else "no such position with the tool down is free, so it is one near the middle of the joints"
    )
    text = f"[{values}] was chosen, with the tip at ({place}) m: {why}; correct it in the SRDF"
    return Finding("info", "home", text)


def _given_poses(arm: Arm, srdf: Srdf, findings: list[Finding]) -> dict[str, Joints]:
    """Return the positions of the given SRDF that the arm can take."""
    collisions, poses = Collisions(arm, World()), {}
    for pose, values in srdf.poses.items():
        joints = tuple(values.get(joint, 0.0) for joint in arm.model.joint_names)
        if not set(values) & set(arm.model.joint_names):
            continue
        if not arm.is_within(np.array(joints)):
            why = "it is outside of the limits of the joints"
        elif (touching := collisions.contacts(np.array(joints))) != []:
            why = f"{touching[0].first} touches {touching[0].second}"
        else:
            poses[pose] = joints
            continue
        text = f'its position "{pose}" is left out: {why}'
        findings.append(Finding("warning", "SRDF", text))
    return poses


def given_srdf(urdf: Path, named: Path | None, examined: Examined) -> Srdf:
    """Return the SRDF that is named, or that lies beside a URDF. Raises `UsageError` for one that is none."""
    beside = sorted(urdf.parent.glob("*.srdf"))
    own = [path for path in beside if path.stem == urdf.stem]
    path = named or next(iter(own or (beside if len(beside) == 1 else [])), None)
    if path is None:
        if beside:
            examined.findings.append(
                Finding(
                    "info",
                    "SRDF",
                    f"there are {len(beside)} beside the URDF, and none is called {urdf.stem}.srdf; "
                    "none is read; name one: --srdf FILE",
                )
            )
        return Srdf()
    srdf = load_srdf(path)
    links = {link.get("name") for link in examined.root.findall("link")}
    pairs = frozenset(pair for pair in srdf.disabled_pairs if pair <= links and len(pair) == 2)
    unknown = sorted({link for pair in srdf.disabled_pairs for link in pair if link not in links})
    text = f"{path} is read: {len(pairs)} pairs of links that need no check, {len(srdf.poses)} positions"
    if unknown:
        text += f"; the URDF has no link {', '.join(unknown)}"
    examined.findings.append(Finding("info", "SRDF", text))
    return Srdf(pairs, srdf.poses)


def _require_movable(path: Path, comparison: Comparison) -> None:
    """Raise `UsageError` if the shapes of a pair refuse too much of what its meshes allow."""
    faults = [
        f"{path}: the shapes of {pair.first} and {pair.second} refuse {100 * pair.falsely_refused:.1f} % of "
        f"the positions that their meshes allow, and {100 * MAX_FALSELY_REFUSED:g} % are acceptable; give "
        "one of them collision meshes of convex parts, or disable the pair in an SRDF if it never touches"
        for pair in comparison.pairs
        if pair.falsely_refused > MAX_FALSELY_REFUSED
    ]
    if faults:
        raise UsageError("\n".join(faults))


def _write_urdf(folder: Path, name: str, examined: Examined) -> None:
    examined.root.set("name", name)
    etree.indent(examined.root)
    (folder / f"{name}.urdf").write_bytes(
        etree.tostring(examined.root, xml_declaration=True, encoding="UTF-8")
    )


def _write(folder: Path, name: str, examined: Examined) -> None:
    _write_urdf(folder, name, examined)
    first = Semantics({}, {"home": tuple(_start(joint) for joint in examined.movable)})
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


def _of_the_model(model: RobotModel) -> list[Finding]:
    planner = Planner(model)
    checked = len(set(link_pairs(planner.collisions.geometry)))
    findings = [
        Finding(
            "warning",
            "limits",
            f"a URDF has no limits of acceleration and jerk; {urdf.ACCELERATION_OF_SPEED:g} and "
            f"{urdf.JERK_OF_SPEED:g} times the velocity are assumed; correct them in {FILE}",
        ),
        Finding(
            "warning",
            "payload",
            f"a URDF has no limit of the payload, so no part is carried; give max_payload_kg in {FILE}",
        ),
        Finding("info", "SRDF", f"{checked} pairs of links are checked for collision"),
    ]
    torques = Torques(planner.arm)
    if torques.unchecked is not None:
        findings.append(
            Finding("warning", "torques", f"torques of motions are not checked: {torques.unchecked}")
        )
    if len(model.joints) < 6:
        findings.append(
            Finding(
                "warning", "joints", f"{len(model.joints)} joints reach only some poses; give joints instead"
            )
        )
    elif planner.inverse.solve(model.tool_pose(model.home), planner.arm.lower * 0 + model.home) is None:
        findings.append(Finding("warning", "joints", "inverse kinematics does not converge at home"))
    return findings
