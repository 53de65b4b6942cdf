"""A URDF of an installed package, made fit for control: no meshes, locked joints, and capsules of ours.

robot.yaml says where the file is and what changes (see `reading`): `locked` joints become fixed at 0, every
shape that is a mesh is left out, and `capsules` give links a shape to draw and to keep apart.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from handover.distribution import install_command
from handover.errors import UsageError
from handover.formats.robot_xml import parse_robot_xml
from handover_humanoid.model.urdf import number

Capsule = tuple[Sequence[float], Sequence[float], float]
"""Start and end (3,) of the axis in m in the frame of the link, and the radius in m."""
DATA = "cmeel.prefix/share"
"""Where packages of robot data install their files, below the directory of packages."""


def packaged_file(package: str, path: str, extra: str) -> Path:
    """Return a data file of an installed package. Raises `UsageError`, which names the extra, without it."""
    try:
        file = Path(str(metadata.distribution(package).locate_file(f"{DATA}/{package}/{path}")))
    except metadata.PackageNotFoundError:
        raise UsageError(f"the robot model needs the package {package}; {install_command(extra)}") from None
    if not file.is_file():
        raise UsageError(f"the package {package} has no file {path}; install the version of the lock file")
    return file


def adapted(urdf: str, locked: Sequence[str], capsules: Mapping[str, Sequence[Capsule]]) -> str:
    """Return a URDF whose links have capsules only. Raises `UsageError` for unknown names."""
    root = parse_robot_xml(urdf, "URDF")
    faults = list(_unknown(root, locked, capsules))
    if faults:
        raise UsageError("\n".join(faults))
    for element in [child for child in root if child.tag not in {"link", "joint"}]:
        root.remove(element)
    for joint in root.findall("joint"):
        if joint.get("name") in locked:
            joint.set("type", "fixed")
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
        inertial = link.find("inertial")
        if inertial is not None and number(inertial.find("mass"), "value") == 0:
            link.remove(inertial)  # a frame; what was rehearsed is of the model without it
        for count, capsule in enumerate(capsules.get(str(link.get("name")), ())):
            _add_capsule(link, f"{link.get('name')}_{count}", *capsule)
    etree.indent(root)
    return str(etree.tostring(root, encoding="unicode"))


def _unknown(root: Any, locked: Sequence[str], capsules: Mapping[str, Any]) -> Iterator[str]:
    names = {kind: {element.get("name") for element in root.findall(kind)} for kind in ("link", "joint")}
    for kind, wanted in (("joint", locked), ("link", capsules)):
        for name in wanted:
            if name not in names[kind]:
                yield f'the URDF has no {kind} "{name}", which robot.yaml names'


def _add_capsule(link: Any, name: str, start: Sequence[float], end: Sequence[float], radius: float) -> None:
    """Add a capsule between two points: a cylinder, named as a capsule for collisions."""
    way, middle = np.subtract(end, start), np.add(start, end) / 2
    length = max(float(np.linalg.norm(way)), 1e-6)
    # Turn z onto the way: first about y by the angle from z, then about z.
    pitch, yaw = math.acos(way[2] / length), math.atan2(way[1], way[0])
    for tag in ("visual", "collision"):
        shape = etree.SubElement(link, tag, name=name)
        etree.SubElement(
            shape,
            "origin",
            xyz=" ".join(f"{coordinate:.6g}" for coordinate in middle),
            rpy=f"0 {pitch:.9g} {yaw:.9g}",
        )
        geometry = etree.SubElement(shape, "geometry")
        etree.SubElement(geometry, "cylinder", radius=f"{radius:g}", length=f"{length:.6g}")
    checking = link.find("collision_checking")
    if checking is None:
        checking = etree.SubElement(link, "collision_checking")
    etree.SubElement(checking, "capsule", name=name)
