"""The model of a robot, read from its URDF and SRDF."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from lxml import etree

from handover.errors import UsageError
from handover.formats.robot_xml import link_of, loop_faults, mesh_faults, number_of
from handover_robots.model.faults import Unreachable
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Frame, Vector
from handover_robots.model.robot_model import (
    IDENTITY,
    AllSolutions,
    Finger,
    InverseKinematics,
    Joint,
    NumericalInverse,
    RobotModel,
    Segment,
    joint_motion,
)
from handover_robots.model.srdf import InvalidSrdf, Srdf, read_srdf
from handover_robots.planning import is_available

__all__ = ["AllSolutions", "Finger", "InverseKinematics", "Joint", "RobotModel", "load_srdf", "read_model"]

MAX_URDF_BYTES = 4 * 1024 * 1024


def read_model(
    urdf: Path,
    *,
    name: str,
    tip: str,
    max_acceleration: float | Mapping[str, float],
    max_jerk: float | Mapping[str, float],
    flange: str | None = None,
    home: Mapping[str, float] | None = None,
    labels: Mapping[str, Mapping[str, str]] | None = None,
    fingers: tuple[Finger, ...] = (),
    inverse: InverseKinematics | None = None,
    solutions: AllSolutions | None = None,
    scene: Path | None = None,
    driver_scenes: Mapping[str, Path] | None = None,
    srdf: Path | None = None,
    max_payload_kg: float | None = None,
) -> RobotModel:
    """Return the model of the robot in a URDF file.

    `tip` and `flange` are links; `inverse` and `solutions` solve for the flange, by default the tip. A URDF
    has no limits of acceleration and jerk: give one for all joints, or one for each by name. Joints that
    `home` does not name are at 0. An SRDF names pairs of links that never collide, and positions; its "home"
    is used without `home`. `driver_scenes` take the place of `scene` for drivers by name.
    Raises `UsageError` that names the file and the fault.
    """
    semantics = load_srdf(srdf) if srdf is not None else Srdf()
    try:
        if urdf.stat().st_size > MAX_URDF_BYTES:
            raise UsageError(f"the robot description {urdf} has more than {MAX_URDF_BYTES >> 20} MB")
        text = urdf.read_text(encoding="utf-8")
        model = _model(
            text,
            name=name,
            flange=flange or tip,
            tip=tip,
            home=dict(semantics.poses.get("home", {}) if home is None else home),
            limits=(max_acceleration, max_jerk),
            labels=labels or {},
            fingers=fingers,
            inverse=inverse,
            solutions=solutions,
            scene=scene,
            semantics=semantics,
        )
        return replace(
            model,
            driver_scenes=driver_scenes or {},
            file=urdf,
            max_payload_kg=max_payload_kg,
            make_inverse=_make_inverse,
        )
    except OSError as error:
        raise UsageError(f"the robot description {urdf} cannot be read: {error.strerror}") from None
    except (etree.XMLSyntaxError, UnicodeDecodeError) as error:
        raise UsageError(f"the robot description {urdf} is not XML: {error}") from None
    except _InvalidUrdf as fault:
        raise UsageError(f"the robot description {urdf}: {fault}") from None


def load_srdf(srdf: Path) -> Srdf:
    """Return the content of an SRDF file. Raises `UsageError` that names the file and the fault."""
    try:
        return read_srdf(srdf.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"the SRDF {srdf} cannot be read: {error.strerror}") from None
    except (etree.XMLSyntaxError, UnicodeDecodeError, InvalidSrdf) as error:
        raise UsageError(f"the SRDF {srdf}: {error}") from None


def _make_inverse(model: RobotModel) -> NumericalInverse | None:
    if not is_available():
        return None
    from handover_robots.planning.planner import Planner  # noqa: PLC0415 - needs the extra, and a second

    return Planner(model, checks_payload=False).reach  # it plans nothing


class _InvalidUrdf(ValueError):
    """The fault of a URDF, without the name of its file."""


def _model(
    text: str,
    *,
    name: str,
    flange: str,
    tip: str,
    home: dict[str, float],
    limits: tuple[float | Mapping[str, float], float | Mapping[str, float]],
    labels: Mapping[str, Mapping[str, str]],
    fingers: tuple[Finger, ...],
    inverse: InverseKinematics | None,
    solutions: AllSolutions | None,
    scene: Path | None,
    semantics: Srdf,
) -> RobotModel:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)
    root = etree.fromstring(text.encode(), parser)
    if root.tag != "robot":
        raise _InvalidUrdf(f"its root element is <{root.tag}>, not <robot>")
    elements = _chain(root, tip)
    for fault in (*mesh_faults(root), *loop_faults(root)):
        raise _InvalidUrdf(fault)
    joints: list[Joint] = []
    segments: list[Segment] = []
    flange_at = 0
    for number, element in enumerate(elements, 1):
        kind = element.get("type")
        movable = kind != "fixed"
        axis = _axis(element) if movable else (0.0, 0.0, 0.0)  # a fixed joint needs none
        segments.append(Segment(_origin(element), axis, kind, len(joints) if movable else None))
        if movable:
            joints.append(_joint(element, limits, labels))
        if element.find("child").get("link") == flange:
            flange_at = number
    wrist = next(
        (link_of(joint, "child") for joint in reversed(elements) if joint.get("type") != "fixed"), ""
    )
    if not joints:
        raise _InvalidUrdf(f'there is no movable joint between its root and "{tip}"')
    if flange_at == 0 or any(segment.number is not None for segment in segments[flange_at:]):
        raise _InvalidUrdf(f'the flange "{flange}" must be a link that "{tip}" is fixed to')
    names = [joint.name for joint in joints]
    poses = {
        pose: _positions(pose, by_joint, names)
        for pose, by_joint in {**semantics.poses, "home": home}.items()
    }
    _require_joints(root, fingers)
    tool = IDENTITY
    for segment in segments[flange_at:]:
        tool = tool @ segment.origin
    model = RobotModel(
        name=name,
        urdf=text,
        joints=tuple(joints),
        home=poses["home"],
        tip=tip,
        fingers=fingers,
        inverse=inverse,
        solutions=solutions,
        scene=scene,
        disabled_pairs=semantics.disabled_pairs,
        poses=poses,
        tool_kg=_mass_below(root, wrist),
        to_flange=tuple(segments[:flange_at]),
        tool=tool,
    )
    for pose, joints_of_pose in poses.items():
        try:
            model.allow(joints_of_pose)
        except Unreachable as why:
            raise _InvalidUrdf(f"{pose}: {why}") from None
    return model


def _mass_below(root: Any, wrist: str) -> float:
    """Return the mass in kg of the links that the last link of the robot carries."""
    children: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        children.setdefault(link_of(joint, "parent"), []).append(link_of(joint, "child"))
    masses = {
        str(link.get("name")): number_of(link.find("inertial/mass"), "value") for link in root.findall("link")
    }
    carried, waiting = 0.0, list(children.get(wrist, ()))
    while waiting:  # the joints form no loop
        link = waiting.pop()
        carried += max(masses.get(link) or 0.0, 0.0)
        waiting += children.get(link, ())
    return carried


def _positions(pose: str, by_joint: Mapping[str, float], names: list[str]) -> Joints:
    unknown = [joint for joint in by_joint if joint not in names]
    if unknown:
        raise _InvalidUrdf(f"{pose} names {', '.join(unknown)}; the joints are {', '.join(names)}")
    return tuple(by_joint.get(name, 0.0) for name in names)


def _chain(root: Any, tip: str) -> list[Any]:
    """Return the joint elements from the root link to the link `tip`."""
    above: dict[str, Any] = {}
    for joint in root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            raise _InvalidUrdf(f'the joint "{joint.get("name")}" needs a parent and a child')
        link = child.get("link")
        if link in above:
            raise _InvalidUrdf(f'the link "{link}" has two parents; a robot description is a tree')
        above[link] = joint
    if tip not in {link.get("name") for link in root.findall("link")}:
        raise _InvalidUrdf(f'there is no link "{tip}"')
    chain: list[Any] = []
    while tip in above:
        if len(chain) > len(above):
            raise _InvalidUrdf(f'its joints form a loop at "{tip}"; a robot description is a tree')
        chain.insert(0, above[tip])
        tip = above[tip].find("parent").get("link")
    return chain


def _joint(
    element: Any,
    bounds: tuple[float | Mapping[str, float], float | Mapping[str, float]],
    labels: Mapping[str, Mapping[str, str]],
) -> Joint:
    name, kind = element.get("name"), element.get("type")
    if kind not in {"revolute", "continuous", "prismatic"}:
        raise _InvalidUrdf(
            f'the joint "{name}" is {kind}; between base and tip a joint is revolute, '
            "continuous, prismatic or fixed"
        )
    if element.find("mimic") is not None:
        raise _InvalidUrdf(f'the joint "{name}" mimics another one; between base and tip none may')
    limit = element.find("limit")
    velocity = _number(limit, "velocity", name) if limit is not None else 0.0
    if not velocity > 0:
        raise _InvalidUrdf(f'the joint "{name}" needs a velocity limit: <limit velocity="…"/> above 0')
    lower = upper = None
    if kind != "continuous":
        lower, upper = (_number(limit, side, name) for side in ("lower", "upper"))
        if not lower < upper:
            raise _InvalidUrdf(f'the joint "{name}" has the lower limit {lower}, which is not below {upper}')
    acceleration, jerk = (
        limits.get(name, 0.0) if isinstance(limits, Mapping) else limits for limits in bounds
    )
    if not (0 < acceleration < math.inf and 0 < jerk < math.inf):
        raise _InvalidUrdf(f'the joint "{name}" needs limits of acceleration and jerk above 0')
    return Joint(name, kind, lower, upper, velocity, acceleration, jerk, dict(labels.get(name, {})))


def _require_joints(root: Any, fingers: tuple[Finger, ...]) -> None:
    names = {joint.get("name") for joint in root.findall("joint")}
    for finger in fingers:
        if finger.joint not in names:
            raise _InvalidUrdf(f'there is no joint "{finger.joint}" for a finger')


def _number(element: Any, attribute: str, joint: str) -> float:
    try:
        number = float(element.get(attribute, "0"))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise _InvalidUrdf(f'the joint "{joint}" has an invalid {attribute}: "{element.get(attribute)}"')
    return number


def _vector(element: Any, attribute: str, default: str) -> Vector:
    text = element.get(attribute, default) if element is not None else default
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise _InvalidUrdf(f'{attribute}="{text}" must be three numbers')
    return (x, y, z)


def _origin(joint: Any) -> Frame:
    origin = joint.find("origin")
    position = _vector(origin, "xyz", "0 0 0")
    roll, pitch, yaw = _vector(origin, "rpy", "0 0 0")
    turned = IDENTITY
    for axis, angle in (((0.0, 0.0, 1.0), yaw), ((0.0, 1.0, 0.0), pitch), ((1.0, 0.0, 0.0), roll)):
        turned = turned @ joint_motion("revolute", axis, angle)
    return Frame(turned.rotation, position)


def _axis(joint: Any) -> Vector:
    x, y, z = _vector(joint.find("axis"), "xyz", "1 0 0")
    length = math.hypot(x, y, z)
    if length < 1e-6:
        raise _InvalidUrdf(f'the joint "{joint.get("name")}" has no axis')
    return (x / length, y / length, z / length)
