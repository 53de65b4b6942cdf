"""The tree of a humanoid's URDF, checked: what has no physical meaning is refused, with a line each."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from lxml import etree

from handover.errors import UsageError
from handover.formats.robot_xml import link_of, number_of, parse_robot_xml, settle_sizes, tree_faults

MOVING = frozenset({"revolute", "prismatic"})
FIXED = "fixed"
MAX_JOINTS = 200
INERTIA_TOLERANCE = 1e-6
SMALLEST_M = 1e-12


def settled(urdf: str) -> tuple[str, tuple[str, ...]]:
    """Return a URDF without shapes of size 0, and what changed; unchanged where it has none."""
    element = parse_robot_xml(urdf, "URDF")
    notes = tuple(
        f'the link "{link.get("name")}": {text}'
        for link in element.findall("link")
        for text in settle_sizes(link)
    )
    return (etree.tostring(element, encoding="unicode"), notes) if notes else (urdf, ())


def number(element: Any, attribute: str) -> float | None:
    """Return an attribute as a finite number; None if it is missing or none."""
    value = number_of(element, attribute)
    return value if value is not None and math.isfinite(value) else None


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
        element = parse_robot_xml(urdf, "URDF")
        faults = [*tree_faults(element), *_kind_faults(element), *_place_faults(element)]
        if faults:
            raise UsageError("\n".join(faults))
        above = {link_of(joint, "child"): joint for joint in element.findall("joint")}
        by_name = {str(link.get("name")): link for link in element.findall("link")}
        root = next(name for name in by_name if name not in above)
        links = tuple(_outwards(root, element))
        moving = tuple(above[link] for link in links if link in above and above[link].get("type") != FIXED)
        faults = [fault for joint in moving for fault in _joint_faults(joint)]
        faults += [fault for name in links for fault in _inertia_faults(by_name[name])]
        faults += _mass_faults(links, by_name, above)
        if faults:
            raise UsageError("\n".join(faults))
        masses = (number(link.find("inertial/mass"), "value") or 0.0 for link in by_name.values())
        shaped = tuple(name for name in links if by_name[name].find("collision") is not None)
        return cls(root, links, shaped, moving, sum(masses), above)

    def child(self, joint: str) -> str | None:
        """Return the link below a joint; None if there is no such joint."""
        return next((link for link, element in self._above.items() if element.get("name") == joint), None)

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
            link = link_of(joint, "parent")
        return tuple(joints)

    def moved_by(self, link: str) -> str | None:
        """Return the moving joint that is nearest above a link; None if nothing moves it."""
        above = self.path(self.root, link)
        return above[-1] if above else None


def _outwards(link: str, element: Any) -> Iterator[str]:
    children: dict[str, list[str]] = {}
    for joint in element.findall("joint"):
        children.setdefault(link_of(joint, "parent"), []).append(link_of(joint, "child"))
    open_links = [link]
    while open_links:
        current = open_links.pop()
        yield current
        open_links += reversed(children.get(current, []))


def _kind_faults(element: Any) -> Iterator[str]:
    joints = element.findall("joint")
    for joint in joints:
        if joint.get("type") not in MOVING | {FIXED}:
            kinds = "a humanoid has revolute, prismatic and fixed ones"
            yield f'the joint "{joint.get("name")}" is {joint.get("type")}; {kinds}'
    if len(joints) > MAX_JOINTS:
        yield f"the URDF has {len(joints)} joints; {MAX_JOINTS} are the most that are computed in time"


def _place_faults(element: Any) -> Iterator[str]:
    """Yield origins and shapes whose numbers are none; parsers of others take them as 0, or fail later."""
    for part in (*element.findall("link"), *element.findall("joint")):
        where = f'the {part.tag} "{part.get("name")}"'
        for origin in part.iter("origin"):
            for attribute in ("xyz", "rpy"):
                written = origin.get(attribute)
                if written is not None and not _are_numbers(written, 3):
                    yield f'{where} has an origin with {attribute}="{written}"; it needs three finite numbers'
        for kind in ("visual", "collision"):
            for shape in part.findall(kind):
                yield from (
                    f"{where} has a {kind} {fault}" for fault in _shape_faults(shape.find("geometry"))
                )


def _shape_faults(geometry: Any) -> Iterator[str]:
    shape = next(iter(geometry), None) if geometry is not None else None
    if shape is None:
        yield "without a shape; its <geometry> has a box, cylinder, sphere or mesh"
        return
    if shape.tag == "mesh":
        if not shape.get("filename"):
            yield "with a mesh that names no file"
        return
    sizes = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
    for attribute in sizes.get(shape.tag, ()):
        written, count = str(shape.get(attribute)), 3 if attribute == "size" else 1
        if not _are_numbers(written, count) or not all(float(size) >= SMALLEST_M for size in written.split()):
            yield f'with a {shape.tag} whose {attribute} is "{written}"; it must be above 0'


def _are_numbers(written: str, count: int) -> bool:
    try:
        numbers = [float(digits) for digits in written.split()]
    except ValueError:
        return False
    return len(numbers) == count and all(map(math.isfinite, numbers))


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


def is_frame(link: Any) -> bool:
    """Return whether a link has no mass: a frame, or a root that only names the robot."""
    inertial = link.find("inertial")
    return inertial is None or number(inertial.find("mass"), "value") == 0


def _mass_faults(links: Sequence[str], by_name: Mapping[str, Any], above: Mapping[str, Any]) -> Iterator[str]:
    """Yield bodies without mass. A body is a link that moves, or the root, with all that is fixed to it."""
    body_of: dict[str, str] = {}
    has_mass: dict[str, bool] = {}
    for name in links:  # outwards, so the link above is known
        joint = above.get(name)
        is_fixed = joint is not None and joint.get("type") == FIXED
        body = body_of[name] = body_of[link_of(joint, "parent")] if is_fixed else name
        has_mass[body] = has_mass.get(body, False) or not is_frame(by_name[name])
    for name, is_heavy in has_mass.items():
        if not is_heavy:
            yield (
                f'the link "{name}" moves and has no <inertial> with a mass, nor has one fixed to it; '
                "without mass its dynamics are undefined"
            )


def _inertia_faults(link: Any) -> Iterator[str]:
    name, inertial = str(link.get("name")), link.find("inertial")
    if is_frame(link):
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
