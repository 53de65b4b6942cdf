"""The wire protocol of gloves: one JSON object a line.

A hello comes first (name, hand, token), then frames: five raw bend values, thumb first, higher is straighter,
with a time in seconds on the clock of the computer that the glove is paired with.
"""

import json
import math
import re
from dataclasses import dataclass, field
from typing import Any, TypeGuard

from glove_sdk_bridge.errors import BadLine

FINGERS: tuple[str, ...] = ("thumb", "index", "middle", "ring", "little")
HANDS = ("right", "left")
VERSION = 1
MAX_LINE_BYTES = 64 * 1024
MAX_VALUE = 1e12
"""The largest valid number of a sensor or a clock."""

_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")

Number = int | float
Five = tuple[Number, Number, Number, Number, Number]


@dataclass(frozen=True, slots=True)
class Frame:
    """Values measured at `t_s` (monotonic seconds); `bend` is raw, thumb first, higher is straighter.

    `pressure` (raw, thumb first) and `battery` (0 to 1) are None if the glove does not have them.
    """

    t_s: float
    bend: Five
    seq: int = 0
    pressure: Five | None = None
    battery: float | None = None

    def encode(self) -> bytes:
        """Return the frame as a line."""
        words: dict[str, Any] = {"type": "frame", "seq": self.seq, "t": round(self.t_s, 6), "bend": self.bend}
        if self.pressure is not None:
            words["pressure"] = self.pressure
        if self.battery is not None:
            words["battery"] = self.battery
        return _line(words)


@dataclass(frozen=True, slots=True)
class Hello:
    """The first line of a glove; `sensors` is the order of the fingers in its frames."""

    glove: str
    hand: str = "right"
    token: str = field(default="", repr=False)
    sensors: tuple[str, ...] = FINGERS

    def encode(self) -> bytes:
        """Return the hello as a line, with the token if there is one."""
        words: dict[str, Any] = {"type": "hello", "version": VERSION, "glove": self.glove, "hand": self.hand}
        if self.token:
            words["token"] = self.token
        return _line({**words, "sensors": self.sensors})


def parse_frame(line: bytes | str, sensors: tuple[str, ...] = FINGERS) -> Frame:
    """Return the frame in `line`, whose values are in the order of `sensors`.

    Raises `BadLine` if it is no frame, or if a number is not finite.
    """
    message = parse_object(line)
    if message.get("type") != "frame":
        raise BadLine('a frame has the type "frame"')
    if not is_number(message.get("t")):
        raise BadLine('a frame needs the time "t" in seconds')
    return frame_of(message, message["t"], sensors)


def frame_of(message: dict[str, Any], t_s: float, sensors: tuple[str, ...] = FINGERS) -> Frame:
    """Return the frame at `t_s` with the values in `given`; raises `BadLine`."""
    seq, pressure, battery = message.get("seq", 0), message.get("pressure"), message.get("battery")
    if type(seq) is not int or not 0 <= seq <= MAX_VALUE:
        raise BadLine('"seq" counts 0, 1, 2, …')
    if battery is not None and not (is_number(battery) and 0 <= battery <= 1):
        raise BadLine('"battery" is a number from 0 to 1')
    return Frame(
        t_s=float(t_s),
        bend=five(message.get("bend"), "bend", sensors),
        seq=seq,
        pressure=None if pressure is None else five(pressure, "pressure", sensors),
        battery=battery,
    )


def parse_hello(line: bytes | str) -> Hello:
    """Return the hello in `line`; raises `BadLine`."""
    message = parse_object(line)
    if message.get("type") != "hello":
        raise BadLine('a hello has the type "hello"')
    if message.get("version") != VERSION:
        raise BadLine(f"only version {VERSION} is supported")
    name, hand, token = message.get("glove"), message.get("hand", HANDS[0]), message.get("token", "")
    if not is_glove_name(name):
        raise BadLine('"glove" must be 1 to 64 letters, digits, ".", "_" or "-"')
    if hand not in HANDS:
        raise BadLine('"hand" must be "right" or "left"')
    if not isinstance(token, str):
        raise BadLine('"token" must be a text')
    sensors = message.get("sensors", list(FINGERS))
    named = sensors if isinstance(sensors, list) else []
    if not all(isinstance(finger, str) for finger in named) or sorted(named) != sorted(FINGERS):
        raise BadLine(f'"sensors" must name {", ".join(FINGERS)}, each once')
    return Hello(name, hand, token, tuple(named))


def parse_object(line: bytes | str) -> dict[str, Any]:
    """Return the JSON object in `line`; raises `BadLine`."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        raise BadLine("not JSON") from None
    if not isinstance(message, dict):
        raise BadLine("not a JSON object")
    return message


def five(values: object, what: str, sensors: tuple[str, ...] = FINGERS) -> Five:
    """Return five `values`, which are in the order of `sensors`, thumb first; raises `BadLine`."""
    if not isinstance(values, list | tuple):
        raise BadLine(f'"{what}" must be a list of five numbers')
    if len(values) != len(FINGERS):
        raise BadLine(f'"{what}" needs five numbers, one a finger')
    if not all(is_number(value) for value in values):
        raise BadLine(f'"{what}" must hold finite numbers')
    thumb, index, middle, ring, little = (values[sensors.index(finger)] for finger in FINGERS)
    return thumb, index, middle, ring, little


def is_number(value: object) -> TypeGuard[Number]:
    """Return True if `value` is a finite number within the valid range."""
    if type(value) is int:
        return -MAX_VALUE <= value <= MAX_VALUE
    return type(value) is float and math.isfinite(value) and abs(value) <= MAX_VALUE


def is_glove_name(name: object) -> TypeGuard[str]:
    """Return True if `name` is valid for a glove: it becomes part of entity ids, URLs and file names."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None and name.strip(".") != ""


def _line(words: dict[str, Any]) -> bytes:
    return json.dumps(words, separators=(",", ":"), allow_nan=False).encode() + b"\n"
