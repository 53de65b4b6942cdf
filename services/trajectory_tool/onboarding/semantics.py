"""The SRDF of a robot: which pairs of links need no check, and a home position.

As the Setup Assistant of MoveIt does: neighbours in the tree always touch; of the other pairs, those that
touch in every sampled position and those that touch in none are disabled.
"""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from lxml import etree

from services.trajectory_tool.obstacles import World
from services.trajectory_tool.planning.arm import Arm, Array
from services.trajectory_tool.planning.collision import Collisions, link_of
from services.trajectory_tool.robot import Joints
from services.trajectory_tool.robot_model import RobotModel
from services.trajectory_tool.srdf import LinkPair

ALWAYS_SHARE = 0.95


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


def sample(model: RobotModel, samples: int, seed: int) -> Semantics:
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
    for joints in random.uniform(arm.lower, arm.upper, (samples, arm.n)):
        pin.computeCollisions(arm.pin_model, arm.data, geometry, data, joints, False)
        touching = {
            pair for pair, result in zip(pairs, data.collisionResults, strict=True) if result.isCollision()
        }
        for pair in touching:
            touches[pair] += 1
    for pair, count in touches.items():
        if count == 0:
            disabled[pair] = "Never"
        elif count >= ALWAYS_SHARE * samples:
            disabled[pair] = "Always"
    checked = sum(1 for pair in touches if pair not in disabled)
    settled = Arm(replace(model, disabled_pairs=frozenset(disabled)))
    return Semantics(disabled, checked, _home(settled, random))


def _adjacent(model: RobotModel) -> set[LinkPair]:
    root = etree.fromstring(model.urdf.encode(), etree.XMLParser(resolve_entities=False, no_network=True))
    return {
        frozenset((joint.find("parent").get("link"), joint.find("child").get("link")))
        for joint in root.findall("joint")
    }


def _home(arm: Arm, random: np.random.Generator) -> Joints | None:
    """Return a free position: all joints at 0, in the middle, or the free one nearest to the middle."""
    collisions = Collisions(arm, World())
    middle = (arm.lower + arm.upper) / 2
    zero = np.zeros(arm.n)
    tries: list[Array] = [zero] if arm.is_within(zero) else []
    tries.append(middle)
    spread = random.uniform(arm.lower, arm.upper, (500, arm.n))
    tries += sorted(spread, key=lambda joints: float(np.abs(joints - middle).max()))
    for joints in tries:
        if collisions.is_free(joints, 0.005) and arm.manipulability(joints) > 0.01:
            return tuple(joints.tolist())
    for joints in tries:
        if collisions.is_free(joints):
            return tuple(joints.tolist())
    return None
