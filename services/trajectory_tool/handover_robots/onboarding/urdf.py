"""The tree of a URDF: checked, completed where a default is safe, and refused where it is not.

Refused is what has no unique meaning: loops, several roots, reversed limits, joints that no arm has, values
that are no numbers. Completed, with a finding, is what a URDF may leave out.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from lxml import etree

from handover.errors import UsageError
from handover.formats.robot_xml import number_of, parse_robot_xml, tree_faults
from handover_robots.robots.urdf import MAX_URDF_BYTES

Level = Literal["info", "warning", "error"]

DEFAULT_SPEED = {"revolute": 1.0, "continuous": 1.0, "prismatic": 0.25}
ACCELERATION_OF_SPEED, JERK_OF_SPEED = 4.0, 40.0
"""Assumed limits as multiples of the limit of velocity."""
MAX_PLAUSIBLE_SPEED = {"revolute": 12.0, "continuous": 12.0, "prismatic": 5.0}
MOVABLE = frozenset(DEFAULT_SPEED)
TIP_NAMES = ("tcp", "tool0", "tip", "ee_link", "end_effector", "eef", "tool_link", "flange")
"""Names of the link whose pose a Task gives, or their last words; the first that there is counts."""
NOT_OF_AN_ARM = frozenset({"planar", "floating"})


@dataclass(frozen=True, slots=True)
class Finding:
    """What is missing or odd: where, what, and what was done or is to be done."""

    level: Level
    about: str
    text: str


@dataclass
class Examined:
    """A checked tree: `root` is the completed XML, `chain` the joints from the root link to `tip`.

    `surfaces` are the shapes of links as the URDF has them, see `meshes.Surfaces`.
    """

    root: Any
    tip: str
    chain: list[Any]
    findings: list[Finding] = field(default_factory=list)
    surfaces: dict[str, list[Any]] = field(default_factory=dict)

    @property
    def movable(self) -> list[Any]:
        """Return the movable joints of the chain."""
        return [joint for joint in self.chain if joint.get("type") != "fixed"]


def read_urdf(path: Path) -> str:
    """Return the text of a URDF file. Raises `UsageError`."""
    try:
        if path.stat().st_size > MAX_URDF_BYTES:
            raise UsageError(f"it has more than {MAX_URDF_BYTES >> 20} MB")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"it cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError("not XML: it is not UTF-8") from None


def examine(text: str, tip: str | None = None) -> Examined:
    """Return the checked tree of a URDF. Raises `UsageError` with a line for each fault."""
    root = parse_robot_xml(text, "URDF")
    findings: list[Finding] = []
    _drop_foreign(root, findings)
    faults = list(tree_faults(root))
    if faults:
        raise UsageError("\n".join(faults))
    tip = _rename_links(root, tip, findings)
    joints = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
    tip = _tip(root, joints, tip, findings)
    chain: list[Any] = []
    link = tip
    while link in joints:
        chain.insert(0, joints[link])
        link = joints[link].find("parent").get("link")
    examined = Examined(root, tip, chain, findings)
    faults = [fault for joint in chain for fault in _joint_faults(joint)]
    if not faults and not examined.movable:
        faults = [f'no joint moves between the root and "{tip}"; name another tip: --tip LINK']
    if faults:
        raise UsageError("\n".join(faults))
    for joint in examined.movable:
        findings += _completed(joint)
    findings += _beside(root, chain)
    findings += _inertias(root)
    return examined


def _drop_foreign(root: Any, findings: list[Finding]) -> None:
    """Remove what belongs to other tools."""
    tags = {"link", "joint", "material"}
    foreign = [element for element in root if element.tag not in tags]
    for element in foreign:
        root.remove(element)
    if foreign:
        names = ", ".join(sorted({str(element.tag) for element in foreign}))
        findings.append(Finding("info", "file", f"elements of other tools are left out: {names}"))


def _rename_links(root: Any, tip: str | None, findings: list[Finding]) -> str | None:
    """Rename links that are called as a joint, which planning cannot distinguish; return the new `tip`."""
    taken = {joint.get("name") for joint in root.findall("joint")}
    links = {link.get("name"): link for link in root.findall("link")}
    for name in [name for name in links if name in taken]:
        new = f"{name}_link"
        while new in taken or new in links:
            new += "_"
        links[name].set("name", new)
        taken.add(new)
        for end in (*root.iterfind("joint/parent"), *root.iterfind("joint/child")):
            if end.get("link") == name:
                end.set("link", new)
        tip = new if tip == name else tip
        findings.append(Finding("info", name, f'a joint has the same name; the link is called "{new}" here'))
    return tip


def _tip(root: Any, joints: dict[str, Any], tip: str | None, findings: list[Finding]) -> str:
    links = [link.get("name") for link in root.findall("link")]
    if tip is not None:
        if tip not in links:
            raise UsageError(f'there is no link "{tip}"; the links are {", ".join(links)}')
        return tip
    inner = {joint.find("parent").get("link") for joint in joints.values()}
    leaves = [link for link in links if link not in inner]

    def reach(link: str) -> tuple[int, int]:
        moving = total = 0
        passes_mimic = False
        while link in joints:
            joint = joints[link]
            total += 1
            moving += joint.get("type") in MOVABLE
            passes_mimic = passes_mimic or joint.find("mimic") is not None
            link = joint.find("parent").get("link")
        return (-1 if passes_mimic else moving, total)

    ordered = sorted(leaves, key=reach, reverse=True)
    named = [link for name in TIP_NAMES for link in links if link == name or link.endswith(f"_{name}")]
    chosen = named[0] if named else ordered[0]
    if len(leaves) > 1:
        findings.append(
            Finding(
                "warning",
                "tip",
                f'there are {len(leaves)} tips ({", ".join(leaves)}); "{chosen}" is used; '
                "choose another with --tip LINK",
            )
        )
    return str(chosen)


def _joint_faults(joint: Any) -> Iterator[str]:  # noqa: PLR0912 - one rule after another
    name, kind, limit = joint.get("name"), joint.get("type"), joint.find("limit")
    if kind in NOT_OF_AN_ARM:
        yield f'the joint "{name}" is {kind}; between base and tip joints turn or slide'
        return
    if kind not in MOVABLE | {"fixed"}:
        yield f'the joint "{name}" has the unknown type "{kind}"'
        return
    if joint.find("mimic") is not None:
        yield (
            f'the joint "{name}" mimics "{joint.find("mimic").get("joint")}" and is on the way to the tip; '
            "name a tip before it: --tip LINK"
        )
    for element in joint.iter():
        for attribute in ("xyz", "rpy"):
            written = element.get(attribute)
            if written is not None and not _is_vector(written):
                yield f'the joint "{name}" has {attribute}="{written}", which is not three numbers'
    axis = joint.find("axis")
    written = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
    if kind != "fixed" and _is_vector(written) and math.hypot(*map(float, written.split())) < 1e-6:
        yield f'the joint "{name}" has an axis of length 0'
    values = {
        limit_name: number_of(limit, limit_name) for limit_name in ("lower", "upper", "velocity", "effort")
    }
    for attribute, value in values.items():
        if value is not None and not math.isfinite(value):
            yield f'the joint "{name}" has {attribute}="{limit.get(attribute)}", which is not a number'
    lower, upper = values["lower"], values["upper"]
    if kind in {"revolute", "prismatic"}:
        if lower is None and upper is None:
            yield f'the joint "{name}" is {kind} without limits: give <limit lower="…" upper="…"/>'
        elif (lower or 0.0) > (upper or 0.0):
            yield f'the joint "{name}" has its limits reversed: lower {lower} is above upper {upper}'
        elif (lower or 0.0) == (upper or 0.0):
            yield f'the joint "{name}" cannot move: lower and upper are {lower}; make it fixed'
    if (values["velocity"] or 0.0) < 0:
        yield f'the joint "{name}" has a negative limit of velocity'


def _is_vector(written: str) -> bool:
    try:
        values = [float(part) for part in written.split()]
    except ValueError:
        return False
    return len(values) == 3 and all(map(math.isfinite, values))


def _completed(joint: Any) -> Iterator[Finding]:
    name, kind, limit = joint.get("name"), joint.get("type"), joint.find("limit")
    unit = "m/s" if kind == "prismatic" else "rad/s"
    if limit is None:
        limit = etree.SubElement(joint, "limit")
    velocity = number_of(limit, "velocity") or 0.0
    if velocity == 0.0:
        limit.set("velocity", str(DEFAULT_SPEED[kind]))
        yield Finding(
            "warning",
            name,
            f"no limit of velocity; {DEFAULT_SPEED[kind]} {unit} is assumed",
        )
    elif velocity > MAX_PLAUSIBLE_SPEED[kind]:
        yield Finding("warning", name, f"the limit of velocity, {velocity:g} {unit}, is implausibly high")
    if not number_of(limit, "effort"):
        limit.set("effort", limit.get("effort") or "0")
        yield Finding("warning", name, "no limit of effort; torques are not limited")
    if kind == "continuous":
        yield Finding("info", name, "continuous; it is planned within one full turn in both directions")
    if kind == "prismatic":
        yield Finding("info", name, "prismatic; positions are in m")
    for attribute in ("lower", "upper"):
        if kind in {"revolute", "prismatic"} and limit.get(attribute) is None:
            limit.set(attribute, "0")
            yield Finding("warning", name, f'no limit "{attribute}"; 0 is its default in a URDF')


def _beside(root: Any, chain: list[Any]) -> Iterator[Finding]:
    """Yield what moves beside the chain: it is held at 0."""
    on_chain = {joint.get("name") for joint in chain}
    for joint in root.findall("joint"):
        if joint.get("name") in on_chain or joint.get("type") == "fixed":
            continue
        mimic = joint.find("mimic")
        text = "is beside the way to the tip; it is held at 0, e.g. as a finger"
        if mimic is not None:
            text = f'mimics "{mimic.get("joint")}"; it {text}'
        yield Finding("info", joint.get("name"), text)


def _complete_inertia(inertial: Any) -> None:
    """Write what an inertia leaves out: the library for planning drops all shapes of a link without it."""
    for tag, attributes in (("mass", ("value",)), ("inertia", ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))):
        element = inertial.find(tag)
        element = etree.SubElement(inertial, tag) if element is None else element
        for attribute in attributes:
            if not math.isfinite(number_of(element, attribute) or 0.0) or element.get(attribute) is None:
                element.set(attribute, "0")


def _inertias(root: Any) -> Iterator[Finding]:
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        mass = number_of(inertial.find("mass"), "value") or 0.0
        _complete_inertia(inertial)
        moments = [number_of(inertial.find("inertia"), axis) or 0.0 for axis in ("ixx", "iyy", "izz")]
        if mass <= 0 or not math.isfinite(mass) or not all(moment > 0 for moment in moments):
            yield Finding("warning", link.get("name"), "zero or negative inertia; its torques are unknown")
            continue
        a, b, c = sorted(moments)
        if a + b < c * (1 - 1e-3):
            yield Finding("warning", link.get("name"), "no body has this inertia: ixx + iyy < izz")
    without = [
        link.get("name")
        for link in root.findall("link")
        if link.find("inertial") is None
        and (link.find("visual") is not None or link.find("collision") is not None)
    ]
    if without:
        yield Finding("warning", ", ".join(without), "no inertia; torques of the robot cannot be computed")
