"""The model of a robot: joints with limits, kinematics and gripper, read from its URDF.

Everything that the trajectory tool and the web page know of a robot comes from its model. The kinematic chain
leads from the root link of the URDF to the tip of the tool. The movable joints on it are the joints of the
robot, in this order; joints beside it, such as fingers, are not planned.
"""

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from lxml import etree

from handover.errors import UsageError
from handover.messages import Message, message, text_of
from handover.robot_xml import link_of, loop_faults, mesh_faults, number_of
from handover_robots.planning import is_available
from handover_robots.poses import Frame, Pose, Vector, cross, turn
from handover_robots.robot import Joints, Unreachable
from handover_robots.srdf import InvalidSrdf, LinkPair, Srdf, read_srdf
from handover_robots.trajectory import Limits

JointKind = Literal["revolute", "continuous", "prismatic"]

InverseKinematics = Callable[[Frame, Joints], Joints]
"""Returns the joints nearest to given ones with the flange at a frame. Raises `Unreachable`."""

AllSolutions = Callable[[Frame, Joints], list[Joints]]
"""Returns every solution (full turns aside) with the flange at a frame, none when it is out of reach."""

MAX_URDF_BYTES = 4 * 1024 * 1024
IDENTITY = Frame(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0))

MAX_PLAIN_NUMBER = 1e6
"""From here on a text has a power of ten: a mistyped position may have 300 digits."""


MEASURING_ERROR = 0.002
"""A joint at its limit is measured at most this far beyond it, in rad or m."""


@dataclass(frozen=True, slots=True)
class Joint:
    """A movable joint; units are rad and s, for a prismatic joint m and s.

    `lower` and `upper` are None for a continuous joint. `labels` are names for people, by language.
    """

    name: str
    kind: JointKind
    lower: float | None
    upper: float | None
    max_velocity: float
    max_acceleration: float
    max_jerk: float
    labels: Mapping[str, str]

    @property
    def unit(self) -> str:
        """Return the unit of the position."""
        return "m" if self.kind == "prismatic" else "rad"


@dataclass(frozen=True, slots=True)
class Finger:
    """A joint of the gripper, for display: its positions when opened, closed, and closed around a part."""

    joint: str
    opened: float
    closed: float
    holding: float


@dataclass(frozen=True, slots=True)
class _Segment:
    """A joint of the chain: its fixed origin, its axis, and its number if it is movable."""

    origin: Frame
    axis: Vector
    kind: str
    number: int | None

    def frame(self, joints: Joints) -> Frame:
        if self.number is None:
            return self.origin
        return self.origin @ _motion(self.kind, self.axis, joints[self.number])


