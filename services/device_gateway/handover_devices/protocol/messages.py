"""Messages of the device protocol: JSON objects, one a line, UTF-8, at most 64 KiB.

From the device:

    {"type":"hello","version":1,"device":"hall-1","token":"…","boot":"7f3a","measures":["temperature"],"takes":[]}
    {"type":"telemetry","seq":17,"t":1712345678.9,"values":{"temperature":21.5}}
    {"type":"state","seq":18,"state":"idle","batteryLevel":0.8}
    {"type":"event","seq":19,"name":"buttonPressed","data":{"times":2}}
    {"type":"ack","id":"c-1","state":"running","progress":0.4}
    {"type":"error","id":"c-1","reason":"the gripper is blocked"}

To the device:

    {"type":"command","id":"c-1","name":"moveTo","parameters":{},"deadline":1712345700.0,"remaining":21.1}
    {"type":"ack","seq":17}
    {"type":"error","seq":18,"code":"unknownValue","reason":"…","retry":false}

`t` and `deadline` are seconds since 1970 in UTC. A message is accepted or refused as a whole. Every function
raises `BadMessage`, which has a code for programs and a reason for people.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

import orjson

from handover import messages
from handover.errors import HandoverError
from handover_datamodels.states import DeviceState

VERSION: Final = 1
MAX_LINE_BYTES: Final = 64 * 1024
MAX_VALUES: Final = 256
"""Values in one telemetry message."""
MAX_TEXT: Final = 1_000
"""Characters of a reason."""
MAX_NAMES: Final = 256
MAX_SEQ: Final = 2**53

_DEVICE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]{0,63}")
_BOOT = re.compile(r"[A-Za-z0-9_.-]{0,64}")
_STATES: Final = ", ".join(DeviceState)


class BadMessage(HandoverError):
    """A line that the gateway refuses; `seq` is that of the message, if it could be read."""

    def __init__(self, code: str, reason: str, seq: int | None = None) -> None:
        super().__init__(reason)
        self.code = code
        self.seq = seq


class AnswerState(StrEnum):
    """What a device says about a command in its `ack`."""

    ACCEPTED = "accepted"
    RUNNING = "running"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class RelayHello:
    """What an edge adds to its hello: the stream of its numbers, and its time in seconds since 1970."""

    stream: str
    time: float


@dataclass(frozen=True, slots=True)
class Hello:
    """The first message of a connection; `boot` differs after each start of the device's program."""

    device: str
    token: str = field(repr=False)
    boot: str = ""
    measures: tuple[str, ...] = ()
    takes: tuple[str, ...] = ()
    drives: bool = False
    """Whether the program follows the velocities of `drive` messages."""
    relay: RelayHello | None = None
    """Given by an edge, which relays other devices (`protocol.relaying`)."""


@dataclass(frozen=True, slots=True)
class Telemetry:
    """Values of one moment; booleans are 0 and 1. `t` is None if the device has no clock."""

    seq: int | None
    t: float | None
    values: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class StateReport:
    """The state of the device, and how full its battery is (0 to 1)."""

    seq: int | None
    t: float | None
    state: DeviceState
    battery_level: float | None


@dataclass(frozen=True, slots=True)
class DeviceEvent:
    """Something that happened at the device."""

    seq: int | None
    t: float | None
    name: str
    data: Any


@dataclass(frozen=True, slots=True)
class CommandAnswer:
    """The answer to a command; `state` is None if the device reports an error with `reason`."""

    id: str
    state: AnswerState | None
    progress: float | None = None
    result: Mapping[str, Any] | None = None
    reason: str = ""


Message = Telemetry | StateReport | DeviceEvent | CommandAnswer


def is_device_name(name: str) -> bool:
    """Return whether `name` can be the name of a device, which is a part of its URN."""
    return _DEVICE.fullmatch(name) is not None


def is_value_name(name: str) -> bool:
    """Return whether `name` can be the name of a value, a command or an event."""
    return _NAME.fullmatch(name) is not None


