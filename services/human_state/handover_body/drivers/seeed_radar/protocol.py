"""The frames of the radar (Seeed, MR60BHA1 user manual): `53 59 control command length data sum 54 43`.

The length is big endian; the sum is that of all bytes before it, modulo 256.
"""

from dataclasses import dataclass
from typing import Final

from handover_body.drivers.base import PacketError

HEADER: Final = b"\x53\x59"
TAIL: Final = b"\x54\x43"
MAX_DATA: Final = 64
_FRAME_BYTES: Final = 9  # without data


@dataclass(frozen=True, slots=True)
class RadarFrame:
    """One frame: `control` is the function, `command` the value of it."""

    control: int
    command: int
    data: bytes


class FrameReader:
    """Finds frames in a stream of bytes; memory is bounded by one frame."""

    def __init__(self) -> None:
        self._buffer = b""
        self.skipped = 0
        """Bytes that belonged to no frame."""

    def feed(self, data: bytes) -> list[RadarFrame]:
        """Take the next bytes; return the frames that they complete."""
        buffer, frames, at = self._buffer + data, list[RadarFrame](), 0
        while True:
            start = buffer.find(HEADER, at)
            if start < 0:
                keep = 1 if buffer.endswith(HEADER[:1]) and len(buffer) > at else 0
                self.skipped += len(buffer) - keep - at
                at = len(buffer) - keep
                break
            self.skipped += start - at
            at = start
            if len(buffer) - at < 6:
                break
            length = int.from_bytes(buffer[at + 4 : at + 6], "big")
            if length > MAX_DATA:
                self.skipped += 1
                at += 1
                continue
            end = at + _FRAME_BYTES + length
            if len(buffer) < end:
                break
            whole = buffer[at:end]
            if whole[-2:] == TAIL and sum(whole[:-3]) & 0xFF == whole[-3]:
                frames.append(RadarFrame(whole[2], whole[3], whole[6:-3]))
                at = end
            else:
                self.skipped += 1
                at += 1
        self._buffer = buffer[at:]
        return frames


def build(frame: RadarFrame) -> bytes:
    """Return the bytes of a frame: what a simulated radar sends."""
    body = HEADER + bytes([frame.control, frame.command]) + len(frame.data).to_bytes(2, "big") + frame.data
    return body + bytes([sum(body) & 0xFF]) + TAIL


@dataclass(frozen=True, slots=True)
class Reading:
    """One value of the radar: `kind` is one of `presence`, `movement`, `distance`, `breathing`, `heart`."""

    kind: str
    values: tuple[float, ...]


def read(frame: RadarFrame) -> Reading | None:  # noqa: PLR0911 - one for each command
    """Return the values of a frame, None for those that are not used; raise `PacketError`.

    A rate of 0 is no value: the radar sends it until it has measured one.
    """
    match frame.control, frame.command:
        case 0x80, 0x01:
            return Reading("presence", (float(_byte(frame) != 0),))
        case 0x80, 0x03:
            return Reading("movement", (float(_byte(frame)),)) if _byte(frame) <= 100 else None
        case 0x80, 0x04:
            if len(frame.data) != 2:
                raise PacketError(f"a distance of {len(frame.data)} bytes; it has 2")
            return Reading("distance", (float(int.from_bytes(frame.data, "big")),))
        case 0x81, 0x02:
            return Reading("breathing", (float(_byte(frame)),)) if _byte(frame) else None
        case 0x85, 0x02:
            return Reading("heart", (float(_byte(frame)),)) if _byte(frame) else None
        case (0x81, 0x05) | (0x85, 0x05):
            name = "breathingWave" if frame.control == 0x81 else "heartWave"
            return Reading(name, tuple(octet - 128.0 for octet in frame.data)) if frame.data else None
    return None


def _byte(frame: RadarFrame) -> int:
    if len(frame.data) != 1:
        raise PacketError(f"{len(frame.data)} bytes where the radar sends one")
    return frame.data[0]
