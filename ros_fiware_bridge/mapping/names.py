"""Names as ROS writes them: of topics, services and types; and entities as this house writes them."""

import re
from typing import Literal

LONGEST_NAME = 200
_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"(?P<package>[a-z][a-z0-9_]*)/((?P<room>msg|srv|action)/)?(?P<name>[A-Z][A-Za-z0-9_]*)")

Room = Literal["msg", "srv", "action"]


def topic(text: str) -> str:
    """Return the full name of a topic, service or action: `odom` is `/odom`. Raises ValueError."""
    if not _TOPIC.fullmatch(text) or "__" in text or len(text) > LONGEST_NAME:
        raise ValueError(
            f'"{text}" is no name of a topic, service or action; such a name is words of letters, digits '
            "and _, not beginning with a digit, joined by /, such as /ur10/joint_states"
        )
    return text if text.startswith("/") else f"/{text}"


_PLACE = re.compile(r"\{([a-z][a-z0-9_]*)\}")


def topic_pattern(text: str) -> str:
    """Return the full name of a topic that may have places, such as `/{robot}/odom`. Raises ValueError."""
    topic(_PLACE.sub("x", text))
    if len(set(_PLACE.findall(text))) < len(_PLACE.findall(text)):
        raise ValueError(f'"{text}" has one place twice; give each its own name')
    return text if text.startswith("/") else f"/{text}"


def places(text: str) -> tuple[str, ...]:
    """Return the names of the places in a topic pattern."""
    return tuple(_PLACE.findall(text))


def matcher(text: str) -> re.Pattern[str]:
    """Return what matches the topics that fit a topic pattern, with a group for each place."""
    parts = _PLACE.split(text)
    return re.compile(
        "".join(f"(?P<{part}>[A-Za-z0-9_]+)" if n % 2 else re.escape(part) for n, part in enumerate(parts))
    )


def type_name(text: str, room: Room) -> str:
    """Return the full name of a type: `std_msgs/String` is `std_msgs/msg/String`. Raises ValueError."""
    found = _TYPE.fullmatch(text)
    if found is None or found["room"] not in {None, room}:
        example = {
            "msg": "sensor_msgs/msg/JointState",
            "srv": "std_srvs/srv/Trigger",
            "action": "control_msgs/action/FollowJointTrajectory",
        }[room]
        raise ValueError(f'"{text}" is no type of this kind; it is written like {example}')
    return f"{found['package']}/{room}/{found['name']}"