def is_boot(boot: str) -> bool:
    """Return whether `boot` can identify a run of a program."""
    return _BOOT.fullmatch(boot) is not None


def encode(message: Mapping[str, Any]) -> bytes:
    """Return `message` as a line."""
    return orjson.dumps(message) + b"\n"


def parse_hello(line: bytes, *, needs_token: bool = True) -> Hello:
    """Return the hello of a connection; without `needs_token` the token may be missing, and is empty then."""
    message = _object(line)
    if message.get("type") != "hello":
        raise BadMessage("noHello", 'the first message must have the type "hello"')
    version = message.get("version")
    if version != VERSION or isinstance(version, bool):
        raise BadMessage("version", f"version must be {VERSION}, the version of the protocol")
    device, token, boot = message.get("device"), message.get("token", ""), message.get("boot", "")
    if not isinstance(device, str) or not is_device_name(device):
        raise BadMessage("badHello", "device must be 1 to 64 letters, digits, '_', '.' or '-'")
    if not isinstance(token, str) or (needs_token and not token) or len(token) > 256:
        raise BadMessage(
            "badHello",
            "token must be the token of the device, which was shown when it was added, or the device "
            "must show its certificate",
        )
    if not isinstance(boot, str) or not is_boot(boot):
        raise BadMessage("badHello", "boot must be up to 64 letters, digits, '_', '.' or '-'")
    drives = message.get("drives", False)
    if not isinstance(drives, bool):
        raise BadMessage("badHello", "drives must be true or false")
    measures, takes = _names(message, "measures"), _names(message, "takes")
    return Hello(device, token, boot, measures, takes, drives, _relay(message))


def parse_message(line: bytes, max_bytes: int = MAX_LINE_BYTES) -> Message:
    """Return a message after the hello."""
    message = _object(line, max_bytes)
    kind = message.get("type")
    if kind == "telemetry":
        return _telemetry(message)
    if kind == "state":
        return _state(message)
    if kind == "event":
        return _event(message)
    if kind in ("ack", "error"):
        return _answer(message, is_error=kind == "error")
    seq = _seq(message)
    if kind == "hello":
        raise BadMessage("unknownType", "the hello was accepted already; send it once a connection", seq)
    shown = kind[:64] if isinstance(kind, str) else "no text"
    raise BadMessage("unknownType", f"type is {shown}; it must be telemetry, state, event, ack or error", seq)


def _relay(message: Mapping[str, Any]) -> RelayHello | None:
    relay = message.get("relay")
    if relay is None:
        return None
    stream, at = (
        (relay.get("stream"), _number(relay.get("time"))) if isinstance(relay, dict) else (None, None)
    )
    if not isinstance(stream, str) or not stream or not is_boot(stream) or at is None:
        raise BadMessage("badHello", "relay must have the stream of the edge and its time")
    return RelayHello(stream, at)


def _object(line: bytes, max_bytes: int = MAX_LINE_BYTES) -> dict[str, Any]:
    if len(line) > max_bytes:
        raise BadMessage("tooLong", f"a line has at most {MAX_LINE_BYTES} bytes; send less at once")
    try:
        message = orjson.loads(line)
    except orjson.JSONDecodeError as error:
        hint = ""
        if b"NaN" in line or b"Infinity" in line:
            hint = "; NaN and Infinity are no JSON, leave out a value that is missing"
        raise BadMessage("notJson", f"the line is no JSON: {str(error)[:200]}{hint}") from None
    if not isinstance(message, dict):
        raise BadMessage("notJson", "a line must be a JSON object")
    return message


def _telemetry(message: Mapping[str, Any]) -> Telemetry:
    seq = _seq(message)
    values = message.get("values")
    if not isinstance(values, dict) or not values:
        raise BadMessage("badValues", "values must be an object with at least one value by name", seq)
    if len(values) > MAX_VALUES:
        raise BadMessage("badValues", f"a message has at most {MAX_VALUES} values; send several", seq)
    read = {name: _number(value) for name, value in values.items()}
    for name, value in read.items():
        if value is None:
            raise BadMessage(
                "badValue", f'the value "{name[:64]}" must be a finite number, true or false', seq
            )
    return Telemetry(seq, _time(message, seq), read)  # type: ignore[arg-type]


