"""URDF files: checked when uploaded, and read for the joints of a robot.

A file comes from a client, so entities and external references are not resolved.
"""

import math
from itertools import chain
from typing import Final

from lxml import etree

from handover.errors import Problem
from handover.formats.robot_xml import loop_faults, mesh_faults, remove_namespace
from handover.messages import Message, message
from handover_devices.model.description import Joint

MAX_URDF_BYTES: Final = 4 * 1024 * 1024
_MOVING: Final = frozenset({"revolute", "continuous", "prismatic"})


def joints_in(urdf: bytes) -> tuple[Joint, ...]:
    """Return the moving joints of a URDF in the order of the file; raise `Problem` 422 for a bad file."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        root = etree.fromstring(urdf, parser)
    except etree.XMLSyntaxError as error:
        raise _refused(
            message("device.urdf_no_xml", "it is no XML: {error}", error=str(error)[:200])
        ) from None
    remove_namespace(root)
    if root.tag != "robot":
        raise _refused(
            message(
                "device.urdf_wrong_root",
                "its root element is {element}, not robot",
                element=str(root.tag)[:40],
            )
        )
    if root.getroottree().docinfo.internalDTD is not None:
        raise _refused(message("device.urdf_document_type", "it has a document type; remove that"))
    fault = next(chain(mesh_faults(root), loop_faults(root)), None)
    if fault is not None:
        raise _refused(message("device.urdf_fault", "{fault}", fault=fault[:500]))
    joints: list[Joint] = []
    for element in root.findall("joint"):
        kind = element.get("type")
        if kind not in _MOVING or element.find("mimic") is not None:
            continue
        limit = element.find("limit")
        bounded = kind != "continuous"
        try:
            joints.append(
                Joint.model_validate(
                    {
                        "name": element.get("name", ""),
                        "type": kind,
                        "lower": _limit(limit, "lower", 0.0) if bounded else None,
                        "upper": _limit(limit, "upper", 0.0) if bounded else None,
                        "max_velocity": _limit(limit, "velocity", None) or None,
                        "max_effort": _limit(limit, "effort", None) or None,
                    }
                )
            )
        except ValueError as error:
            reason = str(error).splitlines()
            text = next((line.strip() for line in reason if "Value error" in line), reason[0])
            raise _refused(
                message(
                    "device.urdf_bad_joint",
                    "joint {joint}: {reason}",
                    joint=element.get("name"),
                    reason=text[:200],
                )
            ) from None
    return tuple(joints)


def _limit(element: "etree._Element | None", name: str, default: float | None) -> float | None:
    text = None if element is None else element.get(name)
    if text is None:
        return default
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"Value error: {name} is not finite")
    return value


def _refused(reason: Message) -> Problem:
    return Problem.translated(
        422, "No URDF", "device.urdf_unusable", "the URDF cannot be used: {reason}", reason=reason
    )
