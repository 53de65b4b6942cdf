"""Pictures of devices: the formats that browsers show and that carry no scripts."""

from typing import Final

from handover.errors import Problem
from handover.messages import message

MAX_PICTURE_BYTES: Final = 2 * 1024 * 1024
PICTURE_TYPES: Final = ("image/png", "image/jpeg", "image/webp")


def media_type_of(content: bytes) -> str:
    """Return the media type of a picture by its first bytes; raise `Problem` 422 for other content."""
    if content.startswith(b"\x89PNG\r\n\x1a\n"):
        return "image/png"
    if content.startswith(b"\xff\xd8\xff"):
        return "image/jpeg"
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return "image/webp"
    raise Problem(
        422,
        "No picture",
        message(
            "device.picture_unusable", "the file is no PNG, JPEG or WebP picture; convert it to one of them"
        ),
    )
