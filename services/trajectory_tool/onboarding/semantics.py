"""The SRDF of a robot: which pairs of links need no check, and a home position.

As the Setup Assistant of MoveIt does: neighbours in the tree always touch; of the other pairs, those that
touch in every sampled position and those that touch in none are disabled. Capsules and boxes are larger than
the meshes in them, so where those touch, the meshes decide.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from services.trajectory_tool.obstacles import World
from services.trajectory_tool.planning.arm import Arm, Array
from services.trajectory_tool.planning.collision import Collisions, link_of
from services.trajectory_tool.robot import Joints
from services.trajectory_tool.robot_model import RobotModel
from services.trajectory_tool.srdf import LinkPair

Meshes = Mapping[str, Sequence[tuple[Any, Any]]]
"""The meshes of links, each with its placement in the frame of the link."""

ALWAYS_SHARE = 0.95

HOME_CLEARANCES_M = (0.03, 0.02, 0.01, 0.005, 0.0025)
"""The largest one that some position has. A motion needs 2 mm at its start, see `Options.margins_m`."""

DEXTERITY_SHARE = 0.3
"""Of the best sampled manipulability: at less, the tool is nearly stuck in some direction."""


@dataclass(frozen=True, slots=True)
class Semantics:
    """Disabled pairs with their reason, and a home position without a contact; None if none was found."""

    disabled: dict[LinkPair, str]
    checked: int
    home: Joints | None

    def written(self, robot: str, joint_names: tuple[str, ...]) -> bytes:
        """Return the SRDF."""
        root = etree.Element("robot", name=robot)
        if self.home is not None:
            state = etree.SubElement(root, "group_state", name="home", group="arm")
            for name, value in zip(joint_names, self.home, strict=True):
                etree.SubElement(state, "joint", name=name, value=f"{value:.6g}")
        for pair, reason in sorted(self.disabled.items(), key=lambda item: sorted(item[0])):
            first, second = sorted(pair)
            etree.SubElement(root, "disable_collisions", link1=first, link2=second, reason=reason)
        return bytes(etree.tostring(root, pretty_print=True, xml_declaration=True, encoding="UTF-8"))


def sample(model: RobotModel, samples: int, seed: int, meshes: Meshes | None = None) -> Semantics:
    """Return the semantics by checking random positions of the joints."""
    random = np.random.default_rng(seed)
    disabled: dict[LinkPair, str] = dict.fromkeys(_adjacent(model), "Adjacent")
    model = replace(model, disabled_pairs=frozenset(disabled))
    arm = Arm(model)
    collisions = Collisions(arm, World())
    geometry, data = collisions.geometry, pin.GeometryData(collisions.geometry)
    names = [link_of(item.name) for item in geometry.geometryObjects]
    pairs = [frozenset((names[pair.first], names[pair.second])) for pair in geometry.collisionPairs]
    touches: dict[LinkPair, int] = dict.fromkeys(pairs, 0)
    exact = _ExactPairs(arm, geometry, meshes or {})
    for joints in random.uniform(arm.lower, arm.upper, (samples, arm.n)):
        pin.computeCollisions(arm.pin_model, arm.data, geometry, data, joints, False)
        touching = {
            pair for pair, result in zip(pairs, data.collisionResults, strict=True) if result.isCollision()
        }
        for pair in touching:
            touches[pair] += 1
            exact.check(pair, joints)
    for pair, count in touches.items():
        if count == 0 or not exact.ever_touched(pair):
            disabled[pair] = "Never"
        elif count >= ALWAYS_SHARE * samples:
            disabled[pair] = "Always"
    checked = sum(1 for pair in touches if pair not in disabled)
    settled = Arm(replace(model, disabled_pairs=frozenset(disabled)))
    return Semantics(disabled, checked, _home(settled, random))


class _ExactPairs:
    """Pairs of links with the meshes that capsules and boxes replace: whether these ever touched."""

    def __init__(self, arm: Arm, fitted: Any, meshes: Meshes) -> None:
        self._arm = arm
        self._geometry = pin.GeometryModel()
        self._of_link: dict[str, list[int]] = {}
        for item in fitted.geometryObjects:
            link = link_of(item.name)
            if link not in meshes:
                self._of_link.setdefault(link, []).append(self._geometry.addGeometryObject(item.copy()))
        for link, shapes in meshes.items():
            frame = arm.pin_model.frames[arm.pin_model.getFrameId(link, pin.FrameType.BODY)]
            for number, (placement, mesh) in enumerate(shapes):
                item = pin.GeometryObject(
                    f"{link}_{number}", frame.parentJoint, frame.placement * placement, mesh
                )
                self._of_link.setdefault(link, []).append(self._geometry.addGeometryObject(item))
        self._data: Any = None
        self._numbers: dict[LinkPair, list[int]] = {}
        self._touched: set[LinkPair] = set()

    def check(self, pair: LinkPair, joints: Array) -> None:
        """Check a pair of links whose shapes touch, until it has once touched."""
        if pair in self._touched:
            return
        if pair not in self._numbers:
            first, second = sorted(pair)
            self._numbers[pair] = []
            for one, other in itertools.product(self._of_link[first], self._of_link[second]):
                self._geometry.addCollisionPair(pin.CollisionPair(one, other))
                self._numbers[pair].append(len(self._geometry.collisionPairs) - 1)
            self._data = pin.GeometryData(self._geometry)
        pin.updateGeometryPlacements(self._arm.pin_model, self._arm.data, self._geometry, self._data, joints)
        if any(pin.computeCollision(self._geometry, self._data, number) for number in self._numbers[pair]):
            self._touched.add(pair)

    def ever_touched(self, pair: LinkPair) -> bool:
        """Return whether the meshes of a pair touched in any position that was checked."""
        return pair in self._touched


def _adjacent(model: RobotModel) -> set[LinkPair]:
    root = etree.fromstring(model.urdf.encode(), etree.XMLParser(resolve_entities=False, no_network=True))
    return {
        frozenset((joint.find("parent").get("link"), joint.find("child").get("link")))
        for joint in root.findall("joint")
    }


def _home(arm: Arm, random: np.random.Generator) -> Joints | None:
    """Return a position with room around all links, from which the tool moves well in all directions.

    All joints at 0 if that is one, else the one nearest to the middle of the joints; None where none is free.
    """
    collisions = Collisions(arm, World())
    middle = (arm.lower + arm.upper) / 2
    half = np.minimum((arm.upper - arm.lower) / 2, math.pi)  # a full turn leads to the same place
    zero = np.zeros(arm.n)
    spread = random.uniform(middle - half, middle + half, (500, arm.n))
    tries: list[Array] = [zero] if arm.is_within(zero) else []
    tries += [middle, *sorted(spread, key=lambda joints: float(np.abs(joints - middle).max()))]
    dexterity = [arm.manipulability(joints) for joints in tries]
    enough = DEXTERITY_SHARE * max(dexterity)
    dexterous = [joints for joints, one in zip(tries, dexterity, strict=True) if one >= enough]
    for candidates in (dexterous, tries):
        for clearance_m in HOME_CLEARANCES_M:
            for joints in candidates:
                if collisions.is_free(joints, clearance_m):
                    return tuple(joints.tolist())
    return None
