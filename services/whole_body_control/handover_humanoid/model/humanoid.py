"""The semantic model: a humanoid by names (`right_arm`, `left_sole`), the same for every robot and component.

After CoSiMA (Figure 2): the URDF gives the tree, the SRDF groups, chains and poses; what neither format has
(gains, contact surfaces) comes from `robot.yaml`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

from handover.errors import UsageError

LinkPair = frozenset[str]


class JointMode(StrEnum):
    """What the drives of the joints accept: positions, joint impedance, or torques."""

    POSITION = "position"
    IMPEDANCE = "impedance"
    TORQUE = "torque"


@dataclass(frozen=True, slots=True)
class Gains:
    """Joint impedance: `stiffness` in N m/rad, `damping` in N m s/rad."""

    stiffness: float
    damping: float


@dataclass(frozen=True, slots=True)
class GainLimits:
    """How far people may change the gains of a chain: the least and the most share of those of the model."""

    stiffness: tuple[float, float]
    damping: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint that moves. Limits in rad, rad/s and N m (m, m/s and N for a prismatic one)."""

    name: str
    kind: str
    lower: float
    upper: float
    max_velocity: float
    max_effort: float
    gains: Gains
    servo: Gains | None = None
    """Of the drive itself in the mode `position`."""


@dataclass(frozen=True, slots=True)
class Chain:
    """A serial chain from `base` to `tip`, with the names of its moving joints in this order."""

    name: str
    base: str
    tip: str
    joints: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ContactSurface:
    """A flat surface that touches the ground: `corners` in m in the frame of `link`, z is the normal."""

    name: str
    link: str
    corners: tuple[tuple[float, float, float], ...]
    friction: float


@dataclass(frozen=True, slots=True)
class Grip:
    """Where a hand holds a ball: `point` (3,) in m in the frame of `link`, moved by the chain `arm`."""

    name: str
    arm: str
    link: str
    point: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Sensors:
    """The links of inertial sensors, and the joints of force-torque sensors with the link below each."""

    inertial: tuple[str, ...]
    force_torque: Mapping[str, str]


@dataclass(frozen=True)
class Humanoid:
    """A humanoid; every value is checked, and none changes.

    `root` is the link that the floating base moves. `chains` and `groups` have the names of the SRDF,
    `end_effectors` the link of each, `poses` angles for all joints, `collision_pairs` the links that may
    collide. `urdf` and `srdf` are the texts that it was read from.
    """

    name: str
    root: str
    joints: tuple[Joint, ...]
    links: tuple[str, ...]
    chains: Mapping[str, Chain]
    groups: Mapping[str, tuple[str, ...]]
    end_effectors: Mapping[str, str]
    contacts: Mapping[str, ContactSurface]
    sensors: Sensors
    poses: Mapping[str, Mapping[str, float]]
    collision_pairs: frozenset[LinkPair]
    mass_kg: float
    urdf: str
    srdf: str
    drive_inertia: float = 0.0
    """The inertia of a drive behind its gear, seen from its joint, in kg m²; the same for all joints."""
    grips: Mapping[str, Grip] = field(default_factory=dict)
    """The hands that can hold and throw a ball, by name."""
    gain_limits: Mapping[str, GainLimits] = field(default_factory=dict)
    """By chain; the gains of other chains are not changed."""
    modes: tuple[JointMode, ...] = (JointMode.IMPEDANCE,)
    """What its drives accept; a driver may have fewer."""
    notes: tuple[str, ...] = ()
    """What a reader should know, such as limits that are placeholders."""

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Return the names of all moving joints, in the order of vectors of joints."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def _indices(self) -> Mapping[str, int]:
        return {name: index for index, name in enumerate(self.joint_names)}

    def index(self, joint: str) -> int:
        """Return where a joint stands in vectors of joints. Raises `UsageError`."""
        place = self._indices.get(joint)
        if place is None:
            raise UsageError(f'{self.name} has no joint "{joint}"; it has: {", ".join(self.joint_names)}')
        return place

    def indices(self, name: str) -> tuple[int, ...]:
        """Return where the joints of a chain or group stand in vectors of joints. Raises `UsageError`."""
        return tuple(self.index(joint) for joint in self.members(name))

    @cached_property
    def tunable(self) -> Mapping[str, tuple[int, ...]]:
        """Return the joints whose gains a chain decides: a joint of two chains belongs to the first."""
        by_chain: dict[str, tuple[int, ...]] = {}
        for chain in self.chains:
            taken = {joint for joints in by_chain.values() for joint in joints}
            by_chain[chain] = tuple(index for index in self.indices(chain) if index not in taken)
        return by_chain

    def members(self, name: str) -> tuple[str, ...]:
        """Return the joints of a chain or group. Raises `UsageError`."""
        if name in self.chains:
            return self.chains[name].joints
        if name in self.groups:
            return self.groups[name]
        there = ", ".join(self._members_of_all())
        raise UsageError(f'{self.name} has no chain or group "{name}"; it has: {there}')

    def pose(self, name: str) -> tuple[float, ...]:
        """Return a named pose as a vector of joints. Raises `UsageError`."""
        if name not in self.poses:
            raise UsageError(f'{self.name} has no pose "{name}"; it has: {", ".join(self.poses)}')
        pose = self.poses[name]
        return tuple(pose[joint] for joint in self.joint_names)

    def _members_of_all(self) -> Iterator[str]:
        yield from self.chains
        yield from (name for name in self.groups if name not in self.chains)
