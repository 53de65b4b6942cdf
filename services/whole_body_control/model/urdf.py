"""The tree of a humanoid's URDF, checked: what has no physical meaning is refused, with a line each."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from lxml import etree

from handover.errors import UsageError

MOVING = frozenset({"revolute", "prismatic"})
FIXED = "fixed"
MAX_JOINTS = 200
INERTIA_TOLERANCE = 1e-6


def parsed(text: str, what: str) -> Any:
    """Return the root of a URDF or SRDF. Raises `UsageError`."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True, huge_tree=False)
    try:
        root = etree.fromstring(text.encode(), parser)
    except etree.XMLSyntaxError as error:
        raise UsageError(f"the {what} is not XML: {error}") from None
    if root.tag != "robot":
        raise UsageError(f"the root element of the {what} is <{root.tag}>, not <robot>")
    if any(each.prefix == "xacro" for each in root.iter()):
        raise UsageError(f"the {what} is a xacro file; expand it first: xacro FILE.xacro > FILE.urdf")
    return root


def number(element: Any, attribute: str) -> float | None:
    """Return an attribute as a finite number; None if it is missing or none."""
    try:
        value = float(element.get(attribute))
    except (AttributeError, TypeError, ValueError):
        return None
    return value if math.isfinite(value) else None


@dataclass(frozen=True)
class Tree:
    """A checked tree: links and moving joints from the root outwards."""

    root: str
    links: tuple[str, ...]
    links_with_shape: tuple[str, ...]
    moving: tuple[Any, ...]
    mass_kg: float
    _above: Mapping[str, Any]

    @classmethod
    def of(cls, urdf: str) -> "Tree":
        """Return the tree of a URDF. Raises `UsageError` with a line for each fault."""
        element = parsed(urdf, "URDF")
        faults = list(_tree_faults(element))
        if faults:
            raise UsageError("\n".join(faults))
        above = {_end(joint, "child"): joint for joint in element.findall("joint")}
        by_name = {str(link.get("name")): link for link in element.findall("link")}
        root = next(name for name in by_name if name not in above)
        links = tuple(_outwards(root, element))
        if len(links) < len(by_name):
            loop = ", ".join(sorted(by_name.keys() - set(links)))
            raise UsageError(f"these links hang in a loop of joints, not below {root}: {loop}")
        moving = tuple(above[link] for link in links if link in above and above[link].get("type") != FIXED)
        faults = [fault for joint in moving for fault in _joint_faults(joint)]
        faults += [fault for name in links for fault in _inertia_faults(by_name[name], name == root, above)]
        if faults:
            raise UsageError("\n".join(faults))
        masses = (number(link.find("inertial/mass"), "value") or 0.0 for link in by_name.values())
        shaped = tuple(name for name in links if by_name[name].find("collision") is not None)
        return cls(root, links, shaped, moving, sum(masses), above)

    def child(self, joint: str) -> str | None:
        """Return the link below a joint; None if there is no such joint."""
        return next((link for link, each in self._above.items() if each.get("name") == joint), None)

    def path(self, base: str, tip: str) -> tuple[str, ...] | None:
        """Return the moving joints from `base` to `tip`; None if `tip` is not below `base`."""
        joints: list[str] = []
        link = tip
        while link != base:
            joint = self._above.get(link)
            if joint is None:
                return None
            if joint.get("type") in MOVING:
                joints.insert(0, str(joint.get("name")))
            link = _end(joint, "parent")
        return tuple(joints)


def _end(joint: Any, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else str(element.get("link") or "")


def _outwards(link: str, element: Any) -> Iterator[str]:
    children: dict[str, list[str]] = {}
    for joint in element.findall("joint"):
        children.setdefault(_end(joint, "parent"), []).append(_end(joint, "child"))
    open_links = [link]
    while open_links:
        current = open_links.pop()
        yield current
        open_links += reversed(children.get(current, []))


def _tree_faults(element: Any) -> Iterator[str]:
    links = [link.get("name") for link in element.findall("link")]
    joints = element.findall("joint")
    if not links:
        yield "the URDF has no link"
        return
    for kind, names in (("link", links), ("joint", [joint.get("name") for joint in joints])):
        for name in sorted({str(name) for name in names if not name or names.count(name) > 1}):
            yield f'more than one {kind} is called "{name}", or it has no name'
    children: list[str] = []
    for joint in joints:
        name = joint.get("name")
        for end in ("parent", "child"):
            if _end(joint, end) not in links:
                yield f'the {end} "{_end(joint, end)}" of the joint "{name}" does not exist'
        if joint.get("type") not in MOVING | {FIXED}:
            kinds = "a humanoid has revolute, prismatic and fixed ones"
            yield f'the joint "{name}" is {joint.get("type")}; {kinds}'
        children.append(_end(joint, "child"))
    for child in sorted({child for child in children if children.count(child) > 1}):
        yield f'the link "{child}" has {children.count(child)} parents, a closed loop; keep one joint'
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        yield f"the URDF has {len(roots)} roots ({', '.join(roots) or 'none'}); it needs exactly one"
    if len(joints) > MAX_JOINTS:
        yield f"the URDF has {len(joints)} joints; {MAX_JOINTS} are the most that are computed in time"


def _joint_faults(joint: Any) -> Iterator[str]:
    name, limit = joint.get("name"), joint.find("limit")
    lower, upper = number(limit, "lower"), number(limit, "upper")
    if lower is None or upper is None:
        yield f'the joint "{name}" has no position limits; add <limit lower upper velocity effort>'
    elif lower >= upper:
        yield f'the limits of the joint "{name}" are reversed or equal: {lower:g} to {upper:g}'
    for attribute in ("velocity", "effort"):
        value = number(limit, attribute)
        if value is None or value <= 0:
            yield f'the joint "{name}" has no {attribute} limit above 0'
    if joint.find("mimic") is not None:
        yield f'the joint "{name}" mimics another one; make it fixed, or a joint of its own'
    axis = joint.find("axis")
    try:
        length = math.hypot(*(float(part) for part in axis.get("xyz").split()))
    except (AttributeError, TypeError, ValueError):
        length = math.nan
    if not 0.99 < length < 1.01:
        yield f'the axis of the joint "{name}" is no vector of length 1'


def _inertia_faults(link: Any, is_root: bool, above: Mapping[str, Any]) -> Iterator[str]:
    name, inertial = str(link.get("name")), link.find("inertial")
    moves = is_root or above[name].get("type") in MOVING
    if inertial is None:
        if moves:
            yield f'the link "{name}" moves and has no <inertial>; without mass its dynamics are undefined'
        return
    mass = number(inertial.find("mass"), "value")
    if mass is None or mass <= 0:
        yield f'the mass of the link "{name}" is not above 0'
    entries = [number(inertial.find("inertia"), key) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")]
    if any(entry is None for entry in entries):
        yield f'the inertia of the link "{name}" is incomplete or not finite'
        return
    ixx, ixy, ixz, iyy, iyz, izz = entries
    principal = np.linalg.eigvalsh(np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]], dtype=float))
    if principal[0] < -INERTIA_TOLERANCE:
        yield f'the inertia of the link "{name}" is not positive'
    elif principal[2] > principal[0] + principal[1] + INERTIA_TOLERANCE:
        yield f'the inertia of the link "{name}" violates the triangle inequality, which no rigid body does'
