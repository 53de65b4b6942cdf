"""Names of topics, services and types in a mapping."""

import re
from typing import Literal

MAX_NAME_LENGTH = 200
_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"(?P<package>[a-z][a-z0-9_]*)/((?P<kind>msg|srv|action)/)?(?P<name>[A-Z][A-Za-z0-9_]*)")

Kind = Literal["msg", "srv", "action"]


def topic(text: str) -> str:
    """Return the full name of a topic, service or action: `odom` is `/odom`. Raises ValueError."""
    if not _TOPIC.fullmatch(text) or "__" in text or len(text) > MAX_NAME_LENGTH:
        raise ValueError(
            f'"{text}" is not a name of a topic, service or action; use A-Z, a-z, 0-9 '
            "and _, no digit first, and / between the parts, as in /ur10/joint_states"
        )
    return text if text.startswith("/") else f"/{text}"


_PLACEHOLDER = re.compile(r"\{([a-z][a-z0-9_]*)\}")


def topic_pattern(text: str) -> str:
    """Return the full name of a topic, with placeholders such as `/{robot}/odom`. Raises ValueError."""
    topic(_PLACEHOLDER.sub("x", text))
    if len(set(_PLACEHOLDER.findall(text))) < len(_PLACEHOLDER.findall(text)):
        raise ValueError(f'"{text}" has one placeholder twice; rename one of them')
    return text if text.startswith("/") else f"/{text}"


def placeholders(text: str) -> tuple[str, ...]:
    """Return the names of the placeholders in a topic pattern."""
    return tuple(_PLACEHOLDER.findall(text))


def matcher(text: str) -> re.Pattern[str]:
    """Return a regular expression for the matching topics, with a group for each placeholder."""
    parts = _PLACEHOLDER.split(text)
    return re.compile(
        "".join(f"(?P<{part}>[A-Za-z0-9_]+)" if n % 2 else re.escape(part) for n, part in enumerate(parts))
    )


def type_name(text: str, kind: Kind) -> str:
    """Return the full name of a type: `std_msgs/String` is `std_msgs/msg/String`. Raises ValueError."""
    match = _TYPE.fullmatch(text)
    if match is None or match["kind"] not in {None, kind}:
        example = {
            "msg": "sensor_msgs/msg/JointState",
            "srv": "std_srvs/srv/Trigger",
            "action": "control_msgs/action/FollowJointTrajectory",
        }[kind]
        raise ValueError(f'"{text}" is not a {kind} type; write it like {example}')
    return f"{match['package']}/{kind}/{match['name']}"
