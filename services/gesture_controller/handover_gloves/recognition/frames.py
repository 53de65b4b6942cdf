"""The wire protocol of gloves: one JSON object a line, a hello first, then frames.

An invalid line raises an error with a short reason, which is used as a label in metrics. A parsed frame is
complete, and its values are finite.
"""

import math
import re
from dataclasses import dataclass
from typing import Any, TypeGuard

import orjson

from handover_gloves.recognition.thresholds import FINGERS

VERSION = 1
MAX_LINE_BYTES = 64 * 1024
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")


class BadFrame(ValueError):
    """A line is no valid frame; `reason` is one of a few fixed texts, used as a label."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class BadHello(ValueError):
    """A hello is invalid; the message says what to change."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Values measured at `t_s` (the glove's monotonic clock); `bend` is raw, thumb first."""

    t_s: float
    bend: list[float]
    battery: float | None = None


@dataclass(frozen=True, slots=True)
class Hello:
    """The first line of a glove; `sensors` is the order of the fingers in its frames."""

    glove: str
    hand: str = "right"
    token: str = ""
    sensors: tuple[str, ...] = FINGERS

    @property
    def order(self) -> tuple[int, ...] | None:
        """The index in `bend` of each finger, thumb first; None if they are in that order."""
        return None if self.sensors == FINGERS else tuple(self.sensors.index(finger) for finger in FINGERS)

    def line(self) -> bytes:
        """Return the hello as a line without the token."""
        hello = {"type": "hello", "version": VERSION, "glove": self.glove, "hand": self.hand}
        return orjson.dumps({**hello, "sensors": self.sensors}) + b"\n"


def parse_frame(line: bytes, order: tuple[int, ...] | None = None) -> Frame:
    """Return the frame in `line`, with its fingers in `order`; raises `BadFrame`."""
    try:
        document = orjson.loads(line)
    except orjson.JSONDecodeError:
        raise BadFrame("not JSON") from None
    if type(document) is not dict or document.get("type") != "frame":
        raise BadFrame("not a frame")
    t_s = document.get("t")
    bend = document.get("bend")
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
    return Frame(t_s, bend, _battery(document.get("battery")))


def parse_hello(line: bytes) -> Hello:
    """Return the hello in `line`; raises `BadHello`."""
    try:
        document = orjson.loads(line)
    except orjson.JSONDecodeError:
        raise BadHello("the first line is not JSON; send a hello first") from None
    if not isinstance(document, dict) or document.get("type") != "hello":
        raise BadHello('the first line is not a hello; send {"type":"hello",…} first')
    if document.get("version") != VERSION:
        version = str(document.get("version"))[:20]
        raise BadHello(f"version {version} is not supported; this controller supports {VERSION}")
    name, hand, token = document.get("glove"), document.get("hand", "right"), document.get("token", "")
    if not is_glove_name(name):
        raise BadHello('"glove" must be a name of 1 to 64 letters, digits, ".", "_" or "-"')
    if hand not in ("left", "right"):
        raise BadHello('"hand" must be "left" or "right"')
    if token is not None and not isinstance(token, str):
        raise BadHello('"token" must be a text')
    return Hello(name, hand, token or "", _sensors(document.get("sensors", list(FINGERS))))


def is_glove_name(name: object) -> TypeGuard[str]:
    """Return True if `name` is valid for a glove: it becomes part of entity ids, URLs and file names."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None and name.strip(".") != ""


def _sensors(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(finger, str) for finger in value):
        raise BadHello('"sensors" must be a list of fingers')
    missing = [finger for finger in FINGERS if finger not in value]
    if missing or len(value) != len(FINGERS):
        what = f"{', '.join(missing)} missing" if missing else "one sensor a finger"
        raise BadHello(f'"sensors" must name {", ".join(FINGERS)} once each: {what}')
    return tuple(value)


def _is_number(value: Any) -> TypeGuard[float]:
    kind = type(value)
    return kind is int or (kind is float and math.isfinite(value))


def _battery(value: Any) -> float | None:
    return round(value, 2) if _is_number(value) and 0 <= value <= 1 else None
