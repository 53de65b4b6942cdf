"""ROS names: which names ROS allows for topics, services and nodes, and how relative names are resolved."""

import re

from handover_ros.errors import BadName

_PART = r"[A-Za-z_][A-Za-z0-9_]*"
_NODE = re.compile(_PART)
_NAME = re.compile(rf"(?:/|~/)?{_PART}(?:/{_PART})*")
_NAMESPACE = re.compile(rf"/|(?:/{_PART})+")
_MAX_NAME_LENGTH = 240


def node_name(name: str) -> str:
    """Return `name` if it is a valid node name.

    Raises:
        BadName: it has characters other than A-Z, a-z, 0-9 and _, or begins with a digit.
    """
    if not _NODE.fullmatch(name):
        raise BadName(f'"{name}" cannot be the name of a node; use A-Z, a-z, 0-9 and _, no digit first')
    return name


def namespace(name: str) -> str:
    """Return `name` if it is a valid namespace, `/` or `/cell_1`.

    Raises:
        BadName: it does not begin with a slash, ends with one, or has an invalid part.
    """
    if not _NAMESPACE.fullmatch(name):
        raise BadName(f'"{name}" cannot be a namespace; write / or /cell_1')
    return name


def full_name(name: str, inside: str, node: str) -> str:
    """Return the full name of a topic, service or action given in the namespace `inside` of `node`.

    `/a` stays, `a` becomes `/inside/a`, `~/a` becomes `/inside/node/a`.

    Raises:
        BadName: ROS does not allow the name.
    """
    if not _NAME.fullmatch(name) or "__" in name:
        raise BadName(
            f'"{name}" cannot be a ROS name; use A-Z, a-z, 0-9 and single underscores, / between the '
            "parts, and no digit at the start of a part"
        )
    base = inside.rstrip("/")
    if name.startswith("~/"):
        full = f"{base}/{node}/{name[2:]}"
    else:
        full = name if name.startswith("/") else f"{base}/{name}"
    if len(full) > _MAX_NAME_LENGTH:
        raise BadName(
            f'"{name}" is too long: {full} has {len(full)} characters, {_MAX_NAME_LENGTH} are allowed'
        )
    return full