@dataclass(frozen=True)
class RobotModel:
    """A robot: what it is, not what it does now. Made by `read_model`."""

    name: str
    urdf: str
    joints: tuple[Joint, ...]
    home: Joints
    tip: str
    fingers: tuple[Finger, ...]
    inverse: InverseKinematics | None
    solutions: AllSolutions | None
    scene: Path | None
    disabled_pairs: frozenset[LinkPair]
    """Pairs of links that are not checked for collision."""
    poses: Mapping[str, Joints]
    """Named positions of the joints."""
    _to_flange: tuple[_Segment, ...] = field(repr=False)
    _tool: Frame = field(repr=False)
    driver_scenes: Mapping[str, Path] = field(default_factory=dict)
    """The scene for a driver in place of `scene`, by the name of the driver."""
    file: Path | None = field(default=None, repr=False)
    """The URDF that the model was read from."""
    base: Frame = IDENTITY
    """Where the root link stands in the frame of the cell; all poses of the model are in that frame."""
    max_payload_kg: float | None = None
    """What the robot may carry at its flange, the tool included; None where its maker is not known."""
    tool_kg: float = 0.0
    """The mass of what the last moving link carries, by its inertias in the URDF."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the joints, from the base to the flange."""
        return tuple(joint.name for joint in self.joints)

    @property
    def limits(self) -> Limits:
        """Return the limits of velocity, acceleration and jerk."""
        return Limits(
            tuple(joint.max_velocity for joint in self.joints),
            tuple(joint.max_acceleration for joint in self.joints),
            tuple(joint.max_jerk for joint in self.joints),
        )

    @cached_property
    def revision(self) -> str:
        """Return a hash that differs between descriptions that are drawn or moved differently."""
        described = (self.name, self.home, self.joints, self.tip, self.fingers, self.urdf, self.base)
        return hashlib.sha256(repr(described).encode()).hexdigest()[:16]

    def mounted(self, base: Frame) -> "RobotModel":
        """Return the model with its root link at `base` in the frame of the cell."""
        from_cell, inverse, solutions = base.inverse(), self.inverse, self.solutions
        return replace(
            self,
            base=base @ self.base,
            _to_flange=(_Segment(base, (0.0, 0.0, 1.0), "fixed", None), *self._to_flange),
            inverse=inverse and (lambda flange, near: inverse(from_cell @ flange, near)),
            solutions=solutions and (lambda flange, near: solutions(from_cell @ flange, near)),
        )

    def with_home(self, home: Joints) -> "RobotModel":
        """Return the model with another home position. Raises `Unreachable`."""
        self.allow(home)
        return replace(self, home=home, poses={**self.poses, "home": home})

    def flange(self, joints: Joints) -> Frame:
        """Return the frame of the flange, seen from the cell."""
        reached = IDENTITY
        for segment in self._to_flange:
            reached = reached @ segment.frame(joints)
        return reached

    def chain(self, joints: Joints) -> list[Vector]:
        """Return the positions of the joints from the base to the flange, and of the tool's tip."""
        reached, found = IDENTITY, []
        for segment in self._to_flange:
            reached = reached @ segment.frame(joints)
            found.append(reached.position)
        return [*found, (reached @ self._tool).position]

    def jacobian(self, joints: Joints) -> list[tuple[Vector, Vector]]:
        """Return for each joint the linear and the angular velocity of the tool's tip in axes of the cell.

        They are for a velocity of 1 rad/s, for prismatic joints 1 m/s.
        """
        reached = IDENTITY
        axes: list[tuple[int, str, Vector, Vector]] = []
        for segment in self._to_flange:
            if segment.number is None:
                reached = reached @ segment.origin
                continue
            before = reached @ segment.origin
            axes.append((segment.number, segment.kind, turn(before.rotation, segment.axis), before.position))
            reached = before @ _motion(segment.kind, segment.axis, joints[segment.number])
        x, y, z = (reached @ self._tool).position
        columns: dict[int, tuple[Vector, Vector]] = {}
        for number, kind, axis, (x0, y0, z0) in axes:
            if kind == "prismatic":
                columns[number] = axis, (0.0, 0.0, 0.0)
            else:
                columns[number] = cross(axis, (x - x0, y - y0, z - z0)), axis
        return [columns[number] for number in range(len(self.joints))]

    def tool_pose(self, joints: Joints) -> Pose:
        """Return the pose of the tool's tip."""
        return Pose.of(self.flange(joints) @ self._tool)

    def flange_for(self, pose: Pose) -> Frame:
        """Return the frame of the flange with the tip of the tool at `pose`."""
        return pose.frame() @ self._tool.inverse()

    def reach(self, pose: Pose, near: Joints) -> Joints:
        """Return the joints nearest to `near` with the tip of the tool at `pose`. Raises `Unreachable`."""
        if self.inverse is None:
            return self._reach_numerically(pose, near)
        try:
            return self.allow(self.inverse(self.flange_for(pose), near))
        except Unreachable as why:
            where = ", ".join(f"{value:.3f}" for value in pose.position)
            raise Unreachable(
                message(
                    "robot.tool_unreachable",
                    "the tool cannot be at ({position}) m: {why}",
                    position=where,
                    why=text_of(why),
                )
            ) from None

    def _reach_numerically(self, pose: Pose, near: Joints) -> Joints:
        if not is_available():
            raise Unreachable(
                message(
                    "robot.no_inverse_kinematics",
                    '{robot} has no inverse kinematics; give "joints" instead of a pose, or install the '
                    'extra "motion"',
                    robot=self.name,
                )
            )
        found: Joints = self._planner.reach(pose, near)
        return found

    @cached_property
    def _planner(self) -> Any:
        # Imported here: it needs the extra, and a second to start.
        return import_module("handover_robots.planning.planner").Planner(
            self,
            checks_payload=False,  # it plans nothing
        )

    def measured_within(self, joints: Joints) -> Joints:
        """Return measured joints without what they are beyond a limit by the errors of servo and encoder."""

        def within(joint: Joint, position: float) -> float:
            if joint.lower is None or joint.upper is None:
                return position
            nearest = min(max(position, joint.lower), joint.upper)
            return nearest if abs(nearest - position) < MEASURING_ERROR else position

        return tuple(within(joint, position) for joint, position in zip(self.joints, joints, strict=True))

    def payload_fault(self, payload_kg: float) -> Message | None:
        """Return why the robot may not carry a part of this mass in its tool; None if it may."""
        if self.max_payload_kg is None:
            if payload_kg <= 0.0:
                return None
            return message(
                "robot.payload_unknown",
                "it is unknown how much {robot} may carry, so no motion with a part of {part} kg is planned; "
                "give the robot max_payload_kg in its robot.yaml, or remove part_mass_kg from the scene",
                part=f"{payload_kg:g}",
                robot=self.name,
            )
        if payload_kg + self.tool_kg <= self.max_payload_kg:
            return None
        return message(
            "robot.payload_exceeded",
            "a part of {part} kg and the tool of {tool} kg are more than the {limit} kg that {robot} may "
            "carry; choose a lighter part, or correct part_mass_kg of the scene, or max_payload_kg of the "
            "model",
            part=f"{payload_kg:g}",
            tool=f"{self.tool_kg:g}",
            limit=f"{self.max_payload_kg:g}",
            robot=self.name,
        )

    def allow(self, joints: Joints) -> Joints:
        """Return `joints` if there is one for each joint, within its limits. Raises `Unreachable`."""
        if len(joints) != len(self.joints):
            raise Unreachable(
                message(
                    "robot.wrong_joint_count",
                    "{robot} has {count} joints ({names}), and {given} positions are given",
                    robot=self.name,
                    count=len(self.joints),
                    names=", ".join(self.joint_names),
                    given=len(joints),
                )
            )
        for joint, position in zip(self.joints, joints, strict=True):
            if joint.lower is None or joint.upper is None or joint.lower <= position <= joint.upper:
                continue
            raise Unreachable(
                message(
                    "robot.joint_limit",
                    "{joint} cannot be at {position} {unit}: it moves from {lower} to {upper} {unit}; "
                    "choose a position in between",
                    joint=joint.name,
                    position=f"{position:.3f}" if abs(position) < MAX_PLAIN_NUMBER else f"{position:.3g}",
                    lower=f"{joint.lower:.3f}",
                    upper=f"{joint.upper:.3f}",
                    unit=joint.unit,
                )
            )
        return joints


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
        return replace(model, driver_scenes=driver_scenes or {}, file=urdf, max_payload_kg=max_payload_kg)
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
    segments: list[_Segment] = []
    flange_at = 0
    for number, element in enumerate(elements, 1):
        kind = element.get("type")
        movable = kind != "fixed"
        axis = _axis(element) if movable else (0.0, 0.0, 0.0)  # a fixed joint needs none
        segments.append(_Segment(_origin(element), axis, kind, len(joints) if movable else None))
        if movable:
            joints.append(_joint(element, limits, labels))
        if element.find("child").get("link") == flange:
            flange_at = number
    wrist = next((link_of(one, "child") for one in reversed(elements) if one.get("type") != "fixed"), "")
    if not joints:
        raise _InvalidUrdf(f'there is no movable joint between its root and "{tip}"')
    if flange_at == 0 or any(segment.number is not None for segment in segments[flange_at:]):
        raise _InvalidUrdf(f'the flange "{flange}" must be a link that "{tip}" is fixed to')
    names = [joint.name for joint in joints]
    poses = {
        pose: _positions(pose, given, names) for pose, given in {**semantics.poses, "home": home}.items()
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
        _to_flange=tuple(segments[:flange_at]),
        _tool=tool,
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


def _positions(pose: str, given: Mapping[str, float], names: list[str]) -> Joints:
    unknown = [one for one in given if one not in names]
    if unknown:
        raise _InvalidUrdf(f"{pose} names {', '.join(unknown)}; the joints are {', '.join(names)}")
    return tuple(given.get(one, 0.0) for one in names)


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
    given: tuple[float | Mapping[str, float], float | Mapping[str, float]],
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
        limits.get(name, 0.0) if isinstance(limits, Mapping) else limits for limits in given
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
        turned = turned @ _motion("revolute", axis, angle)
    return Frame(turned.rotation, position)


def _axis(joint: Any) -> Vector:
    x, y, z = _vector(joint.find("axis"), "xyz", "1 0 0")
    length = math.hypot(x, y, z)
    if length < 1e-6:
        raise _InvalidUrdf(f'the joint "{joint.get("name")}" has no axis')
    return (x / length, y / length, z / length)


def _motion(kind: str, axis: Vector, position: float) -> Frame:
    """Return the frame of a joint that has moved by `position` from 0."""
    x, y, z = axis
    if kind == "prismatic":
        return Frame(IDENTITY.rotation, (x * position, y * position, z * position))
    c, s = math.cos(position), math.sin(position)
    d = 1 - c
    return Frame(
        (
            (c + x * x * d, x * y * d - z * s, x * z * d + y * s),
            (y * x * d + z * s, c + y * y * d, y * z * d - x * s),
            (z * x * d - y * s, z * y * d + x * s, c + z * z * d),
        ),
        (0.0, 0.0, 0.0),
    )
