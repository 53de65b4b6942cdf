"""Reads an SRDF: pairs of links that never collide, and named positions of the joints.

Of the format of MoveIt, `<disable_collisions link1 link2>` and `<group_state name>` are read.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from lxml import etree

LinkPair = frozenset[str]


class InvalidSrdf(ValueError):
    """The fault of an SRDF, without the name of its file."""


@dataclass(frozen=True, slots=True)
class Srdf:
    """The pairs of links that need no check, and positions by joint name of each named pose."""

    disabled_pairs: frozenset[LinkPair] = frozenset()
    poses: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def read_srdf(text: str) -> Srdf:
    """Return the content of an SRDF. Raises `InvalidSrdf`, or `XMLSyntaxError` of lxml."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)
    root = etree.fromstring(text.encode(), parser)
    if root.tag != "robot":
        raise InvalidSrdf(f"its root element is <{root.tag}>, not <robot>")
    pairs = [
        frozenset((pair.get("link1", ""), pair.get("link2", "")))
        for pair in root.findall("disable_collisions")
    ]
    poses = {
        state.get("name", ""): {
            joint.get("name", ""): _position(joint.get("name", ""), joint.get("value", ""))
            for joint in state.findall("joint")
        }
        for state in root.findall("group_state")
    }
    return Srdf(frozenset(pairs), poses)


def _position(joint: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InvalidSrdf(f'the joint "{joint}" of a group_state has the value "{text}"; give a number')
    return value
