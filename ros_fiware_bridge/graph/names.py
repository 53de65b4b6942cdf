"""ROS names: what a topic, a service or a node may be called, and how a relative name becomes a full one."""

import re

from ros_fiware_bridge.errors import BadName

_PART = r"[A-Za-z_][A-Za-z0-9_]*"
_NODE = re.compile(_PART)
_NAME = re.compile(rf"(?:/|~/)?{_PART}(?:/{_PART})*")
_NAMESPACE = re.compile(rf"/|(?:/{_PART})+")
_MOST_CHARACTERS = 240


def node_name(name: str) -> str:
    """Return `name` if a node may be called so.

    Raises:
        BadName: it has other characters than letters, digits and underscores, or begins with a digit.
    """
    if not _NODE.fullmatch(name):
        raise BadName(
            f'"{name}" cannot be the name of a node; use letters, digits and underscores, no digit first'
        )
    return name


def namespace(name: str) -> str:
    """Return `name` if it may be a namespace, `/` or `/cell_1`.

    Raises:
        BadName: it does not begin with a slash, ends with one, or has an empty or odd part.
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
            f'"{name}" cannot be a ROS name; use letters, digits and single underscores, / between the '
            "parts, no part that begins with a digit"
        )
    base = inside.rstrip("/")
    if name.startswith("~/"):
        full = f"{base}/{node}/{name[2:]}"
    else:
        full = name if name.startswith("/") else f"{base}/{name}"
    if len(full) > _MOST_CHARACTERS:
        raise BadName(
            f'"{name}" is too long: {full} has {len(full)} characters, {_MOST_CHARACTERS} are allowed'
        )
    return full
