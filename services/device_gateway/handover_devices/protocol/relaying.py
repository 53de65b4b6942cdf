"""Messages between an edge and the central gateway: JSON lines over one TLS connection.

An edge is a device of kind `edge`. Its hello has `relay`, and other messages than those of a device follow:

    {"type":"hello","version":1,"device":"site-1","token":"…","boot":"…","relay":{"stream":"…","time":1712345678.9}}
    {"type":"relay","seq":812,"device":"hall-1","message":{"type":"telemetry","t":1712345670.1,"values":{…}}}
    {"type":"online","device":"hall-1","boot":"7f3a","drives":false,"ageS":12.3}
    {"type":"offline","device":"hall-1"}
    {"type":"ping","n":17}
    {"type":"live","device":"pad-1","message":{"type":"human_input",…},"after":[17,0.02]}

To the edge, after the acknowledged hello, which has the last stored `seq` of the stream as `received`, and
`live` where it takes such messages:

    {"type":"device","name":"hall-1","description":{…},"tokenSha256":"…","certificateSha256":null}
    {"type":"devices","names":["hall-1"]}       all that the edge may relay; the others are removed
    {"type":"removed","name":"hall-1"}
    {"type":"ack","seq":812}                    everything up to this number is stored
    {"type":"error","seq":811,"device":"hall-1","code":"…","reason":"…"}
    {"type":"deliver","device":"hall-1","message":{"type":"command",…},"after":[17,0.02]}
    {"type":"end","device":"hall-1","code":"tokenChanged","reason":"…","retry":false}
    {"type":"pong","n":17}

Numbers of a stream grow, and may have gaps where a full buffer was shortened. `after` bounds the age of a
message without comparing clocks: the gateway sent it so many seconds after it had received that ping, so it
is not older than the time since the edge sent the ping, less these seconds. In the other direction `after`
names the pong that the edge had received. Live messages (`protocol.live`) are never numbered or buffered.
`ageS` says how long the device has been connected: of two connections of one device the younger one counts.

Of several replicas of the central gateway those that do not lead relay to the leader in the same way, after
the hello of a replica, with the token of the leader's term. What they relay is stored already.

    {"type":"hello","version":1,"replica":"gateway-1","token":"…"}
"""

from dataclasses import dataclass, field
from typing import Any, Final

import orjson

from handover_devices.protocol.live import LIVE
from handover_devices.protocol.messages import MAX_LINE_BYTES, MAX_SEQ, BadMessage, is_boot, is_device_name

MAX_RELAYED_BYTES: Final = MAX_LINE_BYTES + 1024
"""A line of an edge: a message of a device, with its number and the name of the device."""
MAX_DELIVERED_BYTES: Final = 1024 * 1024
"""A line to an edge: the description of a device may be long."""


@dataclass(frozen=True, slots=True)
class Relayed:
    """A message of a device, with its number in the stream of the edge."""

    seq: int
    device: str
    line: bytes


@dataclass(frozen=True, slots=True)
class Presence:
    """A device has connected to the edge, or (`boot` is None) has disconnected."""

    device: str
    boot: str | None
    drives: bool = False
    age_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Live:
    """A message that counts only at once; it was sent so many seconds after the pong with this number."""

    device: str
    message: dict[str, Any]
    pong: int
    held_s: float


@dataclass(frozen=True, slots=True)
class Ping:
    """The number of a ping, which the answer repeats."""

    n: int


@dataclass(frozen=True, slots=True)
class ReplicaHello:
    """The first message of a replica to the leader."""

    replica: str
    token: str = field(repr=False)


def parse_replica_hello(line: bytes) -> ReplicaHello | None:
    """Return the hello of a replica; None for any other line."""
    if b'"replica"' not in line:
        return None
    try:
        message: Any = orjson.loads(line)
    except orjson.JSONDecodeError:
        return None
    if not isinstance(message, dict) or message.get("type") != "hello" or "device" in message:
        return None
    replica, token = message.get("replica"), message.get("token")
    return ReplicaHello(replica, token) if isinstance(replica, str) and isinstance(token, str) else None


def parse_relayed(line: bytes) -> Relayed | Presence | Live | Ping:
    """Return a message of an edge; raise `BadMessage`."""
    try:
        fields: Any = orjson.loads(line)
    except orjson.JSONDecodeError as error:
        raise BadMessage("notJson", f"the line is no JSON: {str(error)[:200]}") from None
    kind = fields.get("type") if isinstance(fields, dict) else None
    if kind == "ping":
        return Ping(_number(fields.get("n"), "n"))
    if kind not in ("relay", "online", "offline", "live"):
        raise BadMessage("unknownType", "type must be relay, online, offline, live or ping")
    device = fields.get("device")
    if not isinstance(device, str) or not is_device_name(device):
        raise BadMessage("badRelay", "device must be the name of a device")
    if kind == "relay":
        seq, message = _number(fields.get("seq"), "seq"), fields.get("message")
        if not isinstance(message, dict):
            raise BadMessage("badRelay", "message must be a message of the device", seq)
        return Relayed(seq, device, orjson.dumps(message))
    if kind == "live":
        return _live(device, fields)
    if kind == "offline":
        return Presence(device, None)
    boot, drives = fields.get("boot"), fields.get("drives", False)
    if not isinstance(boot, str) or not is_boot(boot) or not isinstance(drives, bool):
        raise BadMessage("badRelay", "boot must be that of the hello of the device, drives true or false")
    return Presence(device, boot, drives, _seconds(fields.get("ageS", 0.0), "ageS must be seconds"))


def _live(device: str, fields: dict[str, Any]) -> Live:
    message, after = fields.get("message"), fields.get("after")
    if not isinstance(message, dict) or message.get("type") not in LIVE:
        raise BadMessage("badRelay", f"message must have one of the types {', '.join(LIVE)}")
    reason = "after must be the number of a pong and the seconds since then"
    if not isinstance(after, list) or len(after) != len(("pong", "seconds")):
        raise BadMessage("badRelay", reason)
    return Live(device, message, _number(after[0], "after"), _seconds(after[1], reason))


def _seconds(value: Any, reason: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
        raise BadMessage("badRelay", reason)
    return float(value)


def _number(value: Any, name: str) -> int:
    if type(value) is not int or not 0 <= value <= MAX_SEQ:
        raise BadMessage("badSeq", f"{name} must be a whole number from 0 to {MAX_SEQ}")
    return value
