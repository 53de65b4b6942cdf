"""The SRDF of a robot: which pairs of links need no check, and its positions.

Neighbours in the tree always touch, so they are disabled, as are the pairs that a given SRDF disables. Of the
others, the meshes decide: pairs that touch in nearly all random positions are disabled, and so are those that
never touch, if that is certain. It is for two links with two joints between them at most: their distance at
the middle of a box of joint positions, less how far they approach at most within the box, is a lower bound
for the whole box, and boxes are halved until it is above 0. All other pairs are checked.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import World
from handover_robots.model.srdf import LinkPair, Srdf
from handover_robots.onboarding.comparison import Decided, link_pairs, shapes_within
from handover_robots.planning.arm import Arm
from handover_robots.planning.collision import Collisions, link_of

ALWAYS_SHARE = 0.95
MAX_JOINTS_BETWEEN = 2
MAX_BOXES = 4000

FROM_SRDF = "of the given SRDF"


@dataclass(frozen=True, slots=True)
class Semantics:
    """Disabled pairs with their reason, and named positions."""

    disabled: Mapping[LinkPair, str] = field(default_factory=dict)
    poses: Mapping[str, Joints] = field(default_factory=dict)

    def written(self, robot: str, joint_names: tuple[str, ...]) -> bytes:
        """Return the SRDF."""
        root = etree.Element("robot", name=robot)
        for pose, joints in self.poses.items():
            state = etree.SubElement(root, "group_state", name=pose, group="arm")
            for name, value in zip(joint_names, joints, strict=True):
                etree.SubElement(state, "joint", name=name, value=f"{value:.6g}")
        write_pairs(root, self.disabled)
        return bytes(etree.tostring(root, pretty_print=True, xml_declaration=True, encoding="UTF-8"))


def write_pairs(root: Any, disabled: Mapping[LinkPair, str]) -> None:
    """Write the pairs that need no check into an SRDF, in place of the present ones."""
    for written in root.findall("disable_collisions"):
        root.remove(written)
    for pair, reason in sorted(disabled.items(), key=lambda item: sorted(item[0])):
        first, second = sorted(pair)
        etree.SubElement(root, "disable_collisions", link1=first, link2=second, reason=reason)
    etree.indent(root)


def excluded_pairs(arm: Arm, decided: Decided, srdf: Srdf) -> dict[LinkPair, str]:
    """Return the pairs that need no check, each with the reason.

    `arm` checks all pairs but neighbours and those of the given SRDF. For links without meshes their shapes
    decide.
    """
    excluded = dict.fromkeys(srdf.disabled_pairs, FROM_SRDF) | dict.fromkeys(adjacent(arm), "Adjacent")
    geometry = Collisions(arm, World()).geometry
    names = link_pairs(geometry)
    shapes = shapes_within(arm, decided.configurations, 0.0)
    for pair in dict.fromkeys(names):
        by = decided.touching if pair in decided.pairs else shapes
        touched = sum(pair in touching for touching in by)
        if touched >= ALWAYS_SHARE * len(by):
            excluded[pair] = "Always"
        elif touched == 0 and never_touches(
            arm, geometry, [number for number, links in enumerate(names) if links == pair]
        ):
            excluded[pair] = "Never"
    return excluded


def never_touches(arm: Arm, geometry: Any, numbers: list[int]) -> bool:
    """Return whether it is certain that pairs of shapes of two links never touch."""
    items = geometry.geometryObjects
    pairs = [geometry.collisionPairs[number] for number in numbers]
    ends = sorted((items[pairs[0].first].parentJoint, items[pairs[0].second].parentJoint))
    between = slice(ends[0], ends[1])
    if ends[1] - ends[0] > MAX_JOINTS_BETWEEN:
        return False
    outer = {max((pair.first, pair.second), key=lambda item: items[item].parentJoint) for pair in pairs}
    approach = np.max([arm.reach_of(items[link])[between] for link in outer], axis=0)
    half = (arm.upper - arm.lower)[between] / 2
    half = np.where(arm.is_turning[between], np.minimum(half, math.pi), half)
    data = pin.GeometryData(geometry)
    joints = (arm.lower + arm.upper) / 2
    boxes, checked = [(joints[between].copy(), half)], 0
    while boxes:
        middle, half = boxes.pop()
        joints[between] = middle
        pin.updateGeometryPlacements(arm.pin_model, arm.data, geometry, data, joints)
        distance_m = min(pin.computeDistance(geometry, data, number).min_distance for number in numbers)
        ways_m = approach * half
        if distance_m > float(ways_m.sum()):
            continue
        checked += 1
        if distance_m <= 0.0 or checked > MAX_BOXES:
            return False
        step = np.zeros(len(half))
        widest = int(ways_m.argmax())
        step[widest] = half[widest] / 2
        boxes += [(middle - step, half - step), (middle + step, half - step)]
    return True


def adjacent(arm: Arm) -> set[LinkPair]:
    """Return the pairs of links that share a joint, or are fixed to each other, and have shapes."""
    links = dict.fromkeys(link_of(item.name) for item in arm.geometry.geometryObjects)
    return {
        frozenset(pair)
        for pair in itertools.combinations(links, 2)
        if abs(arm.joint_of_link(pair[0]) - arm.joint_of_link(pair[1])) < 2
    }