def _state(message: Mapping[str, Any]) -> StateReport:
    seq = _seq(message)
    try:
        state = DeviceState(str(message.get("state")))
    except ValueError:
        raise BadMessage("badState", f"state must be one of {_STATES}", seq) from None
    level = message.get("batteryLevel")
    if level is not None:
        level = _number(level)
        if level is None or not 0 <= level <= 1:
            raise BadMessage("badState", "batteryLevel must be a number from 0 to 1", seq)
    return StateReport(seq, _time(message, seq), state, level)


def _event(message: Mapping[str, Any]) -> DeviceEvent:
    seq = _seq(message)
    name = message.get("name")
    if not isinstance(name, str) or not is_value_name(name):
        raise BadMessage("badEvent", "name must be 1 to 64 letters, digits, '_', '.' or '-'", seq)
    return DeviceEvent(seq, _time(message, seq), name, message.get("data"))


def _reason(message: Mapping[str, Any]) -> str:
    """Return the reason of an error: with its code if an edge or a replica gave it with one."""
    coded = messages.message_in(message, "reason")
    if isinstance(coded, messages.Message) and len(coded) <= MAX_TEXT:
        return coded
    return str(message.get("reason", ""))[:MAX_TEXT] or messages.message(
        "device.command_no_reason", "the device gave no reason"
    )


def _answer(message: Mapping[str, Any], *, is_error: bool) -> CommandAnswer:
    identifier = message.get("id")
    if not isinstance(identifier, str) or not 0 < len(identifier) <= 128:
        raise BadMessage("badAnswer", "id must be that of the command that the message answers")
    if is_error:
        return CommandAnswer(identifier, None, reason=_reason(message))
    try:
        state = AnswerState(message.get("state", AnswerState.DONE))
    except ValueError:
        raise BadMessage("badAnswer", f"state must be one of {', '.join(AnswerState)}") from None
    progress = message.get("progress")
    if progress is not None:
        progress = _number(progress)
        if progress is None or not 0 <= progress <= 1:
            raise BadMessage("badAnswer", "progress must be a number from 0 to 1")
    result = message.get("result")
    if result is not None and not isinstance(result, dict):
        raise BadMessage("badAnswer", "result must be an object")
    return CommandAnswer(identifier, state, progress, result)


def _seq(message: Mapping[str, Any]) -> int | None:
    seq = message.get("seq")
    if seq is None:
        return None
    if type(seq) is not int or not 0 <= seq <= MAX_SEQ:
        raise BadMessage("badSeq", f"seq must be a whole number from 0 to {MAX_SEQ}")
    return seq


def _time(message: Mapping[str, Any], seq: int | None) -> float | None:
    t = message.get("t")
    if t is None:
        return None
    read = None if isinstance(t, bool) else _number(t)
    if read is None:
        raise BadMessage("badTime", "t must be the time in seconds since 1970 in UTC", seq)
    return read


def _number(value: Any) -> float | None:
    """Return a finite number or a boolean as a float; None for anything else."""
    if type(value) is float:
        return value if math.isfinite(value) else None
    if isinstance(value, int):  # orjson reads larger ones as floats, so the conversion cannot overflow
        return float(value)
    return None


def _names(message: Mapping[str, Any], member: str) -> tuple[str, ...]:
    names = message.get(member, [])
    if not isinstance(names, list) or len(names) > MAX_NAMES:
        raise BadMessage("badHello", f"{member} must be a list of at most {MAX_NAMES} names")
    if not all(isinstance(name, str) and is_value_name(name) for name in names):
        raise BadMessage(
            "badHello",
            f"{member}: a name has 1 to 64 letters, digits, '_', '.' or '-', a letter or '_' first",
        )
    return tuple(names)
