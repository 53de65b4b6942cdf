"""Messages that count only at once: inputs of people who drive, and images of cameras.

    {"type":"human_input","seq":17,"held":true,"axes":{"stylusX":0.2}}
    {"type":"image","data":"…"}
    {"type":"image","frame":5,"part":0,"parts":3,"data":"…"}

They are neither stored nor acknowledged nor repeated. `data` is base64. An image that does not fit into a
line comes in parts, in their order; one with a missing part is dropped.
"""

import binascii
from base64 import b64decode
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import orjson

from handover_devices.protocol.messages import MAX_SEQ, BadMessage

INPUT: Final = "human_input"
IMAGE: Final = "image"
LIVE: Final = (INPUT, IMAGE)
MAX_PARTS: Final = 64


@dataclass(frozen=True, slots=True)
class ImagePart:
    """A part of an image, or a whole one (`parts` is 1); `frame` differs from that of the image before."""

    frame: int
    part: int
    parts: int
    content: bytes


def live_message(line: bytes) -> dict[str, Any] | None:
    """Return the message of a line if it is a live one; others may contain the words."""
    if not any(kind.encode() in line for kind in LIVE):
        return None
    try:
        message = orjson.loads(line)
    except orjson.JSONDecodeError:
        return None
    return message if isinstance(message, dict) and message.get("type") in LIVE else None


def parse_image(message: Mapping[str, Any]) -> ImagePart:
    """Return the part of an image; raise `BadMessage`."""
    frame, part, parts = message.get("frame", 0), message.get("part", 0), message.get("parts", 1)
    if not all(type(number) is int and 0 <= number <= MAX_SEQ for number in (frame, part, parts)):
        raise BadMessage("badImage", "frame, part and parts must be whole numbers, 0 or more")
    if not part < parts <= MAX_PARTS:
        raise BadMessage("badImage", f"an image has 1 to {MAX_PARTS} parts, and part counts from 0")
    data = message.get("data")
    try:
        content = b64decode(data, validate=True) if isinstance(data, str) else b""
    except (binascii.Error, ValueError):
        content = b""
    if not content:
        raise BadMessage("badImage", "data must be the image, or a part of it, in base64")
    return ImagePart(frame, part, parts, content)
