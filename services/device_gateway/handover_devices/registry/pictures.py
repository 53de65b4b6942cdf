"""Pictures of devices: the formats that browsers show and that carry no scripts.

A small file can claim to be a picture of a billion pixels, for which each browser that shows it reserves the
memory. So the size that a file claims is read from its head (PNG IHDR, JPEG SOF, WebP VP8, VP8L and VP8X). A
file without one is not shown by browsers.
"""

import struct
from collections.abc import Iterator
from typing import Final

from handover.errors import Problem

MAX_PICTURE_BYTES: Final = 2 * 1024 * 1024
MAX_SIDE: Final = 8192
MAX_PIXELS: Final = 32 * 1024 * 1024
PICTURE_TYPES: Final = ("image/png", "image/jpeg", "image/webp")


def media_type_of(content: bytes) -> str:
    """Return the media type of a picture by its first bytes.

    Raises `Problem` 422 for other content, and for a picture with too many pixels.
    """
    media_type = _format_of(content)
    for width, height in _sizes_in(content, media_type):
        if max(width, height) > MAX_SIDE or width * height > MAX_PIXELS:
            raise Problem.translated(
                422,
                "Picture too large",
                "device.picture_too_large",
                "the picture has {width} x {height} pixels; make it smaller: at most {side} on a side, "
                "and {million} million in all",
                width=width,
                height=height,
                side=MAX_SIDE,
                million=MAX_PIXELS // 1_000_000,
            )
    return media_type


def _sizes_in(content: bytes, media_type: str) -> Iterator[tuple[int, int]]:
    """Yield the sizes that a picture claims: of the whole, and of frames."""
    if media_type == "image/png" and content[12:16] == b"IHDR" and len(content) >= 24:
        yield struct.unpack_from(">II", content, 16)
    elif media_type == "image/jpeg":
        yield from _sizes_in_jpeg(content)
    elif media_type == "image/webp":
        yield from _sizes_in_webp(content)


def _sizes_in_jpeg(content: bytes) -> Iterator[tuple[int, int]]:
    """Walk the segments up to the first scan; each begins with its marker and its length."""
    at = 2
    while at + 9 <= len(content) and content[at] == 0xFF:
        marker = content[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
            continue
        if marker == 0xDA:
            return
        if 0xC0 <= marker <= 0xCF and marker not in {0xC4, 0xC8, 0xCC}:
            height, width = struct.unpack_from(">HH", content, at + 5)
            yield width, height
        at += 2 + int(struct.unpack_from(">H", content, at + 2)[0])


def _sizes_in_webp(content: bytes) -> Iterator[tuple[int, int]]:
    """Walk the chunks of the RIFF file; each begins with its name and its length, and has an even length."""
    at = 12
    while at + 18 <= len(content):
        name, length = content[at : at + 4], int(struct.unpack_from("<I", content, at + 4)[0])
        data = content[at + 8 : at + 18]
        if name == b"VP8X":
            yield 1 + int.from_bytes(data[4:7], "little"), 1 + int.from_bytes(data[7:10], "little")
        elif name == b"VP8L":
            bits = int.from_bytes(data[1:5], "little")
            yield 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
        elif name == b"VP8 ":
            width, height = struct.unpack_from("<HH", data, 6)
            yield width & 0x3FFF, height & 0x3FFF
        at += 8 + length + length % 2


def _format_of(content: bytes) -> str:
    if content.startswith(b"\x89PNG\r\n\x1a\n"):
        return "image/png"
    if content.startswith(b"\xff\xd8\xff"):
        return "image/jpeg"
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return "image/webp"
    raise Problem.translated(
        422,
        "No picture",
        "device.picture_unusable",
        "the file is no PNG, JPEG or WebP picture; convert it to one of them",
    )
