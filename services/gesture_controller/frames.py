"""Frames: the lines that a glove sends, read with care.

The wire carries one JSON object a line: a hello first, then frames. What cannot be read is refused with a
short reason, under which it is counted; a frame that is read is complete and finite.
"""

import math
import re
from dataclasses import dataclass
from typing import Any, TypeGuard

import orjson

from services.gesture_controller.thresholds import FINGERS

VERSION = 1
MAX_LINE_BYTES = 64 * 1024
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")


class BadFrame(ValueError):
    """A line of a glove is no frame; `reason` is one of a few words, fit to count by."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class BadHello(ValueError):
    """A glove introduced itself wrongly; the message tells its owner what to change."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What a glove measured at `t_s`, its own monotonic clock; `bend` is raw, in the order it sends."""

    t_s: float
    bend: list[float]
    battery: float | None = None


@dataclass(frozen=True, slots=True)
class Hello:
    """How a glove introduces itself; `sensors` is the order in which it sends its fingers."""

    glove: str
    hand: str = "right"
    token: str = ""
    sensors: tuple[str, ...] = FINGERS

    @property
    def order(self) -> tuple[int, ...] | None:
        """Return where each finger, thumb first, stands in `bend`; None if they are in order already."""
        return None if self.sensors == FINGERS else tuple(self.sensors.index(finger) for finger in FINGERS)

    def line(self) -> bytes:
        """Return the hello as it goes on the wire, without the token."""
        hello = {"type": "hello", "version": VERSION, "glove": self.glove, "hand": self.hand}
        return orjson.dumps({**hello, "sensors": self.sensors}) + b"\n"


def parse_frame(line: bytes, order: tuple[int, ...] | None = None) -> Frame:
    """Return the frame in `line`, its fingers put into `order`; raise `BadFrame` if it is none."""
    try:
        given = orjson.loads(line)
    except orjson.JSONDecodeError:
        raise BadFrame("not JSON") from None
    if type(given) is not dict or given.get("type") != "frame":
        raise BadFrame("not a frame")
    t_s = given.get("t")
    bend = given.get("bend")
    if not _is_number(t_s):
        raise BadFrame("no time")
    if type(bend) is not list:
        raise BadFrame("no bend values")
    if len(bend) != len(FINGERS):
        raise BadFrame("missing fingers" if len(bend) < len(FINGERS) else "too many fingers")
    for value in bend:
        if not _is_number(value):
            raise BadFrame("not a number")
    if order is not None:
        bend = [bend[place] for place in order]
    return Frame(t_s, bend, _battery(given.get("battery")))


def parse_hello(line: bytes) -> Hello:
    """Return the hello in `line`; raise `BadHello` with what to change."""
    try:
        given = orjson.loads(line)
    except orjson.JSONDecodeError:
        raise BadHello("the first line is not JSON; send a hello first") from None
    if not isinstance(given, dict) or given.get("type") != "hello":
        raise BadHello('the first line is not a hello; send {"type":"hello",…} first')
    if given.get("version") != VERSION:
        version = str(given.get("version"))[:20]
        raise BadHello(f"version {version} is not spoken here; this controller speaks {VERSION}")
    name, hand, token = given.get("glove"), given.get("hand", "right"), given.get("token", "")
    if not is_glove_name(name):
        raise BadHello('"glove" must be a name of 1 to 64 letters, digits, ".", "_" or "-"')
    if hand not in ("left", "right"):
        raise BadHello('"hand" must be "left" or "right"')
    if token is not None and not isinstance(token, str):
        raise BadHello('"token" must be a text')
    return Hello(name, hand, token or "", _sensors(given.get("sensors", list(FINGERS))))


def is_glove_name(name: object) -> TypeGuard[str]:
    """Say whether `name` can name a glove: it becomes part of entity ids, URLs and file names."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None and name.strip(".") != ""


def _sensors(given: Any) -> tuple[str, ...]:
    if not isinstance(given, list) or not all(isinstance(finger, str) for finger in given):
        raise BadHello('"sensors" must be a list of fingers')
    missing = [finger for finger in FINGERS if finger not in given]
    if missing or len(given) != len(FINGERS):
        what = f"{', '.join(missing)} missing" if missing else "one sensor a finger"
        raise BadHello(f'"sensors" must name {", ".join(FINGERS)} once each: {what}')
    return tuple(given)


def _is_number(value: Any) -> TypeGuard[float]:
    kind = type(value)
    return kind is int or (kind is float and math.isfinite(value))


def _battery(value: Any) -> float | None:
    return round(value, 2) if _is_number(value) and 0 <= value <= 1 else None
