"""Reads a humanoid from URDF, SRDF and `robot.yaml`, and says what is wrong with a stranger's file.

urdf: coman.urdf                 # robot.yaml
srdf: coman.srdf
gains: {default: {stiffness: 300, damping: 6}, left_arm: {stiffness: 60, damping: 3}}
gain_limits: {default: {stiffness: [0.8, 1.5], damping: [0.8, 1.5]}}   # what people may choose
contacts:
  left_sole: {link: l_sole, corners: [[0.13, 0.05, 0], …], friction: 0.7}
drive_inertia: 0.05              # of a drive behind its gear, seen from its joint, in kg m²
grips: {right_hand: {arm: right_arm, link: RSoftHand, point: [0, 0.03, 0]}}   # where a hand holds a ball
modes: [position, impedance, torque]   # what its drives accept; impedance alone where this is left out
servo: {default: {stiffness: 3000, damping: 60}}   # of the drives themselves in the mode position
notes: [The velocity limits are placeholders.]

Instead of a file, `urdf` may name one of an installed package, and what changes in it (see `packaged`):

urdf: {package: example-robot-data, path: robots/…/talos.urdf, extra: talos, locked: [gripper_joint],
       capsules: {leg_3_link: [[[0, 0, 0], [0, 0, -0.3], 0.07]]}}
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from pydantic import Field, FiniteFloat, ValidationError

from handover.errors import UsageError
from handover.formats.robot_xml import parse_robot_xml
from handover.formats.validation import ClosedModel, fault_lines
from handover_humanoid.model.humanoid import (
    Chain,
    ContactSurface,
    GainLimits,
    Gains,
    Grip,
    Humanoid,
    Joint,
    JointMode,
    LinkPair,
    Sensors,
)
from handover_humanoid.model.packaged import adapted, packaged_file
from handover_humanoid.model.standing import HANDS, SOLES, STAND, require_stance
from handover_humanoid.model.urdf import Tree, number, settled

FILE = "robot.yaml"
MAX_FILE_BYTES = 20_000_000
DEFAULT_GAINS = "default"
INERTIAL_GROUP, FORCE_TORQUE_GROUP = "imu_sensors", "force_torque_sensors"
"""Groups of the SRDF that list sensors, as in CoSiMA."""

MIN_SOLE_M2 = 1e-4

Positive = Annotated[FiniteFloat, Field(gt=0)]


class _Gains(ClosedModel):
    stiffness: Positive
    damping: Positive


class _GainLimits(ClosedModel):
    stiffness: tuple[Positive, Positive]
    damping: tuple[Positive, Positive]


class _Contact(ClosedModel):
    link: str
    corners: Annotated[tuple[tuple[FiniteFloat, FiniteFloat, FiniteFloat], ...], Field(min_length=3)]
    friction: Positive = 0.7


class _Grip(ClosedModel):
    arm: str
    link: str
    point: tuple[FiniteFloat, FiniteFloat, FiniteFloat]


_Point = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class _PackagedUrdf(ClosedModel):
    package: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")]
    path: Annotated[str, Field(pattern=r"^([A-Za-z0-9_-][A-Za-z0-9._-]*/)*[A-Za-z0-9_-][A-Za-z0-9._-]*$")]
    extra: str
    locked: tuple[str, ...] = ()
    capsules: dict[str, tuple[tuple[_Point, _Point, Positive], ...]] = Field(default_factory=dict)


class _RobotFile(ClosedModel):
    name: Annotated[str, Field(min_length=1)]
    urdf: Path | _PackagedUrdf
    srdf: Path
    gains: dict[str, _Gains]
    gain_limits: dict[str, _GainLimits] = Field(default_factory=dict)
    contacts: dict[str, _Contact]
    drive_inertia: Annotated[FiniteFloat, Field(ge=0)] = 0.0
    grips: dict[str, _Grip] = Field(default_factory=dict)
    modes: Annotated[tuple[JointMode, ...], Field(min_length=1)] = (JointMode.IMPEDANCE,)
    servo: dict[str, _Gains] = Field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_folder(folder: Path) -> Humanoid:
    """Return the humanoid of a folder. Raises `UsageError` with a line for each fault."""
    try:
        entry = _RobotFile.model_validate(yaml.safe_load(_text(folder / FILE)))
    except ValidationError as error:
        faults = (f"{folder / FILE}: {line}" for line in fault_lines(error, "the file"))
        raise UsageError("\n".join(faults)) from None
    except yaml.YAMLError as error:
        raise UsageError(f"{folder / FILE} is not YAML: {error}") from None
    return read(entry, _urdf(entry.urdf, folder), _text(folder / entry.srdf))


def _urdf(source: Path | _PackagedUrdf, folder: Path) -> str:
    if isinstance(source, Path):
        return _text(folder / source)
    return adapted(
        _text(packaged_file(source.package, source.path, source.extra)), source.locked, source.capsules
    )


def read(entry: _RobotFile, urdf: str, srdf: str) -> Humanoid:
    """Return the humanoid of three texts. Raises `UsageError` with a line for each fault."""
    urdf, changed = settled(urdf)
    tree = Tree.of(urdf)
    semantics = _Semantics(parse_robot_xml(srdf, "SRDF"), tree)
    faults = [*semantics.faults(), *_entry_faults(entry, tree, semantics)]
    if faults:
        raise UsageError("\n".join(faults))
    joints = tuple(_joint(element, entry, semantics) for element in tree.moving)
    humanoid = Humanoid(
        name=entry.name,
        root=tree.root,
        joints=joints,
        links=tree.links,
        chains=semantics.chains,
        groups=semantics.groups,
        end_effectors=semantics.end_effectors,
        contacts={
            name: ContactSurface(name, contact.link, contact.corners, contact.friction)
            for name, contact in entry.contacts.items()
        },
        sensors=semantics.sensors,
        poses=semantics.poses(joints),
        collision_pairs=semantics.collision_pairs,
        mass_kg=tree.mass_kg,
        urdf=urdf,
        srdf=srdf,
        drive_inertia=entry.drive_inertia,
        grips={name: Grip(name, grip.arm, grip.link, grip.point) for name, grip in entry.grips.items()},
        gain_limits=_gain_limits(entry, semantics),
        modes=tuple(dict.fromkeys(entry.modes)),
        notes=(*entry.notes, *changed),
    )
    return require_stance(humanoid)


class _Semantics:
    """What the SRDF says about a tree."""

    def __init__(self, root: Any, tree: Tree) -> None:
        self._root, self._tree = root, tree
        self._found: list[str] = []
        self.chains: dict[str, Chain] = {}
        self.groups: dict[str, tuple[str, ...]] = {}
        self.sensors = Sensors((), {})
        inertial: tuple[str, ...] = ()
        force_torque: dict[str, str] = {}
        for group in root.findall("group"):
            name = str(group.get("name"))
            if name == INERTIAL_GROUP:
                inertial = tuple(self._link(link.get("name"), name) for link in group.findall("link"))
            elif name == FORCE_TORQUE_GROUP:
                force_torque = {joint: self._below(joint, name) for joint in _names(group, "joint")}
            else:
                self._read_group(name, group)
        self.sensors = Sensors(inertial, force_torque)
        self.end_effectors = {
            str(effector.get("name")): self._link(effector.get("parent_link"), str(effector.get("name")))
            for effector in root.findall("end_effector")
        }

    def faults(self) -> Iterator[str]:
        """Yield what contradicts the tree, and which required parts are missing."""
        yield from self._found
        if not self.chains:
            yield "the SRDF names no chain; a humanoid needs its arms, legs and torso as <chain>"
        states = [str(state.get("name")) for state in self._root.findall("group_state")]
        if STAND not in states:
            there = ", ".join(states) or "none"
            yield (
                f'the SRDF has no <group_state name="{STAND}">, the pose to start from, with both soles on '
                f"the ground; it has: {there}"
            )
        groups = [str(group.get("name")) for group in self._root.findall("group")]
        for kind, names in (("group", groups), ("group_state", states)):
            for name in sorted({repeated for repeated in names if names.count(repeated) > 1}):
                yield f'the SRDF has two elements <{kind} name="{name}">; remove one'
        for joint in _names(self._root, "passive_joint"):
            if any(joint == moving.get("name") for moving in self._tree.moving):
                yield f'the SRDF calls the joint "{joint}" passive; each joint is driven: make it fixed'
        for pair in self._root.findall("disable_collisions"):
            for end in ("link1", "link2"):
                if pair.get(end) not in self._tree.links:
                    yield f'the SRDF disables collisions of "{pair.get(end)}", which is no link of the URDF'

    def poses(self, joints: tuple[Joint, ...]) -> dict[str, dict[str, float]]:
        """Return each pose; joints that it leaves out are at 0 or the nearest limit. Raises `UsageError`."""
        by_pose: dict[str, dict[str, float]] = {}
        faults: list[str] = []
        by_name = {joint.name: joint for joint in joints}
        for state in self._root.findall("group_state"):
            pose = {joint.name: min(max(0.0, joint.lower), joint.upper) for joint in joints}
            where, named = f'the pose "{state.get("name")}"', set[str]()
            for element in state.findall("joint"):
                name, value = str(element.get("name")), number(element, "value")
                joint = by_name.get(name)
                if name in named:
                    faults.append(f'{where} has two values for "{name}"; remove one')
                named.add(name)
                if joint is None:
                    faults.append(f'{where} names the joint "{name}", which does not move or exist')
                elif value is None or not joint.lower - 1e-9 <= value <= joint.upper + 1e-9:
                    limits = f"{joint.lower:g} to {joint.upper:g}"
                    faults.append(f"{where} has {element.get('value')} for {name}; its limits are {limits}")
                else:
                    pose[name] = value
            by_pose[str(state.get("name"))] = pose
        if faults:
            raise UsageError("\n".join(faults))
        return by_pose

    @property
    def collision_pairs(self) -> frozenset[LinkPair]:
        """Return all pairs of links with a shape that the SRDF does not disable."""
        disabled = {
            frozenset((str(element.get("link1")), str(element.get("link2"))))
            for element in self._root.findall("disable_collisions")
        }
        shaped = self._tree.links_with_shape
        every = {frozenset((a, b)) for i, a in enumerate(shaped) for b in shaped[i + 1 :]}
        return frozenset(every - disabled)

    def _read_group(self, name: str, group: Any) -> None:
        members: list[str] = []
        for chain in group.findall("chain"):
            base, tip = str(chain.get("base_link")), str(chain.get("tip_link"))
            path = self._tree.path(base, tip)
            if path is None:
                self._found.append(f'the chain "{name}" goes from "{base}" to "{tip}", which is not below it')
                continue
            self.chains[name] = Chain(name, base, tip, path)
            members += path
        for joint in _names(group, "joint"):
            self._below(joint, name)
            members.append(joint)
        for other in _names(group, "group"):
            joints = self.chains[other].joints if other in self.chains else self.groups.get(other)
            if joints is None:
                self._found.append(f'the group "{name}" names the group "{other}", which is not above it')
            members += joints or ()
        if members:
            self.groups[name] = tuple(dict.fromkeys(members))

    def _link(self, link: str | None, where: str) -> str:
        if link not in self._tree.links:
            self._found.append(f'"{where}" of the SRDF names the link "{link}", which the URDF does not have')
        return str(link)

    def _below(self, joint: str, where: str) -> str:
        child = self._tree.child(joint)
        if child is None:
            self._found.append(
                f'"{where}" of the SRDF names the joint "{joint}", which the URDF does not have'
            )
        return str(child)


def _names(group: Any, tag: str) -> list[str]:
    return [str(element.get("name")) for element in group.findall(tag)]


def _entry_faults(entry: _RobotFile, tree: Tree, semantics: _Semantics) -> Iterator[str]:
    if DEFAULT_GAINS not in entry.gains:
        yield f'{FILE} has no gains "{DEFAULT_GAINS}"; every joint needs a stiffness and a damping'
    names = {
        DEFAULT_GAINS,
        *semantics.chains,
        *semantics.groups,
        *(joint.get("name") for joint in tree.moving),
    }
    if JointMode.POSITION in entry.modes and DEFAULT_GAINS not in entry.servo:
        yield f'{FILE} has the mode position without "servo: {{{DEFAULT_GAINS}: …}}", the gains of its drives'
    for name in sorted((entry.gains.keys() | entry.servo.keys()) - names):
        yield f'{FILE} has gains for "{name}", which is no chain, group or joint'
    yield from _gain_limit_faults(entry, semantics)
    for name, contact in entry.contacts.items():
        if contact.link not in tree.links:
            yield f'the contact "{name}" is on the link "{contact.link}", which the URDF does not have'
    for name, grip in entry.grips.items():
        if grip.link not in tree.links:
            yield f'the grip "{name}" is on the link "{grip.link}", which the URDF does not have'
        if grip.arm not in semantics.chains:
            yield f'the grip "{name}" is moved by "{grip.arm}", which is no chain of the SRDF'
        if name not in HANDS:
            yield f'{FILE} has the grip "{name}"; a grip is called {" or ".join(HANDS)}'
    yield from _sole_faults(entry, tree, semantics)


def _sole_faults(entry: _RobotFile, tree: Tree, semantics: _Semantics) -> Iterator[str]:
    """Yield what balance lacks: soles, legs as chains, force-torque sensors, an inertial sensor."""
    if not semantics.sensors.inertial:
        yield f'the SRDF has no <group name="{INERTIAL_GROUP}"> with the <link> of an inertial sensor'
    for name in SOLES:
        contact = entry.contacts.get(name)
        if contact is None:
            there = ", ".join(entry.contacts) or "none"
            yield f'{FILE} has no contact "{name}", a sole that it stands on; it has: {there}'
            continue
        leg = next((chain for chain in semantics.chains.values() if chain.tip == contact.link), None)
        if contact.link in tree.links and (leg is None or not leg.joints):
            yield f'no chain of the SRDF ends at "{contact.link}", the link of "{name}"; its leg has to'
        elif leg is not None:
            below = [sensor for sensor in semantics.sensors.force_torque.values() if sensor in tree.links]
            if leg.joints[-1] not in map(tree.moved_by, below):
                yield (
                    f'the group "{FORCE_TORQUE_GROUP}" of the SRDF has no <joint> that is fixed below '
                    f'"{leg.joints[-1]}"; balance needs a force-torque sensor at "{name}"'
                )
        if _area(contact.corners) < MIN_SOLE_M2:
            yield f'the corners of "{name}" enclose no area; give at least three that are not on one line'
    first, second = (entry.contacts.get(name) for name in SOLES)
    if first and second and not _are_alike(first.corners, second.corners):
        yield f'the corners of "{SOLES[0]}" and "{SOLES[1]}" differ; give the rectangle that both soles have'


def _area(corners: Sequence[Sequence[float]]) -> float:
    """Return the area in m² of the rectangle around corners (k, 3), less if they are on a line across it."""
    points = np.array(corners)[:, :2]
    spread = points - points.mean(axis=0)
    return float(np.sqrt(max(np.linalg.det(spread.T @ spread), 0.0)))


def _are_alike(first: Sequence[Sequence[float]], second: Sequence[Sequence[float]]) -> bool:
    if len(first) != len(second):
        return False
    return bool(np.allclose(sorted(map(tuple, first)), sorted(map(tuple, second)), atol=1e-3))


def _gain_limit_faults(entry: _RobotFile, semantics: _Semantics) -> Iterator[str]:
    for name, limits in entry.gain_limits.items():
        if name not in {DEFAULT_GAINS, *semantics.chains}:
            yield f'{FILE} has gain_limits for "{name}", which is no chain'
        for kind, (least, most) in (("stiffness", limits.stiffness), ("damping", limits.damping)):
            if not least <= 1 <= most:
                yield (
                    f'{FILE} limits the share of the {kind} of "{name}" to {least:g} … {most:g}, which '
                    "leaves out 1, that of the model"
                )


def _joint(element: Any, entry: _RobotFile, semantics: _Semantics) -> Joint:
    name = str(element.get("name"))
    limit = element.find("limit")
    gains = _gains_of(name, entry.gains, semantics)
    return Joint(
        name=name,
        kind=str(element.get("type")),
        lower=float(limit.get("lower")),
        upper=float(limit.get("upper")),
        max_velocity=float(limit.get("velocity")),
        max_effort=float(limit.get("effort")),
        gains=gains,
        servo=_gains_of(name, entry.servo, semantics) if DEFAULT_GAINS in entry.servo else None,
    )


def _gain_limits(entry: _RobotFile, semantics: _Semantics) -> dict[str, GainLimits]:
    limits = {
        chain: entry.gain_limits.get(chain, entry.gain_limits.get(DEFAULT_GAINS))
        for chain in semantics.chains
    }
    return {
        chain: GainLimits(bounds.stiffness, bounds.damping)
        for chain, bounds in limits.items()
        if bounds is not None
    }


def _gains_of(joint: str, gains: Mapping[str, _Gains], semantics: _Semantics) -> Gains:
    """Return the most specific entry: a joint's own, then its chain's or group's in the order of the file."""
    most_specific = gains[DEFAULT_GAINS]
    for key, gain in gains.items():
        if joint in semantics.groups.get(key, ()):
            most_specific = gain
    most_specific = gains.get(joint, most_specific)
    return Gains(most_specific.stiffness, most_specific.damping)


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UsageError(
                f"{path} is larger than {MAX_FILE_BYTES / 1e6:.0f} MB, which no robot model needs"
            )
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read: {error}") from None
