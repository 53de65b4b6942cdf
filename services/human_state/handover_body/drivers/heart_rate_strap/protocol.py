"""The Heart Rate Measurement characteristic, 0x2A37 (Bluetooth SIG, Heart Rate Service 1.0, section 3.1)."""

import struct
from dataclasses import dataclass

from handover_body.drivers.base import PacketError


@dataclass(frozen=True, slots=True)
class HeartRateMeasurement:
    """One notification. `intervals_s` are between beats, oldest first; `has_contact` None: not measured."""

    heart_rate_bpm: int
    intervals_s: tuple[float, ...] = ()
    has_contact: bool | None = None
    energy_kj: int | None = None


def parse(data: bytes) -> HeartRateMeasurement:
    """Return the measurement; raise `PacketError` for what is no whole one."""
    if len(data) < 2:
        raise PacketError(f"a heart rate of {len(data)} bytes; there are at least 2")
    flags, at = data[0], 1
    if flags & 0x01:
        heart_rate, at = _uint16(data, at), 3
    else:
        heart_rate, at = data[1], 2
    has_contact = bool(flags & 0x02) if flags & 0x04 else None
    energy = None
    if flags & 0x08:
        energy, at = _uint16(data, at), at + 2
    rest = data[at:]
    if not flags & 0x10 and rest:
        raise PacketError(f"{len(rest)} bytes after a heart rate without intervals")
    if len(rest) % 2:
        raise PacketError("an interval between beats is cut")
    intervals = tuple(count / 1024 for (count,) in struct.iter_unpack("<H", rest))
    return HeartRateMeasurement(heart_rate, intervals, has_contact, energy)


def build(measurement: HeartRateMeasurement) -> bytes:
    """Return the notification of a strap: what a simulated one sends."""
    is_wide = measurement.heart_rate_bpm > 255
    flags = int(is_wide) | (0x10 if measurement.intervals_s else 0)
    flags |= 0x08 if measurement.energy_kj is not None else 0
    flags |= {None: 0x00, False: 0x04, True: 0x06}[measurement.has_contact]
    data = struct.pack("<BH" if is_wide else "<BB", flags, measurement.heart_rate_bpm)
    if measurement.energy_kj is not None:
        data += struct.pack("<H", measurement.energy_kj)
    return data + b"".join(struct.pack("<H", round(length_s * 1024)) for length_s in measurement.intervals_s)


def _uint16(data: bytes, at: int) -> int:
    if len(data) < at + 2:
        raise PacketError("a heart rate measurement is cut")
    return data[at] | data[at + 1] << 8
